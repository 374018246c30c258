/* codec: the bytes of Modbus: requests, frames of serial lines, and the functions that identify the
 * daemon. It checks the shape of requests, and knows neither sockets nor registers.
 */
#ifndef DIPOLED_MODBUS_CODEC_H
#define DIPOLED_MODBUS_CODEC_H

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

/* Returns whether the function of a number changes anything. */
bool modbus_pdu_writes(unsigned number);

/* ---- frames of serial lines: unit, PDU, checksum --------------------------------------------- */

enum { MODBUS_RTU_MIN = 4, MODBUS_RTU_MAX = 256 }; /* bytes of a frame */

/* The checksum: CRC-16 with the reflected polynomial 0xa001, from 0xffff. A frame has its low byte
 * first. */
uint16_t modbus_rtu_checksum(const uint8_t *bytes, size_t count);

/* Returns whether the bytes are one frame. */
bool modbus_rtu_is_frame(const uint8_t *bytes, size_t count);

/* Finds the request, to `unit` or to all units (0), at the end of what has arrived before a
 * silence. Before it there may be noise, and frames from and to other devices, because adapters
 * deliver several frames together. Returns the request's length, and where it begins in *begin.
 * Returns 0 if there is no request; if *begin is `count` then, there is noise. */
size_t modbus_rtu_find(const uint8_t *bytes, size_t count, unsigned unit, size_t *begin);

/* ---- identification -------------------------------------------------------------------------- */

/* Function 17, report server id: writes the answer's PDU, at most MODBUS_PDU_MAX bytes, and returns
 * its length. */
size_t modbus_identity_report(unsigned unit, uint8_t *answer);

/* Likewise function 43/14, read device identification; the request's PDU has 4 bytes. Returns 0 if
 * the request gets *exception instead. */
size_t modbus_identity_read(const uint8_t *pdu, uint8_t *answer, unsigned *exception);

#endif
