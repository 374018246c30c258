/* The extended source: every depth of the entering beam is a dipole.
 *
 * Sources: d'Eon and Irving 2011, "A quantized-diffusion model for rendering translucent
 * materials", whose sum over time has this integral as its limit; Habel, Christensen, Jarosz 2013,
 * "Photon beam diffusion", for the same integral with the factor kappa. Lengths are in mean free
 * paths 1 / sigma_t'. With d1 and d2 the distances from the source at depth z and from its mirror
 * image at height z2 = z + 2 z_b,
 *
 *   R(x) = alpha'^2 / (4 pi) int_0^inf e^(-z) kappa { C_phi / D (e^(-mu d1) / d1 - e^(-mu d2) / d2)
 *        + C_E (z (1 + mu d1) e^(-mu d1) / d1^3 + z2 (1 + mu d2) e^(-mu d2) / d2^3) } dz
 *
 * with D, z_b, C_phi and C_E of the better dipole (d'Eon 2012, Table 2), and
 *
 *   variant 0: kappa = 1
 *   variant 1: kappa = 1 - e^(-2 (d1 + z)), Habel et al. 2013, section 5.2, as Pharr, Jakob,
 *              Humphreys, "Physically Based Rendering", 3rd edition, section 15.5.5, writes it
 *
 * With z = x sinh(t) the integrand is a smooth function of t for every x, small or large: it varies
 * near t = 0, is nearly a straight line beyond, and ends like e^(-x e^t / 2) at z = DEPTH. Five
 * panels of a Gauss rule follow that shape.
 *
 * R is infinite at x = 0. It rises there like 1 / x for variant 0 and like ln(1 / x) for variant 1.
 *
 * Domain: every medium that core_medium_check() accepts; an alpha'^2 below SOURCE_LEAST is taken as
 * 0. The integral is computed for radii from LEAST to FAR mean free paths. Smaller radii are
 * continued by the limit at x = 0. From FAR on, R has underflowed or falls like 1 / x^3.
 *
 * Error: EXTENDED_ERROR + 8 epsilon (1 + mu x), relative.
 *
 * Every difference is written as a sum of positive terms, as in dipole.c.
 */
#include "core/kernels.h"

#define EXTENDED_ERROR 2.5e-13
#define SOURCE_LEAST 1e-250
#define LEAST 1e-15

/* Coefficients that preparation computes; lengths are in mean free paths. Variant 1 keeps them in a
 * table, and the table of the energy within r follows them there; see energy.h. */
enum coefficient {
  MFP_PER_MM,
  MU,
  TWO_ZB,
  PHI,          /* C_phi / D */
  FLUX,         /* C_E */
  KAPPA,        /* 1 if the integrand contains the factor kappa (variant 1), else 0 */
  R_SCALE,      /* alpha'^2 / (4 pi) in 1/mm^2 */
  SLOPE_SCALE,  /* alpha'^2 / (4 pi) in 1/mm^3 */
  CDF_SCALE,    /* alpha'^2 / (2 albedo) */
  MIRROR_SHARE, /* e^(-2 mu z_b) */
  PHI_SHARE,    /* (1 - e^(-2 mu z_b)) / mu */
  CDF_LIMIT,    /* limit of the cdf at infinity: 1, or 0 if nothing scatters */
  CDF_WHOLE,    /* from this radius on the cdf has rounded to CDF_LIMIT */
  ENERGY,       /* position where the table of the energy begins (variant 1) */
};

#ifdef CORE_ISA

#include "core/kernel.h"

#if CORE_REAL == 64

#include "core/gauss.h"
#include "core/models/blocks.h"
#include "core/models/energy.h"

/* the integral ends at this depth; light from deeper is less than a rounding error */
#define DEPTH 38.0
#define FAR 1e100

enum { PANELS = 5 };

/* Returns a radius in mean free paths, limited to LEAST to FAR. */
static inline double kept_radius(const double *c, double r) {
  return real_min(real_max(r * c[MFP_PER_MM], LEAST), FAR);
}

/* Sets for each radius the ends in t = asinh(z / x) of the panels over the depth z. */
static void set_edges(size_t n, const double *x, double edge[PANELS + 1][BLOCK_LANES]) {
  for (size_t i = 0; i < CORE_WHOLE(n); i++) {
    const double y = DEPTH / x[i];
    /* asinh(y) is less than y and less than ln(1 + 2 y). For a small y the logarithm would round to
     * 0, so y is used. */
    const double end = y < 1 ? y : real_min(y, real_log(1 + 2 * y, 0));
    const double fifth = 0.2 * end;
    edge[0][i] = 0;
    edge[1][i] = real_min(fifth, 2.5);
    edge[2][i] = real_min(2 * fifth, 7);
    edge[3][i] = end - real_min(2 * fifth, 9);
    edge[4][i] = end - real_min(fifth, 3.5);
    edge[5][i] = end;
  }
}

/* A depth z = x sinh(t) as seen from the radius x: the distances from the source and its mirror
 * image. */
struct view {
  double e;    /* e^(-t) */
  double sine; /* sine of the angle at the source: x / d1 */
  double z;
  double d1;
  double z2;
  double d2;
  double apart; /* d2 - d1 */
};

static inline struct view look(const double *c, double x, double t) {
  struct view v;
  const real_exp_values exp = real_exp(-t);
  const double half = 0.5 / exp.exp;
  const double cosh = half * real_fma(exp.exp, exp.exp, 1);
  v.e = exp.exp;
  v.sine = 1 / cosh;
  v.z = x * (half * exp.one_minus_exp * (1 + exp.exp));
  v.d1 = x * cosh;
  v.z2 = v.z + c[TWO_ZB];
  v.d2 = real_sqrt(real_fma(x, x, v.z2 * v.z2));
  v.apart = c[TWO_ZB] * (v.z + v.z2) / (v.d1 + v.d2);
  return v;
}

/* Returns e^(-z - mu (d1 - x)), with d1 - x = x (1 - e)^2 / (2 e). */
static inline double attenuation(const double *c, double x, struct view v) {
  const double further = x * ((1 - v.e) * (1 - v.e) * (0.5 / v.e));
  return real_exp(-real_fma(c[MU], further, v.z)).exp;
}

/* Returns kappa = 1 - e^(-2 (d1 + z)), or 1 for variant 0. `out` is real_exp(-2 x / e), because d1
 * + z = x / e. */
static inline double kappa_of(const double *c, real_exp_values out) {
  return c[KAPPA] > 0 ? out.one_minus_exp : 1;
}

/* braces() returns the braces in the formula of R, times d1 e^(mu d1); steepness() returns the
 * braces in that of -dR/dx, times d1 e^(mu d1). */
static inline double braces(const double *c, struct view v, real_exp_values mirror) {
  const double i1 = 1 / v.d1;
  const double i2 = 1 / v.d2;
  const double phi = real_fma(v.d1, mirror.one_minus_exp, v.apart) * i2;
  const double flux1 = (v.z * i1) * (i1 + c[MU]);
  const double flux2 = (v.z2 * i2) * (i2 + c[MU]) * (v.d1 * i2) * mirror.exp;
  return real_fma(c[PHI], phi, c[FLUX] * (flux1 + flux2));
}

static inline double steepness(const double *c, struct view v, real_exp_values mirror) {
  const double mu = c[MU];
  const double i1 = 1 / v.d1;
  const double i2 = 1 / v.d2;
  const double q = v.d1 * i2;
  const double cubes = v.apart * i1 * i2 * real_fma(q, q, q + 1);
  const double squares = mu * v.apart * i2 * (q + 1);
  const double gone = q * q * (i2 + mu) * mirror.one_minus_exp;
  const double bend1 = real_fma(3 * i1, i1 + mu, mu * mu);
  const double bend2 = real_fma(3 * i2, i2 + mu, mu * mu);
  const double flux1 = v.z * i1 * bend1;
  const double flux2 = q * q * (v.z2 * i2) * bend2 * mirror.exp;
  return v.sine * real_fma(c[PHI], cubes + squares + gone, c[FLUX] * (flux1 + flux2));
}

static inline double R_integrand(const double *c, double x, double t) {
  const struct view v = look(c, x, t);
  const double kappa = kappa_of(c, real_exp(-2 * x / v.e));
  return attenuation(c, x, v) * kappa * braces(c, v, real_exp(-c[MU] * v.apart));
}

static inline double slope_integrand(const double *c, double x, double t) {
  const struct view v = look(c, x, t);
  const real_exp_values mirror = real_exp(-c[MU] * v.apart);
  const real_exp_values out = real_exp(-2 * x / v.e);
  const double falls = kappa_of(c, out) * steepness(c, v, mirror);
  const double rises = 2 * v.sine * (c[KAPPA] * out.exp) * braces(c, v, mirror);
  return attenuation(c, x, v) * (falls - rises);
}

/* The energy that the dipole at depth z emits within the radius x (d'Eon 2012, integrated over the
 * radius), times e^(-z) d1. */
static inline double energy_integrand(const double *c, double x, double t) {
  const struct view v = look(c, x, t);
  const double a1 = x * v.e; /* d1 - z */
  const double a2 = x * (x / (v.d2 + v.z2));
  const double nearer = a1 * (v.apart + c[TWO_ZB]) / (v.d2 + v.z2); /* a1 - a2 */
  const real_exp_values far = real_exp(-c[MU] * a2);
  const real_exp_values near = real_exp(-c[MU] * nearer);
  const double gone2 = far.one_minus_exp;
  const double near_share = nearer * near.quotient * far.exp;
  const double gone1 = real_fma(c[MU], near_share, gone2);
  const double flux1 = real_fma(v.z, gone1, a1); /* flux of the real source, times d1 */
  const double flux2 = c[MIRROR_SHARE] * real_fma(v.z2, gone2, a2) * (v.d1 / v.d2);
  const double phi = real_fma(c[PHI_SHARE], gone2, near_share) * v.d1;
  const double sum = real_fma(c[PHI], phi, c[FLUX] * (flux1 + flux2));
  return real_exp(-real_fma(c[MU], v.z, v.z)).exp * sum;
}

/* INTEGRATE(name, integrand) defines a function that sets sum[i] to the integral of integrand(c, x,
 * t) over t for each radius of a block. The loop over radii is innermost, so that compilers
 * vectorize it. */
#define INTEGRATE(name, integrand)                                                                 \
  static void name(const double *c, size_t n, const double *x, double *sum) {                      \
    double edge[PANELS + 1][BLOCK_LANES];                                                          \
    set_edges(n, x, edge);                                                                         \
    for (size_t i = 0; i < CORE_WHOLE(n); i++) {                                                   \
      sum[i] = 0;                                                                                  \
    }                                                                                              \
    for (int panel = 0; panel < PANELS; panel++) {                                                 \
      const double *from = edge[panel];                                                            \
      const double *to = edge[panel + 1];                                                          \
      for (int k = 0; k < 2 * CORE_GAUSS_HALF; k++) {                                              \
        const double node = core_gauss_node(k);                                                    \
        const double weight = core_gauss_weight(k);                                                \
        for (size_t i = 0; i < CORE_WHOLE(n); i++) {                                               \
          const double width = to[i] - from[i];                                                    \
          const double t = real_fma(width, node, from[i]);                                         \
          sum[i] = real_fma(weight * width, integrand(c, x[i], t), sum[i]);                        \
        }                                                                                          \
      }                                                                                            \
    }                                                                                              \
  }

INTEGRATE(integrate_R, R_integrand)
INTEGRATE(integrate_slope, slope_integrand)
INTEGRATE(integrate_energy, energy_integrand)

/* Returns the integral at `radius`, given the integral `sum` at x. They differ only for variant 1
 * below LEAST, where the integral rises in proportion to 4 C_E ln(1 / x). */
static inline double risen(const double *c, double x, double radius, double sum) {
  const double ratio = radius < x ? x / real_max(radius, 1e-300) : 1;
  return real_fma(4 * c[KAPPA] * c[FLUX], real_log(ratio, 0), sum);
}

/* Returns R in 1/mm^2. For variant 0 x times the integral has a finite limit at x = 0, so below
 * LEAST mean free paths R is continued in proportion to 1 / radius. */
static inline double finish_R(const double *c, double r, double x, double near_sum) {
  const double radius = r * c[MFP_PER_MM];
  const double far = real_min(x / radius, 1);
  const double near = c[KAPPA] > 0 && radius > 0 ? 1 : real_max(x / radius, 1);
  const double sum = risen(c, x, radius, near_sum);
  const double R = real_times_exp(c[R_SCALE] * sum, -c[MU] * x, 0) * (far * far * far) * near;
  return c[CDF_LIMIT] > 0 ? R : 0;
}

static inline double finish_slope(const double *c, double r, double x, double sum) {
  const double radius = r * c[MFP_PER_MM];
  const double apart = x / radius;
  const double near = c[KAPPA] > 0 ? apart : apart * apart;
  const double factor = radius > x ? (apart * apart) * (apart * apart) : near;
  const double slope = -real_times_exp(c[SLOPE_SCALE] * sum, -c[MU] * x, 0) * factor;
  return c[CDF_LIMIT] > 0 ? slope : 0;
}

static inline double finish_ln_R(const double *c, double r, double x, double near_sum) {
  const double radius = r * c[MFP_PER_MM];
  const double sum = risen(c, x, radius, near_sum);
  const double near = c[KAPPA] > 0 ? 1 : real_min(radius / x, 1);
  const double inside = real_log(c[R_SCALE] * sum, 0) - c[MU] * x;
  const double ln_R = near < 1 ? inside - real_log(real_max(near, 1e-300), 0) : inside;
  const double bounded = radius > x ? -(double)INFINITY : ln_R;
  return c[CDF_LIMIT] > 0 ? (radius > 0 ? bounded : (double)INFINITY) : -(double)INFINITY;
}

static inline double finish_cdf(const double *c, double r, double x, double sum) {
  const double radius = r * c[MFP_PER_MM];
  const double inside = real_min(c[CDF_SCALE] * sum, REAL_BELOW_1);
  return radius > c[CDF_WHOLE] ? c[CDF_LIMIT] : inside * real_min(radius / x, 1);
}

BLOCK_KERNEL(eval_R, kept_radius, integrate_R, finish_R)
BLOCK_KERNEL(eval_slope, kept_radius, integrate_slope, finish_slope)
BLOCK_KERNEL(eval_ln_R, kept_radius, integrate_R, finish_ln_R)
BLOCK_KERNEL(eval_cdf_closed, kept_radius, integrate_energy, finish_cdf)

static void eval_cdf(const double *restrict c, size_t n, const double *restrict r,
                     double *restrict out) {
  if (c[KAPPA] > 0) {
    for (size_t i = 0; i < CORE_WHOLE(n); i++) {
      const double cdf = energy_cdf(&c[ENERGY], r[i]);
      out[i] = c[CDF_LIMIT] > 0 ? cdf : 0;
    }
  } else {
    eval_cdf_closed(c, n, r, out);
  }
}

CORE_KERNEL_TABLE(extended, CORE_KERNELS_OF_ALL);

#else
CORE_KERNEL_TABLE_NONE(extended);
#endif

#else /* what follows prepares a profile, and is compiled once for all instruction sets */

#include <stdlib.h>
#include <string.h>

#define CORE_REAL 64
#include "core/energy.h"
#include "core/models/lanes.h"

/* The cost of one value in kernel evaluations of a dipole, measured with `build/bench kernel`. */
#define COST 130

/* The table of variant 1 reaches from LEAST, below which R is a logarithm, to TABLE_LAST times the larger of
 * 2 z_b and one mean free path, or to TABLE_EXPONENT / mu where that is less. A few 1e-13 of the energy lie beyond the last: without absorption
 * the energy beyond x is about (2 + 2 z_b) / x. */
#define TABLE_LAST 1e13
#define TABLE_EXPONENT 45.0

core_fault core_extended_check(const core_inputs *inputs, core_radii_range *radii) {
  (void)inputs;
  (void)radii;
  return (core_fault){0};
}

/* Sets the coefficients, which are the better dipole's quantities in mean free paths, and returns
 * the albedo for kappa = 1, alpha'^2 / 2 / (1 + mu) [C_E (1 + e^(-2 mu z_b)) + C_phi / D (1 - e^(-2
 * mu z_b)) / mu]. */
static double set_coefficients(const core_inputs *inputs, double *c) {
  double shared[CORE_VARYING_SHARED_MAX];
  const struct lane lane =
      lane_of_medium(shared, CORE_DIPOLE_BETTER, inputs->moments, inputs->medium);
  const struct lane_dipole dipole = lane_dipole_of(shared, lane);
  const double sigma_t_prime = lane.sigma_t;
  c[MFP_PER_MM] = sigma_t_prime;
  c[MU] = dipole.mu;
  c[TWO_ZB] = dipole.z2_less_1;
  c[PHI] = dipole.phi;
  c[FLUX] = shared[LANES_C_FLUX];
  const real_exp_values mirror = real_exp(-c[MU] * c[TWO_ZB]);
  c[MIRROR_SHARE] = mirror.exp;
  c[PHI_SHARE] = c[TWO_ZB] * mirror.quotient;
  const double source = dipole.power >= SOURCE_LEAST ? 0.5 * dipole.power : 0;
  const double two_pi = 6.28318530717958647693;
  c[R_SCALE] = source / two_pi * sigma_t_prime * sigma_t_prime;
  c[SLOPE_SCALE] = c[R_SCALE] * sigma_t_prime;
  c[CDF_LIMIT] = source > 0;
  const double bracket = c[FLUX] * (1 + mirror.exp) + c[PHI] * c[PHI_SHARE];
  c[CDF_SCALE] = source > 0 ? (1 + c[MU]) / bracket : 0;
  /* from x = 1 on, 1 - cdf is at most tail e^(-mu x) and also at most tail / x */
  const double tail =
      c[CDF_SCALE] * (c[FLUX] * (2 + c[TWO_ZB]) + c[PHI] * c[TWO_ZB] * (1 + c[TWO_ZB]));
  const double many = 0x1p56 * tail;
  c[CDF_WHOLE] = fmin(fmax(fmin(many, real_log(fmax(many, 1), 0) / c[MU]), 1), 1e100);
  return source * bracket / (1 + c[MU]);
}

/* Moves the coefficients of variant 1 into a new table, adds the energy within r to it, and sets
 * the albedo to the whole energy of that table. Returns false if memory runs out. */
static bool add_energy(const core_inputs *inputs, core_preparation *preparation) {
  const double *c = preparation->coefficients;
  const double mfp_mm = 1 / c[MFP_PER_MM];
  const double last = TABLE_LAST * fmax(1, c[TWO_ZB]);
  const double reach = c[MU] * last > TABLE_EXPONENT ? TABLE_EXPONENT / c[MU] : last;
  const double first_mm = LEAST * mfp_mm;
  const double last_mm = reach * mfp_mm;
  preparation->table_bytes = (ENERGY + core_energy_length(first_mm, last_mm)) * sizeof(double);
  double *table = malloc(preparation->table_bytes);
  if (table == NULL) {
    return false;
  }
  memcpy(table, c, ENERGY * sizeof *table);
  preparation->albedo = core_energy_build(core_isa_kernels(inputs->isa, CORE_MODEL_BEAM)->f64,
                                          table, first_mm, last_mm, &table[ENERGY]);
  preparation->table = table;
  return true;
}

core_fault core_extended_prepare(const core_inputs *inputs, core_preparation *preparation) {
  preparation->notes = core_similarity_note(inputs);
  double *c = preparation->coefficients;
  preparation->albedo = set_coefficients(inputs, c);
  preparation->error = EXTENDED_ERROR;
  preparation->error_epsilons = 8 * (1 + c[MU]);
  preparation->error_epsilons_per_mm = 8 * c[MU] * c[MFP_PER_MM];
  preparation->cost = COST;
  if (inputs->variant == 1) {
    c[KAPPA] = 1;
    if (!add_energy(inputs, preparation)) {
      return CORE_OUT_OF_MEMORY;
    }
  }
  return (core_fault){0};
}

#endif
