#include "server/jobs/mc_pool.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>
#include <sys/queue.h>

#include "server/store/cache.h"

enum {
  THREADS_MAX = 64,       /* the limit of --mc-threads in options.def */
  BATCHES_PER_THREAD = 2, /* per job: one batch can be walked while another waits to be merged */
  RETRY_AFTER_MS = 1000,  /* retry_after_ms of BUSY: jobs take seconds */
};

/* State of one batch of a job. */
enum batch_state {
  BATCH_FREE,
  BATCH_BEGUN, /* partly walked, waits for a thread */
  BATCH_HELD,  /* a thread is walking it */
  BATCH_DONE,  /* walked, waits to be merged */
};

struct batch {
  core_mc_batch *walk;
  uint64_t index;
  enum batch_state state;
};

struct mc_job {
  struct mc_pool *pool;
  TAILQ_ENTRY(mc_job) in_pool; /* the first job in the list has the next turn */
  uv_async_t *wake;            /* NULL after mc_job_drop() */
  struct mc_task task;
  uint64_t bytes; /* the job's memory, as counted in the server's budget */

  uint64_t next_start; /* index of the next batch to begin */
  uint64_t next_merge; /* index of the next batch to merge */
  unsigned turns;      /* number of threads that work on the job */
  bool totalling;      /* a thread opens the job, merges a batch, or writes the table */
  bool open;           /* the job's memory has been allocated */
  bool failed;         /* the job's memory could not be allocated */
  enum mc_state state; /* why the job has ended; MC_UNDER_WAY if it has not */
  bool complete;       /* whether the table is complete */

  wire_mc_reply progress; /* copy of task.progress */
  bool progress_new;
  uint64_t woken_ms;

  size_t batch_count;
  struct batch batches[]; /* [batch_count]: BATCHES_PER_THREAD for each thread */
};

struct mc_pool {
  struct server *server;
  uv_mutex_t mutex; /* guards all members, and those of all jobs that no thread works on */
  uv_cond_t changed;
  TAILQ_HEAD(, mc_job) jobs;
  uint64_t job_count;
  uint64_t thread_count;
  bool stopping;
  uv_thread_t threads[THREADS_MAX];
};

/* ---- turns ----------------------------------------------------------------------------------- */

/* The kinds of work that a thread does next. It does not hold the mutex meanwhile. */
enum turn_kind { TURN_NONE, TURN_OPEN, TURN_WALK, TURN_MERGE, TURN_TABLE };

struct turn {
  enum turn_kind kind;
  struct mc_job *job;
  struct batch *batch;
  bool begins; /* WALK: the batch is new */
  bool done;   /* WALK: the batch is complete; OPEN: the memory was allocated */
};

/* Returns the batch in this state that has the lowest index, because the merging of later batches
 * waits for it. NULL if no batch is in this state. */
static struct batch *first_batch(struct mc_job *job, enum batch_state state) {
  struct batch *first = NULL;
  for (size_t i = 0; i < job->batch_count; i++) {
    struct batch *batch = &job->batches[i];
    if (batch->state == state && (first == NULL || batch->index < first->index)) {
      first = batch;
    }
  }
  return first;
}

/* Returns a batch to walk: one that has been begun, or else a new one. NULL if there is none. */
static struct batch *batch_to_walk(struct mc_job *job) {
  struct batch *batch = first_batch(job, BATCH_BEGUN);
  if (batch != NULL || job->next_start == job->task.batches_max) {
    return batch;
  }
  batch = first_batch(job, BATCH_FREE);
  if (batch != NULL) {
    batch->index = job->next_start++;
  }
  return batch;
}

static struct turn totalling_turn_of(struct mc_job *job) {
  struct turn turn = {.kind = TURN_NONE, .job = job};
  if (job->wake == NULL || job->complete || job->failed || job->totalling) {
    return turn;
  }
  if (!job->open) {
    turn.kind = TURN_OPEN;
    return turn;
  }
  if (job->state != MC_UNDER_WAY) {
    turn.kind = TURN_TABLE;
    return turn;
  }
  turn.batch = first_batch(job, BATCH_DONE);
  if (turn.batch != NULL && turn.batch->index == job->next_merge) {
    turn.kind = TURN_MERGE;
  }
  return turn;
}

static struct turn walking_turn_of(struct mc_job *job) {
  struct turn turn = {.kind = TURN_NONE, .job = job};
  if (job->wake != NULL && job->open && job->state == MC_UNDER_WAY) {
    turn.batch = batch_to_walk(job);
    turn.kind = turn.batch != NULL ? TURN_WALK : TURN_NONE;
  }
  return turn;
}

/* Finds the next work for a thread. Walking comes last. Allocating the memory of a job, merging a
 * batch and writing a table come before it: they are short, and a client may wait for them. */
static struct turn find_turn(struct mc_pool *pool) {
  struct turn turn = {.kind = TURN_NONE};
  struct mc_job *job;
  TAILQ_FOREACH(job, &pool->jobs, in_pool) {
    turn = totalling_turn_of(job);
    if (turn.kind != TURN_NONE) {
      return turn;
    }
  }
  TAILQ_FOREACH(job, &pool->jobs, in_pool) {
    turn = walking_turn_of(job);
    if (turn.kind != TURN_NONE) {
      return turn;
    }
  }
  return turn;
}

static bool take_turn(struct mc_pool *pool, struct turn *turn) {
  *turn = find_turn(pool);
  if (turn->kind == TURN_NONE) {
    return false;
  }
  struct mc_job *job = turn->job;
  TAILQ_REMOVE(&pool->jobs, job, in_pool);
  TAILQ_INSERT_TAIL(&pool->jobs, job, in_pool);
  job->turns++;
  if (turn->kind == TURN_WALK) {
    turn->begins = turn->batch->state == BATCH_FREE;
    turn->batch->state = BATCH_HELD;
  } else {
    job->totalling = true;
  }
  return true;
}

/* Allocates the memory of a job, which would take a worker too long. If memory is short, one batch
 * is enough. */
static bool open_job(struct mc_job *job) {
  const size_t wanted = job->batch_count;
  job->batch_count = 0;
  if (!mc_task_open(&job->task)) {
    return false;
  }
  while (job->batch_count < wanted) {
    core_mc_batch *walk = core_mc_batch_create(job->task.plan);
    if (walk == NULL) {
      break;
    }
    job->batches[job->batch_count++].walk = walk;
  }
  return job->batch_count > 0;
}

static void do_turn(struct mc_pool *pool, struct turn *turn) {
  struct mc_job *job = turn->job;
  switch (turn->kind) {
  case TURN_OPEN:
    turn->done = open_job(job);
    break;
  case TURN_WALK:
    if (turn->begins) {
      core_mc_batch_start(turn->batch->walk, turn->batch->index);
    }
    turn->done =
        core_mc_batch_walk(turn->batch->walk, pool->server->isa, MC_TASK_SLICE_SCATTERINGS);
    break;
  case TURN_MERGE:
    mc_task_merge(&job->task, turn->batch->walk);
    break;
  case TURN_TABLE:
    mc_task_write_table(&job->task, job->state);
    break;
  case TURN_NONE:
    break;
  }
}

static void wake(struct mc_job *job) {
  if (job->wake != NULL) {
    job->woken_ms = uv_hrtime() / 1000000;
    uv_async_send(job->wake);
  }
}

static void end_merge(struct mc_pool *pool, struct turn *turn) {
  struct mc_job *job = turn->job;
  job->totalling = false;
  turn->batch->state = BATCH_FREE;
  job->next_merge++;
  job->progress = job->task.progress;
  if (job->state == MC_UNDER_WAY) {
    job->state = job->task.progress.state;
  }
  stats_add(&pool->server->stats, STATS_MC_PHOTONS_WALKED, CORE_MC_BATCH_PHOTONS);
}

static void end_open(struct turn *turn) {
  struct mc_job *job = turn->job;
  job->totalling = false;
  job->open = turn->done;
  job->failed = !turn->done;
  job->progress = job->task.progress;
  if (job->failed) {
    wake(job);
  }
}

/* Removes a job from the list if it has been dropped and no thread works on it. Returns the job,
 * which the caller frees without holding the mutex, or NULL if the job is still in use. */
static struct mc_job *take_if_unused(struct mc_job *job) {
  if (job->wake != NULL || job->turns > 0) {
    return NULL;
  }
  TAILQ_REMOVE(&job->pool->jobs, job, in_pool);
  return job;
}

static void free_job(struct mc_job *job) {
  if (job == NULL) {
    return;
  }
  for (size_t i = 0; i < job->batch_count; i++) {
    core_mc_batch_free(job->batches[i].walk);
  }
  mc_task_close(&job->task);
  budget_return(&job->pool->server->buffers, job->bytes);
  free(job);
}

/* Ends a turn of a thread. Returns the job if the caller has to free it, or NULL. */
static struct mc_job *end_turn(struct mc_pool *pool, struct turn *turn) {
  struct mc_job *job = turn->job;
  job->turns--;
  if (turn->kind == TURN_WALK) {
    turn->batch->state = turn->done ? BATCH_DONE : BATCH_BEGUN;
  } else if (turn->kind == TURN_OPEN) {
    end_open(turn);
  } else if (turn->kind == TURN_MERGE) {
    end_merge(pool, turn);
  } else {
    job->totalling = false;
    job->complete = true;
    wake(job);
  }
  if (job->open && !job->complete &&
      uv_hrtime() / 1000000 - job->woken_ms >= MC_PROGRESS_EVERY_MS) {
    job->progress_new = true;
    wake(job);
  }
  if (turn->kind != TURN_WALK || turn->done) {
    uv_cond_broadcast(&pool->changed); /* wakes other threads, for which there may be work */
  }
  return take_if_unused(job);
}

/* ---- threads --------------------------------------------------------------------------------- */

static void thread_main(void *argument) {
  struct mc_pool *pool = argument;
  struct turn turn;
  cache_lower_priority();
  uv_mutex_lock(&pool->mutex);
  while (!pool->stopping) {
    if (!take_turn(pool, &turn)) {
      uv_cond_wait(&pool->changed, &pool->mutex);
      continue;
    }
    uv_mutex_unlock(&pool->mutex);
    do_turn(pool, &turn);
    uv_mutex_lock(&pool->mutex);
    struct mc_job *unused = end_turn(pool, &turn);
    if (unused != NULL) {
      uv_mutex_unlock(&pool->mutex);
      free_job(unused);
      uv_mutex_lock(&pool->mutex);
    }
  }
  uv_mutex_unlock(&pool->mutex);
}

/* Starts the threads that are missing. Returns false if there is no thread. */
static bool start_threads(struct mc_pool *pool) {
  while (pool->thread_count < pool->server->options.mc_threads &&
         uv_thread_create(&pool->threads[pool->thread_count], thread_main, pool) == 0) {
    pool->thread_count++;
  }
  return pool->thread_count > 0;
}

struct mc_pool *mc_pool_new(struct server *server) {
  struct mc_pool *pool = calloc(1, sizeof *pool);
  if (pool == NULL) {
    return NULL;
  }
  pool->server = server;
  TAILQ_INIT(&pool->jobs);
  if (uv_mutex_init(&pool->mutex) != 0) {
    free(pool);
    return NULL;
  }
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
  assert(TAILQ_EMPTY(&pool->jobs));
  uv_cond_destroy(&pool->changed);
  uv_mutex_destroy(&pool->mutex);
  free(pool);
}

/* ---- jobs ------------------------------------------------------------------------------------ */

/* Makes a job. Returns NULL if there is no memory. */
static struct mc_job *new_job(struct mc_pool *pool, const struct mc_task *task, uv_async_t *to) {
  const size_t batches = BATCHES_PER_THREAD * (size_t)pool->server->options.mc_threads;
  const uint64_t bytes = mc_task_bytes(task, batches);
  if (!budget_take(&pool->server->buffers, bytes)) {
    return NULL;
  }
  struct mc_job *job = calloc(1, sizeof *job + batches * sizeof job->batches[0]);
  if (job == NULL) {
    budget_return(&pool->server->buffers, bytes);
    return NULL;
  }
  job->pool = pool;
  job->task = *task;
  job->bytes = bytes;
  job->wake = to;
  job->batch_count = batches;
  job->woken_ms = uv_hrtime() / 1000000;
  return job;
}

/* Adds a job to the pool. Returns false if there are too many jobs, or no threads. */
static bool add_job(struct mc_pool *pool, struct mc_job *job) {
  uv_mutex_lock(&pool->mutex);
  const bool room = pool->job_count < pool->server->options.max_mc_jobs && start_threads(pool);
  if (room) {
    TAILQ_INSERT_TAIL(&pool->jobs, job, in_pool);
    pool->job_count++;
    stats_add(&pool->server->stats, STATS_MC_JOBS_OPEN, 1);
    uv_cond_broadcast(&pool->changed);
  }
  uv_mutex_unlock(&pool->mutex);
  return room;
}

wire_error mc_job_start(struct mc_pool *pool, const uint8_t *payload, size_t payload_bytes,
                        uv_async_t *to, struct mc_job **job) {
  struct mc_task task;
  const wire_error error = mc_task_check(&task, pool->server, payload, payload_bytes);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  *job = new_job(pool, &task, to);
  if (*job == NULL) {
    return wire_error_busy("max_total_bytes",
                           "fewer bytes at a time in the buffers of all connections",
                           RETRY_AFTER_MS);
  }
  if (!add_job(pool, *job)) {
    free_job(*job);
    return wire_error_busy("max_mc_jobs", "fewer Monte Carlo jobs at a time", RETRY_AFTER_MS);
  }
  return wire_error_none();
}

void mc_job_end(struct mc_job *job, enum mc_state state) {
  struct mc_pool *pool = job->pool;
  uv_mutex_lock(&pool->mutex);
  if (job->state == MC_UNDER_WAY) {
    job->state = state;
    atomic_store(&job->task.ends, true);
    uv_cond_broadcast(&pool->changed);
  }
  uv_mutex_unlock(&pool->mutex);
}

void mc_job_drop(struct mc_job *job) {
  struct mc_pool *pool = job->pool;
  uv_mutex_lock(&pool->mutex);
  job->wake = NULL;
  pool->job_count--; /* Another job may start, even if a thread still works on this one. */
  stats_subtract(&pool->server->stats, STATS_MC_JOBS_OPEN, 1);
  atomic_store(&job->task.ends, true);
  struct mc_job *unused = take_if_unused(job);
  uv_mutex_unlock(&pool->mutex);
  free_job(unused);
}

enum mc_news mc_job_look(struct mc_job *job, wire_mc_reply *progress) {
  enum mc_news news = MC_NOTHING_NEW;
  uv_mutex_lock(&job->pool->mutex);
  if (job->failed) {
    news = MC_NO_MEMORY;
  } else if (job->complete) {
    news = MC_TABLE;
  } else if (job->progress_new) {
    job->progress_new = false;
    *progress = job->progress;
    progress->state = MC_UNDER_WAY;
    news = MC_PROGRESS;
  }
  uv_mutex_unlock(&job->pool->mutex);
  return news;
}

const uint8_t *mc_job_table(const struct mc_job *job, size_t *payload_bytes) {
  *payload_bytes = job->task.layout.payload_bytes;
  return job->task.table;
}
