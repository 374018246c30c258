/* The dipole family: one kernel with three switches.
 *
 * Source: E. d'Eon, "A Better Dipole", 2012, Table 2 and Figure 17; the classical member is Jensen,
 * Marschner, Levoy, Hanrahan 2001 (Farrell, Patterson, Wilson 1992). With distances d1, d2 from the
 * real source at depth z1 = 1 / sigma_t' and its mirror image at height z2 = z1 + 4 A D,
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
 * Domain: every medium that core_medium_check() accepts; radii from 0 to infinity.
 * Error: DIPOLE_ERROR_EPSILONS epsilon (1 + mu_tr d1), relative, for R, albedo and cdf, in the
 * epsilon of the evaluator; the factor in brackets is the condition of e^(-mu_tr d1).
 *
 * Everything is computed in units of z1, where d1 >= 1, and every subtraction that would lose
 * digits is rewritten as a sum of positive terms: d2 - d1 = (z2^2 - z1^2) / (d1 + d2) e^(-mu d1) /
 * d1 - e^(-mu d2) / d2 = e^(-mu d1) / (d1 d2) [d2 - d1 + d1 (1 - e^(-mu (d2 - d1)))] and for the
 * cdf, with a_i = d_i - z_i = r^2 / (d_i + z_i), 1 - z_i / d_i e^(-mu a_i) = [a_i + z_i (1 - e^(-mu
 * a_i))] / d_i a1 - a2 = r^2 (d2 - d1 + z2 - z1) / ((d1 + z1) (d2 + z2))
 */
#include "core/kernels.h"

/* What preparation leaves for the kernels; lengths in units of z1. */
enum coefficient {
  SIGMA_T_PRIME, /* 1/mm: what turns a radius into units of z1 */
  MU,            /* effective attenuation, per z1 */
  Z2,            /* height of the mirror source */
  Z2_SQUARED,
  Z2_LESS_1, /* z2 - z1 */
  Z2_SQUARED_LESS_1,
  SCALE, /* p sigma_t'^2 / (4 pi) = SCALE 2^SCALE_EXPONENT, SCALE at least 1 (or 0) */
  SCALE_EXPONENT,
  PHI,          /* C_phi / D */
  FLUX,         /* C_E */
  CDF_FLUX_1,   /* shares of the energy, over the albedo: flux of the real source, */
  CDF_FLUX_2,   /* of the mirror source, */
  CDF_PHI_FAR,  /* fluence, by the attenuation of the sources' own depths */
  CDF_PHI_NEAR, /* and by their difference in distance */
  CDF_LIMIT,    /* the cdf at infinity: 1, or 0 when nothing scatters */
  COEFFICIENTS
};
_Static_assert((int)COEFFICIENTS <= CORE_COEFFICIENTS_MAX, "the profile has room for them");

#define DIPOLE_ERROR_EPSILONS 8.0

#ifdef CORE_ISA /* ---- the kernels, compiled for each instruction set and precision               \
                   -------------- */

#include "core/kernel.h"

/* Radii beyond this many z1 are as good as infinite, in R (which has underflowed) and in the cdf
 * (which has rounded to its limit); below it no square overflows. */
#if CORE_REAL == 64
#define FAR 1e150
#else
#define FAR 1e19f
#endif

static inline real dipole_R(const real *c, real r) {
  const real x = real_min(r * c[SIGMA_T_PRIME], FAR);
  const real mu = c[MU];
  const real d1 = real_sqrt(real_fma(x, x, 1));
  const real d2 = real_sqrt(real_fma(x, x, c[Z2_SQUARED]));
  const real inverse_d1_d2 = 1 / (d1 * d2);
  const real inverse_d1 = inverse_d1_d2 * d2;
  const real inverse_d2 = inverse_d1_d2 * d1;
  const real apart = c[Z2_SQUARED_LESS_1] / (d1 + d2);
  const real_exp_values mirror = real_exp(-mu * apart);

  const real phi = c[PHI] * inverse_d2 * real_fma(d1, mirror.one_minus_exp, apart);
  const real flux1 = real_fma(mu, d1, 1) * inverse_d1 * inverse_d1;
  const real flux2 = c[Z2] * real_fma(mu, d2, 1) * inverse_d2 * inverse_d2;
  const real flux = real_fma(flux2 * (inverse_d2 * d1), mirror.exp, flux1);
  const real sum = real_fma(c[FLUX], flux, phi);
  return real_times_exp(c[SCALE] * inverse_d1 * sum, -mu * d1, c[SCALE_EXPONENT]);
}

static inline real dipole_cdf(const real *c, real r) {
  const real x = real_min(r * c[SIGMA_T_PRIME], FAR);
  const real mu = c[MU];
  const real d1 = real_sqrt(real_fma(x, x, 1));
  const real d2 = real_sqrt(real_fma(x, x, c[Z2_SQUARED]));
  const real inverse_d1_d2 = 1 / (d1 * d2);
  const real slope1 = x / (d1 + 1);
  const real slope2 = x / (d2 + c[Z2]);
  const real apart = c[Z2_SQUARED_LESS_1] / (d1 + d2);
  const real a1 = x * slope1;
  const real a2 = x * slope2;
  const real a1_less_a2 = slope1 * slope2 * (apart + c[Z2_LESS_1]);
  const real_exp_values far = real_exp(-mu * a2);
  const real_exp_values near = real_exp(-mu * a1_less_a2);

  const real gone2 = far.one_minus_exp;
  const real near_length = a1_less_a2 * near.quotient; /* (1 - e^(-mu (a1 - a2))) / mu */
  const real gone1 = real_fma(mu * near_length, 1 - gone2, gone2); /* 1 - e^(-mu a1) */
  const real flux1 = (a1 + gone1) * (inverse_d1_d2 * d2);
  const real flux2 = real_fma(c[Z2], gone2, a2) * (inverse_d1_d2 * d1);
  const real phi = real_fma(c[CDF_PHI_NEAR] * (1 - gone2), near_length, c[CDF_PHI_FAR] * gone2);
  const real cdf = real_fma(c[CDF_FLUX_1], flux1, real_fma(c[CDF_FLUX_2], flux2, phi));
  /* Rounding may leave the sum an ulp above its limit. */
  return x < FAR ? real_min(cdf, c[CDF_LIMIT]) : c[CDF_LIMIT];
}

CORE_KERNEL(eval_R, dipole_R)
CORE_KERNEL(eval_cdf, dipole_cdf)

CORE_KERNEL_TABLE(dipole, .R = eval_R, .cdf = eval_cdf);

#else /* ---- preparation, compiled once                                                           \
         ----------------------------------------------------------- */

#define CORE_REAL 64
#include "core/dd.h"
#include "core/kernel.h"

static const dd ONE = {1, 0};
static const dd TWO = {2, 0};
static const dd THREE = {3, 0};
static const dd FOUR_PI = {0x1.921fb54442d18p+3, 0x1.1a62633145c07p-51};

/* The quantities of Table 2, in units of z1. */
struct dipole {
  dd sigma_t_prime;
  dd albedo_prime_power; /* p */
  dd diffusion;          /* D */
  dd mu;
  dd z2_less_1;
  dd c_phi;
  dd c_flux;
};

static struct dipole table_2(int variant, enum core_moments moments, const core_medium *medium) {
  struct dipole dipole;
  const dd sigma_a = dd_from(medium->sigma_a_per_mm);
  const dd sigma_s_prime = dd_mul(dd_two_sum(1, -medium->g), dd_from(medium->sigma_s_per_mm));
  dipole.sigma_t_prime = dd_add(sigma_a, sigma_s_prime);
  const dd absorbed = dd_div(sigma_a, dipole.sigma_t_prime);
  const dd scattered = dd_div(sigma_s_prime, dipole.sigma_t_prime);
  const core_fresnel fresnel = core_fresnel_moments(moments, medium->eta);
  const dd one_minus_2c1 = dd_from(fresnel.one_minus_2c1);
  const dd one_minus_3c2 = dd_from(fresnel.one_minus_3c2);

  const bool grosjean = (variant & CORE_DIPOLE_GROSJEAN) != 0;
  dipole.diffusion = dd_div(grosjean ? dd_add(ONE, absorbed) : ONE, THREE);
  dipole.albedo_prime_power = grosjean ? dd_mul(scattered, scattered) : scattered;
  dipole.mu = dd_sqrt(dd_div(absorbed, dipole.diffusion));

  const dd lost = (variant & CORE_DIPOLE_BOUNDARY) ? one_minus_3c2 : one_minus_2c1;
  const dd boundary = dd_div(dd_sub(TWO, lost), one_minus_2c1);
  dipole.z2_less_1 = dd_scale(dd_mul(boundary, dipole.diffusion), 4);

  const bool exitance = (variant & CORE_DIPOLE_EXITANCE) != 0;
  dipole.c_phi = exitance ? dd_scale(one_minus_2c1, 0.25) : dd_from(0);
  dipole.c_flux = exitance ? dd_scale(one_minus_3c2, 0.5) : ONE;
  return dipole;
}

static void set_scale(const struct dipole *dipole, double *c) {
  const dd squared = dd_mul(dipole->sigma_t_prime, dipole->sigma_t_prime);
  const double scale = dd_round(dd_div(dd_mul(dipole->albedo_prime_power, squared), FOUR_PI));
  int exponent = 0;
  if (scale < 1 && scale > 0) {
    exponent = ilogb(scale);
  }
  c[SCALE] = ldexp(scale, -exponent);
  c[SCALE_EXPONENT] = exponent;
}

/* The closed forms of the albedo and of the energy within r, divided by the albedo. In
 * double-double where it matters: with sigma_a = 0 the better dipole's albedo is 1 to the last bit.
 */
static double set_energy(const struct dipole *dipole, double *c) {
  const dd z2 = dd_add(ONE, dipole->z2_less_1);
  const double reach = dd_round(dipole->mu) * dd_round(dipole->z2_less_1);
  const dd real_share = dd_from(real_exp(-dd_round(dipole->mu)).exp);
  const dd mirror_share = dd_mul(real_share, dd_from(real_exp(-reach).exp));
  const dd phi = dd_div(dipole->c_phi, dipole->diffusion);
  /* phi (e^(-mu z1) - e^(-mu z2)) / mu */
  const dd between = dd_mul(dd_mul(phi, dd_mul(real_share, dipole->z2_less_1)),
                            dd_from(real_exp(-reach).quotient));
  const dd flux = dd_mul(dipole->c_flux, dd_add(real_share, mirror_share));
  const dd sum = dd_add(flux, between);
  const dd albedo = dd_scale(dd_mul(dipole->albedo_prime_power, sum), 0.5);
  const bool scatters = dd_round(dipole->albedo_prime_power) > 0;

  c[Z2] = dd_round(z2);
  c[PHI] = dd_round(phi);
  c[FLUX] = dd_round(dipole->c_flux);
  c[CDF_LIMIT] = scatters;
  c[CDF_FLUX_1] = scatters ? dd_round(dd_div(dd_mul(dipole->c_flux, real_share), sum)) : 0;
  c[CDF_FLUX_2] = scatters ? dd_round(dd_div(dd_mul(dipole->c_flux, mirror_share), sum)) : 0;
  c[CDF_PHI_FAR] = scatters ? dd_round(dd_div(between, sum)) : 0;
  c[CDF_PHI_NEAR] = scatters ? dd_round(dd_div(dd_mul(phi, real_share), sum)) : 0;
  return dd_round(albedo);
}

core_prepare_function core_dipole_prepare;

void core_dipole_prepare(int variant, enum core_moments moments, const core_medium *medium,
                         core_preparation *preparation) {
  const struct dipole dipole = table_2(variant, moments, medium);
  const dd z2_plus_1 = dd_add(TWO, dipole.z2_less_1);
  const dd z2 = dd_add(ONE, dipole.z2_less_1);
  double *c = preparation->coefficients;
  c[SIGMA_T_PRIME] = dd_round(dipole.sigma_t_prime);
  c[MU] = dd_round(dipole.mu);
  c[Z2_SQUARED] = dd_round(dd_mul(z2, z2));
  c[Z2_LESS_1] = dd_round(dipole.z2_less_1);
  c[Z2_SQUARED_LESS_1] = dd_round(dd_mul(dipole.z2_less_1, z2_plus_1));
  set_scale(&dipole, c);
  preparation->albedo = set_energy(&dipole, c);
  /* 1 + mu_tr d1 <= 1 + mu_tr (z1 + r) */
  preparation->error_epsilons = DIPOLE_ERROR_EPSILONS * (1 + c[MU]);
  preparation->error_epsilons_per_mm = DIPOLE_ERROR_EPSILONS * c[MU] * c[SIGMA_T_PRIME];
}

#endif
