/* tcp: opens sockets that listen at HOST:PORT, and knows what accepting may take. */
#ifndef DIPOLED_TCP_H
#define DIPOLED_TCP_H

#include <stdbool.h>
#include <stddef.h>

/* Listens at HOST:PORT, or [HOST]:PORT for a host with colons; port 0 means any free port. Returns
 * a non-blocking socket. On failure, returns -1 and sets *why to the reason; errno is EADDRINUSE if
 * another process listens there. */
int tcp_listen(const char *host_port, const char **why);

/* Returns whether a client may have one more descriptor: some are kept for /healthz and metrics, and
 * for files that are read again. If not, errno is EMFILE. */
bool tcp_has_descriptor(void);

enum { TCP_TEXT_BYTES = 160 };

/* Writes the address of a listening socket as numeric HOST:PORT, or "" if it is unknown. */
void tcp_bound(int fd, char text[TCP_TEXT_BYTES]);

/* Writes the address of the peer of a connected socket: numeric HOST:PORT, or unix:pid=PID,uid=UID,
 * or "" if it is unknown. */
void tcp_peer(int fd, char text[TCP_TEXT_BYTES]);

#endif
