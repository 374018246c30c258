/* montecarlo_run: Monte Carlo requests run to their end, for tests. */
#ifndef DIPOLED_TESTS_MONTECARLO_RUN_H
#define DIPOLED_TESTS_MONTECARLO_RUN_H

#include "core/montecarlo/montecarlo.h"

#define MONTECARLO_SEED 20120101 /* tests of chance keep to one */

/* Returns a request for a half space with sigma_t = 1 per mm, so that lengths are in mean free
 * paths, one albedo, and rings of logarithmic width; the rest is left at its defaults. */
core_mc_request montecarlo_request(double albedo, double g, double eta);

/* rings: 1 or more, in equal ratios */
void montecarlo_rings(core_mc_request *request, uint64_t rings, double from_mm, double to_mm);

typedef struct montecarlo_run {
  core_mc_plan *plan;
  core_mc_total *total;
} montecarlo_run;

/* Walks this many batches with an instruction set (NULL: the best). slice: scatterings at a time.
 * Faults and an imbalance of energy above 1e-12, for any albedo, fail the test. */
montecarlo_run montecarlo_run_sliced(const core_mc_request *request, uint64_t batches,
                                     const core_isa *isa, uint64_t slice);
montecarlo_run montecarlo_run_batches(const core_mc_request *request, uint64_t batches);
void montecarlo_run_free(montecarlo_run *run);

/* Likewise for one albedo of what has been run. */
core_mc_energy montecarlo_energy(const montecarlo_run *run, size_t albedo);

/* (value - truth) / error */
double montecarlo_deviation(core_mc_value value, double truth);

#endif
