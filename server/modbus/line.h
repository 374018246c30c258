/* line: a serial line on which a master speaks Modbus RTU to one unit, as a client of the worker.
 * Other devices may be on the same line.
 *
 * A frame ends with a silence. If what has arrived is a whole request with the right checksum, it
 * is answered after a silence of 3.5 characters, as the standard says. Otherwise the silence has to
 * be longer, because adapters deliver bytes in pieces. Frames from and to other devices and noise
 * are then skipped. When a device goes away, the daemon tries to open it again: first after a
 * quarter of a second, and in the end every half minute.
 */
#ifndef DIPOLED_MODBUS_LINE_H
#define DIPOLED_MODBUS_LINE_H

#include <modbus.h>
#include <uv.h>

#include "server/modbus/answer.h"

enum {
  MODBUS_LINE_DEVICE_BYTES = 256,
  MODBUS_LINE_INPUT_BYTES = 1024, /* that may arrive without a silence */
};

struct modbus_line {
  struct client client; /* first */
  struct modbus_units *units;
  char device[MODBUS_LINE_DEVICE_BYTES];
  int baud;
  char parity;
  unsigned number;     /* of the unit */
  uint64_t silence_ms; /* 3.5 characters */
  uint64_t retry_ms;   /* until the next attempt to open the device again */

  modbus_t *context; /* libmodbus's, of the device; NULL: the device is away */
  uv_poll_t poll;
  uv_timer_t timer; /* for the silence, or for the next attempt */
  unsigned open_handles;
  bool polling; /* the poll is in use or is being closed */
  bool stopping;
  struct modbus_unit *waits_for; /* the unit that evaluates the request; NULL: none does */
  unsigned frame_begin;          /* of the request, in the input */
  unsigned frame_end;
  unsigned bytes; /* that have arrived since the last silence */
  uint8_t input[MODBUS_LINE_INPUT_BYTES];
};

/* Opens rtu:DEVICE,BAUD,PARITY[,UNIT] and logs it. Then the caller gives `client` to the worker
 * that has the units. False, with a message on standard error: it cannot be opened. */
bool modbus_line_open(struct modbus_line *line, struct modbus_units *units, const char *url);

/* Closes the device. The worker has ended, or has never got the line. */
void modbus_line_close(struct modbus_line *line);

#endif
