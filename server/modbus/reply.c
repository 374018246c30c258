#include "server/modbus/reply.h"

#include <modbus.h>
#include <stdio.h>
#include <string.h>

#include "server/net/worker.h"
#include "server/observe/log.h"

/* ---- statistics ------------------------------------------------------------------------------ */

/* Writes the current statistics into the registers. */
static void refresh_statistics(struct modbus_unit *unit) {
  const struct server *server = unit->units->server;
  const uint64_t up_s = (uv_hrtime() - server->started_ns) / 1000000000;
  registers_set_u32(unit->registers, REGISTERS_AT_UPTIME, (uint32_t)up_s);
#define REGISTERS_STATISTIC(IDENT, address, name, about)                                           \
  registers_set_u32(unit->registers, address, (uint32_t)stats_get(&server->stats, STATS_##IDENT));
#include "proto/registers.def"
}

static bool reads_statistics(const struct modbus_request *request) {
  enum {
#define REGISTERS_BLOCK(id, IDENT, first, length, name, about)                                     \
  FIRST_##IDENT = (first), END_##IDENT = (first) + (length),
#include "proto/registers.def"
  };
  return request->address < END_STATISTICS && request->address + request->count > FIRST_STATISTICS;
}

/* ---- functions: each returns 0 or an exception ----------------------------------------------- */

static unsigned check_bits(const struct modbus_request *request) {
  return request->address + request->count <= REGISTERS_COILS
             ? 0
             : MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS;
}

static unsigned write_bits(struct modbus_unit *unit, const struct modbus_request *request) {
  const unsigned exception = check_bits(request);
  for (unsigned i = 0; exception == 0 && i < request->count; i++) {
    unit->coils[request->address + i] = request->bits[i / 8] >> i % 8 & 1;
  }
  return exception;
}

static unsigned read_registers(struct modbus_unit *unit, const struct modbus_request *request) {
  if (!registers_readable(request->address, request->count)) {
    return MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS;
  }
  if (reads_statistics(request)) {
    refresh_statistics(unit);
  }
  return 0;
}

static unsigned mask_register(struct modbus_unit *unit, const struct modbus_request *request,
                              struct client *client) {
  const unsigned address = request->write_address;
  uint8_t value[2] = {0, 0};
  registers_read(unit->registers, address, address < REGISTERS_END, value);
  const unsigned before = (unsigned)value[0] << 8 | value[1], mask = request->and_mask;
  const unsigned after = (before & mask) | (request->or_mask & ~mask & 0xffff);
  value[0] = (uint8_t)(after >> 8), value[1] = (uint8_t)after;
  return modbus_unit_write(unit, address, 1, value, client);
}

static unsigned write_and_read(struct modbus_unit *unit, const struct modbus_request *request,
                               struct client *client) {
  const unsigned exception = read_registers(unit, request);
  if (exception != 0) {
    const wire_error error =
        wire_error_make(WIRE_STATUS_BAD_ADDRESS, "", "registers that can be read");
    modbus_unit_note_refusal(unit, &error, request->address);
    return exception;
  }
  return modbus_unit_write(unit, request->write_address, request->write_count, request->values,
                           client);
}

static unsigned carry_out(struct modbus_unit *unit, const struct modbus_request *request,
                          struct client *client) {
  switch (request->function) {
  case MODBUS_FC_READ_COILS:
  case MODBUS_FC_READ_DISCRETE_INPUTS:
    return check_bits(request);
  case MODBUS_FC_WRITE_SINGLE_COIL:
  case MODBUS_FC_WRITE_MULTIPLE_COILS:
    return write_bits(unit, request);
  case MODBUS_FC_READ_HOLDING_REGISTERS:
  case MODBUS_FC_READ_INPUT_REGISTERS:
    return read_registers(unit, request);
  case MODBUS_FC_WRITE_SINGLE_REGISTER:
  case MODBUS_FC_WRITE_MULTIPLE_REGISTERS:
    return modbus_unit_write(unit, request->write_address, request->write_count, request->values,
                             client);
  case MODBUS_FC_MASK_WRITE_REGISTER:
    return mask_register(unit, request, client);
  case MODBUS_FC_WRITE_AND_READ_REGISTERS:
    return write_and_read(unit, request, client);
  default:
    return MODBUS_EXCEPTION_ILLEGAL_FUNCTION;
  }
}

/* ---- replies: their lengths ------------------------------------------------------------------ */

static size_t put_exception(unsigned function, unsigned exception, uint8_t *reply) {
  reply[0] = (uint8_t)(function | 0x80);
  reply[1] = (uint8_t)exception;
  return 2;
}

static size_t put_bits(const struct modbus_unit *unit, const struct modbus_request *request,
                       uint8_t *reply) {
  const unsigned bytes = (request->count + 7) / 8;
  reply[0] = (uint8_t)request->function;
  reply[1] = (uint8_t)bytes;
  memset(reply + 2, 0, bytes);
  for (unsigned i = 0; i < request->count; i++) {
    reply[2 + i / 8] |= (uint8_t)(unit->coils[request->address + i] << i % 8);
  }
  return 2 + bytes;
}

static size_t put_registers(struct modbus_unit *unit, const struct modbus_request *request,
                            uint8_t *reply) {
  modbus_unit_refresh(unit, request->address, request->count);
  reply[0] = (uint8_t)request->function;
  reply[1] = (uint8_t)(2 * request->count);
  registers_read(unit->registers, request->address, request->count, reply + 2);
  return 2 + 2 * (size_t)request->count;
}

/* Writes the reply to a valid request. The reply to a write repeats the start of the request. */
static size_t put_result(struct modbus_unit *unit, const struct modbus_request *request,
                         const uint8_t *pdu, uint8_t *reply) {
  switch (request->function) {
  case MODBUS_FC_READ_COILS:
  case MODBUS_FC_READ_DISCRETE_INPUTS:
    return put_bits(unit, request, reply);
  case MODBUS_FC_READ_HOLDING_REGISTERS:
  case MODBUS_FC_READ_INPUT_REGISTERS:
  case MODBUS_FC_WRITE_AND_READ_REGISTERS:
    return put_registers(unit, request, reply);
  default: {
    const size_t bytes = request->function == MODBUS_FC_MASK_WRITE_REGISTER ? 7 : 5;
    memcpy(reply, pdu, bytes);
    return bytes;
  }
  }
}

/* ---- public ---------------------------------------------------------------------------------- */

static void count_reply(const struct modbus_units *units, const uint8_t *reply, size_t bytes) {
  struct worker *worker = units->client.worker;
  const bool refused = bytes > 0 && reply[0] >= 0x80;
  stats_add(&units->server->stats, refused ? STATS_MODBUS_EXCEPTIONS : STATS_MODBUS_TRANSACTIONS,
            1);
  latency_note(worker->context.latency,
               refused      ? LATENCY_REFUSED
               : bytes == 0 ? LATENCY_EVAL_SHORT
                            : LATENCY_OTHER,
               worker_round_ns(worker));
}

static size_t handle_at_unit(struct modbus_unit *unit, struct client *client, const uint8_t *pdu,
                             const struct modbus_request *request, uint8_t *reply) {
  const unsigned exception = carry_out(unit, request, client);
  if (exception != 0) {
    return put_exception(pdu[0], exception, reply);
  }
  return unit->awaited != NULL ? 0 : put_result(unit, request, pdu, reply);
}

static size_t handle_request(struct modbus_units *units, struct client *client, unsigned roles,
                             unsigned number, const uint8_t *pdu, size_t bytes, uint8_t *reply,
                             struct modbus_unit **waits_for) {
  struct modbus_request request;
  unsigned exception = modbus_pdu_parse(pdu, bytes, &request);
  if (number == 0) {
    exception = MODBUS_EXCEPTION_GATEWAY_TARGET;
  } else if ((modbus_pdu_roles(pdu[0]) & ~roles) != 0) {
    exception = MODBUS_EXCEPTION_ILLEGAL_FUNCTION;
  }
  size_t length = 0;
  if (exception == 0 && pdu[0] == MODBUS_FC_READ_DEVICE_ID) {
    length = modbus_identity_read(pdu, reply, &exception);
  }
  if (exception != 0) {
    return put_exception(pdu[0], exception, reply);
  }
  if (length > 0) {
    return length;
  }
  if (pdu[0] == MODBUS_FC_REPORT_SLAVE_ID) {
    return modbus_identity_report(number, reply);
  }
  *waits_for = modbus_units_get(units, number);
  return handle_at_unit(*waits_for, client, pdu, &request, reply);
}

size_t modbus_carry_out(struct modbus_units *units, struct client *client, unsigned roles,
                        unsigned number, const uint8_t *pdu, size_t bytes,
                        uint8_t reply[MODBUS_PDU_MAX], struct modbus_unit **waits_for) {
  const size_t length = handle_request(units, client, roles, number, pdu, bytes, reply, waits_for);
  count_reply(units, reply, length);
  return length;
}

size_t modbus_late_reply(struct modbus_unit *unit, const uint8_t *pdu, size_t bytes,
                         uint8_t reply[MODBUS_PDU_MAX]) {
  struct modbus_request request;
  modbus_pdu_parse(pdu, bytes, &request);
  return put_result(unit, &request, pdu, reply);
}

void modbus_log_refusal(const uint8_t *pdu, size_t bytes, const uint8_t *reply, unsigned number,
                        const char *key, const char *from) {
  if (reply[0] < 0x80) { /* no exception */
    return;
  }
  char address[8] = "-"; /* the first register or bit that the request names */
  if (bytes >= 3 && pdu[0] != MODBUS_FC_READ_DEVICE_ID) {
    snprintf(address, sizeof address, "%u", (unsigned)pdu[1] << 8 | pdu[2]);
  }
  log_peer_line(LOG_LEVEL_INFO,
                "event=modbus-request-refused function=%u exception=%u address=%s unit=%u %s=%s",
                pdu[0], reply[1], address, number, key, from);
}
