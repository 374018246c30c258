#include "server/modbus/unit.h"

#include <assert.h>
#include <modbus.h>
#include <stdlib.h>

#include "server/net/worker.h"

static struct server *server_of(const struct modbus_unit *unit) {
  return unit->units->server;
}

/* ---- what the registers say of a job --------------------------------------------------------- */

static unsigned exception_of(enum wire_status status) {
  switch (status) {
#define WIRE_STATUS(code, IDENT, modbus_exception, name, text)                                     \
  case code:                                                                                       \
    return modbus_exception;
#include "proto/statuses.def"
#undef WIRE_STATUS
  }
  return MODBUS_EXCEPTION_SLAVE_OR_SERVER_FAILURE;
}

static void set_error(struct modbus_unit *unit, unsigned status, unsigned at, const char *text) {
  registers_set_u16(unit->registers, REGISTERS_AT_ERROR, status);
  registers_set_u16(unit->registers, REGISTERS_AT_ERROR_ADDRESS, at);
  registers_set_text(unit->registers, REGISTERS_AT_ERROR_TEXT, REGISTERS_ERROR_TEXT_BYTES / 2,
                     text);
}

static void clear_error(struct modbus_unit *unit) {
  if (registers_u16(unit->registers, REGISTERS_AT_ERROR) != WIRE_STATUS_OK) {
    set_error(unit, WIRE_STATUS_OK, 0, "");
  }
}

void modbus_unit_note_refusal(struct modbus_unit *unit, const wire_error *error, unsigned at) {
  set_error(unit, error->status, at, error->allowed);
}

/* Writes the error of a failed commit into the registers. */
static void fail(struct modbus_unit *unit, const wire_error *error, unsigned at) {
  registers_set_u16(unit->registers, REGISTERS_AT_STATUS, REGISTERS_STATUS_ERROR);
  modbus_unit_note_refusal(unit, error, at);
}

static void fail_job(struct modbus_unit *unit, const wire_error *error) {
  fail(unit, error, registers_of_field(error->field, error->index));
}

/* Writes the results into the registers and lets the client answer. */
static void finish_job(struct modbus_unit *unit) {
  struct client *client = unit->client;
  unit->evaluating = false;
  unit->client = NULL;
  modbus_translate_reply(unit->question, unit->reply, unit->registers);
  const unsigned sequence = registers_u16(unit->registers, REGISTERS_AT_SEQUENCE);
  registers_set_u16(unit->registers, REGISTERS_AT_STATUS, REGISTERS_STATUS_DONE);
  registers_set_u16(unit->registers, REGISTERS_AT_DONE, unit->token);
  registers_set_u16(unit->registers, REGISTERS_AT_SEQUENCE, sequence + 1);
  clear_error(unit);
  stats_add(&server_of(unit)->stats, STATS_MODBUS_EVALUATIONS, 1);
  if (client != NULL) {
    client->kind->finish(client);
  }
}

/* ---- the job --------------------------------------------------------------------------------- */

/* Notes that the job's values are in the batch. */
static void note_evaluating(struct modbus_unit *unit) {
  unit->evaluating = true;
  unit->next_evaluating = unit->units->evaluating;
  unit->units->evaluating = unit;
  worker_finish_later(&unit->units->client);
}

/* Runs the job until its values are in the batch, it waits for its profile, or it is refused. A job
 * has at most 50 radii, so it needs one slice only, and its reply is one part. */
static wire_error follow(struct modbus_unit *unit, enum job_outcome outcome) {
  struct job *job = unit->job;
  while (outcome == JOB_GOES_ON || outcome == JOB_NEXT_PART) {
    uint64_t budget = JOB_SLICE_RADII;
    assert(outcome == JOB_GOES_ON || job->part_bytes <= MODBUS_REPLY_BYTES);
    outcome = outcome == JOB_GOES_ON ? job->kind->step(job, &budget)
                                     : job->kind->begin_part(job, unit->reply);
  }
  unit->busy = outcome == JOB_WAITS;
  if (!unit->busy) {
    job_end(job);
  }
  if (outcome == JOB_DONE) {
    note_evaluating(unit);
  }
  return outcome == JOB_REFUSED ? job->refusal : wire_error_none();
}

/* Goes on with a job whose profile has been prepared. */
static void on_profile(void *context) {
  struct modbus_unit *unit = context;
  const wire_error error = follow(unit, JOB_GOES_ON);
  if (error.status != WIRE_STATUS_OK) {
    fail_job(unit, &error);
  }
}

static wire_error evaluate(struct modbus_unit *unit, struct client *client) {
  const wire_header header = {
      .type = WIRE_TYPE_EVAL,
      .payload_bytes = (uint32_t)modbus_translate_input(unit->registers, unit->question),
  };
  const struct job_request request = {
      .header = &header,
      .payload = unit->question,
      .context = worker_context(unit->units->client.worker),
      .on_ready = on_profile,
      .owner = unit,
      .profiles = &client->profiles,
  };
  const enum job_outcome outcome = job_start(&unit->slot, &request, &unit->job);
  return outcome == JOB_REFUSED ? unit->job->refusal : follow(unit, outcome);
}

/* ---- writing --------------------------------------------------------------------------------- */

enum { WRITE_MAX = 123 }; /* registers in one request: the limit of Modbus */

/* Returns the value that a write gives to the register `commit`; 0 if it does not write there. */
static uint16_t token_of(unsigned address, unsigned count, const uint8_t *values) {
  if (!registers_include(address, count, REGISTERS_AT_COMMIT)) {
    return 0;
  }
  const unsigned at = REGISTERS_AT_COMMIT - address < count
                          ? REGISTERS_AT_COMMIT - address
                          : REGISTERS_AT_COMMIT + REGISTERS_MIRROR - address;
  return (uint16_t)(values[2 * at] << 8 | values[2 * at + 1]);
}

/* Writes the registers and starts the job. If the job cannot be started, restores the registers. */
static unsigned commit(struct modbus_unit *unit, unsigned address, unsigned count,
                       const uint8_t *values, struct client *client) {
  uint8_t before[2 * WRITE_MAX];
  for (unsigned i = 0; i < count; i++) {
    before[2 * i] = (uint8_t)(unit->registers[address + i] >> 8);
    before[2 * i + 1] = (uint8_t)unit->registers[address + i];
  }
  registers_write(unit->registers, address, count, values);
  const wire_error error = evaluate(unit, client);
  if (error.status != WIRE_STATUS_OK) {
    registers_write(unit->registers, address, count, before);
    fail_job(unit, &error);
    return exception_of(error.status);
  }
  clear_error(unit);
  unit->token = registers_u16(unit->registers, REGISTERS_AT_COMMIT);
  unit->client = unit->evaluating ? client : NULL;
  if (unit->busy) {
    registers_set_u16(unit->registers, REGISTERS_AT_STATUS, REGISTERS_STATUS_BUSY);
  }
  return 0;
}

unsigned modbus_unit_write(struct modbus_unit *unit, unsigned address, unsigned count,
                           const uint8_t *values, struct client *client) {
  assert(count <= WRITE_MAX && !unit->evaluating);
  unsigned at = 0;
  wire_error error = registers_check(address, count, values, &at);
  const bool commits = token_of(address, count, values) != 0;
  if (error.status == WIRE_STATUS_OK && commits && unit->busy) {
    error = wire_error_make(WIRE_STATUS_BUSY, "commit", "0, until status is not busy");
    at = REGISTERS_AT_COMMIT;
  }
  if (error.status != WIRE_STATUS_OK) {
    if (commits && !unit->busy) {
      fail(unit, &error, at);
    } else {
      modbus_unit_note_refusal(unit, &error, at);
    }
    return exception_of(error.status);
  }
  if (commits) {
    return commit(unit, address, count, values, client);
  }
  registers_write(unit->registers, address, count, values);
  return 0;
}

/* ---- all units ------------------------------------------------------------------------------- */

static struct modbus_units *units_of(struct client *client) {
  return (struct modbus_units *)(void *)client;
}

static void start(struct client *client) {
  (void)client; /* There is nothing to do: the first request to a unit sets up its registers. */
}

/* Called when the batch has been evaluated: writes the results of all units that were in it. */
static void finish(struct client *client) {
  struct modbus_units *units = units_of(client);
  while (units->evaluating != NULL) {
    struct modbus_unit *unit = units->evaluating;
    units->evaluating = unit->next_evaluating;
    finish_job(unit);
  }
}

static void end_after_last_user(struct modbus_units *units) {
  if (!units->stopping || units->users > 0) {
    return;
  }
  for (unsigned number = 1; number <= MODBUS_UNITS; number++) {
    if (units->units[number].busy) {
      job_end(units->units[number].job);
    }
  }
  worker_forget(&units->client);
}

static void stop(struct client *client) {
  struct modbus_units *units = units_of(client);
  units->stopping = true;
  end_after_last_user(units);
}

static void abort_units(struct client *client) {
  (void)client; /* There is nothing to do: the units end with the last connection or line. */
}

struct modbus_units *modbus_units_new(struct server *server) {
  static const struct client_kind kind = {
      .start = start,
      .run = start,
      .finish = finish,
      .stop = stop,
      .abort = abort_units,
  };
  struct modbus_units *units = calloc(1, sizeof *units);
  if (units != NULL) {
    units->client.kind = &kind;
    units->server = server;
  }
  return units;
}

void modbus_units_join(struct modbus_units *units) {
  units->users++;
}

void modbus_units_leave(struct modbus_units *units, struct client *client) {
  cache_move_waiters(units->server->cache, &client->profiles, &units->client.profiles);
  units->users--;
  end_after_last_user(units);
}

struct modbus_unit *modbus_units_get(struct modbus_units *units, unsigned number) {
  struct modbus_unit *unit = &units->units[number];
  if (unit->units == NULL) {
    unit->units = units;
    registers_reset(unit->registers);
  } else if (unit->evaluating) {
    batch_finish(&worker_context(units->client.worker)->batch, &units->server->stats);
    finish(&units->client);
  }
  return unit;
}

void modbus_unit_forget(struct modbus_unit *unit, const struct client *client) {
  if (unit->client == client) {
    unit->client = NULL;
  }
}
