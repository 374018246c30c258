#include "server/modbus/task.h"

#include "server/net/worker.h"
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
  if (task->call.state == CALL_RUNS && task->owed_radii > 0) {
    set_progress(task, 1 - (double)task->call.run.job->owed_radii / (double)task->owed_radii);
  }
}

/* ---- running --------------------------------------------------------------------------------- */

/* Writes the reply, or a report of progress, into the registers. */
static enum registers_status take_reply(struct modbus_task *task, wire_error *error) {
  return modbus_translate_reply(task->kind, (const uint8_t *)task->call.payload.bytes,
                                (const uint8_t *)task->call.reply.bytes, task->call.reply.count,
                                task->registers, error);
}

static void take_report(struct call *call) {
  wire_error error;
  take_reply((struct modbus_task *)(void *)call, &error);
}

void modbus_task_init(struct modbus_task *task, enum registers_job_kind kind, uint16_t *registers,
                      struct client *client, struct budget *buffers) {
  *task = (struct modbus_task){.kind = kind, .registers = registers};
  call_init(&task->call, client, buffers, false);
  task->call.report = take_report;
}

/* ---- committing and cancelling --------------------------------------------------------------- */

static uint64_t limit_ms(const struct modbus_task *task) {
  const registers_job *fields = fields_of(task);
  const double limit_ms =
      fields->deadline > 0 ? registers_number(task->registers, fields->deadline) : 0;
  return limit_ms > 0 ? (uint64_t)limit_ms : 0;
}

/* Makes the worker call check_deadlines() of the units when nobody has read for too long. */
static void watch_task(const struct modbus_task *task, uint64_t named_ms) {
  struct worker *worker = task->call.client->worker;
  if (call_may_stop(&task->call) && !task->cancelled) {
    worker_wake_at(worker, named_ms + worker->server->options.modbus_idle_timeout_ms);
  }
}

wire_error modbus_task_commit(struct modbus_task *task, struct client *master) {
  struct call *call = &task->call;
  uint64_t budget = JOB_SLICE_RADII;
  size_t media_count;
  media_all(&media_count);
  if (registers_u16(task->registers, REGISTERS_AT_PRESET) > 3 * media_count) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "preset", "0, or a row of `dipole media`");
  }
  if (!modbus_translate_input(task->kind, task->registers, &call->payload)) {
    return job_busy();
  }
  task->cancelled = false;
  call_start(call, fields_of(task)->message, &master->profiles, limit_ms(task));
  task->owed_radii = call->state == CALL_RUNS ? call->run.job->owed_radii : 0;
  call_on(call, &budget);
  if (call->state == CALL_ENDS && call->error.status != WIRE_STATUS_OK) {
    call_take_end(call);
    return call->error;
  }
  watch_task(task, uv_now(&call->client->worker->loop));
  task->token = registers_u16(task->registers, fields_of(task)->commit);
  clear_error(task);
  set_progress(task, 0);
  if (call->state == CALL_RUNS) {
    set_status(task, REGISTERS_STATUS_BUSY);
  }
  return wire_error_none();
}

void modbus_task_move(struct modbus_task *task, struct client *from, struct client *to) {
  if (task->call.state == CALL_RUNS && task->call.run.job->owner == &from->profiles) {
    task->call.run.job->owner = &to->profiles;
  }
}

void modbus_task_cancel(struct modbus_task *task) {
  const bool runs = task->call.state == CALL_RUNS;
  task->cancelled = call_may_stop(&task->call);
  call_stop(&task->call, JOB_CANCELLED);
  if (runs && !task->cancelled) {
    set_status(task, REGISTERS_STATUS_CANCELLED);
  }
}

/* ---- turns ----------------------------------------------------------------------------------- */

void modbus_task_finish(struct modbus_task *task) {
  if (!call_take_end(&task->call)) {
    return;
  }
  const registers_job *fields = fields_of(task);
  const unsigned sequence =
      registers_u16(task->registers, fields->status + REGISTERS_BEHIND_SEQUENCE);
  wire_error error = task->call.error;
  const enum registers_status status =
      error.status == WIRE_STATUS_OK ? take_reply(task, &error) : REGISTERS_STATUS_ERROR;
  if (status == REGISTERS_STATUS_ERROR) {
    modbus_task_fail(task, &error, registers_of_error(fields, &error));
    return;
  }
  set_status(task, task->cancelled ? REGISTERS_STATUS_CANCELLED : status);
  registers_set_u16(task->registers, fields->status + REGISTERS_BEHIND_DONE, task->token);
  registers_set_u16(task->registers, fields->status + REGISTERS_BEHIND_SEQUENCE, sequence + 1);
  clear_error(task);
  set_progress(task, 1);
  stats_add(&task->call.client->worker->server->stats, STATS_MODBUS_EVALUATIONS, 1);
}

void modbus_task_expire(struct modbus_task *task, uint64_t named_ms) {
  const struct worker *worker = task->call.client->worker;
  /* A job that no master reads any more occupies a place that others could use. */
  if (call_may_stop(&task->call) && !task->cancelled &&
      uv_now(&worker->loop) >= named_ms + worker->server->options.modbus_idle_timeout_ms) {
    modbus_task_cancel(task);
  }
  call_expire(&task->call);
  watch_task(task, named_ms);
}
