#include "tests/accuracy/montecarlo_run.h"

#include <math.h>

#include "tests/unit/unit.h"

#define SLICE 100000
#define IMBALANCE_MAX 1e-12

core_mc_request montecarlo_request(double albedo, double g, double eta) {
  return (core_mc_request){
      .sigma_t_per_mm = 1,
      .g = g,
      .eta = eta,
      .thickness_mm = (double)INFINITY,
      .albedo_count = 1,
      .albedo = {albedo},
      .edges = {CORE_SPACING_LOGARITHMIC, 31, 0.01, 30},
      .seed = MONTECARLO_SEED,
  };
}

void montecarlo_rings(core_mc_request *request, uint64_t rings, double from_mm, double to_mm) {
  request->edges = (core_grid){CORE_SPACING_LOGARITHMIC, rings + 1, from_mm, to_mm};
}

montecarlo_run montecarlo_run_sliced(const core_mc_request *request, uint64_t batches,
                                     const core_isa *isa, uint64_t slice) {
  unit_accept(core_mc_check(request));
  montecarlo_run run = {.plan = core_mc_plan_create(request)};
  assert_non_null(run.plan);
  run.total = core_mc_total_create(run.plan);
  assert_non_null(run.total);
  core_mc_batch *batch = core_mc_batch_create(run.plan);
  assert_non_null(batch);
  for (uint64_t index = 0; index < batches; index++) {
    core_mc_batch_start(batch, index);
    while (!core_mc_batch_walk(batch, isa, slice)) {
    }
    core_mc_total_merge(run.total, batch);
  }
  core_mc_batch_free(batch);
  assert_int_equal(core_mc_total_batches(run.total), batches);
  for (size_t k = 0; k < request->albedo_count && batches > 0; k++) {
    montecarlo_energy(&run, k);
  }
  return run;
}

montecarlo_run montecarlo_run_batches(const core_mc_request *request, uint64_t batches) {
  return montecarlo_run_sliced(request, batches, core_isa_select(NULL), SLICE);
}

void montecarlo_run_free(montecarlo_run *run) {
  core_mc_total_free(run->total);
  core_mc_plan_free(run->plan);
}

core_mc_energy montecarlo_energy(const montecarlo_run *run, size_t albedo) {
  core_mc_energy energy;
  core_mc_total_energy(run->total, albedo, &energy);
  const double sum = energy.left[CORE_MC_REFLECTED].value + energy.left[CORE_MC_TRANSMITTED].value +
                     energy.absorbed.value + energy.unfinished.value - energy.roulette.value;
  UNIT_FAIL_IF(!(fabs(sum - 1) <= IMBALANCE_MAX && fabs(energy.imbalance) <= IMBALANCE_MAX),
               "energy out of balance by %g", sum - 1);
  return energy;
}

double montecarlo_deviation(core_mc_value value, double truth) {
  return (value.value - truth) / value.error;
}
