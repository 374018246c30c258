/* line: a serial line on which a master speaks Modbus RTU to one unit, and perhaps to other
 * devices.
 *
 * A frame ends with silence. One whose length and checksum are right already is answered after 3.5
 * characters of it, which the master has a right to; anything else is waited for longer, as
 * adapters deliver bytes in pieces, and then what there is of frames to other devices and of noise
 * is skipped. A device that goes away is opened again, at first soon, then every half minute.
 */
#ifndef DIPOLED_MODBUS_LINE_H
#define DIPOLED_MODBUS_LINE_H

#include <uv.h>

#include "server/modbus/answer.h"

struct modbus_service;

enum {
  MODBUS_LINE_DEVICE_BYTES = 256,
  MODBUS_LINE_INPUT_BYTES = 1024, /* that may arrive before there is silence */
};

struct modbus_line {
  struct modbus_client client; /* first: it is found by its address */
  struct modbus_service *service;
  char device[MODBUS_LINE_DEVICE_BYTES];
  int baud;
  char parity;
  unsigned unit;
  uint64_t silence_ms; /* 3.5 characters */
  uint64_t retry_ms;   /* of the next attempt to open it again */

  modbus_t *context; /* NULL: the device is away */
  uv_poll_t poll;
  uv_timer_t timer; /* silence, or the next attempt */
  unsigned open_handles;
  bool polling; /* the poll is in use or being closed */
  bool started;
  bool stopping;
  bool waiting; /* its request is being evaluated, */
  struct modbus_bank *bank;
  unsigned frame_begin; /* and is here in the input */
  unsigned frame_end;
  unsigned bytes; /* that have arrived since the last silence */
  uint8_t input[MODBUS_LINE_INPUT_BYTES];
};

/* rtu:DEVICE,BAUD,PARITY[,UNIT]; logs it. False, and a message on standard error: it cannot be
 * opened. Before the worker serves it. */
bool modbus_line_open(struct modbus_line *line, struct modbus_service *service, const char *url);

/* On the worker's thread. */
void modbus_line_start(struct modbus_line *line);
void modbus_line_stop(struct modbus_line *line);
bool modbus_line_has_stopped(const struct modbus_line *line);

/* After the worker has ended, or if it has never served it. */
void modbus_line_close(struct modbus_line *line);

#endif
