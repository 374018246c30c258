#include "server/modbus/task.h"

#include <assert.h>

#include "server/net/worker.h"
#include "server/observe/health.h"

static const registers_job *fields_of(const struct modbus_task *task) {
  return &registers_jobs[task->kind];
}

static struct stats *stats_of(const struct modbus_task *task) {
  return &task->queue->server->stats;
}

static uint64_t now_ms(const struct modbus_queue *queue) {
  return uv_now(worker_loop(queue->client->worker));
}

/* ---- what the registers say ------------------------------------------------------------------ */

static void set_status(struct modbus_task *task, enum registers_status status) {
  registers_set_u16(task->registers, fields_of(task)->status, status);
}

static void set_error(struct modbus_task *task, unsigned status, unsigned at, const char *text) {
  const registers_job *fields = fields_of(task);
  registers_set_u16(task->registers, fields->status + REGISTERS_BEHIND_ERROR, status);
  registers_set_u16(task->registers, fields->status + REGISTERS_BEHIND_ERROR_ADDRESS, at);
  registers_set_text(task->registers, fields->error_text, REGISTERS_ERROR_TEXT_BYTES / 2, text);
}

static void clear_error(struct modbus_task *task) {
  if (registers_u16(task->registers, fields_of(task)->status + REGISTERS_BEHIND_ERROR) !=
      WIRE_STATUS_OK) {
    set_error(task, WIRE_STATUS_OK, 0, "");
  }
}

void modbus_task_fail(struct modbus_task *task, const wire_error *error, unsigned at) {
  set_status(task, REGISTERS_STATUS_ERROR);
  set_error(task, error->status, at, error->allowed);
}

static void set_progress(struct modbus_task *task, double progress) {
  if (fields_of(task)->progress > 0) {
    registers_set_f32(task->registers, fields_of(task)->progress, (float)progress);
  }
}

void modbus_task_refresh(struct modbus_task *task) {
  const struct job *job = task->run.job;
  if (task->run.state == RUN_IDLE) {
    return;
  }
  const uint64_t place = job->lookup != NULL ? cache_place(&job->lookup->waiter) : 0;
  registers_set_u16(task->registers, fields_of(task)->place,
                    place < UINT16_MAX ? (unsigned)place : UINT16_MAX);
  if (task->owed_radii > 0) {
    set_progress(task, 1 - (double)job->owed_radii / (double)task->owed_radii);
  }
}

void modbus_task_name(struct modbus_task *task) {
  task->named_ms = now_ms(task->queue);
}

/* ---- states ---------------------------------------------------------------------------------- */

static void enter(struct modbus_task *task, enum modbus_task_state state) {
  struct modbus_queue *queue = task->queue;
  if (task->state != MODBUS_TASK_IDLE) {
    TAILQ_REMOVE(&queue->tasks[task->state], task, in_queue);
  }
  task->state = state;
  if (state != MODBUS_TASK_IDLE) {
    TAILQ_INSERT_TAIL(&queue->tasks[state], task, in_queue);
  }
  if (state == MODBUS_TASK_RUNS) {
    worker_run_later(queue->client);
  } else if (state == MODBUS_TASK_EVALUATED) {
    worker_finish_later(queue->client);
  } else if (state == MODBUS_TASK_IDLE) {
    registers_set_u16(task->registers, fields_of(task)->place, 0);
  }
}

static uint8_t *reserve_reply(void *owner, const struct job *job, wire_error *error) {
  struct modbus_task *task = owner;
  (void)error;
  assert(job->part_bytes <= MODBUS_REPLY_BYTES);
  task->reply_bytes = (size_t)job->part_bytes;
  return task->reply;
}

/* A part that is not the last one is a report of progress. */
static void commit_reply(void *owner, bool last) {
  struct modbus_task *task = owner;
  if (!last) {
    modbus_translate_reply(task->kind, task->request, task->reply, task->reply_bytes,
                           task->registers, NULL);
  }
}

static void wake_task(void *owner) {
  enter(owner, MODBUS_TASK_RUNS);
}

static void end_run(struct run *run, const wire_error *refusal) {
  struct modbus_task *task = run->owner;
  task->error = refusal != NULL ? *refusal : wire_error_none();
  health_note_refusal(task->queue->server, &task->error);
}

static const struct run_sink sink = {
    .reserve = reserve_reply, .commit = commit_reply, .wake = wake_task, .end = end_run};

/* Runs the job until the budget is spent, the job waits, or it ends. Returns the reason why it has
 * failed, or OK. */
static wire_error run_job(struct modbus_task *task, uint64_t *budget) {
  run_on(&task->run, budget);
  if (task->run.state != RUN_IDLE) {
    enter(task, task->run.state == RUN_WAITS ? MODBUS_TASK_WAITS : MODBUS_TASK_RUNS);
    return wire_error_none();
  }
  enter(task, task->error.status == WIRE_STATUS_OK ? MODBUS_TASK_EVALUATED : MODBUS_TASK_IDLE);
  return task->error;
}

static void fail_job(struct modbus_task *task, const wire_error *error) {
  modbus_task_fail(task, error, registers_of_field(fields_of(task), error->field, error->index));
}

/* ---- committing and cancelling --------------------------------------------------------------- */

/* Returns when a detached job ends if no request names the unit until then. */
static uint64_t abandoned_ms(const struct modbus_task *task) {
  return task->named_ms + task->queue->server->options.modbus_idle_timeout_ms;
}

/* Returns whether the job ends with its results so far if it is cancelled: Monte Carlo. */
static bool may_stop(const struct modbus_task *task) {
  return task->run.state != RUN_IDLE && task->run.job->kind->stop != NULL;
}

static uint64_t deadline_of(const struct modbus_task *task) {
  const registers_job *fields = fields_of(task);
  const double limit_ms =
      fields->deadline > 0 ? registers_number(task->registers, fields->deadline) : 0;
  return limit_ms > 0 ? worker_round_ns(task->queue->client->worker) / 1000000 + (uint64_t)limit_ms
                      : 0;
}

/* Makes the worker call modbus_queue_expire() when there is something to do. */
static void watch(const struct modbus_task *task) {
  struct worker *worker = task->queue->client->worker;
  if (task->run.deadline_ms != 0) {
    worker_wake_at(worker, task->run.deadline_ms);
  }
  if (may_stop(task) && !task->cancelled) {
    worker_wake_at(worker, abandoned_ms(task));
  }
}

wire_error modbus_task_commit(struct modbus_task *task, struct client *master) {
  struct worker *worker = task->queue->client->worker;
  const wire_header header = {
      .type = (uint16_t)fields_of(task)->message,
      .payload_bytes = (uint32_t)modbus_translate_input(task->kind, task->registers, task->request),
  };
  struct job_request request = {
      .type = job_type_of(header.type),
      .header = &header,
      .payload = task->request,
      .context = worker_context(worker),
      .profiles = &master->profiles,
  };
  uint64_t budget = JOB_SLICE_RADII;
  task->cancelled = false;
  run_init(&task->run, &sink, task);
  run_start(&task->run, &request, deadline_of(task));
  task->owed_radii = task->run.state != RUN_IDLE ? task->run.job->owed_radii : 0;
  const wire_error error = run_job(task, &budget);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  watch(task);
  task->token = registers_u16(task->registers, fields_of(task)->commit);
  clear_error(task);
  set_progress(task, 0);
  if (task->state != MODBUS_TASK_EVALUATED) {
    set_status(task, REGISTERS_STATUS_BUSY);
  }
  return error;
}

void modbus_task_cancel(struct modbus_task *task) {
  if (may_stop(task)) {
    task->cancelled = true;
    task->run.job->kind->stop(task->run.job, JOB_CANCELLED);
  } else if (task->run.state != RUN_IDLE) {
    run_drop(&task->run);
    enter(task, MODBUS_TASK_IDLE);
    set_status(task, REGISTERS_STATUS_CANCELLED);
  }
}

/* ---- all tasks that are not idle ------------------------------------------------------------- */

void modbus_queue_init(struct modbus_queue *queue, struct server *server, struct client *client) {
  queue->server = server;
  queue->client = client;
  for (unsigned state = 0; state < MODBUS_TASK_STATES; state++) {
    TAILQ_INIT(&queue->tasks[state]);
  }
}

/* Ends the job if its deadline has passed. Returns whether it has. */
static bool expire(struct modbus_task *task) {
  if (!run_expire(&task->run)) {
    return false;
  }
  enter(task, MODBUS_TASK_IDLE);
  fail_job(task, &task->error);
  return true;
}

void modbus_queue_run(struct modbus_queue *queue) {
  uint64_t budget = JOB_SLICE_RADII;
  struct modbus_task *task;
  while (budget > 0 && (task = TAILQ_FIRST(&queue->tasks[MODBUS_TASK_RUNS])) != NULL) {
    budget -= budget < JOB_STEP_RADII ? budget : JOB_STEP_RADII;
    const wire_error error = run_job(task, &budget);
    if (error.status != WIRE_STATUS_OK) {
      fail_job(task, &error);
    }
  }
  if (!TAILQ_EMPTY(&queue->tasks[MODBUS_TASK_RUNS])) {
    worker_run_later(queue->client);
  }
}

struct modbus_task *modbus_queue_finish(struct modbus_queue *queue) {
  struct modbus_task *task = TAILQ_FIRST(&queue->tasks[MODBUS_TASK_EVALUATED]);
  if (task == NULL) {
    return NULL;
  }
  const registers_job *fields = fields_of(task);
  const unsigned sequence =
      registers_u16(task->registers, fields->status + REGISTERS_BEHIND_SEQUENCE);
  wire_error error;
  const enum registers_status status = modbus_translate_reply(
      task->kind, task->request, task->reply, task->reply_bytes, task->registers, &error);
  if (status == REGISTERS_STATUS_ERROR) {
    fail_job(task, &error);
    enter(task, MODBUS_TASK_IDLE);
    return task;
  }
  set_status(task, task->cancelled ? REGISTERS_STATUS_CANCELLED : status);
  registers_set_u16(task->registers, fields->status + REGISTERS_BEHIND_DONE, task->token);
  registers_set_u16(task->registers, fields->status + REGISTERS_BEHIND_SEQUENCE, sequence + 1);
  clear_error(task);
  set_progress(task, 1);
  enter(task, MODBUS_TASK_IDLE);
  stats_add(stats_of(task), STATS_MODBUS_EVALUATIONS, 1);
  return task;
}

void modbus_queue_expire(struct modbus_queue *queue) {
  static const enum modbus_task_state states[] = {MODBUS_TASK_RUNS, MODBUS_TASK_WAITS};
  for (unsigned i = 0; i < sizeof states / sizeof states[0]; i++) {
    struct modbus_task *next;
    for (struct modbus_task *task = TAILQ_FIRST(&queue->tasks[states[i]]); task != NULL;
         task = next) {
      next = TAILQ_NEXT(task, in_queue);
      /* A job that no master reads any more occupies a place that others could use. */
      if (may_stop(task) && !task->cancelled && now_ms(queue) >= abandoned_ms(task)) {
        modbus_task_cancel(task);
      }
      if (!expire(task)) {
        watch(task);
      }
    }
  }
}

static void move(struct modbus_task *task, struct client *from, struct client *to) {
  struct lookup *lookup = task->run.job->lookup;
  if (lookup != NULL && lookup->owner == &from->profiles) {
    lookup->owner = &to->profiles;
  }
}

void modbus_queue_move(struct modbus_queue *queue, struct client *from, struct client *to) {
  struct modbus_task *task;
  cache_move_waiters(queue->server->cache, &from->profiles, &to->profiles);
  TAILQ_FOREACH(task, &queue->tasks[MODBUS_TASK_RUNS], in_queue) {
    move(task, from, to);
  }
  TAILQ_FOREACH(task, &queue->tasks[MODBUS_TASK_WAITS], in_queue) {
    move(task, from, to);
  }
}

void modbus_queue_end(struct modbus_queue *queue) {
  for (unsigned state = 0; state < MODBUS_TASK_STATES; state++) {
    struct modbus_task *task;
    while ((task = TAILQ_FIRST(&queue->tasks[state])) != NULL) {
      run_drop(&task->run);
      enter(task, MODBUS_TASK_IDLE);
    }
  }
}
