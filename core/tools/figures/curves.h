/* curves: transport and the models, at the radii of panels of one eta. */
#ifndef FIGURES_CURVES_H
#define FIGURES_CURVES_H

#include "core/tools/figures/panel.h"
#include "core/tools/tools.h"

/* Estimated work for a panel. */
#define CURVES_COST_US 40e3

/* Fills the columns of transport and of the models of count panels, all of one eta, which share
 * what transport needs of it, by so many threads. */
void curves_run(panel_data *const *panels, size_t count, size_t threads, tools_progress *progress);

#endif
