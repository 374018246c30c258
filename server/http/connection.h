/* connection: one HTTP connection, whose requests are served one after the other.
 *
 * A request becomes the payload of a message, whose job server/jobs/call.h runs: so HTTP has the limits,
 * shares, deadlines and errors of the binary protocol. Most requests are served at
 * once. The others go on in the turns of the connection, as a client of the worker
 * (server/net/client.h), while the library leaves the connection alone.
 */
#ifndef DIPOLED_HTTP_CONNECTION_H
#define DIPOLED_HTTP_CONNECTION_H

#include "server/http/header.h"
#include "server/net/client.h"
#include "server/server.h"

/* The library's memory for the request line and the header of one connection. */
enum { HTTP_CONNECTION_BYTES = 32768 };

/* What all connections share. */
struct http_host {
  struct server *server;
  struct worker *worker;
  struct budget buffers; /* half of the server's budget */
  uint64_t connection_count;
  bool stopping;          /* whether the daemon stops */
  struct client *service; /* client in whose turns libmicrohttpd works */
};

/* The functions that the library calls; `context` is the struct http_host. */
void http_connection_notify(void *context, struct MHD_Connection *connection, void **socket_context,
                            enum MHD_ConnectionNotificationCode what);
void *http_connection_begin(void *context, const char *uri, struct MHD_Connection *connection);
enum MHD_Result http_connection_take(void *context, struct MHD_Connection *connection,
                                     const char *url, const char *method, const char *version,
                                     const char *body, size_t *body_bytes, void **state);
void http_connection_complete(void *context, struct MHD_Connection *connection, void **state,
                              enum MHD_RequestTerminationCode why);

#endif
