/* model_error: model errors by band of radii, and those of the parameter gamma. core/ruler.h computes
 * the errors of models.
 *
 * Only the parameter gamma has errors that cannot be computed from a request: they depend on a
 * phase function of which it knows gamma alone. `make gamma-errors` has measured them
 * (core/gamma_errors.def).
 */
#ifndef DIPOLED_CORE_MODEL_ERROR_H
#define DIPOLED_CORE_MODEL_ERROR_H

#include "core/core.h"

/* Returns sigma_a / sigma_s', which is infinite for a medium that does not scatter. */
double core_ratio_of(const core_medium *medium);

/* The edges of the bands of radii, in mean free paths 1 / sigma_t'. */
extern const double core_error_edges_mfp[CORE_MODEL_ERROR_BANDS + 1];

/* The errors of a model for one medium. */
typedef struct core_model_errors {
  bool exact; /* the model is transport itself and has no model error */
  /* Relative errors of R in each band of radii, then that of the albedo; NAN where not known. */
  double error[CORE_MODEL_ERROR_BANDS + 1];
} core_model_errors;

/* Finds the errors of `transport` with the parameter gamma: the largest ones among modified and
 * two-term Henyey-Greenstein functions and those of spheres, with a gamma in the same range, times
 * 1.08. They are NAN where nothing was measured. */
core_model_errors core_gamma_errors_find(double gamma, const core_medium *medium);

/* Returns the errors that need no ruler: those of `transport`, which are 0 unless gamma is given. The
 * errors of all other models are unknown. */
core_model_errors core_model_errors_stated(unsigned model, double gamma, const core_medium *medium);

/* Returns errors that are all NAN, which means not known. */
core_model_errors core_model_errors_unknown(void);

/* Returns the largest error of the wanted quantities at radii from least to most; there are no
 * radii if least is above most. The error is relative, but absolute for ln R. The cdf, dR/dr and
 * TRANSFER are passed over. The result is NAN if an error is not known or nothing else than these is
 * wanted. An exact model has the error 0. */
double core_model_errors_of(const core_model_errors *errors, const core_medium *medium,
                            unsigned wanted, core_radii_range radii);

#endif
