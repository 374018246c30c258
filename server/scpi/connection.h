/* connection: one SCPI client over TCP, as a client of the worker. It cuts the stream into messages,
 * carries them out in their order (session.h), and writes the answers of each at once, without ever
 * waiting for the peer.
 *
 * While answers have not been written whole, the connection neither carries out further messages nor
 * reads. A message is at most --max-part-bytes long.
 */
#ifndef DIPOLED_SCPI_CONNECTION_H
#define DIPOLED_SCPI_CONNECTION_H

#include "server/net/transport.h"
#include "server/scpi/session.h"

struct scpi_connection {
  struct transport transport; /* first member: see transport.h */
  struct scpi_session session;

  struct text input;
  size_t begin;          /* where the first message begins that has not been carried out */
  size_t message_bytes;  /* its length with its newline; 0: it has not arrived completely */
  size_t at;             /* where its next unit begins, from `begin` on */
  struct scpi_scan scan; /* the search for its end, from `begin` on */
  bool skipping;         /* whether bytes are dropped up to the next newline */
  bool answered;         /* whether the answers are complete, and perhaps still to be written */
};

/* Makes a connection of a connected, non-blocking socket, which the connection then owns. The caller
 * gives its client to a worker. Returns NULL if there is no memory. */
struct scpi_connection *scpi_connection_new(struct server *server, int fd);

/* Gives a connected socket to the least busy worker, or closes it if its peer may not
 * connect. Listeners call this. */
void scpi_connection_admit(struct server *server, int fd);

#endif
