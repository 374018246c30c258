/* Computes the first and second moment of the unpolarized Fresnel reflectance.
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
 * and total internal reflection lies outside the range. All terms are positive, so that no eta
 * loses digits. The only singularities are v = 0 and a double pole beyond v = 1. Panels that are
 * never longer than their distance to either make the 16-point Gauss-Legendre rule exact to double
 * precision (Bernstein ellipse 3 + sqrt(8): 5.8^-32). Only IEEE operations are used, so that all
 * machines give the same bits.
 *
 * Fits: E. d'Eon, "A Better Dipole", 2012, Eq. 2 (d'Eon and Irving 2011), and Jensen et al. 2001
 * (Egan and Hilgeman 1973). The terms of the former cancel to 1e-4 of the largest, so all fits are
 * evaluated in double-double with the decimal coefficients exact.
 */
#include <assert.h>

#include "core/core.h"
#include "core/dd.h"
#include "core/gauss.h"

/* Constants of the integrals. They are double-double, because their errors would not average out as
 * the nodes' rounding errors do. */
struct boundary {
  bool denser_inside; /* whether eta > 1 */
  dd eta_squared;
  dd v0;
};

/* Sums over nodes for the integrals of (1 - F) 2 mu dmu and (1 - F) 3 mu^2 dmu, without the factors
 * that are common to all nodes of a range. */
struct moments {
  dd first;
  dd second;
};

/* Adds the node at v to the sums. u is 1 - v; weight is the node's weight for an integral over v.
 */
static void add_node(const struct boundary *b, double weight, double v, double u,
                     struct moments *sum) {
  const double grazing = u * (2 - u);
  const double larger = 2 - u;
  const double amplitude = b->denser_inside
                               ? fma(b->eta_squared.hi, u, larger) + b->eta_squared.lo * u
                               : fma(b->eta_squared.hi, larger, u) + b->eta_squared.lo * larger;
  const double shared = 4 * grazing / (amplitude * amplitude);
  const double p_transmitted = fma(shared, b->eta_squared.hi, shared * b->eta_squared.lo);
  const double transmitted = 0.5 * (grazing + p_transmitted);
  const double measured = weight * grazing / (v * v) * transmitted;
  const double mu = (b->denser_inside ? larger : u) / sqrt(v);
  sum->first = dd_add(sum->first, dd_from(measured));
  sum->second = dd_add(sum->second, dd_from(measured * mu));
}

/* Adds a panel to the sums. end NULL: the variable is v / v0. Otherwise it is (1 - v) / end. */
static void add_panel(const struct boundary *b, const dd *end, double from, double to,
                      struct moments *sum) {
  const double half = 0.5 * (to - from), middle = 0.5 * (to + from);
  for (int i = 0; i < 2 * CORE_GAUSS_HALF; i++) {
    const double *node = core_gauss[i / 2];
    const double at = fma(i % 2 ? half : -half, node[0], middle);
    const double u =
        end != NULL ? fma(end->hi, at, end->lo * at) : fma(-b->v0.hi, at, 1) - b->v0.lo * at;
    add_node(b, half * node[1], end != NULL ? 1 - u : at, u, sum);
  }
}

/* Integrates the part near normal incidence, where v may be tiny. Each panel is twice as long as the
 * one nearer to v = 0. */
static struct moments sum_near_normal(const struct boundary *b) {
  struct moments sum = {{0, 0}, {0, 0}};
  const double end = 0.5 / dd_round(b->v0);
  for (double from = 1; from < end; from *= 2) {
    add_panel(b, NULL, from, fmin(2 * from, end), &sum);
  }
  return sum;
}

/* Integrates the part near grazing incidence: u = 1 - v from 0 to end. A pole lies at u = -pole, so
 * the panels grow with their distance to it. */
static struct moments sum_near_grazing(const struct boundary *b, dd end, double pole) {
  struct moments sum = {{0, 0}, {0, 0}};
  double to = fmin(pole / dd_round(end), 1);
  for (double from = 0; from < 1; from = to, to = fmin(2 * to, 1)) {
    add_panel(b, &end, from, to, &sum);
  }
  return sum;
}

static core_fresnel integrate_moments(double eta) {
  if (eta == 1) {
    return (core_fresnel){1, 1};
  }
  const dd eta_plus_1 = dd_two_sum(eta, 1);
  const dd difference = eta > 1 ? dd_two_sum(eta, -1) : dd_two_sum(1, -eta);
  const struct boundary b = {
      .denser_inside = eta > 1,
      .eta_squared = dd_two_product(eta, eta),
      .v0 = dd_div(difference, eta_plus_1),
  };
  const dd u0 = dd_div(dd_from(eta > 1 ? 2 : 2 * eta), eta_plus_1);
  const dd end = dd_round(u0) < 0.5 ? u0 : dd_from(0.5);
  const double pole = 2 * fmin(1, eta * eta) / (difference.hi * eta_plus_1.hi);
  const struct moments normal = sum_near_normal(&b);
  const struct moments grazing = sum_near_grazing(&b, end, pole);

  /* The factors that add_node() has left out follow from dv = v0 dratio, v0 / v^2 = 1 / (v0
   * ratio^2) and du = end dshare. */
  const dd root = dd_sqrt(b.v0);
  const dd weight = dd_mul(b.v0, end);
  const dd first = dd_add(normal.first, dd_mul(weight, grazing.first));
  const dd second = dd_add(normal.second, dd_mul(dd_mul(weight, root), grazing.second));
  const dd half_sum = dd_scale(dd_div(eta_plus_1, dd_from(eta)), 0.5);
  const dd squared = dd_mul(half_sum, half_sum);
  const dd cubed = dd_mul(squared, half_sum);
  return (core_fresnel){
      .one_minus_2c1 = dd_round(dd_mul(squared, first)),
      .one_minus_3c2 = dd_round(dd_mul(dd_from(1.5), dd_mul(cubed, second))),
  };
}

/* Each thread keeps those of its latest index: they take longer than all else that a dipole needs, and
 * media that differ mostly have one index. */
static core_fresnel exact_moments(double eta) {
  static _Thread_local struct {
    double eta;
    core_fresnel moments;
  } latest;
  if (latest.eta != eta) {
    latest.moments = integrate_moments(eta);
    latest.eta = eta;
  }
  return latest.moments;
}

/* Evaluates a polynomial. Its coefficients are in millionths, beginning with the highest power. */
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

/* A published fit: one minus a polynomial in eta for 2 C1 and for 3 C2. From eta = 1 on, 3 C2 has
 * also a polynomial in 1 / eta. */
struct fit {
  double first[2][6];  /* coefficients for 2 C1: [0] below eta = 1, [1] from 1 on */
  double second[2][6]; /* coefficients for 3 C2, likewise */
  double inverse[4];   /* coefficients in 1 / eta for 3 C2, from eta = 1 on */
  double times[2];     /* factors of both polynomials */
};

static core_fresnel moments_of(const struct fit *fit, double eta) {
  const dd x = dd_from(eta), inverse = dd_div(dd_from(1), x);
  const int from_1 = eta >= 1;
  const dd first = polynomial(x, fit->first[from_1], 6);
  const dd of_eta = polynomial(x, fit->second[from_1], 6);
  const dd second = from_1 ? dd_add(of_eta, polynomial(inverse, fit->inverse, 4)) : of_eta;
  return (core_fresnel){
      .one_minus_2c1 = dd_round(dd_sub(dd_from(1), dd_scale(first, fit->times[0]))),
      .one_minus_3c2 = dd_round(dd_sub(dd_from(1), dd_mul(dd_from(fit->times[1]), second))),
  };
}

static const struct fit of_d_eon = {
    {{-1368810, 4985540, -7809890, 6753350, -3479300, 919317},
     {254913, -2543960, 10229100, -20929200, 22227200, -9233720}},
    {{145787, 236494, -1952840, 3362310, -2620510, 828421},
     {1918260, -27018100, 164798e3, -568556e3, 1213670e3, -1641100e3}},
    {135926e3, -656175e3, 1376530e3, 0},
    {1, 1}};

/* The polynomials of C1 and C2 in "Physically Based Rendering" (Pharr, Jakob, Humphreys, 3rd edition,
 * section 11.4.2). These have fewer digits than d'Eon's, which changes a profile by about 1e-4. */
static const struct fit of_pbrt = {{{-684410, 2492770, -3904945, 3376680, -1739650, 459660},
                                    {127460, -1271980, 5114550, -10464600, 11113600, -4616860}},
                                   {{48600, 78830, -650950, 1120770, -873500, 276140},
                                    {639420, -9006030, 54932700, -189519e3, 404557e3, -547033e3}},
                                   {45308700, -218725e3, 458843e3, 0},
                                   {2, 3}};

/* Computes F_dr of Jensen's dipole as 2 C1; the classical boundary condition does not need C2. The
 * coefficients are Egan and Hilgeman's four digits, as Donner and Jensen 2005 print them for both
 * sides of 1. */
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
#define CHECK(P, id, IDENT, name, about, eta_min, eta_max)                                         \
  case CORE_MOMENTS_##IDENT:                                                                       \
    return eta >= eta_min && eta <= eta_max                                                        \
               ? (core_fault){0}                                                                   \
               : (core_fault){"eta", #eta_min " to " #eta_max " with moments " name, 0};
    CORE_EACH_MOMENTS(CHECK, )
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
    return moments_of(&of_d_eon, eta);
  case CORE_MOMENTS_JENSEN:
    return jensen_moments(eta);
  case CORE_MOMENTS_PBRT:
    return moments_of(&of_pbrt, eta);
  }
  assert(!"moments of the list");
  return (core_fresnel){0, 0};
}

/* Returns (eta cos_inside)^2 = cos_outside^2 + eta^2 - 1. Both parts are positive for eta > 1; for
 * eta < 1 they cancel at the critical angle and are summed in double-double. */
static double eta_cos_inside_squared(double eta, double cos_outside) {
  if (eta >= 1) {
    return fma(cos_outside, cos_outside, (eta - 1) * (eta + 1));
  }
  const dd lacks = dd_sub(dd_from(1), dd_two_product(eta, eta));
  return dd_round(dd_sub(dd_two_product(cos_outside, cos_outside), lacks));
}

/* Uses 1 - F = (T_s + T_p) / 2 with T_s and T_p = 4 eta cos cos' / (...)^2, where no terms cancel.
 */
double core_fresnel_transmittance(double eta, double cos_outside) {
  /* cos_inside^2 = 1 - (1 - cos_outside^2) / eta^2 */
  const double squared = eta_cos_inside_squared(eta, cos_outside) / (eta * eta);
  if (!(squared > 0) || !(cos_outside > 0)) {
    return 0;
  }
  const double cos_inside = sqrt(squared);
  const double s = fma(eta, cos_inside, cos_outside);
  const double p = fma(eta, cos_outside, cos_inside);
  return 2 * eta * cos_outside * cos_inside * (1 / (s * s) + 1 / (p * p));
}
