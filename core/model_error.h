/* model_error: how far models are from radiative transport, |R / R_transport - 1|, as measured.
 *
 * `make model-errors` measures it and writes core/model_errors.def, the only list of such errors:
 * - for each model and isotropic scattering, at 54 ratios sigma_a / sigma_s' from 0 to 10 and 21 eta
 *   from 1 to 2: the largest error of R in each of ten bands of radii from 0.01 to 20 mean free
 *   paths 1 / sigma_t', and the error of the albedo;
 * - for the similarity relation, which replaces anisotropic scattering (Henyey and Greenstein) by
 *   isotropic scattering with the same sigma_s': the same at eight g and eleven ratios, for radii
 *   from 0.1 mean free paths on. Monte Carlo gives these; two of its standard errors are added.
 *
 * The replies quote it for the radii that were asked for, and core/choose.h chooses by it.
 */
#ifndef DIPOLED_CORE_MODEL_ERROR_H
#define DIPOLED_CORE_MODEL_ERROR_H

#include "core/core.h"

/* Finds the errors of a model for a medium that has been checked. An error is the largest of those
 * at the ratios, eta and g that enclose the medium, times 1.08, by which it may be larger between
 * them. NAN where nothing was measured: outside of those ranges, for moments other than the exact
 * ones, and for models that need more than a medium. Transport itself is exact where g is 0. */
core_model_errors core_model_errors_find(enum core_model model, enum core_moments moments,
                                         const core_medium *medium);

/* Errors of which none is known. */
core_model_errors core_model_errors_unknown(void);

/* The largest error of the quantities that are wanted, at radii from least to most; with least above
 * most there are no radii. It is relative; of ln R absolute.
 * The cdf and dR/dr were not measured: they are passed over, and NAN is returned when nothing else
 * is wanted, but for transport itself. NAN where an error is not known. */
double core_model_errors_of(const core_model_errors *errors, const core_medium *medium,
                            unsigned wanted, core_radii_range radii);

/* ---- errors as bytes, as core/model_errors.def holds them ---------------------------------------
 */

#define CORE_ERROR_CODE_ANY 255u

/* The least code whose error is at least this one, which is 0 or more. */
unsigned core_error_code(double error);

/* The error of a code: 1e-4 times 1.04^code up to code 230, from there on 1.25 times more for each;
 * INFINITY for 255. The bits are the same on every machine. */
double core_error_of_code(unsigned code);

#endif
