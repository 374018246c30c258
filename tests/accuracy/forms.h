/* forms: the formulas of the models in 113 bits. They are written as the papers print them, or
 * integrated in another way than the kernels do, so that tests can hold the kernels against them.
 * Two models have no form: `transport` and `gaussians`.
 *
 * Only one thread of a process may use this file, because reference_fresnel.c keeps values. */
#ifndef DIPOLED_TESTS_FORMS_H
#define DIPOLED_TESTS_FORMS_H

#include "core/kernels.h"
#include "tests/accuracy/reference_fresnel.h"

/* FORM_DIPOLE stands for models 1 to 8, FORM_SLAB for the four multipoles. */
enum form_family {
  FORM_DIPOLE,
  FORM_EXTENDED,
  FORM_QUANTIZED,
  FORM_SINGLE,
  FORM_BURLEY,
  FORM_SKIN,
  FORM_SLAB,
  FORM_FIT,
  FORM_TRANSPORT,
  FORM_SUM
};

/* Returns the family of a model of core/models.def. */
enum form_family form_family_of(unsigned model);

/* Follows the elementwise quantities. */
enum { FORM_ALBEDO = CORE_ELEMENTWISE_COUNT };

enum { FORM_SINGLE_NODES = 690, FORM_SLAB_NODES = 700, FORM_MODES = 13 };

/* One model for one medium. */
typedef struct form_part {
  enum form_family family;
  int variant;
  core_medium medium;
  quad sigma_t_prime; /* 1/mm; the fields down to prefactor are per sigma_t' */
  quad scattered, absorbed, diffusion, mu, two_zb, c_phi, c_flux;
  quad prefactor;
  quad albedo; /* NAN if not known */
  /* burley: 1 / d in 1/mm */
  quad per_d;
  /* single: nodes of the integral over u, and its sums up to each node */
  quad least, sum;
  quad further[FORM_SINGLE_NODES], weight[FORM_SINGLE_NODES], energy[FORM_SINGLE_NODES];
  quad weight_before[FORM_SINGLE_NODES];
  /* slab: its modes, and the light that leaves at the nodes of the integral over time */
  quad y, length, rate, leaving;
  quad mode_source[FORM_MODES], mode_sine[FORM_MODES], mode_flux[FORM_MODES];
  size_t slab_nodes;
  quad per_fourth[FORM_SLAB_NODES], left[FORM_SLAB_NODES];
} form_part;

/* A model for one medium; `gives` is 2 for a sum. */
typedef struct form_model {
  form_part part[2];
  size_t parts;
  bool known;  /* false for `transport` and `gaussians` */
  quad albedo; /* NAN if not known */
  quad S_per_R;
} form_model;

/* Values at one radius: R e^shift, -dR/dr e^shift, and the energy within r over the albedo. A value
 * is NAN if it is not known. */
typedef struct form_values {
  quad R, slope, shift, cdf;
} form_values;

/* Prepares a model for a medium. The parameters are those of a request; S needs cos_in and cos_out,
 * which must be given. */
void form_prepare(form_model *form, unsigned model, enum core_moments moments,
                  const core_medium *medium, const core_parameters *parameters);

/* Returns the values at r mm, from 0 to infinity, in 113 bits. If `fast` is true, the integrals of
 * the extended source, of quantized diffusion and of single scattering are summed in long double,
 * which takes a twentieth of the time; their relative error is then below 1e-17. */
form_values form_at(const form_model *form, double r, bool fast);

/* Returns the truth of a quantity at r mm, `at` being form_at()'s values there: NAN if it is not
 * known, as cdf and pdf where the albedo is 0 in double precision, or nearly. */
quad form_truth(const form_model *form, form_values at, enum core_elementwise quantity, double r);

/* Returns whether core.h states an error of the quantity at r mm: of dR/dr not everywhere. */
bool form_promises(const form_model *form, int quantity, double r);

/* Returns how far a value of this size may be off, by what the profile states. The quantity may be
 * FORM_ALBEDO. */
quad form_allowed(const core_profile *profile, int quantity, double r, quad size);

/* Returns the error of a value over what the profile states; a value that is good has at most 1. It
 * is 0 if the error is within 16 of the smallest numbers or if infinity is right, and INFINITY if
 * infinity is wrong. The truth itself may be off by `unsure`. */
double form_share(const form_model *form, const core_profile *profile, int quantity, double r,
                  double value, quad truth, quad unsure);

/* Returns -d ln R / d sigma_a, mm, of dipoles, `single` and their sums, sigma_a from 0 on, and of Burley's
 * profiles, NAN at sigma_a = 0. Sets *unsure to about its error. */
quad form_path(unsigned model, enum core_moments moments, const core_medium *medium,
               const core_parameters *parameters, double r, quad *unsure);

#endif
