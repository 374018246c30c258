/* handshake: TLS handshakes. They run on a worker of their own, at low priority, so that a flood of
 * them costs other clients nothing but a small share of the processor. A connection whose handshake
 * is done moves on to the workers that evaluate.
 *
 * A handshake may take --tls-handshake-timeout-ms and 64 KiB, and begins when the client has sent
 * something; before that it costs no more than its socket, which the worker watches. There may
 * be --max-tls-handshakes under way, and as many clients that are silent: one more ends the oldest of
 * its kind. So handshakes that somebody leaves half open keep nobody out whose handshake takes
 * milliseconds.
 */
#ifndef DIPOLED_HANDSHAKE_H
#define DIPOLED_HANDSHAKE_H

#include "server/net/tls.h"
#include "server/server.h"

struct handshakes;

/* Gets, and then owns, a socket whose handshake is done, and its session. It is called on the
 * worker's thread. */
typedef void handshakes_done(struct server *server, int fd, struct tls_session *session);

/* Makes the handshakes. done: for the binary protocol. Returns NULL if there is no memory. */
struct handshakes *handshakes_new(struct server *server, struct tls *tls, struct worker *worker,
                                  handshakes_done *done);

/* Frees it. Call this after the worker has ended. handshakes: may be NULL. */
void handshakes_free(struct handshakes *handshakes);

/* Begins the handshake of a connected socket, which it then owns. The connection of a peer that is
 * not from --allow is closed at once. Listeners call this. */
void handshakes_admit(struct server *server, int fd);

/* Like handshakes_admit(), but for any protocol, and for a peer that is known to be from an allowed
 * address. done: gets the connection. */
void handshakes_begin(struct server *server, int fd, handshakes_done *done);

#endif
