#include "server/jobs/mc_task.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- checking -------------------------------------------------------------------------------- */

/* Returns the name on the wire of a field that core has named. */
static const char *wire_field(const char *field) {
  static const struct {
    const char *core, *wire;
  } others[] = {
      {"sigma_t", "sigma_s"},
      {"radius_spacing", "spacing"},
      {"radius_count", "ring_count"},
  };
  for (size_t i = 0; i < sizeof others / sizeof others[0]; i++) {
    if (strcmp(field, others[i].core) == 0) {
      return others[i].wire;
    }
  }
  return field;
}

static wire_error from_fault(core_fault fault) {
  wire_error error = wire_error_make(WIRE_STATUS_BAD_VALUE, wire_field(fault.field), fault.allowed);
  error.index = fault.index;
  return error;
}

/* Returns whether the value can be a target for an error. NaN cannot: it fails every comparison. */
static bool is_error_target(double target) {
  return target == 0 || (target >= 1e-9 && target <= 1);
}

static wire_error check_targets(const wire_mc_request *fixed, uint64_t photons_max) {
  static const char errors[] = "0 (none), or 1e-9 to 1";
  char allowed[64];
  if (fixed->photons == 0) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "photons", "at least 1");
  }
  if (fixed->photons > photons_max) {
    snprintf(allowed, sizeof allowed, "at most %llu", (unsigned long long)photons_max);
    return wire_error_make(WIRE_STATUS_TOO_LARGE, "photons", allowed);
  }
  if (!is_error_target(fixed->error_total)) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "error_total", errors);
  }
  if (!is_error_target(fixed->error_rings)) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "error_rings", errors);
  }
  return wire_error_none();
}

/* Makes the request for core. The medium has been checked. */
static void set_request(struct mc_task *task, const mc_request *wire) {
  core_mc_request *request = &task->request;
  core_mc_request_medium(request, wire->layers, wire->fixed.layer_count);
  if (wire->fixed.albedo_count > 0) {
    request->albedo_count = wire->fixed.albedo_count;
    memcpy(request->albedo, wire->albedo, sizeof request->albedo);
  }
  request->edges = (core_grid){wire->fixed.spacing, (uint64_t)wire->fixed.ring_count + 1,
                               wire->fixed.radius_start, wire->fixed.radius_stop};
  request->seed = wire->fixed.seed;
  task->error_total = wire->fixed.error_total;
  task->error_rings = wire->fixed.error_rings;
  task->batches_max = (wire->fixed.photons - 1) / CORE_MC_BATCH_PHOTONS + 1;
  task->side_count = wire->layers[wire->fixed.layer_count - 1].thickness_mm > 0 ? CORE_MC_SIDES : 1;
  task->ring_count = wire->fixed.ring_count;
}

wire_error mc_task_check(struct mc_task *task, const struct server *server, const uint8_t *payload,
                         size_t payload_bytes) {
  mc_request wire = {0};
  *task = (struct mc_task){0};
  wire_error error = mc_request_parse(payload, payload_bytes, &wire);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  if (wire.fixed.ring_count < 1 || wire.fixed.ring_count > CORE_MC_RINGS_MAX) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "ring_count", "1 to 4096");
  }
  core_fault fault = core_layers_check(wire.layers, wire.fixed.layer_count);
  if (fault.field != NULL) {
    return from_fault(fault);
  }
  set_request(task, &wire);
  fault = core_mc_request_parameters(&task->request, &wire.parameters);
  if (fault.field == NULL) {
    fault = core_mc_check(&task->request);
  }
  if (fault.field != NULL) {
    return from_fault(fault);
  }
  error = check_targets(&wire.fixed, server->options.max_mc_photons);
  if (error.status == WIRE_STATUS_OK &&
      (!mc_reply_layout(task->side_count, (uint32_t)task->request.albedo_count, task->ring_count,
                        &task->layout) ||
       task->layout.payload_bytes > server->options.max_frame_bytes)) {
    char allowed[64];
    snprintf(allowed, sizeof allowed, "at most %llu bytes of reply",
             (unsigned long long)server->options.max_frame_bytes);
    error = wire_error_make(WIRE_STATUS_TOO_LARGE, "ring_count", allowed);
  }
  return error;
}

/* ---- memory ---------------------------------------------------------------------------------- */

/* Bounds the memory: for each albedo, a tally has a slot for each ring and two more on each side,
 * and a few numbers. There is also one count of photons for each slot. */
uint64_t mc_task_bytes(const struct mc_task *task, uint64_t batches) {
  const uint64_t plan_bytes = UINT64_C(512) << 10;
  const uint64_t slots = CORE_MC_SIDES * ((uint64_t)task->ring_count + 2);
  const uint64_t counts_bytes = slots * sizeof(uint64_t);
  const uint64_t tally_bytes = (slots + 8) * task->request.albedo_count * sizeof(double);
  const uint64_t batch_bytes = tally_bytes + counts_bytes + (UINT64_C(32) << 10);
  const uint64_t total_bytes = 2 * tally_bytes + counts_bytes;
  return plan_bytes + total_bytes + batches * batch_bytes + task->layout.payload_bytes +
         task->ring_count * sizeof(core_mc_ring);
}

bool mc_task_open(struct mc_task *task) {
  task->plan = core_mc_plan_create(&task->request);
  task->total = task->plan != NULL ? core_mc_total_create(task->plan) : NULL;
  task->rings = calloc(task->ring_count, sizeof *task->rings);
  task->table = malloc(task->layout.payload_bytes);
  task->next_check = 2;
  task->progress = (wire_mc_reply){
      .side_count = (uint16_t)task->side_count,
      .error_total = (double)INFINITY,
      .error_rings = (double)INFINITY,
      .photons_expected = task->batches_max * CORE_MC_BATCH_PHOTONS,
  };
  return task->total != NULL && task->rings != NULL && task->table != NULL;
}

void mc_task_close(struct mc_task *task) {
  core_mc_total_free(task->total);
  core_mc_plan_free(task->plan);
  free(task->rings);
  free(task->table);
}

/* ---- errors ---------------------------------------------------------------------------------- */

/* Returns the largest relative error of R among the albedos; 0 if no scattered light leaves. */
static double total_error(const struct mc_task *task) {
  double worst = core_mc_total_batches(task->total) >= 2 ? 0 : (double)INFINITY;
  for (size_t k = 0; k < task->request.albedo_count; k++) {
    core_mc_energy energy;
    core_mc_total_energy(task->total, k, &energy);
    const core_mc_value *R = &energy.left[CORE_MC_REFLECTED];
    if (R->value > 0) {
      worst = fmax(worst, R->error / R->value);
    }
  }
  return worst;
}

/* Returns whether scattered light has left on any side. */
static bool light_leaves(const struct mc_task *task) {
  for (size_t k = 0; k < task->request.albedo_count; k++) {
    core_mc_energy energy;
    core_mc_total_energy(task->total, k, &energy);
    for (size_t side = 0; side < CORE_MC_SIDES; side++) {
      if (energy.left[side].value > energy.unscattered[side]) {
        return true;
      }
    }
  }
  return false;
}

/* begin_worst(), note_worst() for each ring, and end_worst() find the largest relative error among
 * the rings that light has reached. It is infinite while no ring has light, and 0 if no scattered
 * light leaves at all. */
static void begin_worst(struct mc_task *task) {
  task->progress.error_rings = -1;
  task->progress.worst_from = task->progress.worst_to = 0;
}

/* Takes the errors of task->rings, which are the rings of this albedo and side, into account. */
static void note_worst(struct mc_task *task, uint32_t albedo, uint32_t side) {
  wire_mc_reply *progress = &task->progress;
  for (uint32_t i = 0; i < task->ring_count; i++) {
    const core_mc_ring *ring = &task->rings[i];
    const double error = ring->error_per_mm2 / ring->R_per_mm2;
    if (ring->R_per_mm2 > 0 && error > progress->error_rings) {
      progress->error_rings = error;
      progress->worst_side = (uint16_t)side;
      progress->worst_albedo = (uint16_t)albedo;
      progress->worst_from = ring->from_mm;
      progress->worst_to = ring->to_mm;
    }
  }
}

static void end_worst(struct mc_task *task) {
  if (task->progress.error_rings < 0) {
    const bool known = core_mc_total_batches(task->total) >= 2 && !light_leaves(task);
    task->progress.error_rings = known ? 0 : (double)INFINITY;
  }
}

/* Finds the worst ring. With many rings and albedos this takes tens of milliseconds, so it stops
 * early if the job has to end. */
static void find_worst_ring(struct mc_task *task) {
  begin_worst(task);
  for (uint32_t k = 0; k < task->request.albedo_count; k++) {
    for (uint32_t side = 0; side < task->side_count && !atomic_load(&task->ends); side++) {
      core_mc_total_rings(task->total, k, side, task->rings);
      note_worst(task, k, side);
    }
  }
  end_worst(task);
}

/* Estimates how many photons reach the wanted error, which falls with the root of their number. */
static double photons_for(double error, double wanted, double photons) {
  return wanted > 0 ? photons * pow(error / wanted, 2) : 0;
}

static bool is_enough(const struct mc_task *task) {
  const bool is_wanted = task->error_total > 0 || task->error_rings > 0;
  return is_wanted && core_mc_total_batches(task->total) >= MC_TASK_BATCHES_MIN &&
         (task->error_total == 0 || task->progress.error_total <= task->error_total) &&
         (task->error_rings == 0 || task->progress.error_rings <= task->error_rings);
}

/* Computes the errors, and estimates how many photons the task will need. */
static void check_errors(struct mc_task *task) {
  wire_mc_reply *progress = &task->progress;
  const double photons = (double)progress->photons;
  const uint64_t most = task->batches_max * CORE_MC_BATCH_PHOTONS;
  progress->error_total = total_error(task);
  find_worst_ring(task);
  progress->photons_expected = most;
  if (task->error_total > 0 || task->error_rings > 0) {
    const double wanted = fmax(photons_for(progress->error_total, task->error_total, photons),
                               photons_for(progress->error_rings, task->error_rings, photons));
    const double least = fmax(photons, (double)MC_TASK_BATCHES_MIN * CORE_MC_BATCH_PHOTONS);
    const double expected = fmax(wanted, least);
    progress->photons_expected = expected < (double)most ? (uint64_t)expected : most;
  }
}

/* Adds a batch. The more batches there are, the more rarely this checks the errors, so that checks
 * cost little. The number of batches alone says when to check, so that the same request always ends
 * after the same batch. */
void mc_task_merge(struct mc_task *task, const core_mc_batch *batch) {
  wire_mc_reply *progress = &task->progress;
  core_mc_total_merge(task->total, batch);
  const uint64_t batches = core_mc_total_batches(task->total);
  progress->photons = batches * CORE_MC_BATCH_PHOTONS;
  if (batches < task->next_check && batches < task->batches_max) {
    return;
  }
  task->next_check = batches < MC_TASK_BATCHES_MIN ? 2 * batches : batches + batches / 32;
  check_errors(task);
  if (is_enough(task)) {
    progress->state = MC_ERRORS_SMALL;
    progress->photons_expected = progress->photons;
  } else if (batches == task->batches_max) {
    progress->state = MC_PHOTONS_WALKED;
  }
}

/* ---- the table ------------------------------------------------------------------------------- */

static wire_mc_energy energy_of(const struct mc_task *task, size_t albedo) {
  core_mc_energy from;
  core_mc_total_energy(task->total, albedo, &from);
  wire_mc_energy to = {
      .albedo = task->request.albedo[albedo],
      .reflected = from.left[CORE_MC_REFLECTED].value,
      .reflected_error = from.left[CORE_MC_REFLECTED].error,
      .transmitted = from.left[CORE_MC_TRANSMITTED].value,
      .transmitted_error = from.left[CORE_MC_TRANSMITTED].error,
      .absorbed = from.absorbed.value,
      .absorbed_error = from.absorbed.error,
      .unfinished = from.unfinished.value,
      .unfinished_error = from.unfinished.error,
      .roulette = from.roulette.value,
      .roulette_error = from.roulette.error,
      .imbalance = from.imbalance,
  };
  for (size_t side = 0; side < CORE_MC_SIDES; side++) {
    to.unscattered[side] = from.unscattered[side];
    to.under[side] = from.under[side].value;
    to.under_error[side] = from.under[side].error;
    to.over[side] = from.over[side].value;
    to.over_error[side] = from.over[side].error;
  }
  for (size_t i = 0; i < CORE_LAYERS_MAX; i++) {
    to.in_layer[i] = from.in_layer[i].value;
    to.in_layer_error[i] = from.in_layer[i].error;
  }
  return to;
}

static void put_array(uint8_t *table, size_t offset, uint32_t index, const void *value) {
  memcpy(table + offset + (size_t)index * 8, value, 8);
}

/* Writes the rings of one albedo and side. All albedos share the edges and the photons. */
static void put_rings(struct mc_task *task, uint32_t albedo, uint32_t side) {
  const mc_layout *layout = &task->layout;
  const uint32_t sides = task->side_count, count = task->ring_count;
  const size_t edges = layout->edges_offset;
  const size_t photons = mc_photons_offset(layout, count, side);
  const size_t R = mc_rings_offset(layout, sides, count, albedo, side, false);
  const size_t error = mc_rings_offset(layout, sides, count, albedo, side, true);
  core_mc_total_rings(task->total, albedo, side, task->rings);
  note_worst(task, albedo, side);
  for (uint32_t i = 0; i < count; i++) {
    const core_mc_ring *ring = &task->rings[i];
    put_array(task->table, edges, i, &ring->from_mm);
    put_array(task->table, photons, i, &ring->photons);
    put_array(task->table, R, i, &ring->R_per_mm2);
    put_array(task->table, error, i, &ring->error_per_mm2);
  }
  put_array(task->table, edges, count, &task->rings[count - 1].to_mm);
}

static void put_reply(struct mc_task *task, enum mc_state state) {
  wire_mc_reply reply = task->progress;
  reply.state = (uint16_t)state;
  reply.albedo_count = (uint16_t)task->request.albedo_count;
  reply.ring_count = task->ring_count;
  reply.photons_expected = reply.photons;
  reply.error_total = total_error(task);
  wire_put_mc_reply(task->table, &reply);
}

/* Writes the table. It computes the errors once more, because a cancelled job ends between two
 * checks. */
void mc_task_write_table(struct mc_task *task, enum mc_state state) {
  begin_worst(task);
  for (uint32_t albedo = 0; albedo < task->request.albedo_count; albedo++) {
    const wire_mc_energy energy = energy_of(task, albedo);
    wire_put_mc_energy(task->table + task->layout.energies_offset +
                           (size_t)albedo * WIRE_BYTES_mc_energy,
                       &energy);
    for (uint32_t side = 0; side < task->side_count; side++) {
      put_rings(task, albedo, side);
    }
  }
  end_worst(task);
  put_reply(task, state);
}
