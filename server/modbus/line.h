/* line: a serial line on which a master speaks Modbus RTU to one unit. It is a client of the
 * worker. Other devices may be on the same line.
 *
 * A frame ends with a silence. A complete request with the right checksum is answered after a
 * silence of 3.5 characters, as the standard says. Other bytes are dropped only after a longer
 * silence, because adapters deliver a frame in pieces: they are noise, or frames from and to other
 * devices. When a device disappears, the daemon tries to open it again: first after a quarter of a
 * second, and in the end every half minute.
 */
#ifndef DIPOLED_MODBUS_LINE_H
#define DIPOLED_MODBUS_LINE_H

#include <modbus.h>
#include <uv.h>

#include "server/modbus/answer.h"

enum {
  MODBUS_LINE_DEVICE_BYTES = 256,
  MODBUS_LINE_INPUT_BYTES = 1024, /* the most bytes that may arrive without a silence */
};

struct modbus_line {
  struct client client; /* first member: see client.h */
  struct modbus_units *units;
  char device[MODBUS_LINE_DEVICE_BYTES];
  int baud;
  char parity;
  unsigned number;     /* of the unit */
  uint64_t silence_ms; /* the time of 3.5 characters */
  uint64_t retry_ms;   /* pause before the next attempt to open the device */

  modbus_t *context; /* of libmodbus, for the device; NULL while the device cannot be opened */
  uv_poll_t poll;
  uv_timer_t timer; /* for the silence, or for the next attempt to open the device */
  unsigned open_handles;
  bool polling; /* whether the poll is in use or is being closed */
  bool stopping;
  struct modbus_unit *waits_for; /* the unit that evaluates the request; NULL: there is none */
  unsigned frame_begin;          /* start of the request in the input */
  unsigned frame_end;
  unsigned bytes; /* number of bytes that have arrived since the last silence */
  uint8_t input[MODBUS_LINE_INPUT_BYTES];
};

/* Opens rtu:DEVICE,BAUD,PARITY[,UNIT] and logs it. The caller then gives `client` to the worker
 * that has the units. If the line cannot be opened, prints a message to standard error and returns
 * false. */
bool modbus_line_open(struct modbus_line *line, struct modbus_units *units, const char *url);

/* Closes the device. Call it after the worker has ended, or if the worker never got the line. */
void modbus_line_close(struct modbus_line *line);

#endif
