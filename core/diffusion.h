/* diffusion: a diffusing cloud over time as a sum of Gaussians, to a tolerance.
 *
 * A cloud that started at time 0 has at time t the profile e^(-r^2 / (4 D t)) / (4 pi D t) across;
 * what leaves is an integral over t. With t = t(s) the integrand is analytic and ends like an
 * exponential or faster on both sides, so that the trapezoidal rule in s converges exponentially
 * with the number of nodes (Trefethen, Weideman 2014, "The exponentially convergent trapezoidal
 * rule"): a factor of 10 in accuracy costs about a tenth more Gaussians, not ten times as many as
 * with the piecewise constant rule of d'Eon and Irving 2011.
 *
 *   t(s) = (p + p^2 / 4) / rate,  p = ln(1 + e^s)
 *
 * is e^s / rate while the decay e^(-rate t) does nothing yet, and then widens to s^2 / (4 rate),
 * which follows the saddle point of e^(-rate t - r^2 / (4 D t)) at equal accuracy for every r.
 */
#ifndef DIPOLED_CORE_DIFFUSION_H
#define DIPOLED_CORE_DIFFUSION_H

#include <stddef.h>

typedef struct core_times {
  double step;  /* in s */
  double first; /* s of the first node */
  size_t count;
  double rate;
} core_times;

/* Nodes from time `earliest` to time `latest` for a decay e^(-rate t), rate > 0: what comes before
 * and after is not needed. tolerance: the relative error of the sum, 1e-12 to 0.1. There is at least
 * one node. */
core_times core_times_make(double rate, double earliest, double latest, double tolerance);

/* The time after which nothing is left, for a decay e^(-rate t), of all profiles
 * e^(-rate t - r^2 / (4 D t)) with r sqrt(rate / D) up to `exponent`. The saddle point of such a
 * profile lies at p + p^2 / 4 = exponent / 2, and around it the profile is e^(-(change of p)^2). */
double core_times_latest(double rate, double exponent);

/* Node i: its time, and its weight: the sum of weight f(time) is the integral of f. */
void core_times_node(const core_times *times, size_t i, double *time, double *weight);

/* e^(x^2) erfc(x) and 1 / (sqrt(pi) x) - e^(x^2) erfc(x) for x >= 0 (the second: x > 0), and
 * e^(x^2) erfc(x) - e^(y^2) erfc(y) for y = x + further, further >= 0; relative error below 1e-13.
 */
double core_erfcx(double x);
double core_erfcx_shortfall(double x);
double core_erfcx_fall(double x, double further);

/* ln of R(r) = int e^(-rate t) H(t) e^(-rho^2 / (4 D t)) / (4 pi D t) dt where R itself has
 * underflowed: by a Gauss-Hermite rule around the saddle point t_0 of the exponentials, with
 * t = t_0 e^u, E = rho sqrt(rate / D) and w = 2 sqrt(E) sinh(u / 2):
 *   R = e^(-E) / (4 pi D) int H(t) e^(-w^2 / 2) / sqrt(E + w^2 / 4) dw
 * E: at least 500, which makes the rule exact to a rounding error for an H that varies by powers of
 * t. H is called with its context and t, and is positive. */
typedef double core_diffusion_function(const void *context, double time);
double core_diffusion_ln(double rate, double diffusion, double rho, core_diffusion_function *h,
                         const void *context);

#endif
