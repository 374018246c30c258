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

/* Nodes from time `earliest` on (what comes before is not needed) for a decay e^(-rate t), rate > 0,
 * or up to time `latest` where that comes before the decay has ended everything; tolerance: the
 * relative error of the sum, 1e-12 to 0.1. */
core_times core_times_make(double rate, double earliest, double latest, double tolerance);

/* Node i: its time, and its weight: the sum of weight f(time) is the integral of f. */
void core_times_node(const core_times *times, size_t i, double *time, double *weight);

/* e^(x^2) erfc(x) and 1 / (sqrt(pi) x) - e^(x^2) erfc(x) for x >= 0 (the second: x > 0), and
 * e^(x^2) erfc(x) - e^(y^2) erfc(y) for y = x + further, further >= 0; relative error below 1e-13.
 */
double core_erfcx(double x);
double core_erfcx_shortfall(double x);
double core_erfcx_fall(double x, double further);

#endif
