/* walk: runs Monte Carlo for panels of one eta. */
#ifndef FIGURES_WALK_H
#define FIGURES_WALK_H

#include "core/tools/figures/panel.h"
#include "core/tools/tools.h"

/* Returns the number of batches, at least 2, that together have so many photons. */
uint64_t walk_batches(uint64_t photons);

/* Estimated time of walk_run(). */
double walk_cost_us(double eta, uint64_t batches);

/* Fills in the Monte Carlo columns of 1 to PANEL_RATIOS panels, all of one eta, from the same
 * photons. The same panels and batches give the same bits with any number of threads. */
void walk_run(panel_data *const *panels, size_t count, uint64_t batches, size_t threads,
              tools_progress *progress);

#endif
