#include "server/modbus/pdu.h"

#include <modbus.h>

static unsigned word(const uint8_t *at) {
  return (unsigned)at[0] << 8 | at[1];
}

/* What is known of a function's requests. */
static const struct function {
  uint8_t number;
  uint8_t bytes;  /* of the PDU, without the values that are written */
  uint8_t values; /* where the PDU says how many bytes of values follow; 0: none do */
  bool writes;
} functions[] = {
    {MODBUS_FC_READ_COILS, 5, 0, false},
    {MODBUS_FC_READ_DISCRETE_INPUTS, 5, 0, false},
    {MODBUS_FC_READ_HOLDING_REGISTERS, 5, 0, false},
    {MODBUS_FC_READ_INPUT_REGISTERS, 5, 0, false},
    {MODBUS_FC_WRITE_SINGLE_COIL, 5, 0, true},
    {MODBUS_FC_WRITE_SINGLE_REGISTER, 5, 0, true},
    {MODBUS_FC_WRITE_MULTIPLE_COILS, 6, 5, true},
    {MODBUS_FC_WRITE_MULTIPLE_REGISTERS, 6, 5, true},
    {MODBUS_FC_REPORT_SLAVE_ID, 1, 0, false},
    {MODBUS_FC_MASK_WRITE_REGISTER, 7, 0, true},
    {MODBUS_FC_WRITE_AND_READ_REGISTERS, 10, 9, true},
    {MODBUS_FC_READ_DEVICE_ID, 4, 0, false},
};

/* NULL: the function is unknown. */
static const struct function *find(unsigned number) {
  for (size_t i = 0; i < sizeof functions / sizeof functions[0]; i++) {
    if (functions[i].number == number) {
      return &functions[i];
    }
  }
  return NULL;
}

size_t modbus_pdu_bytes(const uint8_t *pdu, size_t bytes) {
  const struct function *function = bytes > 0 ? find(pdu[0]) : NULL;
  if (function == NULL || bytes <= function->values) {
    return 0;
  }
  return function->bytes + (function->values > 0 ? (size_t)pdu[function->values] : 0);
}

bool modbus_pdu_writes(unsigned number) {
  const struct function *function = find(number);
  return function != NULL && function->writes;
}

static bool within(unsigned count, unsigned most) {
  return count >= 1 && count <= most;
}

/* Reads the rest of a PDU whose length is right; false: a count or value is wrong. */
static bool take_counts(const uint8_t *pdu, struct modbus_request *request) {
  switch (request->function) {
  case MODBUS_FC_READ_COILS:
  case MODBUS_FC_READ_DISCRETE_INPUTS:
    request->count = word(pdu + 3);
    return within(request->count, MODBUS_MAX_READ_BITS);
  case MODBUS_FC_READ_HOLDING_REGISTERS:
  case MODBUS_FC_READ_INPUT_REGISTERS:
    request->count = word(pdu + 3);
    return within(request->count, MODBUS_MAX_READ_REGISTERS);
  case MODBUS_FC_WRITE_SINGLE_COIL:
    request->count = 1;
    request->bits = pdu + 3;
    return word(pdu + 3) == 0 || word(pdu + 3) == 0xff00;
  case MODBUS_FC_WRITE_MULTIPLE_COILS:
    request->count = word(pdu + 3);
    request->bits = pdu + 6;
    return within(request->count, MODBUS_MAX_WRITE_BITS) && pdu[5] == (request->count + 7) / 8;
  case MODBUS_FC_WRITE_SINGLE_REGISTER:
    request->write_count = 1;
    request->values = pdu + 3;
    return true;
  case MODBUS_FC_WRITE_MULTIPLE_REGISTERS:
    request->write_count = word(pdu + 3);
    request->values = pdu + 6;
    return within(request->write_count, MODBUS_MAX_WRITE_REGISTERS) &&
           pdu[5] == 2 * request->write_count;
  case MODBUS_FC_MASK_WRITE_REGISTER:
    request->write_count = 1;
    request->and_mask = word(pdu + 3);
    request->or_mask = word(pdu + 5);
    return true;
  case MODBUS_FC_WRITE_AND_READ_REGISTERS:
    request->count = word(pdu + 3);
    request->write_address = word(pdu + 5);
    request->write_count = word(pdu + 7);
    request->values = pdu + 10;
    return within(request->count, MODBUS_MAX_WR_READ_REGISTERS) &&
           within(request->write_count, MODBUS_MAX_WR_WRITE_REGISTERS) &&
           pdu[9] == 2 * request->write_count;
  default:
    return true;
  }
}

unsigned modbus_pdu_parse(const uint8_t *pdu, size_t bytes, struct modbus_request *request) {
  *request = (struct modbus_request){.function = pdu[0]};
  if (find(request->function) == NULL ||
      (request->function == MODBUS_FC_READ_DEVICE_ID && bytes > 1 && pdu[1] != 0x0e)) {
    return MODBUS_EXCEPTION_ILLEGAL_FUNCTION;
  }
  if (bytes != modbus_pdu_bytes(pdu, bytes)) {
    return MODBUS_EXCEPTION_ILLEGAL_DATA_VALUE;
  }
  if (bytes >= 3) {
    request->address = request->write_address = word(pdu + 1);
  }
  return take_counts(pdu, request) ? 0 : MODBUS_EXCEPTION_ILLEGAL_DATA_VALUE;
}
