/* Batches: each lane walks a photon and gets the next one when that photon has ended; the tally
 * takes up what each photon leaves behind.
 *
 * All sums run in the order of the lanes at each step. So they do not depend on the instruction
 * set, nor on the slices in which a batch is walked.
 */
#include "core/montecarlo/batch.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/kernels.h"

/* ---- instruction sets ------------------------------------------------------------------------ */

CORE_ISA_TABLE(walk_functions, walk_functions)

/* ---- the tally ------------------------------------------------------------------------------- */

/* A photon at the end of its walk: its stage, the stage's gain, and albedo^collisions for each
 * albedo. */
struct ended {
  const core_mc_plan *plan;
  double *tally;
  size_t stage;
  double gain;
  double power[CORE_MC_ALBEDOS_MAX];
};

static struct ended end_of(core_mc_batch *batch, size_t lane, size_t stage) {
  struct ended ended = {.plan = batch->plan, .tally = batch->tally, .stage = stage, .gain = 1};
  if (mc_is_layered(batch->plan)) {
    ended.power[0] = batch->lanes.weight[lane];
    return ended;
  }
  ended.gain = batch->plan->stage[stage].gain;
  mc_powers(batch->plan, batch->lanes.collisions[lane], ended.power);
  return ended;
}

/* Adds an ended photon to the tally for each albedo: what was absorbed up to here, what roulette
 * has added, and `times` the remaining weight to `row`. times: 1, or -1 where the row counts the
 * weight as taken away. For layers, weigh() has put down the first two. */
static void put_down(const struct ended *ended, enum mc_row row, double times) {
  const size_t albedos = ended->plan->albedos;
  const mc_stage_energy *at_stage = ended->plan->stage_energy[ended->stage];
  for (size_t k = 0; k < albedos && !mc_is_layered(ended->plan); k++) {
    const double absorbed_since = ended->gain * (at_stage[k].weight - ended->power[k]);
    ended->tally[MC_ROW_ABSORBED * albedos + k] += at_stage[k].absorbed + absorbed_since;
    ended->tally[MC_ROW_ROULETTE * albedos + k] += at_stage[k].added;
  }
  for (size_t k = 0; k < albedos; k++) {
    ended->tally[row * albedos + k] += times * (ended->gain * ended->power[k]);
  }
}

/* Returns the squared distance from the axis at which the photon left, in squared mean free paths.
 */
static double exit_r_squared(const walk_lanes *lanes, size_t lane) {
  const double way = lanes->way[lane];
  const double x = lanes->x[lane] + lanes->ux[lane] * way;
  const double y = lanes->y[lane] + lanes->uy[lane] * way;
  return x * x + y * y;
}

/* Whether rings count the light of this photon. In layers its direction is that outside. */
static bool is_seen(const core_mc_batch *batch, size_t lane, size_t side) {
  const core_mc_request *request = &batch->plan->request;
  const double ux = batch->lanes.ux[lane], uy = batch->lanes.uy[lane];
  const bool layered = mc_is_layered(batch->plan);
  const double eta = !layered ? request->eta : side == CORE_MC_REFLECTED ? 1 : request->eta_below;
  const double sine2 = eta * eta * (ux * ux + uy * uy);
  if (layered && batch->lanes.weight[lane] == 0) {
    return false;
  }
  return request->aperture == 0 || sine2 <= request->aperture * request->aperture;
}

static void score_exit(core_mc_batch *batch, size_t lane, size_t side) {
  const core_mc_plan *plan = batch->plan;
  const size_t stage = mc_stage_of(plan, batch->lanes.collisions[lane]);
  const struct ended ended = end_of(batch, lane, stage);
  put_down(&ended, (enum mc_row)side, 1);
  if (!is_seen(batch, lane, side)) {
    return;
  }
  const size_t slot = mc_slot_of(plan, exit_r_squared(&batch->lanes, lane));
  double *row = batch->tally + mc_slot_row(plan, side, slot) * plan->albedos;
  for (size_t k = 0; k < plan->albedos; k++) {
    row[k] += ended.gain * ended.power[k];
  }
  batch->photons[side * plan->slots + slot]++;
}

/* Scores a photon that ended inside. Roulette ends a walk when the walk would begin a stage, so the
 * gain of the stage before applies. */
static void score_inside(core_mc_batch *batch, size_t lane) {
  const core_mc_plan *plan = batch->plan;
  const uint32_t collisions = batch->lanes.collisions[lane];
  const size_t stage = mc_stage_of(plan, collisions);
  const bool unfinished = mc_is_layered(plan) || collisions == plan->request.scatterings_max;
  const struct ended ended = end_of(batch, lane, unfinished ? stage : stage - 1);
  put_down(&ended, unfinished ? MC_ROW_UNFINISHED : MC_ROW_ROULETTE, unfinished ? 1 : -1);
}

static void score(core_mc_batch *batch, size_t lane) {
  switch ((enum walk_fate)batch->lanes.fate[lane]) {
  case WALK_REFLECTED:
    score_exit(batch, lane, CORE_MC_REFLECTED);
    return;
  case WALK_TRANSMITTED:
    score_exit(batch, lane, CORE_MC_TRANSMITTED);
    return;
  case WALK_ENDED:
    score_inside(batch, lane);
    return;
  case WALK_GOES_ON:
    break;
  }
  assert(!"a photon that has ended");
}

/* Adds to the tally what the last step of a photon in layers left in its layer, and what roulette
 * added. */
static void weigh(core_mc_batch *batch, size_t lane) {
  const walk_lanes *lanes = &batch->lanes;
  const double after = lanes->after[lane];
  batch->tally[MC_ROW_LAYERS + lanes->layer[lane]] += lanes->before[lane] - after;
  batch->tally[MC_ROW_ROULETTE] += lanes->weight[lane] - after;
}

/* ---- lanes ----------------------------------------------------------------------------------- */

static void launch_into(core_mc_batch *batch, const walk_functions *functions, size_t lane) {
  const core_mc_plan *plan = batch->plan;
  const uint64_t photon = batch->index * CORE_MC_BATCH_PHOTONS + batch->launched;
  const size_t at = batch->launched % WALK_LANES;
  if (at == 0) {
    functions->launch(&plan->walk, photon, &batch->launch);
  }
  walk_lanes *lanes = &batch->lanes;
  lanes->x[lane] = 0;
  lanes->y[lane] = 0;
  lanes->z[lane] = batch->launch.z[at];
  lanes->ux[lane] = 0;
  lanes->uy[lane] = 0;
  lanes->uz[lane] = batch->launch.uz[at];
  lanes->collisions[lane] = 1;
  lanes->last[lane] = mc_last_collision(plan, batch->launch.chance[at]);
  lanes->photon[lane] = (uint32_t)photon;
  lanes->fate[lane] = WALK_GOES_ON;
  if (mc_is_layered(plan)) {
    const int32_t layer = batch->launch.layer[at];
    lanes->last[lane] = plan->request.scatterings_max;
    lanes->layer[lane] = layer;
    lanes->collided[lane] = ~UINT32_C(0);
    lanes->weight[lane] = plan->walk.albedo[layer];
    batch->tally[MC_ROW_LAYERS + layer] += 1 - (double)lanes->weight[lane];
  }
  batch->launched++;
}

/* All numbers of a lane have four bytes. */
static void move_lane(walk_lanes *lanes, size_t to, size_t from) {
  enum { ROW = WALK_LANES * sizeof(float) };
  _Static_assert(sizeof(walk_lanes) % ROW == 0, "rows of numbers of four bytes");
  for (char *row = (char *)lanes; row < (char *)(lanes + 1); row += ROW) {
    memcpy(row + to * sizeof(float), row + from * sizeof(float), sizeof(float));
  }
}

/* Moves the lanes still in use to the front. This happens when no photons are left to launch, so
 * that the last and longest walks do not carry empty lanes along. */
static void close_ranks(core_mc_batch *batch) {
  size_t kept = 0;
  for (size_t lane = 0; lane < batch->active; lane++) {
    if (batch->lanes.fate[lane] == WALK_GOES_ON) {
      move_lane(&batch->lanes, kept++, lane);
    }
  }
  batch->active = kept;
}

static void settle(core_mc_batch *batch, const walk_functions *functions) {
  bool emptied = false;
  for (size_t lane = 0; lane < batch->active && mc_is_layered(batch->plan); lane++) {
    weigh(batch, lane);
  }
  for (size_t lane = 0; lane < batch->active; lane++) {
    if (batch->lanes.fate[lane] == WALK_GOES_ON) {
      continue;
    }
    score(batch, lane);
    if (batch->launched < CORE_MC_BATCH_PHOTONS) {
      launch_into(batch, functions, lane);
    } else {
      emptied = true;
    }
  }
  if (emptied) {
    close_ranks(batch);
  }
}

/* ---- batches --------------------------------------------------------------------------------- */

core_mc_batch *core_mc_batch_create(const core_mc_plan *plan) {
  core_mc_batch *batch = calloc(1, sizeof *batch);
  if (batch == NULL) {
    return NULL;
  }
  batch->plan = plan;
  batch->photons = calloc(CORE_MC_SIDES * plan->slots, sizeof *batch->photons);
  batch->tally = calloc(mc_rows(plan) * plan->albedos, sizeof *batch->tally);
  if (batch->photons == NULL || batch->tally == NULL) {
    core_mc_batch_free(batch);
    return NULL;
  }
  return batch;
}

void core_mc_batch_free(core_mc_batch *batch) {
  if (batch != NULL) {
    free(batch->photons);
    free(batch->tally);
    free(batch);
  }
}

void core_mc_batch_start(core_mc_batch *batch, uint64_t index) {
  const core_mc_plan *plan = batch->plan;
  assert(index < UINT64_MAX / CORE_MC_BATCH_PHOTONS);
  batch->index = index;
  batch->launched = 0;
  batch->active = 0;
  memset(&batch->lanes, 0, sizeof batch->lanes);
  memset(batch->photons, 0, CORE_MC_SIDES * plan->slots * sizeof *batch->photons);
  memset(batch->tally, 0, mc_rows(plan) * plan->albedos * sizeof *batch->tally);
}

/* Ends the batch of a medium that does not scatter: each photon is absorbed at its first collision.
 */
static void absorb_all(core_mc_batch *batch) {
  double *absorbed = batch->tally + MC_ROW_ABSORBED * batch->plan->albedos;
  for (size_t k = 0; k < batch->plan->albedos; k++) {
    absorbed[k] = CORE_MC_BATCH_PHOTONS;
  }
  batch->launched = CORE_MC_BATCH_PHOTONS;
}

bool core_mc_batch_walk(core_mc_batch *batch, const core_isa *isa, uint64_t scatterings) {
  const walk_functions *functions = walk_functions_of[isa->index];
  const walk_medium *medium = &batch->plan->walk;
  if (batch->launched == 0 && !batch->plan->walks) {
    absorb_all(batch);
  }
  while (batch->active < WALK_LANES && batch->launched < CORE_MC_BATCH_PHOTONS) {
    launch_into(batch, functions, batch->active++);
  }
  const uint32_t high = (uint32_t)(batch->index * CORE_MC_BATCH_PHOTONS >> 32);
  for (uint64_t done = 0; done < scatterings && batch->active > 0;) {
    const size_t lanes = (batch->active + WALK_GROUP - 1) / WALK_GROUP * WALK_GROUP;
    functions->step(medium, high, lanes, &batch->lanes);
    settle(batch, functions);
    done += lanes;
  }
  if (batch->active == 0 && mc_is_layered(batch->plan)) {
    double *absorbed = &batch->tally[MC_ROW_ABSORBED];
    *absorbed = 0;
    for (size_t i = 0; i < CORE_LAYERS_MAX; i++) {
      *absorbed += batch->tally[MC_ROW_LAYERS + i];
    }
  }
  return batch->active == 0;
}
