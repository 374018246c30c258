/* connection: one Modbus master over TCP, as a client of the worker. It cuts the stream into
 * frames, answers them in their order, and writes the answers without ever waiting for the peer.
 *
 * While an answer has not been written whole, the connection neither answers further requests nor
 * reads. So it keeps at most one answer, and a master that does not read costs no more memory than
 * this structure.
 */
#ifndef DIPOLED_MODBUS_CONNECTION_H
#define DIPOLED_MODBUS_CONNECTION_H

#include <uv.h>

#include "server/modbus/answer.h"

enum {
  MODBUS_FRAME_MAX = 260,    /* bytes of a frame over TCP */
  MODBUS_INPUT_BYTES = 1040, /* that are read ahead */
};

struct modbus_connection {
  struct client client; /* first */
  struct modbus_units *units;
  int fd;
  uv_poll_t poll;
  int events; /* that the poll waits for */

  struct modbus_unit *waits_for; /* the unit that evaluates the first frame; NULL: none does */
  bool stopping;                 /* the peer has closed, or the daemon stops */
  unsigned unread; /* bytes that had arrived when the daemon began to stop: they are still read */
  bool ending;     /* no more frames are answered; closes when the answer has been written */
  bool lingering;  /* has shut down, and waits for the peer to close after reading the answer */
  bool closing;    /* uv_close() has been called */

  uint64_t active_ms;        /* when bytes last arrived or left */
  uint64_t frame_started_ms; /* when the unfinished frame began to arrive; 0: there is none */
  unsigned begin;            /* of the input that has not been answered */
  unsigned end;
  unsigned unsent_begin; /* of the answer that has not been written */
  unsigned unsent_end;
  uint8_t input[MODBUS_INPUT_BYTES];
  uint8_t unsent[MODBUS_FRAME_MAX];
};

/* For a connected socket that does not block, which the connection then owns. NULL: out of memory;
 * the socket is still the caller's. The caller gives `client` to the worker that has the units. */
struct modbus_connection *modbus_connection_new(struct modbus_units *units, int fd);

#endif
