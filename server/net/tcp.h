/* tcp: opens sockets that listen at HOST:PORT, and knows what accepting may take. */
#ifndef DIPOLED_TCP_H
#define DIPOLED_TCP_H

#include <stdbool.h>
#include <stddef.h>
#include <sys/socket.h>

enum { TCP_ADDRESSES_MAX = 8 }; /* most addresses of one host name */

/* Listens at HOST:PORT, or [HOST]:PORT for a host with colons; port 0 means any free port. A name may
 * have several addresses: sets fds to non-blocking sockets at each of them, and returns how many there
 * are. On failure, returns 0 and sets *why to the reason. */
size_t tcp_listen(const char *host_port, int fds[TCP_ADDRESSES_MAX], const char **why);

/* Says why a socket cannot listen, and what to do if another program does. error: an errno. */
const char *tcp_why_not(int error);

/* Listens at [HOST]:PORT, where no HOST means the loopback interface: at each address of a name.
 * Returns how many sockets it has opened. On failure, prints a message with the option's name to
 * standard error and returns 0. */
size_t tcp_listen_option(const char *option, const char *address, int fds[TCP_ADDRESSES_MAX]);

/* Returns the number that the next descriptor would get; -1 with errno if none is left. */
int tcp_lowest_descriptor(void);

/* Returns whether a client may have one more descriptor: some are kept for /healthz and metrics, and
 * for files that are read again. If not, errno is EMFILE. */
bool tcp_has_descriptor(void);

enum { TCP_TEXT_BYTES = 160 };

/* Writes the address of a listening socket: numeric HOST:PORT or unix:PATH, or "" if it is unknown. */
void tcp_bound(int fd, char text[TCP_TEXT_BYTES]);

/* Writes the address of the peer of a connected socket: numeric HOST:PORT, or unix:pid=PID,uid=UID,
 * or "" if it is unknown. */
void tcp_peer(int fd, char text[TCP_TEXT_BYTES]);

#endif
