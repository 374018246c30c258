#include "server/modbus/unit.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "server/net/worker.h"

/* ---- errors ---------------------------------------------------------------------------------- */

void modbus_unit_note_refusal(struct modbus_unit *unit, const wire_error *error, unsigned at) {
  registers_set_u16(unit->registers, REGISTERS_AT_ERROR, error->status);
  registers_set_u16(unit->registers, REGISTERS_AT_ERROR_ADDRESS, at);
  registers_set_text(unit->registers, REGISTERS_AT_ERROR_TEXT, REGISTERS_ERROR_TEXT_BYTES / 2,
                     error->allowed);
}

/* Writes the reason why a write was refused into the error registers, and those of the task that it
 * would have committed. Returns the exception. */
static unsigned refuse_write(struct modbus_unit *unit, struct modbus_task *committed,
                             const wire_error *error, unsigned at) {
  modbus_unit_note_refusal(unit, error, at);
  if (committed != NULL && !modbus_task_busy(committed)) {
    modbus_task_fail(committed, error, at);
  }
  return wire_status_of(error->status)->exception;
}

/* ---- writing --------------------------------------------------------------------------------- */

enum { WRITE_MAX = 123 }; /* the most registers in one request, by the limit of Modbus */

/* Returns the value that a write gives to a register; 0 if it does not write there. */
static uint16_t written_word(unsigned address, unsigned count, const uint8_t *values, unsigned at) {
  if (!registers_include(address, count, at)) {
    return 0;
  }
  const unsigned i = at - address < count ? at - address : at + REGISTERS_MIRROR - address;
  return (uint16_t)(values[2 * i] << 8 | values[2 * i + 1]);
}

/* Returns the task that a write commits, or NULL. No request is long enough to commit two. */
static struct modbus_task *committed_by(struct modbus_unit *unit, unsigned address, unsigned count,
                                        const uint8_t *values) {
  for (unsigned kind = 0; kind < REGISTERS_JOBS; kind++) {
    if (written_word(address, count, values, registers_jobs[kind].commit) != 0) {
      return &unit->tasks[kind];
    }
  }
  return NULL;
}

/* The eta of a fit's media. It has no default, because a fit with a wrong eta looks as good. */
enum { ETA_OF_MEDIA, ETA_OF_REFERENCE, ETAS };
static const unsigned eta_at[ETAS] = {REGISTERS_AT_ETA, REGISTERS_AT_FIT_REFERENCE_ETA};

/* Returns which of them have been written, by this write or before. */
static unsigned etas_after(const struct modbus_unit *unit, unsigned address, unsigned count,
                           const uint8_t *values) {
  unsigned etas = written_word(address, count, values, REGISTERS_AT_DEFAULTS) != 0 ? 0 : unit->etas;
  for (unsigned i = 0; i < ETAS; i++) {
    etas |= registers_include(address, count, eta_at[i]) ? 1u << i : 0;
  }
  return etas;
}

/* Starts the job of registers that have been written. */
static wire_error start_task(struct modbus_unit *unit, struct modbus_task *task, unsigned etas,
                             struct client *client) {
  const bool ratios =
      registers_u16(unit->registers, REGISTERS_AT_FIT_SCALE) == CORE_FIT_SCALE_REFERENCE;
  for (unsigned i = 0;
       task->kind == REGISTERS_JOB_FIT && i <= (ratios ? ETA_OF_REFERENCE : ETA_OF_MEDIA); i++) {
    if ((etas & 1u << i) == 0) {
      return wire_error_make(WIRE_STATUS_BAD_VALUE, i == ETA_OF_MEDIA ? "eta" : "reference_eta",
                             "what is written: a fit has no default for it");
    }
  }
  return modbus_task_commit(task, client);
}

/* Adds a unit to the active ones, or removes it, as its tasks are. */
static void note_busy(struct modbus_unit *unit) {
  bool busy = false;
  for (unsigned kind = 0; kind < REGISTERS_JOBS; kind++) {
    busy |= modbus_task_busy(&unit->tasks[kind]);
  }
  if (busy && !unit->active) {
    TAILQ_INSERT_TAIL(&unit->units->active, unit, in_active);
  } else if (!busy && unit->active) {
    TAILQ_REMOVE(&unit->units->active, unit, in_active);
  }
  unit->active = busy;
}

/* Writes the registers and starts the job. If the job cannot be started, restores the registers. */
static unsigned commit_task(struct modbus_unit *unit, struct modbus_task *task, unsigned address,
                            unsigned count, const uint8_t *values, struct client *client) {
  uint8_t before[2 * WRITE_MAX];
  registers_read(unit->registers, address, count, before);
  registers_write(unit->registers, address, count, values);
  const unsigned etas = etas_after(unit, address, count, values);
  wire_error error = start_task(unit, task, etas, client);
  if (error.status != WIRE_STATUS_OK) {
    registers_write(unit->registers, address, count, before);
    const unsigned at = registers_of_error(&registers_jobs[task->kind], &error);
    return refuse_write(unit, task, &error, at);
  }
  note_busy(unit);
  const bool fits = registers_is_fit(task->kind) && modbus_task_runs(task);
  if (fits || task->call.state == CALL_ENDS) {
    unit->awaited = task;
    unit->master = client;
    unit->reply_ms = fits ? uv_now(&client->worker->loop) + MODBUS_FIT_MS : 0;
  }
  if (fits) {
    worker_wake_at(client->worker, unit->reply_ms);
  }
  return 0;
}

/* Ends the jobs whose register `cancel` a write sets, and sets these registers to 0. */
static void cancel_tasks(struct modbus_unit *unit, unsigned address, unsigned count,
                         const uint8_t *values) {
  for (unsigned kind = 0; kind < REGISTERS_JOBS; kind++) {
    if (written_word(address, count, values, registers_jobs[kind].cancel) != 0) {
      modbus_task_cancel(&unit->tasks[kind]);
      registers_set_u16(unit->registers, registers_jobs[kind].cancel, 0);
    }
  }
}

unsigned modbus_unit_write(struct modbus_unit *unit, unsigned address, unsigned count,
                           const uint8_t *values, struct client *client) {
  assert(count <= WRITE_MAX && unit->awaited == NULL);
  unsigned at = 0;
  wire_error error = registers_check(address, count, values, &at);
  struct modbus_task *task = committed_by(unit, address, count, values);
  if (error.status == WIRE_STATUS_OK && task != NULL && modbus_task_busy(task)) {
    error = wire_error_make(WIRE_STATUS_BUSY, "commit", "0, until status is not busy");
    at = registers_jobs[task->kind].commit;
  }
  if (error.status != WIRE_STATUS_OK) {
    return refuse_write(unit, task, &error, at);
  }
  unsigned exception = 0;
  if (task != NULL) {
    exception = commit_task(unit, task, address, count, values, client);
  } else {
    registers_write(unit->registers, address, count, values);
  }
  if (exception == 0) {
    unit->etas = etas_after(unit, address, count, values);
    cancel_tasks(unit, address, count, values);
  }
  return exception;
}

void modbus_unit_refresh(struct modbus_unit *unit, unsigned address, unsigned count) {
  for (unsigned kind = 0; kind < REGISTERS_JOBS; kind++) {
    const unsigned progress = registers_jobs[kind].progress;
    if (progress > 0 && (registers_include(address, count, progress) ||
                         registers_include(address, count, progress + 1))) {
      modbus_task_refresh(&unit->tasks[kind]);
    }
  }
}

/* ---- the client of the worker ---------------------------------------------------------------- */

static struct modbus_units *units_of(struct client *client) {
  return (struct modbus_units *)(void *)client;
}

/* One turn: tasks that run get slices, unit by unit. */
static void run_turn(struct client *client) {
  struct modbus_active *active = &units_of(client)->active;
  const struct modbus_unit *last = TAILQ_LAST(active, modbus_active);
  uint64_t budget = JOB_SLICE_RADII;
  for (struct modbus_unit *unit = NULL; unit != last && budget > 0;) {
    unit = TAILQ_FIRST(active);
    TAILQ_REMOVE(active, unit, in_active);
    TAILQ_INSERT_TAIL(active, unit, in_active);
    const unsigned first = unit->turns++;
    for (unsigned i = 0; i < REGISTERS_JOBS && budget > 0; i++) {
      struct modbus_task *task = &unit->tasks[(first + i) % REGISTERS_JOBS];
      if (modbus_task_runs(task)) {
        budget -= budget < JOB_STEP_RADII ? budget : JOB_STEP_RADII;
        call_on(&task->call, &budget);
      }
    }
  }
  if (budget == 0) {
    worker_run_later(client); /* for the units that come next */
  }
}

/* Notes that the reply to the unit's last commit waits no longer, and lets its master have it. */
static void end_waiting(struct modbus_unit *unit) {
  struct client *master = unit->master;
  unit->awaited = NULL;
  unit->master = NULL;
  if (master != NULL) {
    master->kind->finish(master);
  }
}

/* Ends the waiting for a job that has ended, and for a fit that waits for a profile or takes too long. */
static void check_awaited(struct modbus_unit *unit) {
  const struct modbus_task *task = unit->awaited;
  if (task == NULL || task->call.state == CALL_ENDS) {
    return;
  }
  struct worker *worker = unit->units->client.worker;
  if (!modbus_task_runs(task) || uv_now(&worker->loop) >= unit->reply_ms) {
    end_waiting(unit);
  } else {
    worker_wake_at(worker, unit->reply_ms);
  }
}

static void finish_unit(struct modbus_unit *unit) {
  for (unsigned kind = 0; kind < REGISTERS_JOBS; kind++) {
    modbus_task_finish(&unit->tasks[kind]);
  }
  check_awaited(unit);
  note_busy(unit);
}

static void expire_unit(struct modbus_unit *unit) {
  for (unsigned kind = 0; kind < REGISTERS_JOBS; kind++) {
    modbus_task_expire(&unit->tasks[kind], unit->named_ms);
  }
  check_awaited(unit);
  note_busy(unit);
}

static void for_each_active(struct modbus_units *units, void (*act)(struct modbus_unit *unit)) {
  struct modbus_unit *next;
  for (struct modbus_unit *unit = TAILQ_FIRST(&units->active); unit != NULL; unit = next) {
    next = TAILQ_NEXT(unit, in_active);
    act(unit);
  }
}

/* Called when the batch has been evaluated. */
static void finish_turn(struct client *client) {
  for_each_active(units_of(client), finish_unit);
}

static void check_deadlines(struct client *client) {
  for_each_active(units_of(client), expire_unit);
}

void modbus_units_reset(struct modbus_units *units) {
  for (struct modbus_unit *unit = units->units; unit <= &units->units[MODBUS_UNITS]; unit++) {
    for (unsigned kind = 0; unit->units != NULL && kind < REGISTERS_JOBS; kind++) {
      call_free(&unit->tasks[kind].call);
    }
    unit->units = NULL;
  }
  TAILQ_INIT(&units->active);
}

static void end_after_last_user(struct modbus_units *units) {
  if (units->stopping && units->users == 0) {
    modbus_units_reset(units);
    worker_forget(&units->client);
  }
}

static void stop_client(struct client *client) {
  units_of(client)->stopping = true;
  end_after_last_user(units_of(client));
}

struct modbus_units *modbus_units_new(struct server *server) {
  static const struct client_kind kind = {
      .run = run_turn, .finish = finish_turn, .deadline = check_deadlines, .stop = stop_client};
  struct modbus_units *units = calloc(1, sizeof *units);
  if (units != NULL) {
    units->client.kind = &kind;
    units->server = server;
    TAILQ_INIT(&units->active);
  }
  return units;
}

void modbus_units_leave(struct modbus_units *units, struct client *client) {
  struct modbus_unit *unit;
  cache_move_waiters(units->server->cache, &client->profiles, &units->client.profiles);
  TAILQ_FOREACH(unit, &units->active, in_active) {
    for (unsigned kind = 0; kind < REGISTERS_JOBS; kind++) {
      modbus_task_move(&unit->tasks[kind], client, &units->client);
    }
  }
  units->users--;
  end_after_last_user(units);
}

/* ---- units ----------------------------------------------------------------------------------- */

static void set_up_unit(struct modbus_units *units, struct modbus_unit *unit) {
  memset(unit, 0, sizeof *unit);
  unit->units = units;
  registers_reset(unit->registers);
  for (unsigned kind = 0; kind < REGISTERS_JOBS; kind++) {
    modbus_task_init(&unit->tasks[kind], kind, unit->registers, &units->client,
                     &units->server->buffers);
  }
}

struct modbus_unit *modbus_units_get(struct modbus_units *units, unsigned number) {
  struct modbus_unit *unit = &units->units[number];
  if (unit->units == NULL) {
    set_up_unit(units, unit);
  } else if (unit->awaited != NULL) {
    batch_finish(&units->client.worker->context.batch, &units->server->stats);
    finish_unit(unit);
    if (unit->awaited != NULL) {
      end_waiting(unit);
    }
  }
  unit->named_ms = uv_now(&units->client.worker->loop);
  return unit;
}

void modbus_unit_forget(struct modbus_unit *unit, const struct client *client) {
  if (unit->master == client) {
    unit->master = NULL;
  }
}
