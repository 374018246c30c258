#include "server/modbus/diagnostics.h"

#include <assert.h>
#include <modbus.h>
#include <string.h>

enum sub_function {
  RETURN_QUERY_DATA = 0,
  RESTART_COMMUNICATIONS = 1,
  RETURN_DIAGNOSTIC_REGISTER = 2,
  FORCE_LISTEN_ONLY = 4,
  CLEAR_COUNTERS = 10,
  RETURN_COUNTER_FIRST = 11,
  RETURN_COUNTER_LAST = RETURN_COUNTER_FIRST + MODBUS_COUNTERS - 1,
  CLEAR_OVERRUNS = 20,
};

enum { FIXED_BYTES = 5 }; /* length of a PDU with one word of data */

static unsigned word(const uint8_t *at) {
  return (unsigned)at[0] << 8 | at[1];
}

void modbus_diagnostics_count(struct modbus_diagnostics *diagnostics, const uint8_t *pdu) {
  uint16_t *counters = diagnostics->counters;
  const unsigned exception = pdu[0] >= 0x80 ? pdu[1] : 0;
  counters[MODBUS_COUNTER_EXCEPTIONS] += exception != 0;
  counters[MODBUS_COUNTER_NAKS] += exception == MODBUS_EXCEPTION_NEGATIVE_ACKNOWLEDGE;
  counters[MODBUS_COUNTER_BUSY] += exception == MODBUS_EXCEPTION_SLAVE_OR_SERVER_BUSY;
}

/* Returns whether the data of a request is what its sub-function requires. */
static bool has_right_data(const uint8_t *pdu, size_t bytes) {
  const unsigned sub = word(pdu + 1);
  if (sub == RETURN_QUERY_DATA) {
    return bytes % 2 == 1;
  }
  const unsigned data = bytes == FIXED_BYTES ? word(pdu + 3) : 1;
  return data == 0 || (sub == RESTART_COMMUNICATIONS && data == 0xff00);
}

bool modbus_diagnostics_allows(const struct modbus_diagnostics *diagnostics, const uint8_t *pdu,
                               size_t bytes) {
  return !diagnostics->listen_only ||
         (bytes == FIXED_BYTES && pdu[0] == MODBUS_FC_DIAGNOSTICS &&
          word(pdu + 1) == RESTART_COMMUNICATIONS && has_right_data(pdu, bytes));
}

static bool is_known(unsigned sub) {
  return sub <= RETURN_DIAGNOSTIC_REGISTER || sub == FORCE_LISTEN_ONLY ||
         (sub >= CLEAR_COUNTERS && sub <= RETURN_COUNTER_LAST) || sub == CLEAR_OVERRUNS;
}

static size_t put_exception(unsigned exception, uint8_t *answer) {
  answer[0] = MODBUS_FC_DIAGNOSTICS | 0x80;
  answer[1] = (uint8_t)exception;
  return 2;
}

/* Writes a word as the data of an answer, which is a copy of the request. Returns the length. */
static size_t put_word(uint16_t value, uint8_t *answer) {
  answer[3] = (uint8_t)(value >> 8);
  answer[4] = (uint8_t)value;
  return FIXED_BYTES;
}

size_t modbus_diagnostics_answer(struct modbus_diagnostics *diagnostics, const uint8_t *pdu,
                                 size_t bytes, uint8_t answer[MODBUS_PDU_MAX]) {
  assert(bytes >= 1 && bytes <= MODBUS_PDU_MAX);
  if (bytes < 3) {
    return put_exception(MODBUS_EXCEPTION_ILLEGAL_DATA_VALUE, answer);
  }
  const unsigned sub = word(pdu + 1);
  if (!is_known(sub)) {
    return put_exception(MODBUS_EXCEPTION_ILLEGAL_FUNCTION, answer);
  }
  if (!has_right_data(pdu, bytes)) {
    return put_exception(MODBUS_EXCEPTION_ILLEGAL_DATA_VALUE, answer);
  }
  const bool was_silent = diagnostics->listen_only;
  memcpy(answer, pdu, bytes);
  switch (sub) {
  case RETURN_QUERY_DATA:
    return bytes;
  case RESTART_COMMUNICATIONS:
    *diagnostics = (struct modbus_diagnostics){0};
    return was_silent ? 0 : bytes;
  case RETURN_DIAGNOSTIC_REGISTER:
    return put_word(diagnostics->diagnostic_register, answer);
  case FORCE_LISTEN_ONLY:
    diagnostics->listen_only = true;
    diagnostics->counters[MODBUS_COUNTER_NO_RESPONSES]++;
    return 0;
  case CLEAR_COUNTERS:
    *diagnostics = (struct modbus_diagnostics){0};
    return bytes;
  case CLEAR_OVERRUNS:
    diagnostics->counters[MODBUS_COUNTER_OVERRUNS] = 0;
    return bytes;
  default:
    return put_word(diagnostics->counters[sub - RETURN_COUNTER_FIRST], answer);
  }
}
