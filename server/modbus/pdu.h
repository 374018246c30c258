/* pdu: Modbus requests, taken apart and checked before the codec sees them, which reads past what
 * is too short and sleeps over what is out of range. No sockets, no registers.
 */
#ifndef DIPOLED_MODBUS_PDU_H
#define DIPOLED_MODBUS_PDU_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
  MODBUS_PDU_MAX = 253,
  MODBUS_FC_READ_DEVICE_ID = 0x2b, /* which the codec does not have */
};

/* A request that has the right shape. Addresses are not checked. */
struct modbus_request {
  unsigned function;
  unsigned address; /* of what is read; of the bits that are written, and of nothing else */
  unsigned count;
  unsigned write_address; /* of the registers that are written */
  unsigned write_count;   /* 0: none are */
  const uint8_t *values;  /* of those, in the PDU */
  unsigned and_mask;      /* function 22 */
  unsigned or_mask;
};

/* 0: *request is what a PDU (at least 1 byte, which is less than 0x80) asks for; else the exception
 * that it gets. */
unsigned modbus_pdu_parse(const uint8_t *pdu, size_t bytes, struct modbus_request *request);

/* How long the PDU is that begins with these bytes; 0: they do not say, or the function is unknown.
 */
size_t modbus_pdu_bytes(const uint8_t *pdu, size_t bytes);

/* Whether a function changes anything. */
bool modbus_pdu_writes(unsigned function);

#endif
