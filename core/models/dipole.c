/* The dipole family: one kernel with three switches.
 *
 * Source: E. d'Eon, "A Better Dipole", 2012, Table 2 and Figure 17; the classical member is Jensen,
 * Marschner, Levoy, Hanrahan 2001 (Farrell, Patterson, Wilson 1992). The real source lies at depth
 * z1 = 1 / sigma_t' and its mirror image at height z2 = z1 + 4 A D. With the distances d1 and d2
 * from them,
 *
 *   R(r) = p / (4 pi) [ C_phi / D (e^(-mu d1) / d1 - e^(-mu d2) / d2)
 *                     + C_E (z1 (1 + mu d1) e^(-mu d1) / d1^3 + z2 (1 + mu d2) e^(-mu d2) / d2^3) ]
 *
 *   switch    off (classical)            on (better)
 *   GROSJEAN  D = 1 / (3 sigma_t')       D = (2 sigma_a + sigma_s') / (3 sigma_t'^2)
 *             p = alpha'                 p = alpha'^2
 *   BOUNDARY  A = (1 + 2C1) / (1 - 2C1)  A = (1 + 3C2) / (1 - 2C1)
 *   EXITANCE  C_phi = 0, C_E = 1         C_phi = (1 - 2C1) / 4, C_E = (1 - 3C2) / 2
 *
 * with mu = mu_tr = sqrt(sigma_a / D), alpha' = sigma_s' / sigma_t', and C1 and C2 the Fresnel moments
 * of eta. lanes_share_dipole() in lanes.h computes A, C_phi and C_E, lane_dipole_of() D, mu and p.
 *
 * Domain: every medium that core_medium_check() accepts; radii from 0 to infinity.
 *
 * Error, in the epsilon of the evaluator: DIPOLE_ERROR_EPSILONS epsilon (1 + mu_tr d1), relative,
 * for R, dR/dr, albedo and cdf. For ln R it is the same, absolute, plus as many epsilon of ln
 * R itself. core.h says where each bound holds. The factor in brackets is the condition of
 * e^(-mu_tr d1). Where the mirror source is higher than 50 z1, the condition of
 * e^(-mu_tr (d2 - d1)) counts as well: 3 epsilon for each unit of it beyond 4
 * (mirrored_condition()).
 *
 * Every subtraction that would lose digits is rewritten as a sum of positive terms:
 *
 *   d2 - d1 = (z2^2 - z1^2) / (d1 + d2)
 *   e^(-mu d1) / d1 - e^(-mu d2) / d2
 *           = e^(-mu d1) / (d1 d2) [d2 - d1 + d1 (1 - e^(-mu (d2 - d1)))]
 *
 * For the cdf, with a_i = d_i - z_i = r^2 / (d_i + z_i), the sums are
 *
 *   1 - z_i / d_i e^(-mu a_i) = [a_i + z_i (1 - e^(-mu a_i))] / d_i
 *   a1 - a2 = r^2 (d2 - d1 + z2 - z1) / ((d1 + z1) (d2 + z2))
 */
#include "core/kernels.h"

/* The kernels' unit of length is z1 / Z1. Z1 is so small that in single precision no square of a
 * distance overflows before R has underflowed. Z1 is a power of two, so that scaling by it changes
 * no digit. */
#define Z1 0x1p-40

/* Coefficients that preparation computes for the kernels; lengths are in units of z1 / Z1. */
enum coefficient {
  UNITS_PER_MM,
  MM_PER_UNIT,
  MU,         /* effective attenuation mu_tr */
  INVERSE_MU, /* the smaller of 1 / MU and 1e30, which stands for infinity */
  Z2,         /* height of the mirror source */
  Z2_LESS_Z1,
  Z2_SQUARED,
  Z2_SQUARED_LESS_Z1_SQUARED,
  R_PHI,    /* weight of the fluence in R */
  R_FLUX_1, /* weight of the real source's flux in R */
  /* weight of the mirror source's flux in R; the three weights are in 1/mm^2, divided by
   * 2^R_EXPONENT */
  R_FLUX_2,
  R_EXPONENT,
  SLOPE_PHI, /* these four weights are for dR/dr, in 1/mm^3, in the same order */
  SLOPE_FLUX_1,
  SLOPE_FLUX_2,
  SLOPE_EXPONENT,
  ALBEDO,
  CDF_FLUX_1, /* the flux of the real source as a share of the albedo */
  CDF_FLUX_2, /* the flux of the mirror source as a share of the albedo */
  /* The part of the cdf that the fluence adds has two terms. This is the factor of the first,
   * 1 - e^(-mu a2): the fluence's share of the albedo. */
  CDF_PHI_FAR,
  /* This is the factor of the second, which depends on a1 - a2, per unit of length. */
  CDF_PHI_NEAR,
  CDF_LIMIT, /* limit of the cdf at infinity: 1, or 0 if nothing scatters */
  CDF_WHOLE, /* from this radius on, in kernel units, the cdf has rounded to CDF_LIMIT */
  CORE,      /* the cdf is at most (x / CORE)^2, and nearly equal to it for small x */
  TAIL,      /* 1 - cdf is at most TAIL / d1 e^(-mu (d1 - z1)) */
  /* the transfer function, in units of z1; a number is the sum of its HI, of 24 bits, and LO */
  WAVE_HI, /* 2 pi z1: the wavenumber of a frequency in 1/mm */
  WAVE_LO,
  MU_SQUARED_HI,
  MU_SQUARED_LO,
  TRANSFER_FLUX, /* p C_E / 2: the flux's weight in R(f) */
  TRANSFER_PHI,  /* p C_phi / (2 D) (z2 - z1): the fluence's weight in R(f) */
  /* for the derivatives of ln R, with lengths in units of z1; each BY_... is a derivative by ln a,
   * times 1 - a */
  ABSORBED,  /* a = sigma_a / sigma_t' */
  SCATTERED, /* 1 - a */
  PHI,       /* C_phi / D */
  FLUX,      /* C_E */
  BY_MU,     /* of ln mu */
  BY_PHI,    /* of ln(C_phi / D); those of ln D and of ln(z2 - z1) are the opposite */
  BY_POWER,  /* of ln p, p as in R(r) above */
  COEFFICIENTS
};
_Static_assert((int)COEFFICIENTS <= CORE_COEFFICIENTS_MAX, "the profile has room for them");

#define DIPOLE_ERROR_EPSILONS 8.0
/* dR/dr has more operations than R: up to 8.3 (1 + mu_tr d1) were seen. */
#define DIPOLE_SLOPE_EPSILONS 10.0

#ifndef CORE_ISA
#define CORE_REAL 64
#endif
#include "core/models/lanes.h"

#define REAL_Z1 ((real)Z1)

/* The power of two by which the weights of R are multiplied. With sigma_t' from 1e-6 to 1e6 per mm
 * no sum overflows near the source, and none underflows before the result does. */
#define LANE_R_UP 80

/* Returns a radius in kernel units from which on the cdf has rounded to its limit, by the bound
 * TAIL. tail, mu: TAIL and MU. */
static inline real lane_whole(real tail, real mu) {
  const real far = REAL(0x1p56) * tail;
  const real decayed = real_log(real_max(far / REAL_Z1, 1), 0) / real_max(mu, REAL(1e-30));
  return real_min(real_min(far, REAL_Z1 + decayed), REAL(1e19));
}

/* Sets the coefficients of a medium, except those of dR/dr and of the transfer function, which
 * media that vary do not need. CORE and TAIL are the bounds that bracket the inverse of the cdf. */
static inline void lane_fill(const real *shared, struct lane lane, real *c) {
  const struct lane_dipole d = lane_dipole_of(shared, lane);
  const real z2 = 1 + d.z2_less_1;
  const real flux = shared[LANES_C_FLUX];
  c[UNITS_PER_MM] = lane.sigma_t * REAL_Z1;
  c[MM_PER_UNIT] = lane.mfp / REAL_Z1;
  c[MU] = d.mu / REAL_Z1;
  c[INVERSE_MU] = real_min(1 / c[MU], REAL(1e30));
  c[Z2] = z2 * REAL_Z1;
  c[Z2_LESS_Z1] = d.z2_less_1 * REAL_Z1;
  c[Z2_SQUARED] = z2 * z2 * (REAL_Z1 * REAL_Z1);
  c[Z2_SQUARED_LESS_Z1_SQUARED] = d.z2_less_1 * (2 + d.z2_less_1) * (REAL_Z1 * REAL_Z1);

  const real up = REAL(0x1p40); /* 2^(LANE_R_UP / 2): the factor is applied twice */
  const real scale =
      (lane.sigma_t * up) * (lane.sigma_t * up) * d.power * REAL(0.0795774715459476679);
  const real near_scale = scale * (REAL_Z1 * REAL_Z1 * REAL_Z1);
  c[R_PHI] = scale * REAL_Z1 * d.phi;
  c[R_FLUX_1] = near_scale * flux;
  c[R_FLUX_2] = near_scale * flux * z2;
  c[R_EXPONENT] = -LANE_R_UP;
  const real inverse_sum = d.power > 0 ? 1 / d.sum : 0;
  c[ALBEDO] = REAL(0.5) * d.power * d.sum;
  c[CDF_LIMIT] = d.power > 0 ? 1 : 0;
  c[CDF_FLUX_1] = flux * d.real_share * inverse_sum;
  c[CDF_FLUX_2] = flux * d.mirror_share * inverse_sum;
  c[CDF_PHI_FAR] = d.between * inverse_sum;
  const real phi_near = d.phi * d.real_share * inverse_sum;
  c[CDF_PHI_NEAR] = phi_near / REAL_Z1;
  const real_exp_values mirror = real_exp(-d.mu * d.z2_less_1);
  const real fluence = phi_near * (d.z2_less_1 + mirror.one_minus_exp) / z2;
  const real fluxes = c[CDF_FLUX_1] * (1 + d.mu + (1 + d.mu * z2) / (z2 * z2) * mirror.exp);
  c[CORE] = d.power > 0 ? REAL_Z1 * real_sqrt(2 / (fluence + fluxes)) : 0;
  c[TAIL] = REAL_Z1 * (c[CDF_FLUX_1] * (1 + z2) + REAL(0.5) * phi_near * (d.z2_less_1 * (1 + z2)));
  c[CDF_WHOLE] = lane_whole(c[TAIL], c[MU]);

  const struct lane_slopes by =
      lane_slopes_of(shared[LANES_GROSJEAN] > 0, lane.absorbed, lane.scattered);
  c[ABSORBED] = lane.absorbed;
  c[SCATTERED] = lane.scattered;
  c[PHI] = d.phi;
  c[FLUX] = flux;
  c[BY_MU] = by.mu;
  c[BY_PHI] = by.phi;
  c[BY_POWER] = by.power;
}

#ifdef CORE_ISA /* the kernels, compiled for each instruction set and precision */

/* FAR: beyond this radius, in kernel units, R has underflowed and the cdf has rounded to its limit;
 * up to it no product of two distances overflows. LN_R_FAR: up to this radius the numbers whose
 * logarithm gives ln R have not underflowed. SMALL_U: for a smaller cdf, (x / CORE)^2 equals the
 * cdf to the last digit. BRACKET_SLACK: dipole_sample() accepts a step that leaves its bracket by
 * less than this, relative. SAMPLE_STEPS: the largest number of steps that Newton's method needs in
 * a search, and one more, if the mirror source is no higher than WIDE_Z2. SAMPLE_STEPS_WIDE:
 * the same for higher ones, where the cdf hardly rises between z1 and z2 and most steps halve the
 * bracket. DENSE: up to this many kernel units in a mm, that is up to a sigma_t' of 2^16 per mm, R
 * in single precision has underflowed before 1 - e^(-mu (d2 - d1)) loses digits that matter.
 * DENSE_SMALL: for a smaller mu (d2 - d1), 1 - e^(-mu (d2 - d1)) equals it to the last digit; both
 * are multiplied by DENSE_SCALE, as in R_dense_of(). */
#define WIDE_Z2 (256 * REAL_Z1)
#define DENSE (REAL_Z1 * 0x1p16f)
#define DENSE_SCALE 0x1p64f
#define DENSE_SMALL (0x1p-100f * DENSE_SCALE)
#if CORE_REAL == 64
#define FAR 1e150
#define TRANSFER_FAR                                                                               \
  1e150 /* wavenumbers, in 1 / z1, where R(f) has underflowed but k^2 is finite */
#define LN_R_FAR (REAL_Z1 * 1e100)
#define SMALL_U 1e-30
#define BRACKET_SLACK 1e-13
#define SMALL_SCALE 0x1p-40
enum { SAMPLE_STEPS = 9, SAMPLE_STEPS_WIDE = 48 };
#else
#define FAR 1e19f
#define TRANSFER_FAR 1e18f
#define LN_R_FAR (REAL_Z1 * 1e12f)
#define SMALL_U 1e-13f
#define BRACKET_SLACK 1e-5f
#define SMALL_SCALE 0x1p-40f
enum { SAMPLE_STEPS = 7, SAMPLE_STEPS_WIDE = 32 };
#endif

/* A radius x on the surface, and its distances d1 from the real and d2 from the mirror source. */
struct view {
  real x;
  real d1;
  real d2;
  real inverse_d1;
  real inverse_d2;
  real apart;             /* d2 - d1 */
  real_exp_values mirror; /* e^(-mu (d2 - d1)) */
};

/* The distances of a view, which need square roots and divisions. */
struct distances {
  real d1;
  real d2;
  real inverse_d1_d2;
  real apart;
};

static inline struct distances measure(const real *c, real x) {
  const real d1 = real_sqrt(real_fma(x, x, REAL_Z1 * REAL_Z1));
  const real d2 = real_sqrt(real_fma(x, x, c[Z2_SQUARED]));
  return (struct distances){
      .d1 = d1,
      .d2 = d2,
      .inverse_d1_d2 = 1 / (d1 * d2),
      .apart = c[Z2_SQUARED_LESS_Z1_SQUARED] / (d1 + d2),
  };
}

static inline struct view view_of(const real *c, real x, struct distances distances) {
  return (struct view){
      .x = x,
      .d1 = distances.d1,
      .d2 = distances.d2,
      .inverse_d1 = distances.inverse_d1_d2 * distances.d2,
      .inverse_d2 = distances.inverse_d1_d2 * distances.d1,
      .apart = distances.apart,
      .mirror = real_exp(-c[MU] * distances.apart),
  };
}

static inline struct view look(const real *c, real x) {
  return view_of(c, x, measure(c, x));
}

/* Returns the radius r in mm in kernel units, at most FAR. Adding 0 turns -0 into 0. */
static inline real kernel_units(const real *c, real r) {
  return real_nearer_zero(real_fma(r, c[UNITS_PER_MM], 0), FAR);
}

static inline struct view look_from(const real *c, real r) {
  return look(c, kernel_units(c, r));
}

/* Returns the bracket in the formula of R, times e^(mu d1), where phi, flux1 and flux2 are the
 * weights of the fluence, the real source's flux and the mirror source's flux. Each weight is
 * multiplied in before the small factors, so that no intermediate result underflows before the
 * product does. */
static inline real bracket(struct view v, real mu, real phi, real flux1, real flux2) {
  const real i1 = v.inverse_d1;
  const real i2 = v.inverse_d2;
  const real near = phi * i2;
  const real real_flux = i1 * (i1 + mu);
  const real mirror_flux = (flux2 * i2) * (i2 * (i2 + mu));
#if CORE_REAL == 64
  const real fluence = near * real_fma(v.apart, i1, v.mirror.one_minus_exp);
#else /* in single precision apart / d1 alone would underflow */
  const real fluence = real_fma(near * v.apart, i1, near * v.mirror.one_minus_exp);
#endif
  return real_fma(mirror_flux, v.mirror.exp, real_fma(flux1 * i1, real_flux, fluence));
}

static inline real R_usual_of(const real *c, struct view v) {
  const real sum = bracket(v, c[MU], c[R_PHI], c[R_FLUX_1], c[R_FLUX_2]);
  return real_times_exp(sum, -c[MU] * v.d1, c[R_EXPONENT]);
}

/* R_usual_of() in single precision for a medium that is denser than DENSE. There R is a normal
 * number at radii where 1 - e^(-mu (d2 - d1)) has underflowed. This function therefore multiplies
 * the latter by DENSE_SCALE, and its weight by 1 / DENSE_SCALE. */
static inline real R_dense_of(const real *c, struct view v) {
  v.apart *= DENSE_SCALE;
  v.mirror.one_minus_exp *= DENSE_SCALE;
  const real small = c[MU] * v.apart;
  v.mirror.one_minus_exp = small < DENSE_SMALL ? small : v.mirror.one_minus_exp;
  const real sum = bracket(v, c[MU], c[R_PHI] / DENSE_SCALE, c[R_FLUX_1], c[R_FLUX_2]);
  return real_times_exp(sum, -c[MU] * v.d1, c[R_EXPONENT]);
}

/* Next to the source v.x underflows before a product with it does: it is then replaced by x 2^k. */
struct raised {
  real x;
  real k;
};

static inline struct raised raise_x(const real *c, real r, struct view v) {
  const int low = v.x < REAL_Z1 * REAL(0x1p-64);
  /* adding +0 turns -0 into +0 */
  const real raised = real_nearer_zero(r + 0, 1) * REAL(0x1p64) * c[UNITS_PER_MM];
  return (struct raised){low ? raised : v.x, low ? 64 : 0};
}

static inline real dipole_ln_R(const real *c, real r) {
  const struct view v = look_from(c, r);
  const real sum = bracket(v, c[MU], c[R_PHI], c[R_FLUX_1], c[R_FLUX_2]);
  const real ln_R = real_fma(-c[MU], v.d1, real_log(sum, c[R_EXPONENT]));
  const real near_ln_R = v.x < LN_R_FAR ? ln_R : -(real)INFINITY;
  return c[CDF_LIMIT] > 0 ? near_ln_R : -(real)INFINITY;
}

/* The derivatives of ln R by ln sigma_a and ln sigma_s'. */
struct derivatives {
  real by_a;
  real by_s;
};

/* In units of z1, R / sigma_t'^2 depends on x = r sigma_t' and on a = sigma_a / sigma_t' alone. So
 * with X = d ln R / d ln x and Q = a (1 - a) d ln R / da the derivatives are a (2 + X) + Q and (1 -
 * a) (2 + X) - Q. All sums are those of R, times 4 pi / p d1^2 e^(mu d1), and are written as
 * bracket() and dipole_slope() write theirs. */
static inline __attribute__((always_inline)) struct derivatives dipole_derivatives(const real *c,
                                                                                   real r) {
  const struct view v = look_from(c, r);
  const real mu = c[MU] * REAL_Z1, z2 = c[Z2] * (1 / REAL_Z1);
  const real d1 = v.d1 * (1 / REAL_Z1), d2 = v.d2 * (1 / REAL_Z1);
  const real i1 = 1 / d1, i2 = 1 / d2, t = d1 / d2, t2 = t * t;
  const real sine = v.x / v.d1, sine2 = sine * sine, high = z2 * i2;
  const real apart = v.apart * (1 / REAL_Z1), gone = v.mirror.one_minus_exp;
  const real squares =
      /* z2^2 - z1^2 in units of z1 */
      c[Z2_SQUARED_LESS_Z1_SQUARED] * (1 / REAL_Z1) * (1 / REAL_Z1);
  const real flux = c[FLUX], mirror = flux * v.mirror.exp;
  const real near1 = i1 + mu, near2 = t2 * (i2 + mu); /* (1 + mu d) / d^3 */
  const real bend1 = real_fma(mu, real_fma(mu, d1, 3), 3 * i1);
  const real bend2 = real_fma(mu, real_fma(mu, d2, 3), 3 * i2);
  const real fluence = c[PHI] * t * real_fma(d1, gone, apart);
  const real sum = real_fma(flux, near1, real_fma(mirror * z2, near2, fluence));
  /* -X times the sum */
  const real steeper = real_fma(mu * squares, t, t * d1 * real_fma(mu, d1, t) * gone);
  const real falls_phi = c[PHI] * t * real_fma(apart, 1 + t + t2, steeper);
  const real falls = sine2 * (falls_phi + real_fma(flux, bend1, mirror * z2 * t2 * t2 * bend2));
  /* Q times the sum, without the term of ln p: mu, phi and z2 depend on a */
  const real by_mu = mu * d1 * c[BY_MU];
  const real of_mu = -by_mu * real_fma(c[PHI] * d1, gone, mu * real_fma(mirror * z2, t, flux));
  const real by_z2 = -c[BY_PHI] * c[Z2_LESS_Z1] * (1 / REAL_Z1);
  const real of_z2 = by_z2 * real_fma(c[PHI] * z2 * v.mirror.exp, near2,
                                      mirror * (near2 - t2 * (high * high) * bend2));
  const real of_a = real_fma(c[BY_PHI], fluence, of_mu + of_z2) / sum + c[BY_POWER];
  const real scaled = 2 - falls / sum;
  /* where R is 0, its derivatives are 0 */
  const int shines = (c[CDF_LIMIT] > 0) & (v.x < LN_R_FAR);
  /* No compiler vectorizes a loop that reads under a condition. */
  const real absorbed = c[ABSORBED], scattered = c[SCATTERED];
  return (struct derivatives){
      .by_a = shines ? real_fma(absorbed, scaled, of_a) : 0,
      .by_s = shines ? real_fma(scattered, scaled, -of_a) : 0,
  };
}

static inline real dipole_by_a(const real *c, real r) {
  return dipole_derivatives(c, r).by_a;
}

static inline real dipole_by_s(const real *c, real r) {
  return dipole_derivatives(c, r).by_s;
}

/* dR/dr in 1/mm^3, from R differentiated term by term, in units of z1. With f(d) = (1 + mu d)
 * e^(-mu d) / d^3 the fluence contributes f(d1) - f(d2), which is again written as a sum of
 * positive terms. */
static inline real dipole_slope(const real *c, real r) {
  const struct view v = look_from(c, r);
  /* The inverse distances are computed by new divisions, because their errors count fourfold here.
   */
  const real i1 = REAL_Z1 / v.d1;
  const real i2 = REAL_Z1 / v.d2;
  const real mu = c[MU] * REAL_Z1;
  const real apart = v.apart * (1 / REAL_Z1);
  const real mu_squares = c[MU] * (1 / REAL_Z1) * c[Z2_SQUARED_LESS_Z1_SQUARED];
  const real ratio = v.d1 / v.d2;
  const struct raised raised = raise_x(c, r, v);
  const real sine = raised.x / v.d1;
  const real squares = real_fma(i1, i1, real_fma(i1, i2, i2 * i2));
  const real gone = (i2 + mu) * v.mirror.one_minus_exp * ratio;
  const real steeper = real_fma(mu_squares, i1 * i2, gone);
  const real phi = c[SLOPE_PHI] * sine * i2 * real_fma(apart, squares, steeper);
  /* bend = (3 + 3 mu d + (mu d)^2) / d^2, in a form that does not overflow */
  const real bend1 = real_fma(mu, real_fma(i1, 3, mu), 3 * i1 * i1);
  const real bend2 = real_fma(mu, real_fma(i2, 3, mu), 3 * i2 * i2);
  const real flux1 = c[SLOPE_FLUX_1] * sine * (i1 * i1) * bend1;
  const real flux2 = c[SLOPE_FLUX_2] * sine * (i2 * i2) * bend2 * ratio;
  const real sum = real_fma(flux2, v.mirror.exp, flux1 + phi);
  return -real_times_exp(sum, -c[MU] * v.d1, c[SLOPE_EXPONENT] - raised.k);
}

/* The cdf at a radius, and the attenuation e^(-mu a1) with a1 = d1 - z1 as in the file's first
 * comment. */
struct within {
  real cdf;
  real real_left; /* e^(-mu a1) */
};

static inline struct within gather(const real *c, struct view v) {
  const real mu = c[MU];
  const real slope1 = v.x / (v.d1 + REAL_Z1); /* a1 / x */
  const real slope2 = v.x / (v.d2 + c[Z2]);
  /* `slopes` times `apart` is a1 - a2 with a_i = d_i - z_i; both are scaled, so that neither
   * underflows before the product. */
  const real apart = (v.apart + c[Z2_LESS_Z1]) * SMALL_SCALE;
  const real slopes = (slope1 * (1 / SMALL_SCALE)) * slope2;
  const real_exp_values far = real_exp(-(mu * v.x) * slope2);
  const real_exp_values near = real_exp(-(mu * apart) * slopes);

  const real gone2 = far.one_minus_exp;
  const real near_share = slopes * near.quotient * (1 - gone2);
  const real gone1 = real_fma(mu * apart, near_share, gone2); /* 1 - e^(-mu a1) */
  const real flux1 = real_fma(v.x * v.inverse_d1, slope1, REAL_Z1 * v.inverse_d1 * gone1);
  const real flux2 = real_fma(v.x * v.inverse_d2, slope2, c[Z2] * v.inverse_d2 * gone2);
  const real phi = real_fma(c[CDF_PHI_NEAR] * apart, near_share, c[CDF_PHI_FAR] * gone2);
  return (struct within){
      .cdf = real_fma(c[CDF_FLUX_1], flux1, real_fma(c[CDF_FLUX_2], flux2, phi)),
      .real_left = far.exp * near.exp,
  };
}

static inline real dipole_cdf(const real *c, real r) {
  const struct view v = look_from(c, r);
  const struct within within = gather(c, v);
  /* Before CDF_WHOLE the cdf is kept below 1: rounding could make it 1 and then less again. */
  const real limit = c[CDF_LIMIT]; /* No compiler vectorizes a loop that reads under a condition. */
  return v.x < c[CDF_WHOLE] ? real_min(within.cdf, REAL_BELOW_1) : limit;
}

/* A source at depth z has the Hankel transform e^(-q z), times 2 pi / q for the fluence and 2 pi
 * for the flux, with q^2 = mu^2 + k^2, k = 2 pi f. q is summed in two parts, as the exponential
 * would multiply its rounding error by q. */
static inline real dipole_transfer(const real *c, real f) {
  const real bounded = real_nearer_zero(f + 0, TRANSFER_FAR / c[WAVE_HI]);
  const real product = bounded * c[WAVE_HI];
  const real product_low = real_fma(bounded, c[WAVE_HI], -product) + bounded * c[WAVE_LO];
  const real k = product + product_low;
  const real k_low = product_low - (k - product);
  const real squared = k * k;
  const real squared_low = real_fma(k, k, -squared) + 2 * k * k_low;
  const real sum = squared + c[MU_SQUARED_HI];
  const real lost = squared > c[MU_SQUARED_HI] ? c[MU_SQUARED_HI] - (sum - squared)
                                               : squared - (sum - c[MU_SQUARED_HI]);
  const real low = lost + squared_low + c[MU_SQUARED_LO];
  const real whole = sum + low;
  const real q = real_sqrt(whole);
  const real q_low = q > 0 ? (real_fma(-q, q, whole) + (low - (whole - sum))) / (2 * q) : 0;
  const real_exp_values mirror = real_exp(-q * (c[Z2_LESS_Z1] * (1 / REAL_Z1)));
  const real value =
      real_fma(c[TRANSFER_PHI], mirror.quotient, c[TRANSFER_FLUX] * (1 + mirror.exp));
  return real_times_exp(value * (1 - q_low), -q, 0);
}

/* Returns the radius in mm at which the cdf is u, by Newton's method on ln(cdf / (1 - cdf)) as a
 * function of ln x. That function is nearly a straight line: its slope is 2 at the source, 1 in a
 * tail without absorption, and 1 + mu x in a tail with absorption.
 *
 * The first bracket of the root follows from two bounds: cdf <= (x / CORE)^2, since R falls with r;
 * and 1 - cdf <= TAIL / d1 e^(-mu (d1 - z1)), since e^(-mu d) / d falls with d. Every step shrinks
 * the bracket. A step that would leave the bracket is replaced by the bracket's geometric middle.
 * From the start used here the method needs at most steps - 1 steps for every medium of the
 * domain; tests/accuracy/truth.c checks samples. The code sums 1 - cdf from
 * the light beyond r, so that both tails keep their digits.
 */
struct search {
  real x;
  real low;
  real high;
};

static inline struct search search_begin(const real *c, real u) {
  const real inside = real_max(u, SMALL_U);
  const real outside = real_max(1 - inside, REAL_HALF_EPSILON);
  const real spread = c[TAIL] / outside;
  struct search s;
  s.low = real_sqrt(inside) * c[CORE];
  const real decayed = real_fma(real_log(spread / REAL_Z1, 0), c[INVERSE_MU], REAL_Z1);
  s.high = real_max(real_min(spread, decayed), s.low);
  s.x = real_min(s.low * real_sqrt(1 / outside), s.high);
  return s;
}

static inline struct search search_step(const real *c, real u, struct search s) {
  const real inside = real_max(u, SMALL_U);
  const real outside = real_max(1 - inside, REAL_HALF_EPSILON);
  const real wanted = real_log(inside / outside, 0);
  const struct view v = look(c, s.x);
  const struct within within = gather(c, v);
  const real mirror_beyond = c[Z2] * v.inverse_d2 * v.mirror.exp;
  const real flux_beyond = real_fma(REAL_Z1, v.inverse_d1, mirror_beyond);
  const real phi_beyond = c[CDF_PHI_NEAR] * v.apart * v.mirror.quotient;
  const real beyond = within.real_left * real_fma(c[CDF_FLUX_1], flux_beyond, phi_beyond);
  const real density =
      s.x * within.real_left *
      bracket(v, c[MU], c[CDF_PHI_NEAR], c[CDF_FLUX_1] * REAL_Z1, c[CDF_FLUX_1] * c[Z2]);
  const real excess = real_log(within.cdf / beyond, 0) - wanted;
  s.low = excess < 0 ? s.x : s.low;
  s.high = excess < 0 ? s.high : s.x;
  const real newton = -excess * (within.cdf * beyond) / (s.x * density);
  const real next = s.x * real_exp(real_max(real_min(newton, 5), -5)).exp;
  /* At the root, rounding decides which end of the bracket x becomes. BRACKET_SLACK makes sure
   * that the next x is still accepted then. */
  const int kept = next > s.low * (1 - BRACKET_SLACK) && next < s.high * (1 + BRACKET_SLACK);
  s.x = kept ? next : real_sqrt(s.low * s.high);
  return s;
}

static inline real search_end(const real *c, real u, real found) {
  const real x = u < SMALL_U ? real_sqrt(u) * c[CORE] : found;
  const real r = x * c[MM_PER_UNIT];
  const real bounded = u < 1 ? r : (real)INFINITY;
  return c[CDF_LIMIT] > 0 && u > 0 ? bounded : 0;
}

/* SEARCH(n, u, r, steps, coefficients) finds the radii r[n] of u[n] in blocks: each loop over the
 * numbers of a block is vectorized. `coefficients` are statements that declare the coefficients c
 * of number k. */
enum { SEARCH_BLOCK = 64 };
#define SEARCH(n, u, r, steps, coefficients)                                                       \
  for (size_t done = 0; done < n; done += SEARCH_BLOCK) {                                          \
    const size_t block = CORE_WHOLE(n - done < SEARCH_BLOCK ? n - done : SEARCH_BLOCK);            \
    real x[SEARCH_BLOCK], low[SEARCH_BLOCK], high[SEARCH_BLOCK];                                   \
    for (size_t i = 0; i < block; i++) {                                                           \
      const size_t k = done + i;                                                                   \
      coefficients const struct search begun = search_begin(c, u[k]);                              \
      x[i] = begun.x;                                                                              \
      low[i] = begun.low;                                                                          \
      high[i] = begun.high;                                                                        \
    }                                                                                              \
    for (int step = 0; step < steps; step++) {                                                     \
      for (size_t i = 0; i < block; i++) {                                                         \
        const size_t k = done + i;                                                                 \
        coefficients const struct search next =                                                    \
            search_step(c, u[k], (struct search){x[i], low[i], high[i]});                          \
        x[i] = next.x;                                                                             \
        low[i] = next.low;                                                                         \
        high[i] = next.high;                                                                       \
      }                                                                                            \
    }                                                                                              \
    for (size_t i = 0; i < block; i++) {                                                           \
      const size_t k = done + i;                                                                   \
      coefficients r[k] = search_end(c, u[k], x[i]);                                               \
    }                                                                                              \
  }

/* VIEW_KERNEL(quantity) defines eval_<quantity>(), the kernel of <quantity>_of(). One loop measures
 * the distances of a block of radii and evaluates the block before. The roots and divisions of the
 * one wait for nothing of the other, so a processor's divider and multipliers work at the same
 * time. Radius by radius the chain of operations is too long for that: R took a fifth longer. For
 * ln R and the cdf this is slower with some instruction sets. */
enum { BLOCK = 64 };
struct block {
  real d1[BLOCK];
  real d2[BLOCK];
  real inverse_d1_d2[BLOCK];
  real apart[BLOCK];
};

static inline void block_set(struct block *block, size_t i, struct distances distances) {
  block->d1[i] = distances.d1;
  block->d2[i] = distances.d2;
  block->inverse_d1_d2[i] = distances.inverse_d1_d2;
  block->apart[i] = distances.apart;
}

static inline struct distances block_get(const struct block *block, size_t i) {
  return (struct distances){block->d1[i], block->d2[i], block->inverse_d1_d2[i], block->apart[i]};
}

static inline size_t block_length(size_t left) {
  return CORE_WHOLE(left < BLOCK ? left : BLOCK);
}

#define VIEW_KERNEL(quantity)                                                                      \
  static void eval_##quantity(const real *restrict c, size_t n, const real *restrict r,            \
                              real *restrict out) {                                                \
    struct block block;                                                                            \
    for (size_t i = 0; i < block_length(n); i++) {                                                 \
      block_set(&block, i, measure(c, kernel_units(c, r[i])));                                     \
    }                                                                                              \
    for (size_t done = 0; done < n; done += BLOCK) {                                               \
      const size_t now = block_length(n - done);                                                   \
      const size_t next = block_length(n - done - now);                                            \
      const real *restrict now_r = r + done;                                                       \
      const real *restrict next_r = now_r + now;                                                   \
      for (size_t i = 0; i < next; i++) {                                                          \
        const struct distances measured = block_get(&block, i);                                    \
        block_set(&block, i, measure(c, kernel_units(c, next_r[i])));                              \
        out[done + i] = quantity##_of(c, view_of(c, kernel_units(c, now_r[i]), measured));         \
      }                                                                                            \
      for (size_t i = next; i < now; i++) {                                                        \
        out[done + i] =                                                                            \
            quantity##_of(c, view_of(c, kernel_units(c, now_r[i]), block_get(&block, i)));         \
      }                                                                                            \
    }                                                                                              \
  }

VIEW_KERNEL(R_usual)
VIEW_KERNEL(R_dense)
CORE_KERNEL(eval_cdf, dipole_cdf)
CORE_KERNEL(eval_ln_R, dipole_ln_R)
CORE_KERNEL(eval_slope, dipole_slope)
CORE_KERNEL(eval_transfer, dipole_transfer)
CORE_KERNEL(eval_by_a, dipole_by_a)
CORE_KERNEL(eval_by_s, dipole_by_s)

static void eval_R(const real *restrict c, size_t n, const real *restrict r, real *restrict R) {
  const int dense = CORE_REAL == 32 && c[UNITS_PER_MM] > DENSE;
  (dense ? eval_R_dense : eval_R_usual)(c, n, r, R);
}

static void sample(const real *restrict c, size_t n, const real *restrict u, real *restrict r) {
  const int steps = c[Z2] > WIDE_Z2 ? SAMPLE_STEPS_WIDE : SAMPLE_STEPS;
  SEARCH(n, u, r, steps, )
}

/* ---- a medium for each value ----------------------------------------------------------------- */

static inline real dipole_R(const real *c, real r) {
  return R_usual_of(c, look_from(c, r));
}

static inline real dipole_albedo(const real *c, real r) {
  (void)r;
  return c[ALBEDO];
}

LANES_KERNEL(varying_R, COEFFICIENTS, lane_fill, dipole_R, INFINITY)
LANES_KERNEL(varying_cdf, COEFFICIENTS, lane_fill, dipole_cdf, INFINITY)
LANES_KERNEL(varying_albedo, COEFFICIENTS, lane_fill, dipole_albedo, INFINITY)
#if CORE_REAL == 64
LANES_GRADIENT(varying_gradient, COEFFICIENTS, lane_fill, dipole_ln_R, dipole_derivatives)
#endif

static void varying_sample(const real *restrict shared, const real *restrict words, size_t n,
                           const real *restrict sigma_a, const real *restrict sigma_s,
                           const real *restrict u, real *restrict r) {
  (void)words;
  /* The mirror source of this eta is highest where nothing scatters, with D = 2/3. */
  const real z2 = (1 + shared[LANES_Z2_PER_D] * (REAL(2.0) / 3)) * REAL_Z1;
  const int steps = z2 > WIDE_Z2 ? SAMPLE_STEPS_WIDE : SAMPLE_STEPS;
  SEARCH(n, u, r, steps, real c[COEFFICIENTS];
         lane_fill(shared, lane_of(shared, sigma_a[k], sigma_s[k]), c);)
  for (size_t i = 0; i < CORE_WHOLE(n); i++) {
    const int good = lane_good(shared, sigma_a[i], sigma_s[i]) & (u[i] >= 0) & (u[i] <= 1);
    r[i] = good ? r[i] : (real)NAN;
  }
}

CORE_KERNEL_TABLE(dipole, .sample = sample, CORE_KERNELS_OF_ALL,
                  .evaluate[CORE_ELEMENTWISE_TRANSFER] = eval_transfer,
                  .evaluate[CORE_ELEMENTWISE_BY_SIGMA_A] = eval_by_a,
                  .evaluate[CORE_ELEMENTWISE_BY_SIGMA_S] = eval_by_s,
#if CORE_REAL == 64
                  .varying_gradient = varying_gradient,
#endif
                  LANES_KERNELS_OF_ALL);

#else /* what follows prepares a profile, and is compiled once for all instruction sets */

#include "core/dd.h"

/* Scales three weights by a power of two, which their exponent takes back, such that `scale`, by
 * which they are multiplied, is between 2^least and 2^most. With that range, in single precision,
 * no weight underflows in the kernels' unit, no sum overflows near the source, and no sum underflows
 * before R does. */
static void set_weights(double scale, int least, int most, double *weights, double *exponent) {
  const int size = scale > 0 ? ilogb(scale) : least;
  const int power = size < least ? size - least : size > most ? size - most : 0;
  *exponent += power;
  for (int i = 0; i < 3; i++) {
    weights[i] = ldexp(weights[i], -power);
  }
}

static void set_scales(struct lane lane, double power, double *c) {
  const double scale = power * (lane.sigma_t * lane.sigma_t) * 0.0795774715459476679;
  const double to_slope[3] = {1 / Z1, 1 / (Z1 * Z1 * Z1), 1 / (Z1 * Z1 * Z1)};
  for (int i = 0; i < 3; i++) {
    c[R_PHI + i] = ldexp(c[R_PHI + i], -LANE_R_UP);
    c[SLOPE_PHI + i] = c[R_PHI + i] * to_slope[i] * lane.sigma_t;
  }
  c[R_EXPONENT] = c[SLOPE_EXPONENT] = 0;
  set_weights(scale, 90, 100, &c[R_PHI], &c[R_EXPONENT]);
  set_weights(scale * lane.sigma_t, 70, 80, &c[SLOPE_PHI], &c[SLOPE_EXPONENT]);
}

/* Splits a number so that neither part loses digits in single precision. */
static void set_parts(dd x, double *high, double *low) {
  *high = (double)(float)dd_round(x);
  *low = dd_round(dd_sub(x, dd_from(*high)));
}

/* R(f) falls like e^(-q) with q up to some hundred: the 16 epsilon of
 * tests/accuracy/test_transfer.c need k and mu in double-double. */
static void set_transfer(const core_medium *medium, const double *shared, struct lane_dipole d,
                         double *c) {
  static const dd two_pi = {0x1.921fb54442d18p+2, 0x1.1a62633145c07p-52};
  const dd sigma_a = dd_from(medium->sigma_a_per_mm);
  const dd reduced = dd_mul(dd_two_sum(1, -medium->g), dd_from(medium->sigma_s_per_mm));
  const dd sigma_t = dd_add(sigma_a, reduced), absorbed = dd_div(sigma_a, sigma_t);
  const dd three_D = dd_add(dd_from(1), shared[LANES_GROSJEAN] > 0 ? absorbed : dd_from(0));
  set_parts(dd_div(two_pi, sigma_t), &c[WAVE_HI], &c[WAVE_LO]);
  set_parts(dd_div(dd_mul(dd_from(3), absorbed), three_D), &c[MU_SQUARED_HI], &c[MU_SQUARED_LO]);
  c[TRANSFER_FLUX] = 0.5 * d.power * shared[LANES_C_FLUX];
  c[TRANSFER_PHI] = 0.5 * d.power * shared[LANES_C_BETWEEN];
}

/* Returns the largest mu (d2 - d1) at which the mirror source still matters: it is at most mu (z2 -
 * z1), and the mirror source's flux is at most z2 / z1 e^(-mu (d2 - d1)) times the real one's. */
static double mirrored_condition(struct lane_dipole d) {
  return fmin(d.mu * d.z2_less_1, real_log(1 + d.z2_less_1, 0));
}

core_fault core_dipole_check(const core_inputs *inputs, core_radii_range *radii) {
  (void)inputs;
  (void)radii;
  return (core_fault){0};
}

core_fault core_dipole_prepare(const core_inputs *inputs, core_preparation *preparation) {
  const core_medium *medium = inputs->medium;
  double shared[CORE_VARYING_SHARED_MAX];
  const struct lane lane = lane_of_medium(shared, inputs->variant, inputs->moments, medium);
  const struct lane_dipole dipole = lane_dipole_of(shared, lane);
  double *c = preparation->coefficients;
  lane_fill(shared, lane, c);
  set_scales(lane, dipole.power, c);
  set_transfer(medium, shared, dipole, c);
  preparation->notes = core_similarity_note(inputs);
  preparation->albedo = c[ALBEDO];
  /* the error bound contains 1 + mu_tr d1, which is at most 1 + mu_tr (z1 + r) */
  preparation->error_epsilons =
      DIPOLE_ERROR_EPSILONS * (1 + dipole.mu) + 3 * fmax(mirrored_condition(dipole) - 4, 0);
  preparation->slope_epsilons = (DIPOLE_SLOPE_EPSILONS - DIPOLE_ERROR_EPSILONS) * (1 + dipole.mu);
  preparation->error_epsilons_per_mm = DIPOLE_ERROR_EPSILONS * c[MU] * c[UNITS_PER_MM];
  return (core_fault){0};
}

#endif
