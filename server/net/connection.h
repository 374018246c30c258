/* connection: one client of the binary protocol. It reads bytes, calls server/jobs/requests.h to
 * serve the requests in them, and writes the replies. It ends when the peer is done, is too slow
 * or too silent, or when the daemon stops. */
#ifndef DIPOLED_CONNECTION_H
#define DIPOLED_CONNECTION_H

#include "proto/wire.h"
#include "server/net/client.h"
#include "server/net/tls.h"
#include "server/server.h"

enum connection_purpose {
  CONNECTION_SERVE,
  CONNECTION_INHERITED, /* the connection of --fd: the daemon stops when it is closed */
  CONNECTION_REFUSE,    /* a connection beyond max_connections: it gets BUSY and is closed */
  CONNECTION_FORBID,    /* a connection from a place not in --allow: the same with NOT_ALLOWED */
};

/* Makes a connection of a connected stream socket, which the connection then owns. tls: the session
 * whose handshake is done, which it then owns, too; NULL for plain bytes. The caller gives the
 * connection to a worker by worker_give(). Returns NULL if there is no memory; fd and tls are still
 * the caller's then. May be called on any thread. */
struct client *connection_new(struct server *server, int fd, struct tls_session *tls,
                              enum connection_purpose purpose);

/* Makes the error that a connection gets which is refused or forbidden. */
wire_error connection_refusal(enum connection_purpose purpose);

#endif
