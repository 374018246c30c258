#include "core/diffusion.h"

#include <math.h>

#define CORE_REAL 64
#include "core/kernel.h"

/* ---- nodes in time ----------------------------------------------------------------------------
 */

/* The integrand is analytic for |Im s| < pi / 2, which makes the error of a step h about
 * e^(-pi^2 / h); SAFETY holds what is in front of it. */
#define PI_SQUARED 9.86960440108935862
#define SAFETY 8.0

/* e^(-rate t - r^2 / (4 D t)) underflows for every r whose saddle point lies at p = SADDLE_LAST;
 * the Gaussian around it has the width 1 in p. */
#define SADDLE_LAST 38.7
#define SADDLE_WIDTH 6.5

/* Below it p = e^s to the last digit, and e^s is taken from its own exponent. */
static double softplus(double s) {
  const double e = real_exp(-fabs(s)).exp;
  const double bend = e < 1e-5 ? e * (1 - e * (0.5 - e / 3)) : real_log(1 + e, 0);
  return s > 0 ? s + bend : bend;
}

/* scaled: positive, infinity included. */
static double s_of_time(double scaled) {
  /* p + p^2 / 4 = scaled */
  if (scaled > 1e6) {
    return 2 * sqrt(scaled);
  }
  const double p = 2 * scaled / (1 + sqrt(1 + scaled));
  return p > 30 ? p : p < 1e-8 ? real_log(p, 0) : real_log(1 / real_exp(-p).exp - 1, 0);
}

core_times core_times_make(double rate, double earliest, double latest, double tolerance) {
  core_times times = {.rate = rate};
  times.step = PI_SQUARED / (SAFETY - real_log(tolerance, 0));
  times.first = s_of_time(rate * earliest);
  const double last = fmin(SADDLE_LAST + SADDLE_WIDTH, s_of_time(rate * latest));
  /* When the decay has ended everything before the earliest time, one node tells that. */
  times.count = (size_t)fmax(ceil((last - times.first) / times.step), 0) + 1;
  return times;
}

void core_times_node(const core_times *times, size_t i, double *time, double *weight) {
  const double s = fma((double)i, times->step, times->first);
  const double p = softplus(s);
  const double e = real_exp(-fabs(s)).exp;
  const double dp = s > 0 ? 1 / (1 + e) : e / (1 + e);
  *time = p * fma(0.25, p, 1) / times->rate;
  *weight = times->step * dp * fma(0.5, p, 1) / times->rate;
}

/* ---- the complementary error function ---------------------------------------------------------
 */

/* Hunter, Regan 1972 (after Goodwin 1949): with t_n = (n + 1/2) h,
 *   e^(x^2) erfc(x) = 2 h / pi sum_n e^(-t_n^2) x / (t_n^2 + x^2) + 2 e^(x^2) / (e^(2 pi x / h) + 1)
 * for x < pi / h, and without the last term beyond; its error is below e^(-(pi / h)^2). */
#define H 0.5
enum { TERMS = 13 };
#define LAST_POLE 6.28318530717958647693

static double pole(double x) {
  const double gone = real_exp(-(12.5663706143591729539 - x) * x).exp; /* e^(x^2 - 2 pi x / h) */
  const double whole = real_exp(-12.5663706143591729539 * x).exp;
  return x < LAST_POLE ? 2 * gone / (1 + whole) : 0;
}

double core_erfcx(double x) {
  double sum = 0;
  for (int n = 0; n < TERMS; n++) {
    const double t = (n + 0.5) * H;
    sum = fma(real_exp(-t * t).exp, x / fma(t, t, x * x), sum);
  }
  return fma(2 * H / 3.14159265358979323846, sum, pole(x));
}

double core_erfcx_shortfall(double x) {
  /* the sum of 2 h / pi e^(-t^2) is 1 / sqrt(pi), and 1 / x - x / (t^2 + x^2) = t^2 / (x (...)) */
  double sum = 0;
  for (int n = 0; n < TERMS; n++) {
    const double t = (n + 0.5) * H;
    sum = fma(real_exp(-t * t).exp, t * t / (x * fma(t, t, x * x)), sum);
  }
  return fma(2 * H / 3.14159265358979323846, sum, -pole(x));
}

double core_erfcx_fall(double x, double further) {
  const double y = x + further;
  if (x < LAST_POLE) {
    return core_erfcx(x) - core_erfcx(y);
  }
  double sum = 0;
  for (int n = 0; n < TERMS; n++) {
    const double t = (n + 0.5) * H;
    sum = fma(real_exp(-t * t).exp,
              further * fma(x, y, -t * t) / (fma(t, t, x * x) * fma(t, t, y * y)), sum);
  }
  return 2 * H / 3.14159265358979323846 * sum;
}
