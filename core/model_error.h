/* model_error: how far models are from radiative transport, as it was measured.
 *
 * core/tools/model_errors.c measures it and writes core/model_errors.def: for each model the largest
 * relative deviation of R from transport at radii from 0.1 to 20 mean free paths 1 / sigma_t', for
 * isotropic scattering at sixteen ratios sigma_a / sigma_s' (those of the figures of d'Eon 2012) and
 * four eta; and, for the similarity relation alone, of an isotropic medium from an anisotropic one
 * with the same sigma_s' (Henyey and Greenstein), by Monte Carlo, less two standard errors.
 */
#ifndef DIPOLED_CORE_MODEL_ERROR_H
#define DIPOLED_CORE_MODEL_ERROR_H

#include "core/core.h"

/* The largest of the errors measured around this medium: at the two ratios and the two eta that
 * enclose it; with that of the similarity relation, around its g, on top of it when the model uses
 * it. NAN outside what was measured (ratios 1e-4 to 10, eta 1 to 2, g -0.5 to 0.98), and for models
 * that need more than a medium. Transport itself has 0 where scattering is isotropic. */
double core_model_error(enum core_model model, const core_medium *medium, bool similarity);

#endif
