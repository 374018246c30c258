/* Monte Carlo: a detached job, so other requests of its connection go on. It replies with reports of
 * progress and, at the end, with its table of results. Several threads of the pool may walk batches of
 * the same job at a time. The batches are merged in the order of their indices, so the result does not
 * depend on which thread walked which batch. */
#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "server/jobs/job.h"
#include "server/jobs/mc_pool.h"
#include "server/jobs/mc_task.h"
#include "server/store/cache.h"

enum {
  THREADS_MAX = 64,        /* the limit of --mc-threads in options.def */
  BATCHES_PER_THREAD = 2,  /* per job: one batch can be walked while another waits to be merged */
  PROGRESS_EVERY_MS = 200, /* a job reports progress at most this often */
  RETRY_AFTER_MS = 1000,   /* retry_after_ms of BUSY: jobs take seconds */
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

/* ---- the end --------------------------------------------------------------------------------- */

static void free_walk(struct walk *walk) {
  for (size_t i = 0; i < walk->slot_count; i++) {
    core_mc_batch_free(walk->slots[i].photons);
  }
  mc_task_close(&walk->task);
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
  if (!mc_task_open(&walk->task)) {
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
  return core_mc_batch_walk(batch->photons, walk->pool->server->isa, MC_TASK_SLICE_SCATTERINGS);
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
    mc_task_merge(&walk->task, batch->photons);
  } else {
    mc_task_write_table(&walk->task, walk->state);
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
  if (pool == NULL || uv_mutex_init(&pool->mutex) != 0) {
    free(pool);
    return NULL;
  }
  pool->server = server;
  TAILQ_INIT(&pool->walks);
  if (uv_cond_init(&pool->changed) != 0) {
    uv_mutex_destroy(&pool->mutex);
    free(pool);
    return NULL;
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
  const uint64_t bytes = mc_task_bytes(task, slots);
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
  const wire_error error =
      mc_task_check(&task, pool->server, request->payload, request->header->payload_bytes);
  if (error.status != WIRE_STATUS_OK) {
    return job_refuse(job, error);
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
    return job_refuse(job, wire_error_busy(CORE_FIELD_MEMORY,
                                           "less than the memory that is free: try again",
                                           JOB_RETRY_AFTER_MS));
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

const struct job_kind job_kind_MC = {.detached = true,
                                     .start = start_mc,
                                     .begin_part = begin_part,
                                     .step = step_mc,
                                     .end = end_mc,
                                     .stop = stop_mc};
