#include "server/modbus/answer.h"

#include "server/modbus/identity.h"
#include "server/modbus/service.h"
#include "server/net/worker.h"

/* ---- statistics -------------------------------------------------------------------------------
 */

/* Puts them in place for who reads them. */
static void refresh_statistics(const struct server *server, uint16_t image[REGISTERS_END]) {
  const uint64_t up_s = (uv_hrtime() - server->started_ns) / 1000000000;
  registers_set_u32(image, REGISTERS_AT_UPTIME, (uint32_t)up_s);
#define REGISTERS_STATISTIC(IDENT, address, name, about)                                           \
  registers_set_u32(image, address, (uint32_t)stats_get(&server->stats, STATS_##IDENT));
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

/* ---- functions --------------------------------------------------------------------------------
 */

static unsigned use_bits(const struct modbus_request *request) {
  return request->address + request->count <= REGISTERS_COILS
             ? 0
             : MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS;
}

static unsigned read_registers(struct modbus_service *service, struct modbus_bank *bank,
                               const struct modbus_request *request) {
  if (!registers_readable(request->address, request->count)) {
    return MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS;
  }
  if (reads_statistics(request)) {
    refresh_statistics(service->server, bank->image);
  }
  return 0;
}

/* Writing with a mask, as libmodbus does once more when it answers: twice is as good as once. */
static unsigned mask_register(struct modbus_bank *bank, const struct modbus_request *request,
                              struct modbus_client *client) {
  const unsigned address = request->write_address;
  const unsigned before = address < REGISTERS_END ? bank->image[address] : 0;
  const unsigned after =
      (before & request->and_mask) | (request->or_mask & ~request->and_mask & 0xffff);
  const uint8_t value[] = {(uint8_t)(after >> 8), (uint8_t)after};
  return modbus_bank_write(bank, address, 1, value, client);
}

static unsigned write_and_read(struct modbus_service *service, struct modbus_bank *bank,
                               const struct modbus_request *request, struct modbus_client *client) {
  const unsigned exception = read_registers(service, bank, request);
  if (exception != 0) {
    const wire_error error =
        wire_error_make(WIRE_STATUS_BAD_ADDRESS, "", "registers that can be read");
    modbus_bank_note_refusal(bank, &error, request->address);
    return exception;
  }
  return modbus_bank_write(bank, request->write_address, request->write_count, request->values,
                           client);
}

static unsigned carry_out(struct modbus_service *service, struct modbus_bank *bank,
                          const struct modbus_request *request, struct modbus_client *client) {
  switch (request->function) {
  case MODBUS_FC_READ_COILS:
  case MODBUS_FC_READ_DISCRETE_INPUTS:
  case MODBUS_FC_WRITE_SINGLE_COIL:
  case MODBUS_FC_WRITE_MULTIPLE_COILS:
    return use_bits(request);
  case MODBUS_FC_READ_HOLDING_REGISTERS:
  case MODBUS_FC_READ_INPUT_REGISTERS:
    return read_registers(service, bank, request);
  case MODBUS_FC_WRITE_SINGLE_REGISTER:
  case MODBUS_FC_WRITE_MULTIPLE_REGISTERS:
    return modbus_bank_write(bank, request->write_address, request->write_count, request->values,
                             client);
  case MODBUS_FC_MASK_WRITE_REGISTER:
    return mask_register(bank, request, client);
  case MODBUS_FC_WRITE_AND_READ_REGISTERS:
    return write_and_read(service, bank, request, client);
  default:
    return MODBUS_EXCEPTION_ILLEGAL_FUNCTION;
  }
}

/* ---- public -----------------------------------------------------------------------------------
 */

static void answer_unit(struct modbus_service *service, struct modbus_client *client, unsigned unit,
                        const uint8_t *pdu, const struct modbus_request *request,
                        struct modbus_answer *answer) {
  switch (request->function) {
  case MODBUS_FC_REPORT_SLAVE_ID:
    answer->bytes = modbus_identity_report(unit, answer->pdu);
    return;
  case MODBUS_FC_READ_DEVICE_ID:
    answer->bytes = modbus_identity_read(pdu, answer->pdu, &answer->exception);
    return;
  default:
    answer->bank = modbus_service_bank(service, unit);
    answer->exception = carry_out(service, answer->bank, request, client);
    answer->later = answer->bank->evaluating;
  }
}

static void count(struct modbus_service *service, const struct modbus_answer *answer) {
  struct stats *stats = &service->server->stats;
  struct latency *latency = worker_context(service->worker)->latency;
  const bool refused = answer->exception != 0;
  stats_add(stats, refused ? STATS_MODBUS_EXCEPTIONS : STATS_MODBUS_TRANSACTIONS, 1);
  latency_note(latency,
               refused         ? LATENCY_REFUSED
               : answer->later ? LATENCY_EVAL_SHORT
                               : LATENCY_OTHER,
               worker_round_ns(service->worker));
}

void modbus_answer(struct modbus_service *service, struct modbus_client *client, unsigned unit,
                   const uint8_t *pdu, size_t bytes, struct modbus_answer *answer) {
  struct modbus_request request;
  answer->bank = NULL; /* not the PDU, which is large and hardly ever used */
  answer->later = false;
  answer->bytes = 0;
  answer->exception = modbus_pdu_parse(pdu, bytes, &request);
  if (unit == 0) {
    answer->exception = MODBUS_EXCEPTION_GATEWAY_TARGET;
  } else if (service->server->options.modbus_read_only && modbus_pdu_writes(pdu[0])) {
    answer->exception = MODBUS_EXCEPTION_ILLEGAL_FUNCTION;
  } else if (answer->exception == 0) {
    answer_unit(service, client, unit, pdu, &request, answer);
  }
  count(service, answer);
}
