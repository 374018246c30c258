/* walk: Monte Carlo for panels of one eta. */
#ifndef FIGURES_WALK_H
#define FIGURES_WALK_H

#include "core/tools/figures/panel.h"
#include "core/tools/tools.h"

/* Photons are walked in batches: the number of them that holds so many photons, at least 2. */
uint64_t walk_batches(uint64_t photons);

/* Estimated work. */
double walk_cost_us(double eta, uint64_t batches);

/* Fills the columns of Monte Carlo of count panels (1 to PANEL_RATIOS, all of one eta) from one
 * walk by so many threads. The same panels and batches give the same bits with any number of
 * threads. */
void walk_run(panel_data *const *panels, size_t count, uint64_t batches, size_t threads,
              tools_progress *progress);

#endif
