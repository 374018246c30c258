/* Monte Carlo: a detached job, so other requests of its connection go on. It replies with reports of
 * progress and, at the end, with its table of results. Several threads of the pool may walk batches of
 * the same job at a time. The batches are merged in the order of their indices, so the result does not
 * depend on which thread walked which batch. */
#include <assert.h>
#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/mc.h"
#include "server/jobs/job.h"
#include "server/jobs/mc_pool.h"
#include "server/store/cache.h"

enum {
  THREADS_MAX = 64,        /* the limit of --mc-threads in options.def */
  BATCHES_PER_THREAD = 2,  /* per job: one batch can be walked while another waits to be merged */
  PROGRESS_EVERY_MS = 200, /* a job reports progress at most this often */
  RETRY_AFTER_MS = 1000,   /* retry_after_ms of BUSY: jobs take seconds */
  BATCHES_MIN =
      32, /* the fewest for which standard errors are trusted: they are known to 13 % then */
  /* what a thread walks before it checks whether the job is still wanted: 1 to 4 ms */
  SLICE_SCATTERINGS = 100000,
};

/* The work of one job: which photons are walked, when their errors are small enough, and the table of
 * results. */
struct mc_task {
  core_mc_request request;
  double error_total; /* the error of the total R that the client requested; 0 if it named none */
  double error_rings; /* the error of each ring that it requested; 0 if it named none */
  uint64_t batches_max;
  uint32_t side_count;
  uint32_t ring_count;
  schema_layout layout;
  core_mc_plan *plan;
  core_mc_total *total;
  core_mc_ring *rings; /* [ring_count], working space */
  uint8_t *table;      /* [layout.payload_bytes]: payload of the last reply */
  uint64_t next_check; /* the number of batches at which the errors are checked next */
  wire_mc_reply progress;
  atomic_bool ends; /* set by any thread: the job ends, so errors are not checked any more */
};

struct photon_batch {
  core_mc_batch *photons;
  enum { BATCH_NEW, BATCH_BEGUN, BATCH_HELD, BATCH_DONE } state; /* HELD: a thread walks it */
};

/* The photons of a job. They outlive it until libuv has closed `wake` and no thread works on them. */
struct walk {
  struct mc_pool *pool;
  TAILQ_ENTRY(walk) in_pool; /* the first in the list has the next turn */
  uv_async_t wake;           /* sent when there is progress, or the end */
  void (*on_ready)(void *owner);
  void *owner;
  struct mc_task task;
  uint64_t bytes; /* memory as counted in the server's budget */

  unsigned users;         /* threads that work on it, and `wake` until it is closed */
  bool dropped;           /* whether the job is gone */
  bool totalling;         /* whether a thread opens the task, merges a batch, or writes the table */
  bool open;              /* whether the task's memory has been allocated */
  bool failed;            /* whether it could not be */
  bool complete;          /* whether the table is complete */
  enum mc_state state;    /* why the walk has ended; MC_UNDER_WAY if it has not */
  wire_mc_reply progress; /* copy of task.progress */
  bool progress_new;
  uint64_t woken_ms;

  uint64_t next_start; /* index of the next batch to begin */
  uint64_t next_merge; /* index of the next batch to merge; those between are in their slots */
  size_t slot_count;
  struct photon_batch slots[]; /* [slot_count]: that of batch i is i % slot_count */
};

struct mc_pool {
  struct server *server;
  uv_mutex_t mutex; /* guards all members, and those of all walks that no thread works on */
  uv_cond_t changed;
  TAILQ_HEAD(, walk) walks;
  uint64_t job_count;
  uint64_t thread_count;
  bool stopping;
  uv_thread_t threads[THREADS_MAX];
};

static uint64_t clock_ms(void) {
  return uv_hrtime() / 1000000;
}

/* ---- checking -------------------------------------------------------------------------------- */

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

/* Checks a request. If it is valid, sets all members of the task except those that open_task()
 * allocates. */
static wire_error check_task(struct mc_task *task, const struct server *server,
                             const struct job_request *from) {
  mc_request wire = {0};
  *task = (struct mc_task){0};
  const wire_error error = mc_request_parse(from->payload, &from->layout, &wire);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  if (wire.fixed.photons > server->options.max_mc_photons) {
    return job_too_large("photons", server->options.max_mc_photons, "photons");
  }
  core_fault fault = core_layers_check(wire.layers, wire.fixed.layer_count);
  if (fault.field == NULL) {
    set_request(task, &wire);
    fault = core_mc_request_parameters(&task->request, &wire.parameters);
  }
  if (fault.field == NULL) {
    fault = core_mc_check(&task->request);
  }
  if (fault.field != NULL) {
    return job_error(fault);
  }
  const bool fits = mc_reply_layout(task->side_count, (uint32_t)task->request.albedo_count,
                                    task->ring_count, &task->layout) &&
                    task->layout.payload_bytes <= server->options.max_frame_bytes;
  return fits ? error
              : job_too_large("ring_count", server->options.max_frame_bytes, "bytes of reply");
}

/* ---- memory ---------------------------------------------------------------------------------- */

/* Bounds the memory: for each albedo, a tally has a slot for each ring and two more on each side,
 * and a few numbers. There is also one count of photons for each slot. */
static uint64_t task_bytes(const struct mc_task *task, uint64_t batches) {
  const uint64_t plan_bytes = UINT64_C(512) << 10;
  const uint64_t slots = CORE_MC_SIDES * ((uint64_t)task->ring_count + 2);
  const uint64_t counts_bytes = slots * sizeof(uint64_t);
  const uint64_t tally_bytes = (slots + 8) * task->request.albedo_count * sizeof(double);
  const uint64_t batch_bytes = tally_bytes + counts_bytes + (UINT64_C(32) << 10);
  const uint64_t total_bytes = 2 * tally_bytes + counts_bytes;
  return plan_bytes + total_bytes + batches * batch_bytes + task->layout.payload_bytes +
         task->ring_count * sizeof(core_mc_ring);
}

/* Returns false if there is no memory. The caller calls close_task() in either case. */
static bool open_task(struct mc_task *task) {
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

static void close_task(struct mc_task *task) {
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

/* begin_worst(), note_worst() for each ring, and end_worst() find the largest relative error among
 * the rings that light has reached. It is infinite while no ring has light. */
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
    task->progress.error_rings = (double)INFINITY;
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
  return is_wanted && core_mc_total_batches(task->total) >= BATCHES_MIN &&
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
    const double least = fmax(photons, (double)BATCHES_MIN * CORE_MC_BATCH_PHOTONS);
    const double expected = fmax(wanted, least);
    progress->photons_expected = expected < (double)most ? (uint64_t)expected : most;
  }
}

/* Adds a batch. The more batches there are, the more rarely this checks the errors, so that checks
 * cost little. The number of batches alone says when to check, so that the same request always ends
 * after the same batch. */
static void merge_batch(struct mc_task *task, const core_mc_batch *batch) {
  wire_mc_reply *progress = &task->progress;
  core_mc_total_merge(task->total, batch);
  const uint64_t batches = core_mc_total_batches(task->total);
  progress->photons = batches * CORE_MC_BATCH_PHOTONS;
  if (batches < task->next_check && batches < task->batches_max) {
    return;
  }
  task->next_check = batches < BATCHES_MIN ? 2 * batches : batches + batches / 32;
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
  const schema_layout *layout = &task->layout;
  const uint32_t count = task->ring_count;
  const size_t edges = (size_t)layout->parts[MC_EDGES].at;
  const size_t photons = mc_photons_offset(layout, side);
  const size_t R = mc_rings_offset(layout, albedo, side, false);
  const size_t error = mc_rings_offset(layout, albedo, side, true);
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
static void write_table(struct mc_task *task, enum mc_state state) {
  begin_worst(task);
  for (uint32_t albedo = 0; albedo < task->request.albedo_count; albedo++) {
    const wire_mc_energy energy = energy_of(task, albedo);
    wire_put_mc_energy(task->table + task->layout.parts[MC_ENERGIES].at +
                           (size_t)albedo * WIRE_BYTES_mc_energy,
                       &energy);
    for (uint32_t side = 0; side < task->side_count; side++) {
      put_rings(task, albedo, side);
    }
  }
  end_worst(task);
  put_reply(task, state);
}

/* ---- the end of a walk ----------------------------------------------------------------------- */

static void free_walk(struct walk *walk) {
  for (size_t i = 0; i < walk->slot_count; i++) {
    core_mc_batch_free(walk->slots[i].photons);
  }
  close_task(&walk->task);
  budget_return(&walk->pool->server->buffers, walk->bytes);
  free(walk);
}

/* Ends the use of a walk. The last user frees it, without the mutex, which is held. */
static void leave_walk(struct walk *walk) {
  struct mc_pool *pool = walk->pool;
  if (--walk->users == 0) {
    TAILQ_REMOVE(&pool->walks, walk, in_pool);
    uv_mutex_unlock(&pool->mutex);
    free_walk(walk);
    uv_mutex_lock(&pool->mutex);
  }
}

static void on_closed(uv_handle_t *handle) {
  struct walk *walk = handle->data;
  struct mc_pool *pool = walk->pool;
  uv_mutex_lock(&pool->mutex);
  leave_walk(walk);
  uv_mutex_unlock(&pool->mutex);
}

/* ---- turns of threads ------------------------------------------------------------------------ */

/* The kinds of work that a thread does next. It does not hold the mutex meanwhile. */
enum turn { TURN_NONE, TURN_OPEN, TURN_WALK, TURN_MERGE, TURN_TABLE };

/* Returns a batch to walk: the first that waits for a thread, because the merging of later ones waits
 * for it, or else a new one. NULL if there is none. */
static struct photon_batch *batch_to_walk(struct walk *walk) {
  for (uint64_t i = walk->next_merge; i < walk->next_start; i++) {
    struct photon_batch *batch = &walk->slots[i % walk->slot_count];
    if (batch->state < BATCH_HELD) {
      return batch;
    }
  }
  if (walk->next_start == walk->task.batches_max ||
      walk->next_start == walk->next_merge + walk->slot_count) {
    return NULL;
  }
  struct photon_batch *batch = &walk->slots[walk->next_start++ % walk->slot_count];
  batch->state = BATCH_NEW;
  return batch;
}

/* Finds the next work for a walk: walking if `walks`, else what is short: allocating memory, merging,
 * or writing the table. */
static enum turn next_turn(struct walk *walk, bool walks, struct photon_batch **batch) {
  const bool ended = walk->state != MC_UNDER_WAY;
  if (walk->dropped || walk->complete || walk->failed) {
    return TURN_NONE;
  }
  if (walks) {
    *batch = walk->open && !ended ? batch_to_walk(walk) : NULL;
    return *batch != NULL ? TURN_WALK : TURN_NONE;
  }
  if (walk->totalling || !walk->open || ended) {
    return walk->totalling ? TURN_NONE : walk->open ? TURN_TABLE : TURN_OPEN;
  }
  *batch = &walk->slots[walk->next_merge % walk->slot_count];
  return walk->next_merge < walk->next_start && (*batch)->state == BATCH_DONE ? TURN_MERGE
                                                                              : TURN_NONE;
}

/* Walking comes last: the rest is short, and a client may wait for it. */
static enum turn find_turn(struct mc_pool *pool, struct walk **walk, struct photon_batch **batch) {
  for (int walks = 0; walks < 2; walks++) {
    TAILQ_FOREACH(*walk, &pool->walks, in_pool) {
      const enum turn turn = next_turn(*walk, walks, batch);
      if (turn != TURN_NONE) {
        return turn;
      }
    }
  }
  return TURN_NONE;
}

/* Allocates the memory of a walk, which would take a worker too long. If memory is short, one batch
 * is enough. */
static bool open_walk(struct walk *walk) {
  const size_t wanted = walk->slot_count;
  walk->slot_count = 0;
  if (!open_task(&walk->task)) {
    return false;
  }
  while (walk->slot_count < wanted) {
    core_mc_batch *photons = core_mc_batch_create(walk->task.plan);
    if (photons == NULL) {
      break;
    }
    walk->slots[walk->slot_count++].photons = photons;
  }
  return walk->slot_count > 0;
}

/* Starts the batch unless it has begun, and walks a slice of it. Returns whether it is complete. */
static bool walk_slice(const struct walk *walk, const struct photon_batch *batch, bool begins,
                       uint64_t index) {
  if (begins) {
    core_mc_batch_start(batch->photons, index);
  }
  return core_mc_batch_walk(batch->photons, walk->pool->server->isa, SLICE_SCATTERINGS);
}

/* Notes what a turn has changed, and wakes those for whom that is news. done: whether the memory was
 * allocated, or the batch is complete. */
static void note_turn(struct walk *walk, enum turn turn, struct photon_batch *batch, bool done) {
  struct mc_pool *pool = walk->pool;
  walk->totalling &= turn == TURN_WALK;
  if (turn == TURN_WALK) {
    batch->state = done ? BATCH_DONE : BATCH_BEGUN;
  } else if (turn == TURN_OPEN) {
    walk->open = done;
    walk->failed = !done;
  } else if (turn == TURN_MERGE) {
    walk->next_merge++;
    walk->state = walk->state == MC_UNDER_WAY ? walk->task.progress.state : walk->state;
    stats_add(&pool->server->stats, STATS_MC_PHOTONS_WALKED, CORE_MC_BATCH_PHOTONS);
  }
  walk->complete |= turn == TURN_TABLE;
  if (turn == TURN_OPEN || turn == TURN_MERGE) {
    walk->progress = walk->task.progress;
  }
  const bool late =
      walk->open && !walk->complete && clock_ms() - walk->woken_ms >= PROGRESS_EVERY_MS;
  walk->progress_new |= late;
  if (!walk->dropped && (late || walk->failed || walk->complete)) {
    walk->woken_ms = clock_ms();
    uv_async_send(&walk->wake);
  }
  if (turn != TURN_WALK || done) {
    uv_cond_broadcast(&pool->changed); /* wakes other threads, for which there may be work */
  }
}

/* Takes a turn. The mutex is held before and after. */
static void do_turn(struct walk *walk, enum turn turn, struct photon_batch *batch) {
  struct mc_pool *pool = walk->pool;
  bool done = true;
  const bool begins = turn == TURN_WALK && batch->state == BATCH_NEW;
  const uint64_t index = walk->next_start - 1; /* of a batch that begins */
  TAILQ_REMOVE(&pool->walks, walk, in_pool);
  TAILQ_INSERT_TAIL(&pool->walks, walk, in_pool);
  walk->users++;
  walk->totalling |= turn != TURN_WALK;
  if (turn == TURN_WALK) {
    batch->state = BATCH_HELD;
  }
  uv_mutex_unlock(&pool->mutex);
  if (turn == TURN_OPEN) {
    done = open_walk(walk);
  } else if (turn == TURN_WALK) {
    done = walk_slice(walk, batch, begins, index);
  } else if (turn == TURN_MERGE) {
    merge_batch(&walk->task, batch->photons);
  } else {
    write_table(&walk->task, walk->state);
  }
  uv_mutex_lock(&pool->mutex);
  note_turn(walk, turn, batch, done);
  leave_walk(walk);
}

static void thread_main(void *argument) {
  struct mc_pool *pool = argument;
  struct walk *walk;
  struct photon_batch *batch = NULL;
  cache_lower_priority(10);
  uv_mutex_lock(&pool->mutex);
  while (!pool->stopping) {
    const enum turn turn = find_turn(pool, &walk, &batch);
    if (turn != TURN_NONE) {
      do_turn(walk, turn, batch);
    } else {
      uv_cond_wait(&pool->changed, &pool->mutex);
    }
  }
  uv_mutex_unlock(&pool->mutex);
}

/* ---- the pool -------------------------------------------------------------------------------- */

struct mc_pool *mc_pool_new(struct server *server) {
  struct mc_pool *pool = calloc(1, sizeof *pool);
  if (pool != NULL) {
    pool->server = server;
    TAILQ_INIT(&pool->walks);
    if (uv_mutex_init(&pool->mutex) != 0 || uv_cond_init(&pool->changed) != 0) {
      abort(); /* On Linux this takes nothing that could be lacking. */
    }
  }
  return pool;
}

void mc_pool_free(struct mc_pool *pool) {
  if (pool == NULL) {
    return;
  }
  uv_mutex_lock(&pool->mutex);
  pool->stopping = true;
  uv_cond_broadcast(&pool->changed);
  uv_mutex_unlock(&pool->mutex);
  for (uint64_t i = 0; i < pool->thread_count; i++) {
    uv_thread_join(&pool->threads[i]);
  }
  assert(TAILQ_EMPTY(&pool->walks));
  uv_cond_destroy(&pool->changed);
  uv_mutex_destroy(&pool->mutex);
  free(pool);
}

/* Counts a job, and starts the threads that are missing. Returns false if there are too many jobs, or
 * no thread. */
static bool count_job(struct mc_pool *pool) {
  const struct options *options = &pool->server->options;
  uv_mutex_lock(&pool->mutex);
  while (pool->thread_count < options->mc_threads &&
         uv_thread_create(&pool->threads[pool->thread_count], thread_main, pool) == 0) {
    pool->thread_count++;
  }
  const bool room = pool->job_count < options->max_mc_jobs && pool->thread_count > 0;
  pool->job_count += room;
  stats_add(&pool->server->stats, STATS_MC_JOBS_OPEN, room);
  uv_mutex_unlock(&pool->mutex);
  return room;
}

/* Counts a job less. Another job may start, even if a thread still works on this one. */
static void end_job(struct mc_pool *pool, struct walk *walk) {
  uv_mutex_lock(&pool->mutex);
  pool->job_count--;
  stats_subtract(&pool->server->stats, STATS_MC_JOBS_OPEN, 1);
  if (walk != NULL) {
    walk->dropped = true;
    atomic_store(&walk->task.ends, true);
  }
  uv_mutex_unlock(&pool->mutex);
}

/* ---- the job --------------------------------------------------------------------------------- */

struct mc {
  struct job job;
  struct walk *walk;
  uint64_t progress_count; /* number of progress replies sent */
  bool complete;           /* whether the next part is the table and not a report of progress */
  wire_mc_reply progress;
};

JOB_STRUCTURE(struct mc, mc_of)

static void on_wake(uv_async_t *handle) {
  const struct walk *walk = handle->data;
  walk->on_ready(walk->owner);
}

/* Makes a walk. Returns NULL if there is no memory. */
static struct walk *new_walk(const struct job *job, const struct mc_task *task) {
  struct mc_pool *pool = job->context->server->mc;
  struct budget *budget = &pool->server->buffers;
  const size_t slots = BATCHES_PER_THREAD * (size_t)pool->server->options.mc_threads;
  const uint64_t bytes = task_bytes(task, slots);
  if (!budget_take(budget, bytes)) {
    return NULL;
  }
  struct walk *walk = calloc(1, sizeof *walk + slots * sizeof walk->slots[0]);
  if (walk == NULL || uv_async_init(job->context->loop, &walk->wake, on_wake) != 0) {
    budget_return(budget, bytes);
    free(walk);
    return NULL;
  }
  walk->pool = pool;
  walk->task = *task;
  walk->bytes = bytes;
  walk->slot_count = slots;
  walk->users = 1;
  walk->wake.data = walk;
  walk->woken_ms = clock_ms();
  return walk;
}

static enum job_outcome start_mc(struct job *job, const struct job_request *request) {
  struct mc *mc = mc_of(job);
  struct mc_pool *pool = job->context->server->mc;
  struct mc_task task;
  if (!job_passes(job, check_task(&task, pool->server, request))) {
    return JOB_REFUSED;
  }
  if (!count_job(pool)) {
    return job_refuse(
        job, wire_error_busy("max_mc_jobs", "fewer Monte Carlo jobs at a time", RETRY_AFTER_MS));
  }
  mc->progress_count = 0;
  mc->complete = false;
  mc->walk = new_walk(job, &task);
  if (mc->walk == NULL) {
    wire_error busy = job_busy();
    busy.retry_after_ms = RETRY_AFTER_MS;
    end_job(pool, NULL);
    return job_refuse(job, busy);
  }
  mc->walk->on_ready = request->on_ready;
  mc->walk->owner = request->owner;
  uv_mutex_lock(&pool->mutex);
  TAILQ_INSERT_TAIL(&pool->walks, mc->walk, in_pool);
  uv_cond_broadcast(&pool->changed);
  uv_mutex_unlock(&pool->mutex);
  return JOB_GOES_ON;
}

static enum job_outcome step_mc(struct job *job, uint64_t *budget) {
  struct mc *mc = mc_of(job);
  struct walk *walk = mc->walk;
  (void)budget;
  uv_mutex_lock(&walk->pool->mutex);
  const bool failed = walk->failed, reports = walk->progress_new && job->reader_idle;
  mc->complete = walk->complete;
  walk->progress_new = false;
  mc->progress = walk->progress;
  uv_mutex_unlock(&walk->pool->mutex);
  mc->progress.state = MC_UNDER_WAY;
  if (failed) {
    return job_refuse(job, job_no_memory());
  }
  job->part_bytes = mc->complete ? walk->task.layout.payload_bytes : WIRE_BYTES_mc_reply;
  return mc->complete || reports ? JOB_NEXT_PART : JOB_WAITS;
}

static enum job_outcome begin_part(struct job *job, uint8_t *payload) {
  struct mc *mc = mc_of(job);
  if (mc->complete) {
    memcpy(payload, mc->walk->task.table, (size_t)job->part_bytes);
    return JOB_DONE;
  }
  mc->progress.number = ++mc->progress_count;
  wire_put_mc_reply(payload, &mc->progress);
  return JOB_GOES_ON;
}

/* The table then holds the results of the photons so far. */
static void stop_mc(struct job *job, enum job_stop why) {
  struct walk *walk = mc_of(job)->walk;
  uv_mutex_lock(&walk->pool->mutex);
  if (walk->state == MC_UNDER_WAY) {
    walk->state = why == JOB_CANCELLED ? MC_CANCELLED : MC_STOPPED;
    atomic_store(&walk->task.ends, true);
    uv_cond_broadcast(&walk->pool->changed);
  }
  uv_mutex_unlock(&walk->pool->mutex);
}

static void end_mc(struct job *job) {
  struct walk *walk = mc_of(job)->walk;
  end_job(walk->pool, walk);
  uv_close((uv_handle_t *)&walk->wake, on_closed);
}

const struct job_kind job_kind_MC = {.request = &schema_mc_request,
                                     .detached = true,
                                     .start = start_mc,
                                     .begin_part = begin_part,
                                     .step = step_mc,
                                     .end = end_mc,
                                     .stop = stop_mc};
