/* values: evaluates the model of a fit for a medium that the search tries. Internal to core/fit. */
#ifndef DIPOLED_CORE_FIT_VALUES_H
#define DIPOLED_CORE_FIT_VALUES_H

#include "core/core.h"

struct fit_model {
  const core_isa *isa;
  unsigned model;
  unsigned moments;
  enum core_quantity quantity; /* what a reading is */
  double g;
  double eta;
  core_parameters parameters;
};

/* A medium by ln(sigma_a / sigma_s') and ln(sigma_s'), sigma_s' in 1/mm. */
struct fit_place {
  double ln_ratio;
  double ln_scattering;
};

core_medium fit_medium(const struct fit_model *model, struct fit_place place);

/* Returns ln x, or that of the least normal number if x is less. */
double fit_ln(double x);

/* Evaluates the model at[n] for a medium, whose g and eta need not be those of the model. */
core_fault fit_values_of_medium(const struct fit_model *model, const core_medium *medium, size_t n,
                                const double *at, double *value);

/* Evaluates the model at[n]. Sets value[n] and, unless they are NULL, its derivatives by ln_ratio
 * and by ln_scattering. Returns the fault of a medium that the model does not take. */
core_fault fit_values(const struct fit_model *model, struct fit_place place, size_t n,
                      const double *at, double *value, double *by_ratio, double *by_scattering);

#endif
