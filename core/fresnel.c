/* The first and second moment of the unpolarized Fresnel reflectance.
 *
 * Exact moments. Let a > b be eta mu and mu_t, the wave's normal components on both sides (for
 * eta < 1 mu_t and eta mu), which satisfy a^2 - b^2 = |eta^2 - 1|. In v = (a - b) / (a + b) every
 * Fresnel factor is rational:
 *
 *   v from v0 = |eta - 1| / (eta + 1) (normal incidence) to 1 (grazing),     u = 1 - v
 *   1 - F_s = u (2 - u)
 *   1 - F_p = 4 eta^2 u (2 - u) / ((2 - u) + eta^2 u)^2                       eta > 1
 *           = 4 eta^2 u (2 - u) / (u + eta^2 (2 - u))^2                       eta < 1
 *   mu dmu  = (eta + 1)^2 / (8 eta^2) v0 u (2 - u) / v^2 dv
 *   mu      = (eta + 1) / (2 eta) sqrt(v0 / v) (2 - u)                        eta > 1
 *           = (eta + 1) / (2 eta) sqrt(v0 / v) u                              eta < 1
 *
 * and total internal reflection is simply outside the range. All terms are positive, no digit is
 * lost for any eta, and the only singularities are v = 0 and a double pole beyond v = 1. Panels
 * that are never longer than their distance to either make the 16-point Gauss-Legendre rule exact
 * to double precision (Bernstein ellipse 3 + sqrt(8): 5.8^-32). Only IEEE operations are used: the
 * same bits on every machine.
 *
 * Fits: E. d'Eon, "A Better Dipole", 2012, Eq. 2 (d'Eon and Irving 2011), and Jensen et al. 2001
 * (Egan and Hilgeman 1973). The terms of the former cancel to 1e-4 of the largest, so all fits are
 * evaluated in double-double with the decimal coefficients exact.
 */
#include <assert.h>

#include "core/core.h"
#include "core/dd.h"

enum { NODES = 8 };

/* Gauss-Legendre, 16 points: the positive nodes and their weights. */
static const double gauss[NODES][2] = {
    {0.98940093499164993259, 0.02715245941175409485},
    {0.94457502307323257607, 0.06225352393864789286},
    {0.86563120238783174388, 0.09515851168249278480},
    {0.75540440835500303389, 0.12462897125553387205},
    {0.61787624440264374844, 0.14959598881657673208},
    {0.45801677765722738634, 0.16915651939500253818},
    {0.28160355077925891323, 0.18260341504492358886},
    {0.09501250983763744018, 0.18945061045506849628},
};

/* What does not change along the integral. */
struct boundary {
  double eta;
  double eta_squared;
  double v0;
};

/* Sums of 1 - F times 2 mu dmu and times 3 mu^2 dmu, without the powers of (eta + 1) / (2 eta). */
struct moments {
  dd first;
  dd second;
};

/* weight: of dv / v0 at v = 1 - u; ratio: v / v0 */
static void add_node(const struct boundary *b, double weight, double ratio, double u,
                     struct moments *sum) {
  const double grazing = u * (2 - u);
  const double larger = 2 - u;
  const double p_amplitude = b->eta > 1 ? larger + b->eta_squared * u : u + b->eta_squared * larger;
  const double p_transmitted = 4 * b->eta_squared * grazing / (p_amplitude * p_amplitude);
  const double transmitted = 0.5 * (grazing + p_transmitted);
  const double measure = weight * grazing / (ratio * ratio);
  const double mu = (b->eta > 1 ? larger : u) / sqrt(ratio);
  sum->first = dd_add(sum->first, dd_from(measure * transmitted));
  sum->second = dd_add(sum->second, dd_from(measure * transmitted * mu));
}

/* from and to: in v / v0 */
static void add_panel_in_v(const struct boundary *b, double from, double to, struct moments *sum) {
  const double half = 0.5 * (to - from);
  const double middle = 0.5 * (to + from);
  for (int i = 0; i < 2 * NODES; i++) {
    const double *node = gauss[i / 2];
    const double ratio = middle + (i % 2 ? half : -half) * node[0];
    add_node(b, half * node[1], ratio, 1 - b->v0 * ratio, sum);
  }
}

/* from and to: in u */
static void add_panel_in_u(const struct boundary *b, double from, double to, struct moments *sum) {
  const double half = 0.5 * (to - from);
  const double middle = 0.5 * (to + from);
  for (int i = 0; i < 2 * NODES; i++) {
    const double *node = gauss[i / 2];
    const double u = middle + (i % 2 ? half : -half) * node[0];
    add_node(b, half * node[1] / b->v0, (1 - u) / b->v0, u, sum);
  }
}

static core_fresnel exact_moments(double eta) {
  if (eta == 1) {
    return (core_fresnel){1, 1};
  }
  const double difference = fabs(eta - 1);
  const struct boundary b = {eta, eta * eta, difference / (eta + 1)};
  const double u0 = (eta > 1 ? 2 : 2 * eta) / (eta + 1);
  struct moments sum = {{0, 0}, {0, 0}};

  /* Near normal incidence, where v may be tiny: panels that double away from v = 0, in v / v0. */
  const double half_ratio = 0.5 / b.v0;
  for (double from = 1; from < half_ratio; from *= 2) {
    add_panel_in_v(&b, from, fmin(2 * from, half_ratio), &sum);
  }
  /* Towards grazing incidence: panels that double away from the pole beyond u = 0. */
  const double u_end = fmin(u0, 0.5);
  const double pole = 2 * fmin(1, b.eta_squared) / (difference * (eta + 1));
  double to = fmin(pole, u_end);
  add_panel_in_u(&b, 0, to, &sum);
  while (to < u_end) {
    const double from = to;
    to = fmin(2 * from, u_end);
    add_panel_in_u(&b, from, to, &sum);
  }

  const dd half_sum = dd_scale(dd_div(dd_two_sum(eta, 1), dd_from(eta)), 0.5);
  const dd squared = dd_mul(half_sum, half_sum);
  return (core_fresnel){
      .one_minus_2c1 = dd_round(dd_mul(squared, sum.first)),
      .one_minus_3c2 =
          dd_round(dd_mul(dd_from(1.5), dd_mul(dd_mul(squared, half_sum), sum.second))),
  };
}

/* Polynomials with coefficients in millionths, from the highest power down. */
static dd polynomial(dd x, const double *millionths, int count) {
  dd sum = dd_from(0);
  for (int i = 0; i < count; i++) {
    sum = dd_add(dd_mul(sum, x), dd_from(millionths[i]));
  }
  return dd_div(sum, dd_from(1e6));
}

#define POLYNOMIAL(x, ...)                                                                         \
  polynomial(x, (const double[]){__VA_ARGS__},                                                     \
             sizeof((const double[]){__VA_ARGS__}) / sizeof(double))

static core_fresnel fitted_moments(double eta) {
  const dd x = dd_from(eta);
  dd first;
  dd second;
  if (eta < 1) {
    first = POLYNOMIAL(x, -1368810, 4985540, -7809890, 6753350, -3479300, 919317);
    second = POLYNOMIAL(x, 145787, 236494, -1952840, 3362310, -2620510, 828421);
  } else {
    first = POLYNOMIAL(x, 254913, -2543960, 10229100, -20929200, 22227200, -9233720);
    const dd inverse = dd_div(dd_from(1), x);
    second = dd_add(POLYNOMIAL(x, 1918260, -27018100, 164798e3, -568556e3, 1213670e3, -1641100e3),
                    POLYNOMIAL(inverse, 135926e3, -656175e3, 1376530e3, 0));
  }
  return (core_fresnel){
      .one_minus_2c1 = dd_round(dd_sub(dd_from(1), first)),
      .one_minus_3c2 = dd_round(dd_sub(dd_from(1), second)),
  };
}

/* F_dr = 2 C1 in Jensen's dipole; its classical boundary needs no second moment. The coefficients
 * are Egan and Hilgeman's four digits, as Donner and Jensen 2005 print them for both sides of 1. */
static core_fresnel jensen_moments(double eta) {
  const dd inverse = dd_div(dd_from(1), dd_from(eta));
  const dd f_dr = eta < 1 ? POLYNOMIAL(inverse, 63600, -331900, 709900, -439900)
                          : dd_add(POLYNOMIAL(inverse, -1439900, 709900, 668100),
                                   POLYNOMIAL(dd_from(eta), 63600, 0));
  return (core_fresnel){
      .one_minus_2c1 = dd_round(dd_sub(dd_from(1), f_dr)),
      .one_minus_3c2 = exact_moments(eta).one_minus_3c2,
  };
}

core_fault core_fresnel_check(enum core_moments moments, double eta) {
  switch (moments) {
#define CORE_MOMENTS(id, IDENT, name, eta_min, eta_max, about)                                     \
  case CORE_MOMENTS_##IDENT:                                                                       \
    return eta >= eta_min && eta <= eta_max                                                        \
               ? (core_fault){0}                                                                   \
               : (core_fault){"eta", #eta_min " to " #eta_max " with moments " name, 0};
#include "core/choices.def"
  }
  assert(!"moments of the list");
  return (core_fault){0};
}

core_fresnel core_fresnel_moments(enum core_moments moments, double eta) {
  assert(core_fresnel_check(moments, eta).field == NULL);
  switch (moments) {
  case CORE_MOMENTS_EXACT:
    return exact_moments(eta);
  case CORE_MOMENTS_FIT:
    return fitted_moments(eta);
  case CORE_MOMENTS_JENSEN:
    return jensen_moments(eta);
  }
  assert(!"moments of the list");
  return (core_fresnel){0, 0};
}
