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

static void distance(mpfr_t d, const mpfr_t z, double r_mm) {
  mpfr_set_d(d, r_mm, MPFR_RNDN);
  mpfr_hypot(d, d, z, MPFR_RNDN);
}

/* sum += sign * (e^(-mu a) - e^(-mu b)) / mu; for mu = 0 that is sign * (b - a). */
static void add_fluence(mpfr_t sum, const reference_dipole *dipole, const mpfr_t a, const mpfr_t b,
                        int sign) {
  mpfr_t at_a, at_b;
  mpfr_inits2(mpfr_get_prec(sum), at_a, at_b, (mpfr_ptr)NULL);
  if (mpfr_zero_p(dipole->mu_tr_per_mm)) {
    mpfr_sub(at_a, b, a, MPFR_RNDN);
  } else {
    attenuation(at_a, dipole, a);
    attenuation(at_b, dipole, b);
    mpfr_sub(at_a, at_a, at_b, MPFR_RNDN);
    mpfr_div(at_a, at_a, dipole->mu_tr_per_mm, MPFR_RNDN);
  }
  mpfr_mul_si(at_a, at_a, sign, MPFR_RNDN);
  mpfr_add(sum, sum, at_a, MPFR_RNDN);
  mpfr_clears(at_a, at_b, (mpfr_ptr)NULL);
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
  mpfr_set_zero(fluence, 1);
  add_fluence(fluence, dipole, dipole->z1_mm, dipole->z2_mm, 1);
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

/* flux += e^(-mu z) - (z / d) e^(-mu d) */
static void add_flux_within(mpfr_t flux, const reference_dipole *dipole, const mpfr_t z,
                            const mpfr_t d) {
  mpfr_t term, ratio;
  mpfr_inits2(mpfr_get_prec(flux), term, ratio, (mpfr_ptr)NULL);
  attenuation(term, dipole, z);
  mpfr_add(flux, flux, term, MPFR_RNDN);
  attenuation(term, dipole, d);
  mpfr_div(ratio, z, d, MPFR_RNDN); /* 1 at r = 0, so that nothing is left there */
  mpfr_mul(term, term, ratio, MPFR_RNDN);
  mpfr_sub(flux, flux, term, MPFR_RNDN);
  mpfr_clears(term, ratio, (mpfr_ptr)NULL);
}

void reference_dipole_cdf(const reference_dipole *dipole, double r_mm, mpfr_t value) {
  if (!dipole->scatters || isinf(r_mm)) {
    mpfr_set_ui(value, dipole->scatters, MPFR_RNDN);
    return;
  }
  mpfr_t flux, fluence, d1, d2;
  mpfr_inits2(working_bits(dipole, r_mm), flux, fluence, d1, d2, (mpfr_ptr)NULL);
  distance(d1, dipole->z1_mm, r_mm);
  distance(d2, dipole->z2_mm, r_mm);
  mpfr_set_zero(flux, 1);
  add_flux_within(flux, dipole, dipole->z1_mm, d1);
  add_flux_within(flux, dipole, dipole->z2_mm, d2);
  mpfr_set_zero(fluence, 1);
  add_fluence(fluence, dipole, dipole->z1_mm, d1, 1);
  add_fluence(fluence, dipole, dipole->z2_mm, d2, -1);
  combine(flux, dipole, flux, fluence);
  mpfr_div(value, flux, dipole->albedo, MPFR_RNDN);
  mpfr_clears(flux, fluence, d1, d2, (mpfr_ptr)NULL);
}

/* flux += z (1 + mu d) e^(-mu d) / d^3, fluence += sign * e^(-mu d) / d */
static void add_source(mpfr_t flux, mpfr_t fluence, const reference_dipole *dipole, const mpfr_t z,
                       double r_mm, int sign) {
  mpfr_t d, share, term;
  mpfr_inits2(mpfr_get_prec(flux), d, share, term, (mpfr_ptr)NULL);
  distance(d, z, r_mm);
  attenuation(share, dipole, d);
  mpfr_div(share, share, d, MPFR_RNDN);

  mpfr_mul(term, dipole->mu_tr_per_mm, d, MPFR_RNDN);
  mpfr_add_ui(term, term, 1, MPFR_RNDN);
  mpfr_mul(term, term, z, MPFR_RNDN);
  mpfr_mul(term, term, share, MPFR_RNDN);
  mpfr_div(term, term, d, MPFR_RNDN);
  mpfr_div(term, term, d, MPFR_RNDN);
  mpfr_add(flux, flux, term, MPFR_RNDN);

  mpfr_mul_si(share, share, sign, MPFR_RNDN);
  mpfr_add(fluence, fluence, share, MPFR_RNDN);
  mpfr_clears(d, share, term, (mpfr_ptr)NULL);
}

void reference_dipole_R(const reference_dipole *dipole, double r_mm, mpfr_t value) {
  if (!dipole->scatters || isinf(r_mm)) {
    mpfr_set_zero(value, 1);
    return;
  }
  mpfr_t flux, fluence, pi;
  mpfr_inits2(working_bits(dipole, r_mm), flux, fluence, pi, (mpfr_ptr)NULL);
  mpfr_set_zero(flux, 1);
  mpfr_set_zero(fluence, 1);
  add_source(flux, fluence, dipole, dipole->z1_mm, r_mm, 1);
  add_source(flux, fluence, dipole, dipole->z2_mm, r_mm, -1);
  combine(flux, dipole, flux, fluence);
  mpfr_const_pi(pi, MPFR_RNDN);
  mpfr_mul_2ui(pi, pi, 1, MPFR_RNDN);
  mpfr_div(value, flux, pi, MPFR_RNDN);
  mpfr_clears(flux, fluence, pi, (mpfr_ptr)NULL);
}

double reference_dipole_condition(const reference_dipole *dipole, double r_mm) {
  const double d_mm = hypot(r_mm, mpfr_get_d(dipole->z1_mm, MPFR_RNDN));
  return 1 + mpfr_get_d(dipole->mu_tr_per_mm, MPFR_RNDN) * d_mm;
}

int reference_switches(unsigned model) {
  switch (model) {
#define CORE_MODEL(id, IDENT, name, family, variant, source)                                       \
  case id:                                                                                         \
    return strcmp(#family, "dipole") == 0 ? (variant) : -1;
#include "core/models.def"
#undef CORE_MODEL
  default:
    return -1;
  }
}
