#include "server/net/tcp.h"

#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

enum {
  BACKLOG = 1024,
  KEPT_MOST = 24,  /* descriptors that no client gets: */
  KEPT_SHARE = 16, /* at most one in so many */
};

static void describe(int fd, int (*name)(int fd, struct sockaddr *address, socklen_t *length),
                     char text[TCP_TEXT_BYTES]) {
  struct sockaddr_storage address;
  socklen_t length = sizeof address;
  char host[128];
  char port[16];
  text[0] = '\0';
  if (name(fd, (struct sockaddr *)&address, &length) == 0 &&
      getnameinfo((struct sockaddr *)&address, length, host, sizeof host, port, sizeof port,
                  NI_NUMERICHOST | NI_NUMERICSERV) == 0) {
    const bool bracket = address.ss_family == AF_INET6;
    snprintf(text, TCP_TEXT_BYTES, "%s%s%s:%s", bracket ? "[" : "", host, bracket ? "]" : "", port);
  }
}

void tcp_bound(int fd, char text[TCP_TEXT_BYTES]) {
  describe(fd, getsockname, text);
}

void tcp_peer(int fd, char text[TCP_TEXT_BYTES]) {
  struct ucred process;
  socklen_t length = sizeof process;
  int family = AF_UNSPEC;
  socklen_t family_length = sizeof family;
  if (getsockopt(fd, SOL_SOCKET, SO_DOMAIN, &family, &family_length) == 0 && family == AF_UNIX) {
    text[0] = '\0';
    if (getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &process, &length) == 0) {
      snprintf(text, TCP_TEXT_BYTES, "unix:pid=%ld,uid=%lu", (long)process.pid,
               (unsigned long)process.uid);
    }
    return;
  }
  describe(fd, getpeername, text);
}

static int bind_to(const struct addrinfo *address) {
  const int fd =
      socket(address->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, IPPROTO_TCP);
  const int on = 1;
  if (fd >= 0) {
    setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    if (bind(fd, address->ai_addr, address->ai_addrlen) == 0 && listen(fd, BACKLOG) == 0) {
      return fd;
    }
    const int error = errno;
    close(fd);
    errno = error;
  }
  return -1;
}

/* Splits HOST:PORT, where brackets enclose a HOST with colons. Returns false for any other text.
 */
static bool split(const char *text, char *host, size_t room, const char **port) {
  const char *colon = strrchr(text, ':');
  if (colon == NULL || colon[1] == '\0') {
    return false;
  }
  size_t length = (size_t)(colon - text);
  if (length >= 2 && text[0] == '[' && text[length - 1] == ']') {
    text++;
    length -= 2;
  }
  if (length == 0 || length >= room) {
    return false;
  }
  memcpy(host, text, length);
  host[length] = '\0';
  *port = colon + 1;
  return true;
}

static int refuse(const char *reason, const char **why) {
  *why = reason;
  errno = EINVAL;
  return -1;
}

int tcp_listen(const char *host_port, const char **why) {
  char host[256];
  const char *port;
  if (!split(host_port, host, sizeof host, &port)) {
    return refuse("write a host and a port, as in 127.0.0.1:4817 or [::1]:4817", why);
  }
  char *port_end;
  if (strtoul(port, &port_end, 10) > 65535 || *port_end != '\0') {
    return refuse("the port, behind the last colon, has to be a number from 0 to 65535", why);
  }
  const struct addrinfo hints = {.ai_socktype = SOCK_STREAM, .ai_flags = AI_PASSIVE};
  struct addrinfo *found = NULL;
  const int looked_up = getaddrinfo(host, port, &hints, &found);
  if (looked_up != 0) {
    return refuse(looked_up == EAI_NONAME ? "no host has this name" : gai_strerror(looked_up), why);
  }
  const int fd = bind_to(found);
  const int error = errno;
  freeaddrinfo(found);
  *why = strerror(error);
  errno = error;
  return fd;
}

bool tcp_has_descriptor(void) {
  struct rlimit limit;
  const int lowest = fcntl(STDERR_FILENO, F_DUPFD_CLOEXEC, 0); /* of those that are free */
  if (lowest < 0 || getrlimit(RLIMIT_NOFILE, &limit) != 0) {
    return false;
  }
  close(lowest);
  const rlim_t share = limit.rlim_cur / KEPT_SHARE;
  errno = EMFILE;
  return (rlim_t)lowest < limit.rlim_cur - (share < KEPT_MOST ? share : KEPT_MOST);
}
