#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/un.h>
#include <unistd.h>

#include "clients/c/client.h"

/* A Unix socket that is non-blocking refuses at once when the daemon's queue is full, so this one
 * blocks, for a limited time, and becomes non-blocking afterwards. 0, or an errno. */
static int connect_unix(const char *path, unsigned timeout_ms, int *connected) {
  struct sockaddr_un name = {.sun_family = AF_UNIX};
  const struct timeval timeout = {.tv_sec = timeout_ms / 1000,
                                  .tv_usec = (suseconds_t)(timeout_ms % 1000) * 1000};
  const int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (fd < 0) {
    return errno;
  }
  memcpy(name.sun_path, path, strlen(path) + 1);
  setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &timeout, sizeof timeout);
  int result;
  do {
    result = connect(fd, (const struct sockaddr *)&name, sizeof name);
  } while (result != 0 && errno == EINTR);
  if (result == 0 && fcntl(fd, F_SETFL, O_NONBLOCK) == 0) {
    *connected = fd;
    return 0;
  }
  const int number = errno == EAGAIN ? ETIMEDOUT : errno;
  close(fd);
  return number;
}

/* One of a host's addresses. 0, or an errno. */
static int connect_tcp_address(const struct addrinfo *to, unsigned timeout_ms, int *connected) {
  const int one = 1;
  const int fd = socket(to->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, to->ai_protocol);
  if (fd < 0) {
    return errno;
  }
  int number = connect(fd, to->ai_addr, to->ai_addrlen) == 0 ? 0 : errno;
  if (number == EINPROGRESS || number == EINTR) { /* it goes on in the background after both */
    short ready;
    socklen_t bytes = sizeof number;
    if (!libdipole_wait(fd, POLLOUT, timeout_ms, &ready) ||
        getsockopt(fd, SOL_SOCKET, SO_ERROR, &number, &bytes) != 0) {
      number = errno;
    }
  }
  if (number != 0) {
    close(fd);
    return number;
  }
  /* Small requests should not wait for the acknowledgement of earlier ones. */
  setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
  *connected = fd;
  return 0;
}

static bool connect_tcp(const libdipole_address *address, unsigned timeout_ms, int *fd,
                        dipole_error *error) {
  const struct addrinfo hints = {.ai_family = AF_UNSPEC, .ai_socktype = SOCK_STREAM};
  struct addrinfo *list;
  const int fault = getaddrinfo(address->host, address->port, &hints, &list);
  if (fault != 0) {
    return libdipole_fail(error, DIPOLE_ERROR_CONNECT, "cannot find the host '%s': %s",
                          address->host, gai_strerror(fault));
  }
  const int64_t until_ms = libdipole_now_ms() + timeout_ms;
  int number = EADDRNOTAVAIL;
  unsigned left_ms = timeout_ms;
  for (const struct addrinfo *to = list; to != NULL && number != 0; to = to->ai_next) {
    const int64_t now_ms = libdipole_now_ms();
    left_ms = timeout_ms == 0 ? 0 : now_ms < until_ms ? (unsigned)(until_ms - now_ms) : 1;
    number = connect_tcp_address(to, left_ms, fd);
  }
  freeaddrinfo(list);
  char what[sizeof address->host + 64];
  snprintf(what, sizeof what, "cannot connect to host %s, port %s", address->host, address->port);
  return number == 0 || libdipole_fail_errno(error, DIPOLE_ERROR_CONNECT, number, what);
}

bool libdipole_connect(const libdipole_address *address, unsigned timeout_ms, int *fd,
                       dipole_error *error) {
  if (address->kind == LIBDIPOLE_TCP) {
    return connect_tcp(address, timeout_ms, fd, error);
  }
  char what[sizeof((struct sockaddr_un *)0)->sun_path + 64];
  const int number = connect_unix(address->path, timeout_ms, fd);
  snprintf(what, sizeof what, "cannot connect to the socket %.108s", address->path);
  return number == 0 || libdipole_fail_errno(error, DIPOLE_ERROR_CONNECT, number, what);
}
