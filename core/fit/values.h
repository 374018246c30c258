/* values: evaluates the model of a fit's readings for a medium that the search tries. Internal to
 * core/fit. */
#ifndef DIPOLED_CORE_FIT_VALUES_H
#define DIPOLED_CORE_FIT_VALUES_H

#include "core/core.h"
#include "core/fit/aperture.h"
#include "core/fit/fit.h"
#include "core/fit/loops.h"
#include "core/varying.h"

struct fit_model {
  const core_isa *isa;
  const fit_loops *loops; /* loops of the instruction set */
  unsigned model;
  unsigned moments;
  enum core_quantity quantity; /* the quantity of a reading: R or TRANSFER */
  double g;
  double eta;
  double thickness_mm; /* mm, thickness of the media; 0: half spaces */
  core_parameters parameters;
  bool narrow;           /* whether the design has an aperture */
  fit_aperture aperture; /* valid if `narrow` */
  /* NULL if the model has kernels for media that vary, or a parameter that is a length */
  fit_table *table;
  bool varies;          /* whether `varying` is valid: its kernels evaluate any medium */
  core_varying varying; /* owned */
};

/* Where readings are taken: reading i is the sum of weight R(at) over the nodes from first[i] to
 * first[i + 1] - 1. */
struct fit_places {
  size_t count;
  size_t *first; /* [count + 1]: index of each reading's first node */
  double *at;
  double *ln_at; /* ln of `at`; for 0, ln of the least normal number */
  double *weight;
  core_radii_range radii; /* range of all distances; least > most for frequencies */
  /* Whether light is modulated; [count] what readings are, omega n / c, and the largest of these */
  bool modulated;
  const double *quantity;
  double *wavenumber_per_mm, wavenumber_most_per_mm;
};

/* A medium by ln(sigma_a / sigma_s') and ln(sigma_s'), sigma_s' in 1/mm. */
struct fit_place {
  double ln_ratio;
  double ln_scattering;
};

core_medium fit_medium(const struct fit_model *model, struct fit_place place);

/* Returns the relative error of readings against radiative transport; NAN if it is not known. */
double fit_model_error(const struct fit_model *model, const core_medium *medium,
                       const struct fit_places *places);

/* Returns what reading i is: 0, PHASE or MODULATION. A factor of R does not change these two. */
static inline unsigned fit_quantity_of(const struct fit_places *places, size_t i) {
  return places->modulated ? (unsigned)places->quantity[i] : 0;
}

/* Sets errors[count] to the numerical errors of what fit_values() gives, relative, of phases in
 * radians. Returns the fault of a medium that the model does not take. */
core_fault fit_numerical_errors(const struct fit_model *model, struct fit_place place,
                                const struct fit_places *places, double *errors);

/* Returns ln x; for smaller x, ln of the least normal number. */
double fit_ln(double x);

/* Evaluates the readings for a medium, whose g and eta need not be those of the model. model_error:
 * receives what fit_model_error() returns. */
core_fault fit_values_of_medium(const struct fit_model *model, const core_medium *medium,
                                const struct fit_places *places, double *value,
                                double *model_error);

/* Evaluates the readings from a prepared profile of the medium. */
void fit_values_of_profile(const struct fit_model *model, const core_profile *profile,
                           const struct fit_places *places, double *value);

/* Evaluates the readings. Sets value[count] and, unless they are NULL, its derivatives by ln_ratio
 * and by ln_scattering. Returns the fault of a medium that the model does not take. */
core_fault fit_values(const struct fit_model *model, struct fit_place place,
                      const struct fit_places *places, double *value, double *by_ratio,
                      double *by_scattering);

#endif
