#include "core/transport/decay.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>

#include "core/transport/functions.h"

/* x = atanh(kappa) solves tanh(x) / x = a. The code uses Newton's method from x = 1 / a, from where
 * it converges from one side. For weak absorption this would lose digits, so there the code solves
 * for kappa in the series
 *
 *   atanh(kappa) / kappa = 1 + kappa^2 / 3 + kappa^4 / 5 + ... = 1 / a.
 */
double transport_kappa(double albedo) {
  if (albedo > 0.999) {
    const double excess = (1 - albedo) / albedo;
    double square = 0;
    for (int i = 0; i < 6; i++) {
      square = excess / (1.0 / 3 + square * (1.0 / 5 + square * (1.0 / 7 + square / 9)));
    }
    return sqrt(square);
  }
  if (albedo < 0.04) {
    return 1; /* kappa is 1 within 1e-20 here */
  }
  double x = 1 / albedo;
  double tanh_x = 1;
  for (int i = 0; i < 60; i++) {
    const double before = x, e = fn_exp(-2 * x);
    tanh_x = (1 - e) / (1 + e);
    x -= (albedo * x - tanh_x) / (albedo - (1 - tanh_x * tanh_x));
    if (fabs(x - before) < 1e-15 * x) {
      break;
    }
  }
  return tanh_x;
}

/* 1 / kappa is the largest eigenvalue u of the symmetric tridiagonal matrix with l / sqrt(h_(l-1)
 * h_l) beside its diagonal, h_l = (2 l + 1) (1 - a g_l): the largest root of
 *
 *   f(u) = p_0, p_l = h_l u - (l + 1)^2 / p_(l+1).
 *
 * f is concave and ascends where p_1, p_2, ... are positive, so that Newton's steps from below
 * ascend to the root, and those from above leap below it. */
enum { TERMS = 600 };

struct pivot {
  double value;
  double slope; /* by u */
  bool good;    /* p_1, p_2, ... are positive */
};

/* Returns p_0. Where a g_l is small the fraction converges by (u - sqrt(u^2 - 1))^2 at each l. */
static struct pivot pivot_at(const double *moment, size_t moments, double albedo, double reversed,
                             double absorbed, double u) {
  size_t l = 0;
  while (l < moments && albedo * moment[l] > 0.1) {
    l++;
  }
  /* less than -ln of that factor */
  const double converges = u > 1 ? fmin(sqrt((u - 1) * (u + 1)), 1) : 0;
  l = converges * (double)(TERMS - l) > 40 ? l + (size_t)(40 / converges) : TERMS;
  struct pivot pivot = {(double)(2 * l - 1) * u, (double)(2 * l - 1), true};
  for (l--; l-- > 0;) {
    const double g = l < moments ? moment[l] : 0, back = l % 2 == 0 ? reversed : -reversed;
    const double h = l > 0 ? (double)(2 * l + 1) * (1 - albedo * g - back) : absorbed;
    const double ratio = (double)(l + 1) / pivot.value;
    pivot.good &= pivot.value > 0;
    pivot.slope = h + ratio * ratio * pivot.slope;
    pivot.value = h * u - ratio * (double)(l + 1);
  }
  return pivot;
}

/* Next to u = 1, where a beam decays, f is in proportion to 1 / ln(u - ENDS), so that Newton's steps are
 * those of ln(u - ENDS). A matrix of TERMS rows has its eigenvalues up to ENDS without scattering. */
#define ENDS (1 - 8e-6)

double transport_decay_rate(const double *moment, size_t moments, double albedo, double reversed,
                            double absorbed) {
  enum { STEPS = 100 };
  const double first = 3 * (1 - albedo * (moments > 1 ? moment[1] : 0) + reversed);
  if (!(absorbed > 0)) {
    return 0;
  }
  double low = 0, high = (double)INFINITY, u = sqrt(1 / (absorbed * first) + 1);
  bool done = false;
  for (int step = 0; step < STEPS && !done; step++) {
    const struct pivot pivot = pivot_at(moment, moments, albedo, reversed, absorbed, u);
    const bool below = !pivot.good || pivot.value < 0;
    *(below ? &low : &high) = u;
    const double share = -pivot.value / (pivot.slope * (u - ENDS));
    const double longer = fabs(share) < 1e-3 ? share : fn_exp(share) - 1;
    const double next = fmax(u + longer * (u - ENDS), 1);
    /* the step after a small one is its square, and a root below 1 counts as 1 */
    done = pivot.good && (fabs(share) < 1e-8 || (u == 1 && !below));
    u = done || (pivot.good && next > low && next < high) ? next
        : high < (double)INFINITY                         ? 0.5 * (low + high)
                                                          : 1.5 * u;
  }
  return 1 / u;
}

double transport_anisotropic_kappa(double albedo, double g) {
  enum { MOMENTS = 200 };
  assert(albedo > 0 && albedo <= 1 && fabs(g) <= 0.99);
  double moment[MOMENTS];
  moment[0] = 1;
  for (size_t l = 1; l < MOMENTS; l++) {
    moment[l] = g * moment[l - 1];
  }
  const double sigma_s = albedo / (1 - g), sigma_t = 1 - albedo + sigma_s;
  return sigma_t *
         transport_decay_rate(moment, MOMENTS, sigma_s / sigma_t, 0, (1 - albedo) / sigma_t);
}
