/* codec: reads and writes the bytes of Modbus: requests, frames of serial lines, and the functions
 * that identify the daemon. It checks lengths and counts. It knows neither sockets nor registers.
 */
#ifndef DIPOLED_MODBUS_CODEC_H
#define DIPOLED_MODBUS_CODEC_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
  MODBUS_PDU_MAX = 253,
  MODBUS_FC_DIAGNOSTICS = 0x08,    /* modbus.h lacks this function */
  MODBUS_FC_READ_DEVICE_ID = 0x2b, /* modbus.h lacks this function */
};

/* A request whose lengths and counts are valid. Its addresses have not been checked. */
struct modbus_request {
  unsigned function;
  unsigned address; /* of the registers that are read, or of the bits that are read or written */
  unsigned count;
  const uint8_t *bits;    /* the bits that are written, in the PDU, lowest bit first */
  unsigned write_address; /* first register to write */
  unsigned write_count;   /* number of registers that are written; may be 0 */
  const uint8_t *values;  /* values to write, in the PDU */
  unsigned and_mask;      /* function 22 */
  unsigned or_mask;
};

/* Reads the PDU of a request; its first byte is less than 0x80. Returns 0, or the exception that
 * serves the request. */
unsigned modbus_pdu_parse(const uint8_t *pdu, size_t bytes, struct modbus_request *request);

/* Returns the length of the request's PDU that begins with these bytes. Returns 0 if there are too
 * few bytes to tell, or if the function is none of the standard's. */
size_t modbus_pdu_bytes(const uint8_t *pdu, size_t bytes);

/* Returns the roles (server/net/roles.h) that the function of a number needs; 0: it is not served. */
unsigned modbus_pdu_roles(unsigned number);

/* ---- frames of serial lines: unit, PDU, checksum --------------------------------------------- */

enum { MODBUS_RTU_MIN = 4, MODBUS_RTU_MAX = 256 }; /* limits for the length of a frame */

/* Returns the checksum: CRC-16 with the reflected polynomial 0xa001 and the start value 0xffff. In
 * a frame, its low byte comes first. */
uint16_t modbus_rtu_checksum(const uint8_t *bytes, size_t count);

/* Returns whether the bytes are exactly one frame. */
bool modbus_rtu_is_frame(const uint8_t *bytes, size_t count);

/* The frames, requests and replies, at the start of some bytes. They follow each other without
 * anything between them. */
struct modbus_rtu_frames {
  unsigned count;
  size_t last;  /* start of the last frame */
  size_t bytes; /* total length of all frames */
};

/* Finds the frames at the start of the bytes. A frame of an unknown function, whose length is
 * unknown, is found only if nothing follows it. */
struct modbus_rtu_frames modbus_rtu_split(const uint8_t *bytes, size_t count);

/* ---- identification -------------------------------------------------------------------------- */

/* Function 17, report server id: writes the reply's PDU, at most MODBUS_PDU_MAX bytes, and returns
 * its length. */
size_t modbus_identity_report(unsigned unit, uint8_t *reply);

/* Function 43/14, read device identification: writes the reply's PDU, at most MODBUS_PDU_MAX
 * bytes, and returns its length. The request's PDU has 4 bytes. Returns 0 if *exception is the
 * reply. */
size_t modbus_identity_read(const uint8_t *pdu, uint8_t *reply, unsigned *exception);

#endif
