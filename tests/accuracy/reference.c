#include "tests/accuracy/reference.h"

#include <math.h>
#include <string.h>

/* ---- preparation -------------------------------------------------------------------------- */

#define FIELDS(dipole)                                                                             \
  (dipole)->prefactor, (dipole)->diffusion_mm, (dipole)->mu_tr_per_mm, (dipole)->z1_mm,            \
      (dipole)->z2_mm, (dipole)->c_phi, (dipole)->c_flux, (dipole)->albedo

void reference_dipole_init(reference_dipole *dipole) {
  mpfr_inits2(REFERENCE_BITS, FIELDS(dipole), (mpfr_ptr)NULL);
}

void reference_dipole_clear(reference_dipole *dipole) {
  mpfr_clears(FIELDS(dipole), (mpfr_ptr)NULL);
}

/* The diffusion coefficient, the prefactor and what follows from the coefficients alone. */
static void set_volume(reference_dipole *dipole, bool grosjean, const core_medium *medium) {
  mpfr_t sigma_a, sigma_s_prime, sigma_t_prime;
  mpfr_inits2(REFERENCE_BITS, sigma_a, sigma_s_prime, sigma_t_prime, (mpfr_ptr)NULL);
  mpfr_set_d(sigma_a, medium->sigma_a_per_mm, MPFR_RNDN);
  mpfr_set_d(sigma_s_prime, medium->g, MPFR_RNDN);
  mpfr_ui_sub(sigma_s_prime, 1, sigma_s_prime, MPFR_RNDN);
  mpfr_mul_d(sigma_s_prime, sigma_s_prime, medium->sigma_s_per_mm, MPFR_RNDN);
  mpfr_add(sigma_t_prime, sigma_a, sigma_s_prime, MPFR_RNDN);

  mpfr_ui_div(dipole->z1_mm, 1, sigma_t_prime, MPFR_RNDN);
  mpfr_div(dipole->prefactor, sigma_s_prime, sigma_t_prime, MPFR_RNDN);
  mpfr_div_ui(dipole->diffusion_mm, dipole->z1_mm, 3, MPFR_RNDN);
  if (grosjean) {
    mpfr_sqr(dipole->prefactor, dipole->prefactor, MPFR_RNDN);
    mpfr_mul_2ui(dipole->diffusion_mm, sigma_a, 1, MPFR_RNDN);
    mpfr_add(dipole->diffusion_mm, dipole->diffusion_mm, sigma_s_prime, MPFR_RNDN);
    mpfr_div_ui(dipole->diffusion_mm, dipole->diffusion_mm, 3, MPFR_RNDN);
    mpfr_div(dipole->diffusion_mm, dipole->diffusion_mm, sigma_t_prime, MPFR_RNDN);
    mpfr_div(dipole->diffusion_mm, dipole->diffusion_mm, sigma_t_prime, MPFR_RNDN);
  }
  mpfr_div(dipole->mu_tr_per_mm, sigma_a, dipole->diffusion_mm, MPFR_RNDN);
  mpfr_sqrt(dipole->mu_tr_per_mm, dipole->mu_tr_per_mm, MPFR_RNDN);
  dipole->scatters = mpfr_sgn(sigma_s_prime) > 0;
  mpfr_clears(sigma_a, sigma_s_prime, sigma_t_prime, (mpfr_ptr)NULL);
}

/* z2 = z1 + 2 z_b, z_b = 2 A D, A = (1 + 2 C1 or 3 C2) / (1 - 2 C1) */
static void set_boundary(reference_dipole *dipole, bool boundary,
                         const reference_fresnel *fresnel) {
  mpfr_ui_sub(dipole->z2_mm, 2, boundary ? fresnel->one_minus_3c2 : fresnel->one_minus_2c1,
              MPFR_RNDN);
  mpfr_div(dipole->z2_mm, dipole->z2_mm, fresnel->one_minus_2c1, MPFR_RNDN);
  mpfr_mul(dipole->z2_mm, dipole->z2_mm, dipole->diffusion_mm, MPFR_RNDN);
  mpfr_mul_2ui(dipole->z2_mm, dipole->z2_mm, 2, MPFR_RNDN);
  mpfr_add(dipole->z2_mm, dipole->z2_mm, dipole->z1_mm, MPFR_RNDN);
}

static void set_exitance(reference_dipole *dipole, bool exitance,
                         const reference_fresnel *fresnel) {
  mpfr_set_ui(dipole->c_phi, 0, MPFR_RNDN);
  mpfr_set_ui(dipole->c_flux, 1, MPFR_RNDN);
  if (exitance) {
    mpfr_div_2ui(dipole->c_phi, fresnel->one_minus_2c1, 2, MPFR_RNDN);
    mpfr_div_2ui(dipole->c_flux, fresnel->one_minus_3c2, 1, MPFR_RNDN);
  }
}

/* ---- closed forms ------------------------------------------------------------------------- */

static double magnitude(const mpfr_t value) {
  return mpfr_zero_p(value) ? 0 : fabs((double)mpfr_get_exp(value));
}

/* Bits that no difference of the formulas can use up at this radius: each is, relative to its
 * terms, no smaller than a square of the ratio of two of the lengths r, z1, z2, 1 / mu_tr. */
static mpfr_prec_t working_bits(const reference_dipole *dipole, double r_mm) {
  const double r_exponent = r_mm > 0 && isfinite(r_mm) ? fabs((double)ilogb(r_mm)) : 0;
  const double lengths = r_exponent + magnitude(dipole->z1_mm) + magnitude(dipole->z2_mm) +
                         magnitude(dipole->mu_tr_per_mm);
  return REFERENCE_BITS + 2 * (mpfr_prec_t)lengths;
}

/* e^(-mu_tr x) */
static void attenuation(mpfr_t value, const reference_dipole *dipole, const mpfr_t x) {
  mpfr_mul(value, dipole->mu_tr_per_mm, x, MPFR_RNDN);
  mpfr_neg(value, value, MPFR_RNDN);
  mpfr_exp(value, value, MPFR_RNDN);
}

/* (e^(-mu z1) - e^(-mu z2)) / mu, which is z2 - z1 for mu = 0 */
static void set_fluence(mpfr_t fluence, const reference_dipole *dipole) {
  mpfr_t share;
  mpfr_init2(share, mpfr_get_prec(fluence));
  if (mpfr_zero_p(dipole->mu_tr_per_mm)) {
    mpfr_sub(fluence, dipole->z2_mm, dipole->z1_mm, MPFR_RNDN);
  } else {
    attenuation(fluence, dipole, dipole->z1_mm);
    attenuation(share, dipole, dipole->z2_mm);
    mpfr_sub(fluence, fluence, share, MPFR_RNDN);
    mpfr_div(fluence, fluence, dipole->mu_tr_per_mm, MPFR_RNDN);
  }
  mpfr_clear(share);
}

/* energy = p / 2 (C_E flux + C_phi / D fluence), with the brackets of the closed forms. */
static void combine(mpfr_t energy, const reference_dipole *dipole, mpfr_t flux, mpfr_t fluence) {
  mpfr_mul(flux, flux, dipole->c_flux, MPFR_RNDN);
  mpfr_mul(fluence, fluence, dipole->c_phi, MPFR_RNDN);
  mpfr_div(fluence, fluence, dipole->diffusion_mm, MPFR_RNDN);
  mpfr_add(energy, flux, fluence, MPFR_RNDN);
  mpfr_mul(energy, energy, dipole->prefactor, MPFR_RNDN);
  mpfr_div_2ui(energy, energy, 1, MPFR_RNDN);
}

static void set_albedo(reference_dipole *dipole) {
  mpfr_t flux, fluence, share;
  mpfr_inits2(working_bits(dipole, 0), flux, fluence, share, (mpfr_ptr)NULL);
  attenuation(flux, dipole, dipole->z1_mm);
  attenuation(share, dipole, dipole->z2_mm);
  mpfr_add(flux, flux, share, MPFR_RNDN);
  set_fluence(fluence, dipole);
  combine(dipole->albedo, dipole, flux, fluence);
  mpfr_clears(flux, fluence, share, (mpfr_ptr)NULL);
}

void reference_dipole_prepare(reference_dipole *dipole, int switches, enum core_moments moments,
                              const core_medium *medium) {
  const reference_fresnel *fresnel = reference_fresnel_moments(moments, medium->eta);
  set_volume(dipole, (switches & CORE_DIPOLE_GROSJEAN) != 0, medium);
  set_boundary(dipole, (switches & CORE_DIPOLE_BOUNDARY) != 0, fresnel);
  set_exitance(dipole, (switches & CORE_DIPOLE_EXITANCE) != 0, fresnel);
  set_albedo(dipole);
}

/* ---- at a radius --------------------------------------------------------------------------- */

/* A source, real or mirrored, as seen from a radius. */
struct source {
  mpfr_t z;
  mpfr_t d;
  mpfr_t left_at_z; /* e^(-mu_tr z) */
  mpfr_t left_at_d;
  mpfr_t mu_d; /* mu_tr d */
};

#define SOURCE_FIELDS(source)                                                                      \
  (source)->z, (source)->d, (source)->left_at_z, (source)->left_at_d, (source)->mu_d

static void source_start(struct source *source, const reference_dipole *dipole, const mpfr_t z_mm,
                         double r_mm) {
  mpfr_inits2(working_bits(dipole, r_mm), SOURCE_FIELDS(source), (mpfr_ptr)NULL);
  mpfr_set(source->z, z_mm, MPFR_RNDN);
  mpfr_set_d(source->d, r_mm, MPFR_RNDN);
  mpfr_hypot(source->d, source->d, source->z, MPFR_RNDN);
  attenuation(source->left_at_z, dipole, source->z);
  attenuation(source->left_at_d, dipole, source->d);
  mpfr_mul(source->mu_d, dipole->mu_tr_per_mm, source->d, MPFR_RNDN);
}

static void source_clear(struct source *source) {
  mpfr_clears(SOURCE_FIELDS(source), (mpfr_ptr)NULL);
}

/* flux += e^(-mu z) - (z / d) e^(-mu d); fluence += sign (e^(-mu z) - e^(-mu d)) / mu, which is
 * sign (d - z) for mu = 0. */
static void add_within(mpfr_t flux, mpfr_t fluence, const reference_dipole *dipole,
                       const struct source *source, int sign) {
  mpfr_t term;
  mpfr_init2(term, mpfr_get_prec(flux));
  mpfr_add(flux, flux, source->left_at_z, MPFR_RNDN);
  mpfr_div(term, source->z, source->d, MPFR_RNDN); /* 1 at r = 0, so that nothing is left there */
  mpfr_mul(term, term, source->left_at_d, MPFR_RNDN);
  mpfr_sub(flux, flux, term, MPFR_RNDN);

  if (mpfr_zero_p(dipole->mu_tr_per_mm)) {
    mpfr_sub(term, source->d, source->z, MPFR_RNDN);
  } else {
    mpfr_sub(term, source->left_at_z, source->left_at_d, MPFR_RNDN);
    mpfr_div(term, term, dipole->mu_tr_per_mm, MPFR_RNDN);
  }
  mpfr_mul_si(term, term, sign, MPFR_RNDN);
  mpfr_add(fluence, fluence, term, MPFR_RNDN);
  mpfr_clear(term);
}

/* flux += z (1 + mu d) e^(-mu d) / d^3, fluence += sign e^(-mu d) / d */
static void add_R(mpfr_t flux, mpfr_t fluence, const reference_dipole *dipole,
                  const struct source *source, int sign) {
  (void)dipole;
  mpfr_t share, term;
  mpfr_inits2(mpfr_get_prec(flux), share, term, (mpfr_ptr)NULL);
  mpfr_div(share, source->left_at_d, source->d, MPFR_RNDN);

  mpfr_add_ui(term, source->mu_d, 1, MPFR_RNDN);
  mpfr_mul(term, term, source->z, MPFR_RNDN);
  mpfr_mul(term, term, share, MPFR_RNDN);
  mpfr_div(term, term, source->d, MPFR_RNDN);
  mpfr_div(term, term, source->d, MPFR_RNDN);
  mpfr_add(flux, flux, term, MPFR_RNDN);

  mpfr_mul_si(share, share, sign, MPFR_RNDN);
  mpfr_add(fluence, fluence, share, MPFR_RNDN);
  mpfr_clears(share, term, (mpfr_ptr)NULL);
}

/* The derivatives of the terms of add_R() over r, divided by r. With d' = r / d,
 *   d/dd e^(-mu d) / d              = -(1 + mu d) e^(-mu d) / d^2
 *   d/dd (1 + mu d) e^(-mu d) / d^3 = -(3 + 3 mu d + (mu d)^2) e^(-mu d) / d^4 */
static void add_slope(mpfr_t flux, mpfr_t fluence, const reference_dipole *dipole,
                      const struct source *source, int sign) {
  (void)dipole;
  mpfr_t cube, term;
  mpfr_inits2(mpfr_get_prec(flux), cube, term, (mpfr_ptr)NULL);
  mpfr_pow_ui(cube, source->d, 3, MPFR_RNDN);

  mpfr_add_ui(term, source->mu_d, 1, MPFR_RNDN);
  mpfr_mul(term, term, source->left_at_d, MPFR_RNDN);
  mpfr_div(term, term, cube, MPFR_RNDN);
  mpfr_mul_si(term, term, -sign, MPFR_RNDN);
  mpfr_add(fluence, fluence, term, MPFR_RNDN);

  mpfr_add_ui(term, source->mu_d, 3, MPFR_RNDN);
  mpfr_mul(term, term, source->mu_d, MPFR_RNDN);
  mpfr_add_ui(term, term, 3, MPFR_RNDN);
  mpfr_mul(term, term, source->left_at_d, MPFR_RNDN);
  mpfr_mul(term, term, source->z, MPFR_RNDN);
  mpfr_div(term, term, cube, MPFR_RNDN);
  mpfr_div(term, term, source->d, MPFR_RNDN);
  mpfr_div(term, term, source->d, MPFR_RNDN);
  mpfr_sub(flux, flux, term, MPFR_RNDN);
  mpfr_clears(cube, term, (mpfr_ptr)NULL);
}

/* flux += e^(-q z), fluence += sign e^(-q z) / q, which is -sign z for q = 0 */
static void add_transfer(mpfr_t flux, mpfr_t fluence, const mpfr_t q, const mpfr_t z, int sign) {
  mpfr_t term;
  mpfr_init2(term, mpfr_get_prec(flux));
  mpfr_mul(term, q, z, MPFR_RNDN);
  mpfr_neg(term, term, MPFR_RNDN);
  mpfr_exp(term, term, MPFR_RNDN);
  mpfr_add(flux, flux, term, MPFR_RNDN);
  if (mpfr_zero_p(q)) {
    mpfr_neg(term, z, MPFR_RNDN);
  } else {
    mpfr_div(term, term, q, MPFR_RNDN);
  }
  mpfr_mul_si(term, term, sign, MPFR_RNDN);
  mpfr_add(fluence, fluence, term, MPFR_RNDN);
  mpfr_clear(term);
}

/* The Hankel transform of R at a frequency, with q^2 = mu_tr^2 + (2 pi f)^2. */
static void set_transfer(mpfr_t value, const reference_dipole *dipole, double f_per_mm) {
  enum { BITS = 2000 }; /* the two sources may cancel */
  mpfr_t q, flux, fluence;
  mpfr_inits2(BITS, q, flux, fluence, (mpfr_ptr)NULL);
  mpfr_const_pi(q, MPFR_RNDN);
  mpfr_mul_2ui(q, q, 1, MPFR_RNDN);
  mpfr_mul_d(q, q, f_per_mm, MPFR_RNDN);
  mpfr_hypot(q, q, dipole->mu_tr_per_mm, MPFR_RNDN);
  mpfr_set_zero(flux, 1);
  mpfr_set_zero(fluence, 1);
  add_transfer(flux, fluence, q, dipole->z1_mm, 1);
  add_transfer(flux, fluence, q, dipole->z2_mm, -1);
  combine(value, dipole, flux, fluence);
  mpfr_clears(q, flux, fluence, (mpfr_ptr)NULL);
}

typedef void add_function(mpfr_t flux, mpfr_t fluence, const reference_dipole *dipole,
                          const struct source *source, int sign);

/* p / 2 (C_E flux + C_phi / D fluence), with what both sources add. */
static void sum_sources(mpfr_t value, const reference_dipole *dipole,
                        const struct source sources[2], add_function *add) {
  mpfr_t flux, fluence;
  mpfr_inits2(mpfr_get_prec(sources[0].d), flux, fluence, (mpfr_ptr)NULL);
  mpfr_set_zero(flux, 1);
  mpfr_set_zero(fluence, 1);
  add(flux, fluence, dipole, &sources[0], 1);
  add(flux, fluence, dipole, &sources[1], -1);
  combine(value, dipole, flux, fluence);
  mpfr_clears(flux, fluence, (mpfr_ptr)NULL);
}

void reference_values_init(reference_values *values) {
  for (int i = 0; i < CORE_ELEMENTWISE_COUNT; i++) {
    mpfr_init2(values->of[i], REFERENCE_BITS);
  }
}

void reference_values_clear(reference_values *values) {
  for (int i = 0; i < CORE_ELEMENTWISE_COUNT; i++) {
    mpfr_clear(values->of[i]);
  }
}

/* Where nothing scatters, and infinitely far away. */
static void set_limits(const reference_dipole *dipole, reference_values *values) {
  for (int i = 0; i < CORE_ELEMENTWISE_COUNT; i++) {
    mpfr_set_zero(values->of[i], 1);
  }
  mpfr_set_ui(values->of[CORE_ELEMENTWISE_CDF], dipole->scatters, MPFR_RNDN);
  mpfr_set_inf(values->of[CORE_ELEMENTWISE_LN_R], -1);
}

/* ln R where R has left even MPFR's range: with e^(-mu_tr d1) taken out of both sources. */
static void set_deep_ln_R(mpfr_t ln_R, const reference_dipole *dipole, struct source sources[2],
                          const mpfr_t two_pi) {
  mpfr_set_ui(sources[0].left_at_d, 1, MPFR_RNDN);
  mpfr_sub(sources[1].left_at_d, sources[0].mu_d, sources[1].mu_d, MPFR_RNDN);
  mpfr_exp(sources[1].left_at_d, sources[1].left_at_d, MPFR_RNDN);
  sum_sources(ln_R, dipole, sources, add_R);
  mpfr_div(ln_R, ln_R, two_pi, MPFR_RNDN);
  mpfr_log(ln_R, ln_R, MPFR_RNDN);
  mpfr_sub(ln_R, ln_R, sources[0].mu_d, MPFR_RNDN);
}

void reference_dipole_evaluate(const reference_dipole *dipole, double r_mm,
                               reference_values *values) {
  if (!dipole->scatters || isinf(r_mm)) {
    set_limits(dipole, values);
    return;
  }
  struct source sources[2];
  source_start(&sources[0], dipole, dipole->z1_mm, r_mm);
  source_start(&sources[1], dipole, dipole->z2_mm, r_mm);
  mpfr_t two_pi;
  mpfr_init2(two_pi, REFERENCE_BITS);
  mpfr_const_pi(two_pi, MPFR_RNDN);
  mpfr_mul_2ui(two_pi, two_pi, 1, MPFR_RNDN);

  mpfr_ptr R = values->of[CORE_ELEMENTWISE_R];
  sum_sources(R, dipole, sources, add_R);
  mpfr_div(R, R, two_pi, MPFR_RNDN);
  mpfr_log(values->of[CORE_ELEMENTWISE_LN_R], R, MPFR_RNDN);

  mpfr_ptr slope = values->of[CORE_ELEMENTWISE_SLOPE];
  sum_sources(slope, dipole, sources, add_slope);
  mpfr_div(slope, slope, two_pi, MPFR_RNDN);
  mpfr_mul_d(slope, slope, r_mm, MPFR_RNDN);

  mpfr_ptr ring = values->of[CORE_ELEMENTWISE_RING];
  mpfr_mul(ring, R, two_pi, MPFR_RNDN);
  mpfr_mul_d(ring, ring, r_mm, MPFR_RNDN);
  mpfr_ptr pdf = values->of[CORE_ELEMENTWISE_PDF];
  mpfr_div(pdf, ring, dipole->albedo, MPFR_RNDN);

  mpfr_ptr cdf = values->of[CORE_ELEMENTWISE_CDF];
  sum_sources(cdf, dipole, sources, add_within);
  mpfr_div(cdf, cdf, dipole->albedo, MPFR_RNDN);

  set_transfer(values->of[CORE_ELEMENTWISE_TRANSFER], dipole, r_mm);

  if (mpfr_zero_p(R)) { /* last, because it spoils the sources */
    set_deep_ln_R(values->of[CORE_ELEMENTWISE_LN_R], dipole, sources, two_pi);
  }
  mpfr_clear(two_pi);
  source_clear(&sources[0]);
  source_clear(&sources[1]);
}

double reference_dipole_condition(const reference_dipole *dipole, double r_mm) {
  const double d_mm = hypot(r_mm, mpfr_get_d(dipole->z1_mm, MPFR_RNDN));
  return 1 + mpfr_get_d(dipole->mu_tr_per_mm, MPFR_RNDN) * d_mm;
}

int reference_switches(unsigned model) {
  switch (model) {
#define CORE_MODEL(id, IDENT, name, formula, kernels, variant, parameters, source)                 \
  case id:                                                                                         \
    return strcmp(#formula, "dipole") == 0 ? (variant) : -1;
#include "core/models.def"
  default:
    return -1;
  }
}
