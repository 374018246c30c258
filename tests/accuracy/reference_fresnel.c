/* C_k is the integral over mu in [0, 1] of F(mu) mu^k, where F is the mean of Fresnel's two
 * reflectances for light that strikes the boundary from inside at cosine mu, and 1 beyond the
 * critical angle. So
 *
 *   1 - 2 C1 = integral of 2 mu   (1 - F) dmu,     1 - 3 C2 = integral of 3 mu^2 (1 - F) dmu
 *
 * over those mu that let light out. F has a square root's singularity where the smaller of the two
 * cosines vanishes: at the critical angle for eta > 1, at mu = 0 for eta < 1. The integrals are
 * taken over that smaller cosine by the tanh-sinh rule, whose points crowd exponentially towards
 * the ends, which also takes care of poles near the end for very large, very small and nearly
 * matched indices. (For eta > 1 it is the outer cosine s: mu dmu = s ds / eta^2.) */
#include "tests/accuracy/reference_fresnel.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- the integrals --------------------------------------------------------------------------- */

/* x = 1 / (1 + e^(-pi sinh t)), dx/dt = pi cosh t x (1 - x), at equal steps of t. Each level halves
 * the step. At |t| = T_MAX the weights are below 1e-70. */
enum { FIRST_STEPS = 8, LEVELS_MAX = 10, T_MAX = 5 };
/* Two levels that agree to this are good to 1e-27. */
#define CONVERGED 1e-19Q

struct point {
  quad x, weight; /* weight: dx/dt */
};

static struct point make_point(quad t) {
  const quad pi = 3.14159265358979323846264338327950288Q, e = expf128(-pi * sinhf128(t));
  const quad x = 1 / (1 + e);
  return (struct point){x, pi * coshf128(t) * x * (e * x)};
}

/* Adds a point over the smaller cosine. Snell's law: eta^2 (1 - mu^2) = 1 - s^2. */
static void add_point(quad eta, struct point point, reference_fresnel *sum) {
  const quad x = point.x;
  const quad mu = eta < 1 ? x : sqrtf128(x * x + (eta * eta - 1)) / eta;
  const quad s = eta < 1 ? sqrtf128(eta * x * eta * x + (1 - eta * eta)) : x;
  const quad a = eta * mu + s, b = mu + eta * s;
  const quad escapes = 2 * eta * mu * s * (1 / (a * a) + 1 / (b * b)); /* 1 - F */
  sum->one_minus_2c1 += point.weight * escapes * x;
  sum->one_minus_3c2 += point.weight * escapes * x * mu;
}

static reference_fresnel integrate(quad eta) {
  static struct point points[2 * T_MAX * (FIRST_STEPS << (LEVELS_MAX - 1)) + 1]; /* of all levels */
  static size_t made;
  size_t next = 0;
  const quad scale = eta < 1 ? 1 : eta * eta;
  reference_fresnel sum = {0, 0}, before = {0, 0};
  for (int level = 0; level < LEVELS_MAX; level++) {
    const int steps = FIRST_STEPS << level; /* for each unit of t; at later levels new ones alone */
    for (int i = -T_MAX * steps + (level > 0); i <= T_MAX * steps; i += level > 0 ? 2 : 1) {
      points[next] = next < made ? points[next] : make_point((quad)i / steps);
      add_point(eta, points[next++], &sum);
      made = next > made ? next : made;
    }
    const reference_fresnel now = {2 * sum.one_minus_2c1 / (steps * scale),
                                   3 * sum.one_minus_3c2 / (steps * scale)};
    if (fabsf128(now.one_minus_2c1 / before.one_minus_2c1 - 1) < CONVERGED &&
        fabsf128(now.one_minus_3c2 / before.one_minus_3c2 - 1) < CONVERGED) {
      return now;
    }
    before = now;
  }
  fprintf(stderr, "reference: the moments' quadrature does not converge\n");
  abort();
}

static reference_fresnel exact(double eta) {
  static struct {
    double eta;
    reference_fresnel moments;
  } kept[1024];
  uint64_t bits;
  memcpy(&bits, &eta, sizeof bits);
  const size_t at = (size_t)(bits * UINT64_C(0x9e3779b97f4a7c15) >> 54);
  if (!(kept[at].eta == eta)) {
    kept[at].moments = integrate((quad)eta);
    kept[at].eta = eta;
  }
  return kept[at].moments;
}

/* ---- the fits ----------------------------------------------------------------------------- */

/* Sums of powers of eta, from -3 to 5: below 1, and from 1 on. */
enum { POWERS = 9 };
typedef const quad fit[2][POWERS];

/* d'Eon 2012, Eq. 2 */
static fit two_c1 = {
    {0, 0, 0, 0.919317Q, -3.4793Q, 6.75335Q, -7.80989Q, 4.98554Q, -1.36881Q},
    {0, 0, 0, -9.23372Q, 22.2272Q, -20.9292Q, 10.2291Q, -2.54396Q, 0.254913Q},
};
static fit three_c2 = {
    {0, 0, 0, 0.828421Q, -2.62051Q, 3.36231Q, -1.95284Q, 0.236494Q, 0.145787Q},
    {135.926Q, -656.175Q, 1376.53Q, -1641.1Q, 1213.67Q, -568.556Q, 164.798Q, -27.0181Q, 1.91826Q},
};

/* C1 and C2 themselves, as renderers print them: Pharr, Jakob, Humphreys, "Physically Based
 * Rendering", 3rd edition, section 11.4.2. */
static fit c1 = {
    {0, 0, 0, 0.45966Q, -1.73965Q, 3.37668Q, -3.904945Q, 2.49277Q, -0.68441Q},
    {0, 0, 0, -4.61686Q, 11.1136Q, -10.4646Q, 5.11455Q, -1.27198Q, 0.12746Q},
};
static fit c2 = {
    {0, 0, 0, 0.27614Q, -0.87350Q, 1.12077Q, -0.65095Q, 0.07883Q, 0.04860Q},
    {45.3087Q, -218.725Q, 458.843Q, -547.033Q, 404.557Q, -189.519Q, 54.9327Q, -9.00603Q, 0.63942Q},
};

/* F_dr, which is 2 C1: Egan and Hilgeman 1973, as in Jensen et al. 2001; Donner and Jensen 2005
 * have both sides of 1. */
static fit f_dr = {
    {0.0636Q, -0.3319Q, 0.7099Q, -0.4399Q},
    {0, -1.4399Q, 0.7099Q, 0.6681Q, 0.0636Q},
};

/* Returns 1 - factor times the sum at eta. */
static quad complement(fit of, int factor, double eta) {
  quad sum = 0, power = 1 / ((quad)eta * (quad)eta * (quad)eta);
  for (int i = 0; i < POWERS; i++) {
    sum += of[eta >= 1][i] * power;
    power *= (quad)eta;
  }
  return 1 - factor * sum;
}

reference_fresnel reference_fresnel_moments(enum core_moments moments, double eta) {
  switch (moments) {
  case CORE_MOMENTS_FIT:
    return (reference_fresnel){complement(two_c1, 1, eta), complement(three_c2, 1, eta)};
  case CORE_MOMENTS_JENSEN:
    return (reference_fresnel){complement(f_dr, 1, eta), exact(eta).one_minus_3c2};
  case CORE_MOMENTS_PBRT:
    return (reference_fresnel){complement(c1, 2, eta), complement(c2, 3, eta)};
  default:
    return exact(eta);
  }
}
