/* curves: evaluates transport and the models at the radii of panels of one eta. */
#ifndef FIGURES_CURVES_H
#define FIGURES_CURVES_H

#include "core/tools/figures/panel.h"
#include "core/tools/tools.h"

/* Estimated time for one panel. */
#define CURVES_COST_US 40e3

/* Fills in the columns of transport and of the models for `count` panels. The panels have one eta,
 * so that they share the part of transport's solution that depends on eta alone. */
void curves_run(panel_data *const *panels, size_t count, size_t threads, tools_progress *progress);

#endif
