#include "core/diffusion.h"

#include <math.h>

#define CORE_REAL 64
#include "core/kernel.h"

/* ---- nodes in time --------------------------------------------------------------------------- */

/* The integrand is analytic for |Im s| < pi / 2, so a step h gives an error of about C e^(-pi^2 /
 * h). SAFETY is an upper bound of ln C. */
#define PI_SQUARED 9.86960440108935862
#define SAFETY 8.0

/* e^(-p^2) is below a rounding error for p of at least this. */
#define SADDLE_WIDTH 6.5

/* Returns ln(1 + e^s). Corrects for the rounding of 1 + e^s. */
static double softplus(double s) {
  const double e = real_exp(-fabs(s)).exp;
  const double sum = 1 + e;
  const double bend = real_log(sum, 0) + (e - (sum - 1)) / sum;
  return s > 0 ? s + bend : bend;
}

/* Returns the s at which rate t(s) = scaled, for scaled from above 0 to infinity. */
static double s_of_time(double scaled) {
  /* p solves p + p^2 / 4 = scaled, and s = ln(e^p - 1). */
  if (scaled > 1e6) {
    return 2 * sqrt(scaled);
  }
  const double p = 2 * scaled / (1 + sqrt(1 + scaled));
  return p > 30 ? p : p < 1e-8 ? real_log(p, 0) : real_log(1 / real_exp(-p).exp - 1, 0);
}

double core_times_latest(double rate, double exponent) {
  const double saddle = 2 * (sqrt(1 + 0.5 * exponent) - 1);
  const double p = saddle + SADDLE_WIDTH;
  return p * fma(0.25, p, 1) / rate;
}

core_times core_times_make(double rate, double earliest, double latest, double tolerance) {
  core_times times = {.rate = rate};
  times.step = PI_SQUARED / (SAFETY - real_log(tolerance, 0));
  times.first = s_of_time(rate * earliest);
  const double last = s_of_time(rate * latest);
  /* If `latest` is before `earliest`, the light has decayed and one node is enough. */
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

/* ---- the complementary error function -------------------------------------------------------- */

/* Hunter, Regan 1972 (after Goodwin 1949): with t_n = (n + 1/2) h,
 *   e^(x^2) erfc(x) = 2 h / pi sum_n e^(-t_n^2) x / (t_n^2 + x^2) + 2 e^(x^2) / (e^(2 pi x / h) +
 *   1)
 * for x < pi / h. For larger x the last term is left out. The error is below e^(-(pi / h)^2). */
#define H 0.5
enum { TERMS = 13 };
#define LAST_POLE 6.28318530717958647693

static double pole(double x) {
  /* exponential factor of the pole's term: e^(x^2 - 2 pi x / h) */
  const double gone = real_exp(-(12.5663706143591729539 - x) * x).exp;
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
  /* 2 h / pi e^(-t^2) sums to 1 / sqrt(pi); 1 / x - x / (t^2 + x^2) is t^2 / (x (t^2 + x^2)). */
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

/* ---- far away -------------------------------------------------------------------------------- */

/* The positive nodes and their weights of the Gauss-Hermite rule for the weight e^(-w^2 / 2). */
static const double hermite[][2] = {
    {0.48493570751549764, 0.8638902213754461},   {1.4659890943911582, 0.3396072806420476},
    {2.4843258416389546, 0.047905628056117255},  {3.581823483551927, 0.0019002020381229435},
    {4.859462828332312, 1.0805203766271025e-05},
};

double core_diffusion_ln(double rate, double diffusion, double rho, core_diffusion_function *h,
                         const void *context) {
  const double exponent = rho * sqrt(rate / diffusion);
  const double saddle = rho / (2 * sqrt(rate * diffusion));
  double sum = 0;
  for (size_t i = 0; i < sizeof hermite / sizeof hermite[0]; i++) {
    const double sinh = hermite[i][0] / (2 * sqrt(exponent));
    /* e^(u / 2) at this node, where w = 2 sqrt(E) sinh(u / 2) */
    const double e = sinh + sqrt(fma(sinh, sinh, 1));
    const double both = h(context, saddle * (e * e)) + h(context, saddle / (e * e));
    sum += hermite[i][1] / sqrt(fma(sinh, sinh, 1)) * both;
  }
  const double per_four_pi = 0.07957747154594766788;
  return real_log(per_four_pi / diffusion * sum, 0) - 0.5 * real_log(exponent, 0) - exponent;
}
