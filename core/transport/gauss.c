#include "core/transport/gauss.h"

#include <assert.h>

#include "core/transport/functions.h"

struct legendre {
  double value;
  double slope;
};

/* Returns P_n and its derivative at x in (-1, 1), by the three-term recurrence (Abramowitz and
 * Stegun, 8.5.3 and 8.5.4). */
static struct legendre legendre(size_t n, double x) {
  double before = 1;
  double now = x;
  for (size_t j = 2; j <= n; j++) {
    const double next = ((2.0 * (double)j - 1) * x * now - ((double)j - 1) * before) / (double)j;
    before = now;
    now = next;
  }
  return (struct legendre){now, (double)n * (x * now - before) / (x * x - 1)};
}

/* Each root comes from Newton's method, which starts from Tricomi's estimate of the i-th root from
 * above. That estimate is so near that three steps are more than enough. On (-1, 1) the weight is 2
 * / ((1 - x^2) P_n'(x)^2) (Abramowitz and Stegun, 25.4.29 and 22.16.6); on (0, 1) it is half of
 * that. Roots come in pairs +-x. */
void transport_gauss(gauss_rule *rule, size_t n) {
  assert(n >= 1 && n <= GAUSS_MAX);
  rule->n = n;
  const double m = (double)n;
  for (size_t i = 0; i < (n + 1) / 2; i++) {
    double sine, x;
    fn_sincos(FN_PI * ((double)i + 0.75) / (m + 0.5), &sine, &x);
    x *= 1 - (m - 1) / (8 * m * m * m);
    struct legendre p = legendre(n, x);
    for (int step = 0; step < 3; step++) {
      x -= p.value / p.slope;
      p = legendre(n, x);
    }
    const double weight = 1 / ((1 - x * x) * p.slope * p.slope);
    rule->x[i] = 0.5 * (1 - x);
    rule->x[n - 1 - i] = 0.5 * (1 + x);
    rule->weight[i] = rule->weight[n - 1 - i] = weight;
  }
}
