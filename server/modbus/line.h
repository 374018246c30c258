/* line: a serial line on which a master speaks Modbus RTU to one unit. It is a client of the
 * worker. Other devices may be on the same line.
 *
 * If whole frames have arrived, the request among them is replied_bytes after a silence of 3.5
 * characters, as the standard says. An unfinished frame gets more time, because adapters deliver
 * bytes in pieces (server/modbus/receiver.h).
 *
 * The device may be missing when the daemon starts, and it may disappear later. The line then tries
 * to open it twice a second. A device that can be opened but is lost before any byte has arrived is
 * opened more and more rarely, in the end every half minute.
 */
#ifndef DIPOLED_MODBUS_LINE_H
#define DIPOLED_MODBUS_LINE_H

#include <modbus.h>
#include <uv.h>

#include "server/modbus/receiver.h"
#include "server/modbus/reply.h"

enum { MODBUS_DEVICE_PATH_BYTES = 256 };

/* The level of RTS while the daemon sends. */
enum modbus_rts { MODBUS_RTS_UNUSED, MODBUS_RTS_HIGH, MODBUS_RTS_LOW };

struct modbus_device {
  char path[MODBUS_DEVICE_PATH_BYTES];
  int baud;
  char parity; /* 'N', 'E' or 'O' */
  int stop_bits;
  unsigned number; /* number of the unit on this line */
  enum modbus_rts rts;
  /* Delay between RTS and the first character, and between the last character and RTS. */
  unsigned rts_delay_ms;

  modbus_t *context; /* context of libmodbus; NULL while the device is closed */
  bool rts_by_hand;  /* whether the caller has to set RTS */
};

struct modbus_line {
  struct client client; /* first member: see client.h */
  struct modbus_units *units;
  struct modbus_device device;
  struct modbus_receiver receiver;

  uv_poll_t poll;
  uv_timer_t timer; /* for the silence, for the end of a probe, or for the next attempt to open */
  unsigned open_handles; /* and work of the thread pool under way */
  bool polling;          /* whether the poll is in use or is being closed */
  bool stopping;
  bool echo_is_logged;
  bool was_open;  /* whether the device has ever been opened */
  int open_error; /* errno of the last attempt to open the device; 0: it succeeded */
  uint64_t
      retry_ms; /* pause between the next loss of the device and the first attempt to open it */

  struct modbus_unit *waits_for; /* the unit that evaluates the request; NULL: there is none */
  struct modbus_burst burst;     /* the last burst, with its request */

  /* The reply that is being sent. If RTS is set by hand, a thread of the pool sends it. */
  uv_work_t work;
  int sending_fd;   /* descriptor for the sending thread */
  bool sending;     /* whether the sending thread still runs */
  bool probing;     /* whether the line probes for echo: only the reply's first byte is sent */
  uint64_t sent_ns; /* when the last character of the reply, and the delay of RTS, will be over */
  size_t output_begin; /* start of the bytes of the output that have not been written */
  size_t output_end;
  size_t frame_bytes; /* length of the reply's frame */
  uint8_t output[MODBUS_RTU_MAX];
};

/* Reads rtu:DEVICE[,BAUD[,PARITY[,UNIT]]][,rts=high|low][,rts-delay-ms=N], opens the device and logs it. If the device cannot be
 * opened, logs that, and the line opens it later. The caller then gives `client` to the worker that
 * has the units. If the option is wrong, prints a message to standard error and returns false. */
bool modbus_line_open(struct modbus_line *line, struct modbus_units *units, const char *url);

/* Closes the device. Call it after the worker has ended, or if the worker never got the line. */
void modbus_line_close(struct modbus_line *line);

#endif
