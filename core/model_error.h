/* model_error: finds the measured errors |R / R_transport - 1| of models against transport.
 *
 * `make model-errors` measures the errors and writes core/model_errors.def, the only list of them:
 * - for each model and isotropic scattering, at 54 ratios sigma_a / sigma_s' from 0 to 10 and 21
 * eta
 *   from 1 to 2: the largest error of R in each of ten bands of radii from 0.01 to 20 mean free
 *   paths 1 / sigma_t', and the error of the albedo;
 * - for each model and anisotropic scattering (Henyey and Greenstein), in cells of g from -0.5 to
 *   0.95, of ratios from 0 to 10 and of eta from 1 to 2: the same errors, the largest in each cell.
 *   They were measured against the model `transport` with the medium's own g, and contain its
 *   error;
 * - for the similarity relation, which replaces anisotropic scattering by isotropic scattering with
 *   the same sigma_s': its errors at g 0.95 and 0.98 and at eleven ratios, for radii from 0.1 mean
 *   free paths on. They come from Monte Carlo, and two of its standard errors are added.
 *
 * Replies quote the error for the radii that were asked for, and core/choose.h chooses by it.
 */
#ifndef DIPOLED_CORE_MODEL_ERROR_H
#define DIPOLED_CORE_MODEL_ERROR_H

#include "core/core.h"

/* Ratios sigma_a / sigma_s', from least to most; infinite for a medium that does not scatter. */
typedef struct core_ratio_range {
  double least;
  double most;
} core_ratio_range;

/* Returns the range that holds the ratio of one medium. */
core_ratio_range core_ratio_of(const core_medium *medium);

/* Finds the errors of a model for media with this g and eta and a range of ratios, which are the
 * largest ones of its media, band by band. For g = 0 an error is the largest
 * one at the measured ratios and eta that enclose the medium, times 1.08, because it may be larger
 * between them; for other g it is that of the medium's cell, times 1.04. For g beyond the cells, up
 * to 0.98, it combines that for g = 0 and that of the similarity relation, for models that see
 * sigma_s (1 - g) alone. Values within 1e-7 of a node or edge, relative, count as the node, so that
 * rounding to single precision moves nothing out of the measured range. An error is NAN where
 * nothing was measured: outside of the measured ranges, for moments other than the exact ones, and
 * for models that need more than a medium. `transport` is exact where g is 0; for other g its
 * errors are those of the similarity relation. */
core_model_errors core_model_errors_find(enum core_model model, enum core_moments moments, double g,
                                         double eta, core_ratio_range range);

/* The edges of the bands of radii that errors are stated for, in mean free paths 1 / sigma_t'. */
extern const double core_error_edges_mfp[CORE_MODEL_ERROR_BANDS + 1];

/* Finds the errors of `transport` with the parameter gamma. `make gamma-errors` has measured them
 * (core/gamma_errors.def): they are the largest among modified and two-term Henyey-Greenstein
 * functions and those of spheres, with a gamma in the same range, at the ratios that enclose that
 * of the medium, times 1.08. They are NAN where nothing was measured. */
core_model_errors core_gamma_errors_find(double gamma, double eta, core_ratio_range range);

/* Returns the errors that are stated of a model with these parameters (which are not NULL), for media
 * as in core_model_errors_find(). notes: those of the model for them (bits of enum core_note), of which
 * only SIMILARITY counts. `transport` without it is exact, but for the parameter gamma. Otherwise the
 * errors are those of core_model_errors_find(); they were measured with the default of the surface
 * albedo alone. */
core_model_errors core_model_errors_stated(enum core_model model, enum core_moments moments,
                                           unsigned notes, const core_parameters *parameters,
                                           double g, double eta, core_ratio_range range);

/* Returns the errors of a model that is transport itself. */
core_model_errors core_model_errors_exact(void);

/* Returns errors that are all NAN, which means not known. */
core_model_errors core_model_errors_unknown(void);

/* Returns the largest error of the wanted quantities at radii from least to most; there are no
 * radii if least is above most. The error is relative, but absolute for ln R. The cdf and dR/dr
 * were not measured and are passed over. The result is NAN if an error is not known or nothing else
 * than these two is wanted. An exact model has the error 0. */
double core_model_errors_of(const core_model_errors *errors, const core_medium *medium,
                            unsigned wanted, core_radii_range radii);

/* ---- errors as bytes, as core/model_errors.def holds them ------------------------------------ */

#define CORE_ERROR_CODE_ANY 255u

/* Returns the least code whose error is at least `error`, which must be 0 or more. */
unsigned core_error_code(double error);

/* Returns the error of a code: 1e-4 times 1.04^code up to code 230, and 1.25 times more for each
 * code beyond it. Code 255 means INFINITY. The bits are the same on every machine. */
double core_error_of_code(unsigned code);

/* An error in one printable character, which may stand in a string, for every other code from 73 to
 * 249 and for CORE_ERROR_CODE_ANY. */

/* Returns the symbol of the least error that is at least `error`, which must be 0 or more. */
char core_error_symbol(double error);

/* Returns the code of a symbol. */
unsigned core_error_code_of_symbol(char symbol);

#endif
