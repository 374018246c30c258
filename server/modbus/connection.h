/* connection: one Modbus master over TCP or TLS, as a client of the worker. It cuts the stream into
 * frames, serves them in their order, and writes the replies without ever waiting for the peer.
 *
 * While a reply has not been written whole, the connection neither serves further requests nor
 * reads. So it keeps at most one reply, and a master that does not read costs no more memory than
 * this structure.
 */
#ifndef DIPOLED_MODBUS_CONNECTION_H
#define DIPOLED_MODBUS_CONNECTION_H

#include <uv.h>

#include "server/modbus/reply.h"
#include "server/net/transport.h"

enum {
  MODBUS_FRAME_MAX = 260,    /* bytes of a frame over TCP */
  MODBUS_INPUT_BYTES = 1040, /* size of the input: four frames */
};

struct modbus_connection {
  struct transport transport; /* first member: see transport.h */
  struct modbus_units *units;
  unsigned roles; /* roles of the master */

  struct modbus_unit *waits_for; /* the unit that evaluates the first frame; NULL: there is none */
  bool ending; /* whether to serve no more frames, and to close after the last reply */

  uint64_t frame_started_ms; /* when the incomplete frame began to arrive; 0: there is none */
  unsigned begin;            /* start of the input that has not been served */
  unsigned end;
  uint8_t input[MODBUS_INPUT_BYTES];
  uint8_t reply[MODBUS_FRAME_MAX]; /* which the transport sends from here */
};

/* Makes a connection of a connected, non-blocking socket, which the connection then owns, like the
 * session, which may be NULL. The caller gives its client to the worker that has the
 * units. Returns NULL if there is no memory; all that is still the caller's then. */
struct modbus_connection *modbus_connection_new(struct modbus_units *units, int fd,
                                                struct tls_session *session, unsigned roles);

#endif
