#include "server/modbus/task.h"

#include <assert.h>

#include "server/net/worker.h"
#include "server/observe/health.h"
#include "server/store/media.h"

static const registers_job *fields_of(const struct modbus_task *task) {
  return &registers_jobs[task->kind];
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
  if (task->run.state != RUN_IDLE && task->owed_radii > 0) {
    set_progress(task, 1 - (double)task->run.job->owed_radii / (double)task->owed_radii);
  }
}

/* ---- running --------------------------------------------------------------------------------- */

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
  worker_run_later(((struct modbus_task *)owner)->client);
}

static void end_run(struct run *run, const wire_error *refusal) {
  struct modbus_task *task = run->owner;
  task->error = refusal != NULL ? *refusal : wire_error_none();
  health_note_refusal(task->server, &task->error);
}

static const struct run_sink sink = {
    .reserve = reserve_reply, .commit = commit_reply, .wake = wake_task, .end = end_run};

/* Runs the job until the budget is spent, the job waits, or it ends. Returns the reason why it has
 * failed, or OK. */
static wire_error run_job(struct modbus_task *task, uint64_t *budget) {
  run_on(&task->run, budget);
  if (modbus_task_runs(task)) {
    worker_run_later(task->client);
  } else if (task->run.state == RUN_IDLE && task->error.status == WIRE_STATUS_OK) {
    task->evaluated = true;
    worker_finish_later(task->client);
  } else if (task->run.state == RUN_IDLE) {
    task->evaluated = false;
    return task->error;
  }
  return wire_error_none();
}

static void fail_job(struct modbus_task *task, wire_error error) {
  const unsigned at = registers_of_error(fields_of(task), &error);
  modbus_task_fail(task, &error, at);
}

/* ---- committing and cancelling --------------------------------------------------------------- */

/* Returns whether the job ends with its results so far if it is cancelled: Monte Carlo. */
static bool may_stop(const struct modbus_task *task) {
  return task->run.state != RUN_IDLE && task->run.job->kind->stop != NULL;
}

static uint64_t deadline_of(const struct modbus_task *task) {
  const registers_job *fields = fields_of(task);
  const double limit_ms =
      fields->deadline > 0 ? registers_number(task->registers, fields->deadline) : 0;
  return limit_ms > 0 ? worker_round_ns(task->client->worker) / 1000000 + (uint64_t)limit_ms : 0;
}

/* Makes the worker call check_deadlines() of the units when there is something to do. */
static void watch_task(const struct modbus_task *task, uint64_t named_ms) {
  struct worker *worker = task->client->worker;
  if (task->run.deadline_ms != 0) {
    worker_wake_at(worker, task->run.deadline_ms);
  }
  if (may_stop(task) && !task->cancelled) {
    worker_wake_at(worker, named_ms + task->server->options.modbus_idle_timeout_ms);
  }
}

wire_error modbus_task_commit(struct modbus_task *task, struct client *master) {
  struct worker *worker = task->client->worker;
  size_t media_count;
  media_all(&media_count);
  if (registers_u16(task->registers, REGISTERS_AT_PRESET) > 3 * media_count) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "preset", "0, or a row of `dipole media`");
  }
  const wire_header header = {
      .type = (uint16_t)fields_of(task)->message,
      .payload_bytes = (uint32_t)modbus_translate_input(task->kind, task->registers, task->request),
  };
  struct job_request request = {
      .type = job_type_of(header.type),
      .header = &header,
      .payload = task->request,
      .context = &worker->context,
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
  watch_task(task, uv_now(&worker->loop));
  task->token = registers_u16(task->registers, fields_of(task)->commit);
  clear_error(task);
  set_progress(task, 0);
  if (!task->evaluated) {
    set_status(task, REGISTERS_STATUS_BUSY);
  }
  return error;
}

void modbus_task_move(struct modbus_task *task, struct client *from, struct client *to) {
  if (task->run.state != RUN_IDLE && task->run.job->owner == &from->profiles) {
    task->run.job->owner = &to->profiles;
  }
}

void modbus_task_cancel(struct modbus_task *task) {
  if (may_stop(task)) {
    task->cancelled = true;
    task->run.job->kind->stop(task->run.job, JOB_CANCELLED);
  } else if (task->run.state != RUN_IDLE) {
    modbus_task_end(task);
    set_status(task, REGISTERS_STATUS_CANCELLED);
  }
}

/* ---- turns ----------------------------------------------------------------------------------- */

void modbus_task_run(struct modbus_task *task, uint64_t *budget) {
  const wire_error error = run_job(task, budget);
  if (error.status != WIRE_STATUS_OK) {
    fail_job(task, error);
  }
}

void modbus_task_finish(struct modbus_task *task) {
  if (!task->evaluated) {
    return;
  }
  const registers_job *fields = fields_of(task);
  const unsigned sequence =
      registers_u16(task->registers, fields->status + REGISTERS_BEHIND_SEQUENCE);
  wire_error error;
  const enum registers_status status = modbus_translate_reply(
      task->kind, task->request, task->reply, task->reply_bytes, task->registers, &error);
  task->evaluated = false;
  if (status == REGISTERS_STATUS_ERROR) {
    fail_job(task, error);
    return;
  }
  set_status(task, task->cancelled ? REGISTERS_STATUS_CANCELLED : status);
  registers_set_u16(task->registers, fields->status + REGISTERS_BEHIND_DONE, task->token);
  registers_set_u16(task->registers, fields->status + REGISTERS_BEHIND_SEQUENCE, sequence + 1);
  clear_error(task);
  set_progress(task, 1);
  stats_add(&task->server->stats, STATS_MODBUS_EVALUATIONS, 1);
}

void modbus_task_expire(struct modbus_task *task, uint64_t named_ms) {
  const uint64_t now_ms = uv_now(&task->client->worker->loop);
  /* A job that no master reads any more occupies a place that others could use. */
  if (may_stop(task) && !task->cancelled &&
      now_ms >= named_ms + task->server->options.modbus_idle_timeout_ms) {
    modbus_task_cancel(task);
  }
  if (run_expire(&task->run)) {
    task->evaluated = false;
    fail_job(task, task->error);
  } else if (task->run.state != RUN_IDLE) {
    watch_task(task, named_ms);
  }
}

void modbus_task_end(struct modbus_task *task) {
  run_drop(&task->run);
  task->evaluated = false;
}
