/* diffusion: writes a cloud of light that diffuses over time as a sum of Gaussians.
 *
 * A cloud that starts at time 0 has the lateral profile e^(-r^2 / (4 D t)) / (4 pi D t) at time t.
 * The light that leaves is an integral of it over t. With t = t(s) the integrand is analytic and
 * falls off like an exponential or faster on both sides, so that the trapezoidal rule in s
 * converges exponentially with the number of nodes (Trefethen, Weideman 2014, "The exponentially
 * convergent trapezoidal rule"): a factor of 10 in accuracy costs about a tenth more Gaussians,
 * where the piecewise constant rule of d'Eon and Irving 2011 needs ten times as many.
 *
 *   t(s) = (p + p^2 / 4) / rate,  p = ln(1 + e^s)
 *
 * is close to e^s / rate while the decay e^(-rate t) is still near 1. Later it grows like s^2 / (4
 * rate), which follows the saddle point of e^(-rate t - r^2 / (4 D t)) at equal accuracy for every
 * r.
 */
#ifndef DIPOLED_CORE_DIFFUSION_H
#define DIPOLED_CORE_DIFFUSION_H

#include <stddef.h>

/* Nodes of the trapezoidal rule: equally spaced in s. */
typedef struct core_times {
  double step;  /* distance of the nodes in s */
  double first; /* value of s at the first node */
  size_t count;
  double rate;
} core_times;

/* Makes at least one node, from time `earliest` to time `latest`, for a decay e^(-rate t) with rate
 * > 0. The caller needs no light that leaves before or after. tolerance: the relative error of the
 * sum, 1e-12 to 0.1. */
core_times core_times_make(double rate, double earliest, double latest, double tolerance);

/* Returns a time. After it every profile e^(-rate t - r^2 / (4 D t)) with r sqrt(rate / D) up to
 * `exponent` is below a rounding error of its largest value. The saddle point of such a profile is
 * at p + p^2 / 4 = exponent / 2; around it the profile is e^(-(change of p)^2). */
double core_times_latest(double rate, double exponent);

/* Sets the time and weight of node i. The integral of f over time is about the sum over all nodes
 * of weight f(time). */
void core_times_node(const core_times *times, size_t i, double *time, double *weight);

/* With E(x) = e^(x^2) erfc(x), these functions return E(x) for x >= 0, 1 / (sqrt(pi) x) - E(x) for
 * x > 0, and E(x) - E(x + further) for further >= 0. Their relative error is below 1e-13. */
double core_erfcx(double x);
double core_erfcx_shortfall(double x);
double core_erfcx_fall(double x, double further);

/* Returns ln of R(rho) = int e^(-rate t) H(t) e^(-rho^2 / (4 D t)) / (4 pi D t) dt where R itself
 * has underflowed. It uses a Gauss-Hermite rule around the saddle point t_0 of the exponentials,
 * with t = t_0 e^u, E = rho sqrt(rate / D) and w = 2 sqrt(E) sinh(u / 2):
 *   R = e^(-E) / (4 pi D) int H(t) e^(-w^2 / 2) / sqrt(E + w^2 / 4) dw
 * E must be at least 500. The rule is then exact to a rounding error for an H that varies like a
 * power of t. The function h returns H(t) > 0 for the context and t. */
typedef double core_diffusion_function(const void *context, double time);
double core_diffusion_ln(double rate, double diffusion, double rho, core_diffusion_function *h,
                         const void *context);

#endif
