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
  const struct job *job = task->job;
  if (task->state != MODBUS_TASK_RUNS && task->state != MODBUS_TASK_WAITS) {
    return;
  }
  const uint64_t place = job->lookup != NULL ? cache_place(&job->lookup->waiter) : 0;
  registers_set_u16(task->registers, fields_of(task)->place,
                    place < UINT16_MAX ? (unsigned)place : UINT16_MAX);
  if (task->detached == NULL && task->owed_radii > 0) {
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

/* Called when the job can go on, because its profile has been prepared or Monte Carlo has news. */
static void on_ready(void *owner) {
  struct modbus_task *task = owner;
  if (task->state == MODBUS_TASK_WAITS) {
    enter(task, MODBUS_TASK_RUNS);
  }
}

/* Calls the function of the job that its last outcome asks for. Subtracts the cost from *budget. */
static enum job_outcome step(struct modbus_task *task, enum job_outcome outcome, uint64_t *budget) {
  struct job *job = task->job;
  if (outcome != JOB_NEXT_PART) {
    job->reader_idle = true;
    return job->kind->step(job, budget);
  }
  assert(job->part_bytes <= MODBUS_REPLY_BYTES);
  task->reply_bytes = (size_t)job->part_bytes;
  outcome = job->kind->begin_part(job, task->reply);
  if (outcome == JOB_GOES_ON && task->detached != NULL) { /* This part was a report of progress. */
    modbus_translate_reply(task->kind, task->question, task->reply, task->reply_bytes,
                           task->registers, NULL);
  }
  return outcome;
}

/* Runs the job until the budget is spent, the job waits, or it ends. Returns the reason why it has
 * failed, or OK. */
static wire_error follow(struct modbus_task *task, enum job_outcome outcome, uint64_t *budget) {
  while ((outcome == JOB_GOES_ON && *budget > 0) || outcome == JOB_NEXT_PART) {
    outcome = step(task, outcome, budget);
  }
  if (outcome == JOB_GOES_ON) {
    enter(task, MODBUS_TASK_RUNS);
  } else if (outcome == JOB_WAITS || outcome == JOB_DETACHED) {
    enter(task, MODBUS_TASK_WAITS);
  } else {
    const wire_error error = outcome == JOB_DONE ? wire_error_none() : task->job->refusal;
    health_note_refusal(task->queue->server, &error);
    job_end(task->job);
    enter(task, outcome == JOB_DONE ? MODBUS_TASK_EVALUATED : MODBUS_TASK_IDLE);
    return error;
  }
  return wire_error_none();
}

/* Ends the job without results. First evaluates the batch, which may still write to its reply. */
static void give_up(struct modbus_task *task) {
  batch_finish(&worker_context(task->queue->client->worker)->batch, stats_of(task));
  job_end(task->job);
  enter(task, MODBUS_TASK_IDLE);
}

static void fail_job(struct modbus_task *task, const wire_error *error) {
  modbus_task_fail(task, error, registers_of_field(fields_of(task), error->field, error->index));
}

/* ---- committing and cancelling --------------------------------------------------------------- */

/* Returns when a detached job ends if no request names the unit until then. */
static uint64_t abandoned_ms(const struct modbus_task *task) {
  return task->named_ms + task->queue->server->options.modbus_idle_timeout_ms;
}

static void set_deadline(struct modbus_task *task) {
  const registers_job *fields = fields_of(task);
  struct worker *worker = task->queue->client->worker;
  const double limit_ms =
      fields->deadline > 0 ? registers_number(task->registers, fields->deadline) : 0;
  task->deadline_ms = limit_ms > 0 ? worker_round_ns(worker) / 1000000 + (uint64_t)limit_ms : 0;
  if (task->deadline_ms > 0) {
    worker_wake_at(worker, task->deadline_ms);
  }
  if (task->detached != NULL) {
    worker_wake_at(worker, abandoned_ms(task));
  }
}

wire_error modbus_task_commit(struct modbus_task *task, struct client *master) {
  struct worker *worker = task->queue->client->worker;
  const wire_header header = {
      .type = (uint16_t)fields_of(task)->message,
      .payload_bytes =
          (uint32_t)modbus_translate_input(task->kind, task->registers, task->question),
  };
  task->detached = NULL;
  const struct job_request request = {
      .header = &header,
      .payload = task->question,
      .context = worker_context(worker),
      .on_ready = on_ready,
      .on_news = on_ready,
      .owner = task,
      .profiles = &master->profiles,
      .detached = &task->detached,
  };
  enum job_outcome outcome = job_start(&task->slot, &request, &task->job);
  if (outcome == JOB_REFUSED) {
    health_note_refusal(task->queue->server, &task->job->refusal);
    return task->job->refusal;
  }
  task->job = outcome == JOB_DETACHED ? task->detached : task->job;
  task->cancelled = false;
  task->owed_radii = task->job->owed_radii;
  set_deadline(task);
  uint64_t budget = JOB_SLICE_RADII;
  const wire_error error = follow(task, outcome, &budget);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  task->token = registers_u16(task->registers, fields_of(task)->commit);
  clear_error(task);
  set_progress(task, 0);
  if (task->state != MODBUS_TASK_EVALUATED) {
    set_status(task, REGISTERS_STATUS_BUSY);
  }
  return error;
}

void modbus_task_cancel(struct modbus_task *task) {
  if (task->state != MODBUS_TASK_RUNS && task->state != MODBUS_TASK_WAITS) {
    return;
  }
  if (task->detached != NULL) {
    task->cancelled = true;
    task->job->kind->stop(task->job, JOB_CANCELLED);
    return;
  }
  give_up(task);
  set_status(task, REGISTERS_STATUS_CANCELLED);
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
  if (task->deadline_ms == 0 || now_ms(task->queue) < task->deadline_ms) {
    return false;
  }
  const wire_error error =
      wire_error_make(WIRE_STATUS_DEADLINE, "deadline_ms", "more: the results take longer");
  give_up(task);
  fail_job(task, &error);
  return true;
}

/* Cancels a detached job that no master asks for any more, because it keeps its place from
 * others. */
static void abandon(struct modbus_task *task) {
  if (task->detached == NULL || task->cancelled) {
    return;
  }
  if (now_ms(task->queue) >= abandoned_ms(task)) {
    modbus_task_cancel(task);
  } else {
    worker_wake_at(task->queue->client->worker, abandoned_ms(task));
  }
}

void modbus_queue_run(struct modbus_queue *queue) {
  uint64_t budget = JOB_SLICE_RADII;
  struct modbus_task *task;
  while (budget > 0 && (task = TAILQ_FIRST(&queue->tasks[MODBUS_TASK_RUNS])) != NULL) {
    budget -= budget < JOB_STEP_RADII ? budget : JOB_STEP_RADII;
    const wire_error error = expire(task) ? wire_error_none() : follow(task, JOB_GOES_ON, &budget);
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
      task->kind, task->question, task->reply, task->reply_bytes, task->registers, &error);
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
      abandon(task);
      if (!expire(task) && task->deadline_ms != 0) {
        worker_wake_at(queue->client->worker, task->deadline_ms);
      }
    }
  }
}

static void move(struct modbus_task *task, struct client *from, struct client *to) {
  struct profiles_lookup *lookup = task->job->lookup;
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
      if (state != MODBUS_TASK_EVALUATED) {
        job_end(task->job);
      }
      enter(task, MODBUS_TASK_IDLE);
    }
  }
}
