/* model_error: model errors by band of radii. core/ruler.h computes them. */
#ifndef DIPOLED_CORE_MODEL_ERROR_H
#define DIPOLED_CORE_MODEL_ERROR_H

#include "core/core.h"

/* Returns sigma_a / sigma_s', which is infinite for a medium that does not scatter. */
double core_ratio_of(const core_medium *medium);

/* The edges of the bands of radii, in mean free paths 1 / sigma_t', ascending. The last band has no
 * end. */
extern const double core_error_edges_mfp[CORE_ERROR_BANDS];

/* The errors of a model for one medium. */
typedef struct core_model_errors {
  bool exact; /* the model is transport itself and has no model error */
  /* Relative errors of R in each band of radii, then that of the albedo; NAN where not known. */
  double error[CORE_MODEL_ERROR_BANDS + 1];
} core_model_errors;

/* Returns whether the model error is 0. It is for `transport`, unless the parameter gamma is given:
 * gamma does not determine the phase function. */
bool core_is_exact(unsigned model, bool gamma);

/* Returns radii around r_mm, without a margin at the edges of bands, at which core_profile_errors() states
 * the same as there of R, its multiples, ln R, slope, cdf and TRANSFER; none if r_mm is beyond the reach. */
core_radii_range core_errors_alike(const core_profile *profile, double r_mm);

/* Returns errors that are all NAN, which means not known. */
core_model_errors core_model_errors_unknown(void);

/* Returns the largest error of the wanted quantities at radii from least to most; there are no
 * radii if least is above most. The error is relative, but absolute for ln R. The cdf, dR/dr and
 * TRANSFER are passed over. The result is NAN if an error is not known or nothing else than these is
 * wanted. An exact model has the error 0. */
double core_model_errors_of(const core_model_errors *errors, const core_medium *medium,
                            unsigned wanted, core_radii_range radii);

#endif
