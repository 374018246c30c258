/* cells: measures the errors |R / R_transport - 1| of models for anisotropic scattering (Henyey and
 * Greenstein 1941). The model `transport` with the medium's own g is the reference; its own stated
 * error is added.
 *
 * A cell is a range of g, of ratios sigma_a / sigma_s' and of eta. Its errors are the largest at a
 * grid of media in it, edges included. Lengths are in reduced mean free paths 1 / sigma_t'. */
#ifndef TRADEOFF_CELLS_H
#define TRADEOFF_CELLS_H

#include "core/tools/tools.h"
#include "core/tools/tradeoff/errors.h"
#include "core/tools/tradeoff/subjects.h"

enum { CELLS_GS = 9, CELLS_RATIOS = 18, CELLS_ETAS = 8 };

/* Edges of the cells, rising. */
extern const double cells_gs[CELLS_GS + 1];
extern const double cells_ratios[CELLS_RATIOS + 1]; /* sigma_a / sigma_s' */
extern const double cells_etas[CELLS_ETAS + 1];

/* The work that cells_measure() adds to the progress. */
double cells_cost_us(void);

/* Allocates and returns [model][g][ratio][eta], with models as in subjects.models. Errors are
 * infinite where a model refuses a medium or `transport` does not hold for its g. The caller frees
 * it with free(). Any number of threads gives the same bits. */
errors_node *cells_measure(const subjects *of, size_t threads, tools_progress *progress);

/* Returns the errors of a model in a cell. */
errors_node *cells_at(errors_node *cells, size_t model, size_t g, size_t ratio, size_t eta);

#endif
