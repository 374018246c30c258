/* Burley's normalized diffusion: two exponentials fitted to Monte Carlo results.
 *
 * Sources: Christensen, Burley 2015, "Approximate reflectance profiles for efficient subsurface
 * scattering" (profile and fits); Golubev 2018, "Efficient screen-space subsurface scattering using
 * Burley's normalized diffusion in real-time" (inverse of the cdf).
 *
 *   R(r) = A (e^(-r/d) + e^(-r/(3d))) / (8 pi d r),  cdf = 1 - e^(-r/d) / 4 - 3 e^(-r/(3d)) / 4
 *
 * A is the surface albedo: the parameter if it is given, else the albedo that the better dipole has
 * for the medium. The width is d = l / s. The length l is the mean free path 1 / sigma_t'; for the
 * variant DMFP it is the diffuse mean free path 1 / mu_tr. The divisor s is
 *
 *   SEARCHLIGHT  s = 1.85 - A + 7 |A - 0.8|^3
 *   DIFFUSE      s = 1.9 - A + 3.5 (A - 0.8)^2
 *   DMFP         s = 3.5 + 100 (A - 0.33)^4
 *
 * R is infinite at r = 0, where 2 pi r R is A / (2 d).
 *
 * Domain: every medium that core_medium_check() accepts; DMFP also needs sigma_a > 0. Beyond FAR d
 * R is 0 and the cdf is 1.
 *
 * Error: 10 epsilon (1 + r / d), relative. For DMFP it is 25 epsilon (1 + r / d): near A = 1 the
 * relative error of A grows fivefold in s. A sampled radius belongs to a cdf that differs from the
 * wanted one by at most 4 epsilon, relative to the cdf and also to 1 - cdf.
 */
#include "core/kernels.h"

enum coefficient {
  PER_D,   /* 1/mm */
  D,       /* mm */
  ALBEDO,  /* A */
  R_SCALE, /* A / (8 pi d), in 1/mm; R is this times the exponentials, divided by r */
  /* derivatives by ln sigma_a (_BY_A) and by ln sigma_s' (_BY_S) */
  A_BY_A, /* derivatives of ln A */
  A_BY_S,
  PER_D_BY_A, /* derivatives of ln(1 / d) */
  PER_D_BY_S,
  COEFFICIENTS
};

#ifndef CORE_ISA
#define CORE_REAL 64
#endif
#include "core/models/lanes.h"

#if CORE_REAL == 64

/* A profile with a smaller surface albedo is 0. */
#define ALBEDO_LEAST 1e-250

/* Sets the last four, from the derivative of ln A by ln sigma_a: that by ln sigma_s' is the
 * opposite. divisor: s. */
static inline void set_derivatives(double *c, double fit, double absorbed, double scattered,
                                   double albedo, double divisor, double by_a) {
  const double away = albedo - 0.8, off = albedo - 0.33;
  const double cubic = 21 * (away < 0 ? -away : away) * away - 1, square = 7 * away - 1;
  const double fourth = 400 * (off * off) * off;
  const bool diffuse = fit > CORE_BURLEY_DIFFUSE; /* for this fit the length l is 1 / mu_tr */
  const double slope = diffuse ? fourth : fit > CORE_BURLEY_SEARCHLIGHT ? square : cubic;
  const double by_albedo = albedo * slope / divisor * by_a;
  const double by_mu = diffuse ? 0.5 * scattered / (1 + absorbed) : 0;
  c[A_BY_A] = by_a;
  c[A_BY_S] = -by_a;
  c[PER_D_BY_A] = absorbed + (by_mu + by_albedo);
  c[PER_D_BY_S] = scattered - (by_mu + by_albedo);
}

/* What is chosen for all media is a factor of 1 or 0 in place of a condition, which keeps compilers
 * from vectorizing; so products with it are exact. */
struct lane_choice {
  double cubic, square, fourth; /* the fit */
  double given;                 /* the parameter `surface_albedo`, or 0 */
  double own;                   /* 1 to use the medium's own albedo, else 0 */
};

static inline struct lane_choice lane_choice_of(const double *shared) {
  const double fit = shared[LANES_FIT], given = shared[LANES_SURFACE_ALBEDO];
  const double fourth = fit > CORE_BURLEY_DIFFUSE ? 1 : 0;
  const double square = fit > CORE_BURLEY_SEARCHLIGHT ? 1 - fourth : 0;
  return (struct lane_choice){1 - square - fourth, square, fourth, given >= 0 ? given : 0,
                              given >= 0 ? 0 : 1};
}

/* Returns s = l / d. */
static inline double lane_divisor(struct lane_choice choice, double albedo) {
  const double away = albedo - 0.8;
  const double cubic = 1.85 - albedo + 7 * fabs(away) * (away * away);
  const double square = 1.9 - albedo + 3.5 * (away * away);
  const double off = (albedo - 0.33) * (albedo - 0.33);
  const double fourth = 3.5 + 100 * (off * off);
  return choice.cubic * cubic + choice.square * square + choice.fourth * fourth;
}

/* Sets the coefficients of a medium. */
static inline void lane_fill(const double *shared, struct lane lane, double *c) {
  const struct lane_choice choice = lane_choice_of(shared);
  const struct lane_dipole better = lane_dipole_of(shared, lane);
  const double own = real_min(0.5 * better.power * better.sum, 1);
  const double chosen = choice.given + choice.own * own;
  const double albedo = chosen >= ALBEDO_LEAST ? chosen : 0;
  const double mu_tr =
      real_sqrt(lane.sigma_a) * real_sqrt(lane.sigma_t) * real_sqrt(3 / (1 + lane.absorbed));
  const double divisor = lane_divisor(choice, albedo);
  c[PER_D] = (choice.fourth * mu_tr + (1 - choice.fourth) * lane.sigma_t) * divisor;
  c[D] = 1 / c[PER_D];
  c[ALBEDO] = albedo;
  c[R_SCALE] = albedo * c[PER_D] * (1 / 25.1327412287183459077);
  const double by_a = lane_albedo_slope(shared, lane, better);
  const bool constant = (choice.own == 0) | !(albedo < 1) | !(albedo > 0);
  set_derivatives(c, shared[LANES_FIT], lane.absorbed, lane.scattered, albedo, divisor,
                  constant ? 0 : by_a);
}

#endif

#ifdef CORE_ISA

#if CORE_REAL == 64

#define FAR 1e100
#define WHOLE 120.0 /* from r = WHOLE d on the kernel returns 1; the formula could round to less */

/* The kernels compute numerator 2^UP_EXPONENT / (r UP): so the quotient underflows only where R
 * itself does, although the exponential in the numerator may underflow earlier. */
#define UP_EXPONENT 64
#define UP 0x1p64
#define LEAST (-1306.0) /* e^LEAST 2^UP_EXPONENT underflows to 0 */

/* Both exponentials are powers of q = e^(-x / 3), where x = r / d: e^(-x) + e^(-x/3) = q (1 + q^2).
 * This function returns x, at most FAR. */
static inline double burley_x(const double *c, double r) {
  return real_min(r * c[PER_D], FAR);
}

static inline double burley_R(const double *c, double r) {
  const double third = burley_x(c, r) * (1.0 / 3);
  /* `up` is 2^(800 + UP_EXPONENT) times the power of two in q, so that it is a normal number */
  const real_exp_parts parts = real_exp_split(real_nearer_zero(-third, LEAST));
  const double biased = parts.shifted + (800 + UP_EXPONENT + REAL_EXPONENT_BIAS);
  const double up = real_from_bits(real_to_bits(biased) << REAL_MANTISSA_BITS);
  const double q = real_fma(up, parts.m, up) * (0x1p-800 / UP);
  const double scale = c[R_SCALE] * real_fma(q, q, 1);
  const double R = real_fma(scale, parts.m, scale) * up * 0x1p-800 / (r * UP);
  return c[ALBEDO] > 0 ? R : 0;
}

static inline double burley_albedo(const double *c, double r) {
  (void)r;
  return c[ALBEDO];
}

/* The Hankel transform of e^(-s r) / r is 2 pi / sqrt(s^2 + k^2), k = 2 pi f: here
 * A / 4 [1 / sqrt(1 + (k d)^2) + 3 / sqrt(1 + 9 (k d)^2)]. */
static inline double burley_transfer(const double *c, double f) {
  const double kd = real_min(6.28318530717958647693 * f * c[D], FAR);
  const double squared = kd * kd;
  const double sum = 1 / real_sqrt(1 + squared) + 3 / real_sqrt(real_fma(9, squared, 1));
  const double value = 0.25 * c[ALBEDO] * sum;
  return c[ALBEDO] > 0 && f < (double)INFINITY ? value : 0;
}

/* Returns dR/dr = -A / (8 pi d r) [(1 + q^2) q / r + (1/3 + q^2) q / d], with q = e^(-r / (3 d)).
 */
static inline double burley_slope(const double *c, double r) {
  const double x = burley_x(c, r);
  const double third = x * (1.0 / 3);
  const double q2 = real_exp(-2 * third).exp;
  const double sum = real_fma(x, q2 + 1.0 / 3, 1 + q2);
  const double slope = -(real_times_exp(c[R_SCALE] * sum, -third, UP_EXPONENT) / r) / (r * UP);
  return c[ALBEDO] > 0 ? slope : 0;
}

static inline double burley_ln_R(const double *c, double r) {
  const double x = burley_x(c, r);
  const double third = x * (1.0 / 3);
  const double q2 = real_exp(-2 * third).exp;
  /* the radius, limited so that the product is a normal number */
  const double kept = real_min(r, 1e250) * UP;
  /* Near R = 1 the difference of two logarithms would cancel, so the logarithm of the quotient is
   * taken wherever the quotient is a normal number. */
  const double scale = c[R_SCALE] * (1 + q2);
  const double quotient = scale * UP / kept;
  const bool normal = quotient > 1e-290 && quotient < 1e290;
  const double ratio = real_log(normal ? quotient : scale, 0) -
                       real_log(normal ? 1 : kept, normal ? 0 : -UP_EXPONENT);
  const double ln_R = ratio - third;
  const double bounded = x < FAR ? ln_R : -(double)INFINITY;
  const double any = r > 0 ? bounded : (double)INFINITY;
  return c[ALBEDO] > 0 ? any : -(double)INFINITY;
}

/* The derivatives of ln R by ln sigma_a and ln sigma_s': R depends on A and d, and d ln R / d
 * ln(1 / d) is 1 - x (1/3 + q^2) / (1 + q^2). */
struct derivatives {
  double by_a;
  double by_s;
};

static inline struct derivatives burley_derivatives(const double *c, double r) {
  const double x = burley_x(c, r + 0);
  const double q2 = real_exp(-x * (2.0 / 3)).exp;
  const double by_per_d = 1 - x * (q2 + 1.0 / 3) / (1 + q2);
  /* where R is 0, its derivatives are 0 */
  const double shines = c[ALBEDO] > 0 ? FAR : 0;
  const double by_a = real_fma(c[PER_D_BY_A], by_per_d, c[A_BY_A]);
  const double by_s = real_fma(c[PER_D_BY_S], by_per_d, c[A_BY_S]);
  return (struct derivatives){x < shines ? by_a : 0, x < shines ? by_s : 0};
}

static inline double burley_by_a(const double *c, double r) {
  return burley_derivatives(c, r).by_a;
}

static inline double burley_by_s(const double *c, double r) {
  return burley_derivatives(c, r).by_s;
}

/* Returns the cdf, 1/4 (1 - e^(-x)) + 3/4 (1 - e^(-x/3)), at x = r / d. It uses 1 - q^3 = (1 - q)
 * (1 + q + q^2) with q = e^(-x/3). */
static inline double share(double x) {
  const real_exp_values e = real_exp(-x * (1.0 / 3));
  const double more = real_fma(e.exp, e.exp, e.exp) + 4;
  return 0.25 * e.one_minus_exp * more;
}

static inline double burley_cdf(const double *c, double r) {
  const double x = burley_x(c, r);
  const double bounded = x < WHOLE ? real_min(share(x), REAL_BELOW_1) : 1;
  return c[ALBEDO] > 0 ? bounded : 0;
}

/* Returns the radius in mm at which the cdf is u. With q = e^(-r / (3 d)) and w = 1 - q the cdf is
 * w (6 - 3 w + w^2) / 4. The closed form of this cubic's root (Golubev 2018) cancels at small u. So
 * the code solves the cubic by Newton's method, which doubles the number of right digits in each
 * step. It starts from u (2/3 + 0.33 u^2), which is within 1.5 % of the root everywhere; three
 * steps are enough. The loop also solves 4 (1 - u) = q (3 + q^2) for q. The radius comes from x = r
 * / d = -3 ln(1 - w) for u < 0.5, which keeps the digits of a small w, and from x = -3 ln q
 * otherwise. */
static inline double burley_sample(const double *c, double u) {
  const double outside = 1 - u, d = c[D];
  double w = u * real_fma(0.33, u * u, 2.0 / 3);
  double q = outside * real_fma(-0.3, outside * outside, 4.0 / 3);
#pragma GCC unroll 5
  for (int i = 0; i < 5; i++) {
    const double value = w * real_fma(w, w - 3, 6);
    w -= (value - 4 * u) / real_fma(3 * w, w - 2, 6);
    const double beyond = q * real_fma(q, q, 3);
    q -= (beyond - 4 * outside) / real_fma(3 * q, q, 3);
  }
  /* for small w, -ln(1 - w) = 2 artanh(w / (2 - w)) */
  const double s = w / (2 - w);
  const double t = s * s;
  double series = 1.0 / 23;
  series = real_fma(series, t, 1.0 / 21);
  series = real_fma(series, t, 1.0 / 19);
  series = real_fma(series, t, 1.0 / 17);
  series = real_fma(series, t, 1.0 / 15);
  series = real_fma(series, t, 1.0 / 13);
  series = real_fma(series, t, 1.0 / 11);
  series = real_fma(series, t, 1.0 / 9);
  series = real_fma(series, t, 1.0 / 7);
  series = real_fma(series, t, 1.0 / 5);
  series = real_fma(series, t, 1.0 / 3);
  const double near = 2 * real_fma(s * t, series, s);
  const double far = -real_log(real_max(q, 1e-300), 0);
  const double x = 3 * (u < 0.5 ? near : far);
  const double r = u < 1 ? x * d : (double)INFINITY;
  const double any = u > 0 ? r : 0;
  return c[ALBEDO] > 0 ? any : 0;
}

/* Adding 0 turns the radius -0 into 0. */
static inline double zero_R(const double *c, double r) {
  return burley_R(c, r + 0);
}

static inline double zero_slope(const double *c, double r) {
  return burley_slope(c, r + 0);
}

static inline double zero_cdf(const double *c, double r) {
  return burley_cdf(c, r + 0);
}

CORE_KERNEL(eval_R, zero_R)
CORE_KERNEL(eval_cdf, zero_cdf)
CORE_KERNEL(eval_slope, zero_slope)
CORE_KERNEL(eval_ln_R, burley_ln_R)
CORE_KERNEL(eval_transfer, burley_transfer)
CORE_KERNEL(eval_by_a, burley_by_a)
CORE_KERNEL(eval_by_s, burley_by_s)
CORE_KERNEL(sample, burley_sample)

/* ---- a medium for each value ----------------------------------------------------------------- */

LANES_KERNEL(varying_R, COEFFICIENTS, lane_fill, zero_R, INFINITY)
LANES_KERNEL(varying_cdf, COEFFICIENTS, lane_fill, zero_cdf, INFINITY)
LANES_KERNEL(varying_albedo, COEFFICIENTS, lane_fill, burley_albedo, INFINITY)
LANES_GRADIENT(varying_gradient, COEFFICIENTS, lane_fill, burley_ln_R, burley_derivatives)
LANES_KERNEL(varying_sample, COEFFICIENTS, lane_fill, burley_sample, 1)

CORE_KERNEL_TABLE(burley, .sample = sample, CORE_KERNELS_OF_ALL,
                  .evaluate[CORE_ELEMENTWISE_TRANSFER] = eval_transfer,
                  .evaluate[CORE_ELEMENTWISE_BY_SIGMA_A] = eval_by_a,
                  .evaluate[CORE_ELEMENTWISE_BY_SIGMA_S] = eval_by_s,
                  .varying_gradient = varying_gradient, LANES_KERNELS_OF_ALL);

#else
CORE_KERNEL_TABLE_NONE(burley);
#endif

#else /* what follows prepares a profile, and is compiled once for all instruction sets */

core_fault core_burley_check(const core_inputs *inputs, core_radii_range *radii) {
  (void)radii;
  if (inputs->variant == CORE_BURLEY_DMFP && !(inputs->medium->sigma_a_per_mm > 0)) {
    return (core_fault){"sigma_a", "more than 0: a diffuse mean free path is 1 / mu_tr", 0};
  }
  return (core_fault){0};
}

core_fault core_burley_prepare(const core_inputs *inputs, core_preparation *preparation) {
  double shared[CORE_VARYING_SHARED_MAX] = {
      [LANES_SURFACE_ALBEDO] = core_parameter_or(inputs, CORE_PARAMETER_SURFACE_ALBEDO, -1),
      [LANES_FIT] = inputs->variant};
  double *c = preparation->coefficients;
  lane_fill(shared, lane_of_medium(shared, CORE_DIPOLE_BETTER, inputs->moments, inputs->medium), c);
  preparation->notes = core_similarity_note(inputs);
  preparation->albedo = c[ALBEDO];
  preparation->error_epsilons = inputs->variant == CORE_BURLEY_DMFP ? 25 : 10;
  preparation->error_epsilons_per_mm = preparation->error_epsilons * c[PER_D];
  preparation->scale_mm = c[D];
  return (core_fault){0};
}

#endif
