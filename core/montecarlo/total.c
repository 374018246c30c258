/* Totals: merging batches, means and standard errors. */
#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/montecarlo/batch.h"

/* mean[i] is the mean over the batches of number i of a tally, and deviation[i] the sum of its
 * squared deviations from that mean. */
struct core_mc_total {
  const core_mc_plan *plan;
  uint64_t batches;
  uint64_t *photons;
  double *mean;
  double *deviation;
};

core_mc_total *core_mc_total_create(const core_mc_plan *plan) {
  core_mc_total *total = calloc(1, sizeof *total);
  if (total == NULL) {
    return NULL;
  }
  const size_t numbers = mc_rows(plan) * plan->albedos;
  total->plan = plan;
  total->photons = calloc(CORE_MC_SIDES * plan->slots, sizeof *total->photons);
  total->mean = calloc(numbers, sizeof *total->mean);
  total->deviation = calloc(numbers, sizeof *total->deviation);
  if (total->photons == NULL || total->mean == NULL || total->deviation == NULL) {
    core_mc_total_free(total);
    return NULL;
  }
  return total;
}

void core_mc_total_free(core_mc_total *total) {
  if (total != NULL) {
    free(total->photons);
    free(total->mean);
    free(total->deviation);
    free(total);
  }
}

uint64_t core_mc_total_batches(const core_mc_total *total) {
  return total->batches;
}

/* Welford 1962: this update of means and squared deviations does not cancel. */
void core_mc_total_merge(core_mc_total *total, const core_mc_batch *batch) {
  const core_mc_plan *plan = total->plan;
  assert(batch->plan == plan && batch->index == total->batches);
  assert(batch->launched == CORE_MC_BATCH_PHOTONS && batch->active == 0);
  total->batches++;
  const size_t numbers = mc_rows(plan) * plan->albedos;
  const double share = 1 / (double)total->batches;
  for (size_t i = 0; i < numbers; i++) {
    const double value = batch->tally[i] * (1.0 / CORE_MC_BATCH_PHOTONS);
    const double before = value - total->mean[i];
    total->mean[i] += before * share;
    total->deviation[i] += before * (value - total->mean[i]);
  }
  for (size_t i = 0; i < CORE_MC_SIDES * plan->slots; i++) {
    total->photons[i] += batch->photons[i];
  }
}

/* ---- results --------------------------------------------------------------------------------- */

/* Returns a row's value per unit of power that entered; the tally is per unit of power that
 * collides. */
static core_mc_value value_of(const core_mc_total *total, size_t row, size_t albedo) {
  const core_mc_plan *plan = total->plan;
  const size_t i = row * plan->albedos + albedo;
  const double batches = (double)total->batches;
  const double variance = total->deviation[i] / ((batches - 1) * batches);
  return (core_mc_value){
      .value = plan->scattered_or_absorbed * total->mean[i],
      .error = total->batches < 2 ? (double)INFINITY : plan->scattered_or_absorbed * sqrt(variance),
  };
}

void core_mc_total_energy(const core_mc_total *total, size_t albedo, core_mc_energy *energy) {
  const core_mc_plan *plan = total->plan;
  assert(albedo < plan->albedos);
  *energy = (core_mc_energy){
      .absorbed = value_of(total, MC_ROW_ABSORBED, albedo),
      .unfinished = value_of(total, MC_ROW_UNFINISHED, albedo),
      .roulette = value_of(total, MC_ROW_ROULETTE, albedo),
  };
  energy->in_layer[0] = energy->absorbed;
  for (size_t i = 0; i < CORE_LAYERS_MAX && mc_is_layered(plan); i++) {
    energy->in_layer[i] = value_of(total, MC_ROW_LAYERS + i, 0);
  }
  double sum = energy->absorbed.value + energy->unfinished.value - energy->roulette.value;
  for (size_t side = 0; side < CORE_MC_SIDES; side++) {
    energy->unscattered[side] = plan->unscattered[side];
    energy->left[side] = value_of(total, side, albedo);
    energy->left[side].value += plan->unscattered[side];
    energy->under[side] = value_of(total, mc_slot_row(plan, side, 0), albedo);
    energy->over[side] = value_of(total, mc_slot_row(plan, side, plan->slots - 1), albedo);
    sum += energy->left[side].value;
  }
  /* before the first batch nothing is unbalanced */
  energy->imbalance = total->batches > 0 ? sum - 1 : 0;
}

static core_mc_ring ring_of(const core_mc_total *total, size_t albedo, size_t side, size_t slot) {
  const core_mc_plan *plan = total->plan;
  core_mc_ring ring = {.photons = total->photons[side * plan->slots + slot]};
  core_grid_radii(&plan->request.edges, slot - 1, 1, false, &ring.from_mm);
  core_grid_radii(&plan->request.edges, slot, 1, false, &ring.to_mm);
  const double width_mm = ring.to_mm - ring.from_mm;
  const double area_mm2 = 3.14159265358979323846 * width_mm * (ring.to_mm + ring.from_mm);
  const core_mc_value light = value_of(total, mc_slot_row(plan, side, slot), albedo);
  ring.R_per_mm2 = light.value / area_mm2;
  ring.error_per_mm2 = light.error / area_mm2;
  if (ring.photons == 0 && total->batches >= 2) {
    const double photons = (double)total->batches * CORE_MC_BATCH_PHOTONS;
    const double heaviest = plan->scattered_or_absorbed * plan->weight_max[albedo] / photons;
    ring.error_per_mm2 = heaviest / area_mm2;
  }
  return ring;
}

void core_mc_total_rings(const core_mc_total *total, size_t albedo, enum core_mc_side side,
                         core_mc_ring *rings) {
  assert(albedo < total->plan->albedos && side < CORE_MC_SIDES);
  for (size_t i = 0; i + 2 < total->plan->slots; i++) {
    rings[i] = ring_of(total, albedo, side, i + 1);
  }
}
