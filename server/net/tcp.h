/* tcp: a socket that listens at HOST:PORT. */
#ifndef DIPOLED_TCP_H
#define DIPOLED_TCP_H

#include <stddef.h>

/* HOST:PORT, [HOST]:PORT for a host with colons; port 0: any free one. The socket, which does not
 * block; -1: *why says why, and errno is EADDRINUSE if somebody else listens there. */
int tcp_listen(const char *host_port, const char **why);

enum { TCP_TEXT_BYTES = 160 };

/* Where it listens, as HOST:PORT in numbers; "" when that cannot be told. */
void tcp_bound(int fd, char text[TCP_TEXT_BYTES]);

#endif
