/* pdu: takes Modbus requests apart and checks their shape. It knows neither sockets nor registers.
 */
#ifndef DIPOLED_MODBUS_PDU_H
#define DIPOLED_MODBUS_PDU_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
  MODBUS_PDU_MAX = 253,
  MODBUS_FC_READ_DEVICE_ID = 0x2b, /* modbus.h does not have it */
};

/* A request of the right shape. Its addresses have not been checked. */
struct modbus_request {
  unsigned function;
  unsigned address; /* of the registers that are read, or of the bits that are read or written */
  unsigned count;
  const uint8_t *bits;    /* the bits that are written, in the PDU, lowest bit first */
  unsigned write_address; /* of the registers that are written */
  unsigned write_count;   /* 0: no registers are written */
  const uint8_t *values;  /* of those registers, in the PDU */
  unsigned and_mask;      /* function 22 */
  unsigned or_mask;
};

/* Takes a PDU apart; it has at least 1 byte, which is less than 0x80. Returns 0, or the exception
 * that the request gets. */
unsigned modbus_pdu_parse(const uint8_t *pdu, size_t bytes, struct modbus_request *request);

/* The length of the request's PDU that begins with these bytes. 0: there are too few bytes to tell,
 * or the function is unknown. */
size_t modbus_pdu_bytes(const uint8_t *pdu, size_t bytes);

/* Whether the function of a number changes anything. */
bool modbus_pdu_writes(unsigned number);

#endif
