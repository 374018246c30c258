/* connection: one client of the binary protocol. It moves bytes: it reads what arrives, has the
 * requests answered (server/jobs/requests.h), and writes the answers. It ends when the peer is
 * done, is too slow or too silent, or when the daemon stops.
 */
#ifndef DIPOLED_CONNECTION_H
#define DIPOLED_CONNECTION_H

#include "proto/wire.h"
#include "server/net/client.h"
#include "server/server.h"

enum connection_purpose {
  CONNECTION_SERVE,
  CONNECTION_INHERITED, /* of --fd: the daemon stops when it is closed */
  CONNECTION_REFUSE,    /* beyond max_connections: it gets BUSY and is closed */
};

/* Makes a connection of a connected stream socket, to be given to a worker with worker_give(). It
 * owns fd from then on. Returns NULL if there is no memory; fd is still the caller's then. May be
 * called on any thread. */
struct client *connection_new(struct server *server, int fd, enum connection_purpose purpose);

/* BUSY: what a connection beyond max_connections is told. */
wire_error connection_refusal(void);

#endif
