#include "server/modbus/bank.h"

#include <assert.h>
#include <string.h>

#include "server/net/worker.h"

/* ---- beginning and end ------------------------------------------------------------------------
 */

static void on_profile(void *context);

static struct server *server_of(const struct modbus_bank *bank) {
  return bank->worker->server;
}

void modbus_bank_start(struct modbus_bank *bank, struct worker *worker,
                       struct modbus_banks_done *done) {
  bank->worker = worker;
  bank->done = done;
  bank->mapping = (modbus_mapping_t){
      .nb_bits = REGISTERS_COILS,
      .nb_input_bits = REGISTERS_COILS,
      .nb_input_registers = REGISTERS_END,
      .nb_registers = REGISTERS_END,
      .tab_bits = bank->coils,
      .tab_input_bits = bank->coils,
      .tab_input_registers = bank->image,
      .tab_registers = bank->image,
  };
  registers_reset(bank->image);
}

void modbus_bank_end(struct modbus_bank *bank) {
  job_end(bank->job);
  bank->busy = false;
}

void modbus_bank_forget(struct modbus_bank *bank, const struct modbus_client *client) {
  if (bank->client == client) {
    bank->client = NULL;
  }
}

/* ---- what the registers say of a job ----------------------------------------------------------
 */

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

static void set_error(struct modbus_bank *bank, unsigned status, unsigned at, const char *text) {
  registers_set_u16(bank->image, REGISTERS_AT_ERROR, status);
  registers_set_u16(bank->image, REGISTERS_AT_ERROR_ADDRESS, at);
  registers_set_text(bank->image, REGISTERS_AT_ERROR_TEXT, REGISTERS_ERROR_TEXT_BYTES / 2, text);
}

void modbus_bank_note_refusal(struct modbus_bank *bank, const wire_error *error, unsigned at) {
  set_error(bank, error->status, at, error->allowed);
}

/* A commit that has come to nothing. */
static void fail(struct modbus_bank *bank, const wire_error *error, unsigned at) {
  registers_set_u16(bank->image, REGISTERS_AT_STATUS, REGISTERS_STATUS_ERROR);
  modbus_bank_note_refusal(bank, error, at);
}

static void fail_job(struct modbus_bank *bank, const wire_error *error) {
  fail(bank, error, registers_of_field(error->field, error->index));
}

void modbus_bank_finish(struct modbus_bank *bank) {
  struct modbus_client *client = bank->client;
  bank->evaluating = false;
  bank->client = NULL;
  modbus_translate_reply(bank->question, bank->reply, bank->image);
  const unsigned sequence = registers_u16(bank->image, REGISTERS_AT_SEQUENCE);
  registers_set_u16(bank->image, REGISTERS_AT_STATUS, REGISTERS_STATUS_DONE);
  registers_set_u16(bank->image, REGISTERS_AT_DONE, bank->token);
  registers_set_u16(bank->image, REGISTERS_AT_SEQUENCE, sequence + 1);
  if (registers_u16(bank->image, REGISTERS_AT_ERROR) != WIRE_STATUS_OK) {
    set_error(bank, WIRE_STATUS_OK, 0, "");
  }
  stats_add(&server_of(bank)->stats, STATS_MODBUS_EVALUATIONS, 1);
  if (client != NULL) {
    client->answer(client);
  }
}

/* ---- the job ----------------------------------------------------------------------------------
 */

static void is_evaluating(struct modbus_bank *bank) {
  bank->evaluating = true;
  bank->next_done = bank->done->first;
  bank->done->first = bank;
}

/* Goes on with the job until its values are in the batch, or it waits, or it has been refused. Its
 * 50 radii at most are no more than a slice, and their reply is one part. */
static wire_error follow(struct modbus_bank *bank, enum job_outcome outcome) {
  struct job *job = bank->job;
  while (outcome == JOB_GOES_ON || outcome == JOB_NEXT_PART) {
    uint64_t budget = JOB_SLICE_RADII;
    assert(outcome == JOB_GOES_ON || job->part_bytes <= MODBUS_REPLY_BYTES);
    outcome = outcome == JOB_GOES_ON ? job->kind->step(job, &budget)
                                     : job->kind->begin_part(job, bank->reply);
  }
  bank->busy = outcome == JOB_WAITS;
  if (!bank->busy) {
    job_end(job);
  }
  if (outcome == JOB_DONE) {
    is_evaluating(bank);
  }
  return outcome == JOB_REFUSED ? job->refusal : wire_error_none();
}

/* What it waited for is there. */
static void on_profile(void *context) {
  struct modbus_bank *bank = context;
  const wire_error error = follow(bank, JOB_GOES_ON);
  if (error.status != WIRE_STATUS_OK) {
    fail_job(bank, &error);
  }
}

static wire_error evaluate(struct modbus_bank *bank) {
  const wire_header header = {
      .type = WIRE_TYPE_EVAL,
      .payload_bytes = (uint32_t)modbus_translate_input(bank->image, bank->question),
  };
  const struct job_request request = {.header = &header,
                                      .payload = bank->question,
                                      .context = worker_context(bank->worker),
                                      .on_ready = on_profile,
                                      .owner = bank};
  const enum job_outcome outcome = job_start(&bank->slot, &request, &bank->job);
  return outcome == JOB_REFUSED ? bank->job->refusal : follow(bank, outcome);
}

/* ---- writing ----------------------------------------------------------------------------------
 */

enum { WRITE_MAX = 123 }; /* registers in one request */

/* The token that a write commits with; 0: it does not. */
static uint16_t token_of(unsigned address, unsigned count, const uint8_t *values) {
  if (!registers_include(address, count, REGISTERS_AT_COMMIT)) {
    return 0;
  }
  const unsigned at = REGISTERS_AT_COMMIT - address < count
                          ? REGISTERS_AT_COMMIT - address
                          : REGISTERS_AT_COMMIT + REGISTERS_MIRROR - address;
  return (uint16_t)(values[2 * at] << 8 | values[2 * at + 1]);
}

/* Writes the input and starts the job; if that cannot be done, the input is what it was. */
static unsigned commit(struct modbus_bank *bank, unsigned address, unsigned count,
                       const uint8_t *values, struct modbus_client *client) {
  uint8_t before[2 * WRITE_MAX];
  for (unsigned i = 0; i < count; i++) {
    before[2 * i] = (uint8_t)(bank->image[address + i] >> 8);
    before[2 * i + 1] = (uint8_t)bank->image[address + i];
  }
  registers_write(bank->image, address, count, values);
  const wire_error error = evaluate(bank);
  if (error.status != WIRE_STATUS_OK) {
    registers_write(bank->image, address, count, before);
    fail_job(bank, &error);
    return exception_of(error.status);
  }
  bank->token = registers_u16(bank->image, REGISTERS_AT_COMMIT);
  bank->client = bank->evaluating ? client : NULL;
  if (bank->busy) {
    registers_set_u16(bank->image, REGISTERS_AT_STATUS, REGISTERS_STATUS_BUSY);
  }
  return 0;
}

unsigned modbus_bank_write(struct modbus_bank *bank, unsigned address, unsigned count,
                           const uint8_t *values, struct modbus_client *client) {
  assert(count <= WRITE_MAX && !bank->evaluating);
  unsigned at = 0;
  wire_error error = registers_check(address, count, values, &at);
  const bool commits = token_of(address, count, values) != 0;
  if (error.status == WIRE_STATUS_OK && commits && bank->busy) {
    error = wire_error_make(WIRE_STATUS_BUSY, "commit", "0, until status is not busy");
    at = REGISTERS_AT_COMMIT;
  }
  if (error.status != WIRE_STATUS_OK) {
    if (commits && !bank->busy) {
      fail(bank, &error, at);
    } else {
      modbus_bank_note_refusal(bank, &error, at);
    }
    return exception_of(error.status);
  }
  if (commits) {
    return commit(bank, address, count, values, client);
  }
  registers_write(bank->image, address, count, values);
  return 0;
}
