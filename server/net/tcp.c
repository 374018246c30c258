#include "server/net/tcp.h"

#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

enum {
  BACKLOG = 1024,
  KEPT_MOST = 24,  /* largest number of descriptors kept free of clients */
  KEPT_SHARE = 16, /* at most one in this many is kept */
};

/* What an IPv4 address in IPv6 begins with (RFC 4291). */
#define MAPPED "::ffff:"

static void write_address(const struct sockaddr *address, socklen_t length,
                          char text[TCP_TEXT_BYTES]) {
  char host[128];
  char port[16];
  text[0] = '\0';
  if (address->sa_family == AF_UNIX) {
    snprintf(text, TCP_TEXT_BYTES, "unix:%.*s", (int)(length - sizeof address->sa_family),
             address->sa_data);
  } else if (getnameinfo(address, length, host, sizeof host, port, sizeof port,
                         NI_NUMERICHOST | NI_NUMERICSERV) == 0) {
    const bool mapped = strncmp(host, MAPPED, strlen(MAPPED)) == 0;
    const bool bracket = address->sa_family == AF_INET6 && !mapped;
    snprintf(text, TCP_TEXT_BYTES, "%s%s%s:%s", bracket ? "[" : "",
             host + (mapped ? strlen(MAPPED) : 0), bracket ? "]" : "", port);
  }
}

static void describe(int fd, int (*name)(int fd, struct sockaddr *address, socklen_t *length),
                     char text[TCP_TEXT_BYTES]) {
  struct sockaddr_storage address;
  socklen_t length = sizeof address;
  text[0] = '\0';
  if (name(fd, (struct sockaddr *)&address, &length) == 0) {
    write_address((struct sockaddr *)&address, length, text);
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

static bool is_every_ipv6(const struct sockaddr *address) {
  return address->sa_family == AF_INET6 &&
         IN6_IS_ADDR_UNSPECIFIED(&((const struct sockaddr_in6 *)(const void *)address)->sin6_addr);
}

static int bind_to(const struct addrinfo *address) {
  const int fd =
      socket(address->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, IPPROTO_TCP);
  const int on = 1;
  if (fd >= 0) {
    setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    int bound = bind(fd, address->ai_addr, address->ai_addrlen);
    if (bound != 0 && errno == EADDRINUSE && is_every_ipv6(address->ai_addr)) {
      /* Somebody listens at the port for IPv4, maybe this daemon. */
      setsockopt(fd, IPPROTO_IPV6, IPV6_V6ONLY, &on, sizeof on);
      bound = bind(fd, address->ai_addr, address->ai_addrlen);
    }
    if (bound == 0 && listen(fd, BACKLOG) == 0) {
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

/* Returns whether an address stands before another in a list. */
static bool is_repeated(const struct addrinfo *list, const struct addrinfo *address) {
  while (list != address && (list->ai_addrlen != address->ai_addrlen ||
                             memcmp(list->ai_addr, address->ai_addr, list->ai_addrlen) != 0)) {
    list = list->ai_next;
  }
  return list != address;
}

const char *tcp_why_not(int error) {
  return error == EADDRINUSE ? "Address already in use: end the program that has it, or give "
                               "another address (--listen, --http, --metrics, --modbus or --scpi)"
                             : strerror(error);
}

/* Listens at the addresses of a list. One that the machine does not have is left out
 * if another is there. Returns how many; if one fails, closes all, returns 0 and sets *why. */
static size_t listen_at_all(const struct addrinfo *list, int fds[TCP_ADDRESSES_MAX],
                            const char **why) {
  size_t count = 0;
  for (const struct addrinfo *one = list; one != NULL && count < TCP_ADDRESSES_MAX;
       one = one->ai_next) {
    fds[count] = is_repeated(list, one) ? -1 : bind_to(one);
    if (fds[count] >= 0) {
      count++;
    } else if (!is_repeated(list, one)) {
      const int error = errno;
      *why = tcp_why_not(error);
      if (error != EADDRNOTAVAIL && error != EAFNOSUPPORT) {
        while (count > 0) {
          close(fds[--count]);
        }
        return 0;
      }
    }
  }
  return count;
}

size_t tcp_listen(const char *host_port, int fds[TCP_ADDRESSES_MAX], const char **why) {
  char host[256];
  const char *port;
  if (!split(host_port, host, sizeof host, &port)) {
    *why = "write a host and a port, as in 127.0.0.1:4817 or [::1]:4817";
    return 0;
  }
  char *port_end;
  if (strtoul(port, &port_end, 10) > 65535 || *port_end != '\0') {
    *why = "the port, behind the last colon, has to be a number from 0 to 65535";
    return 0;
  }
  const struct addrinfo hints = {.ai_socktype = SOCK_STREAM, .ai_flags = AI_PASSIVE};
  struct addrinfo *found = NULL;
  const int looked_up = getaddrinfo(host, port, &hints, &found);
  if (looked_up != 0) {
    *why = looked_up == EAI_NONAME ? "no host has this name" : gai_strerror(looked_up);
    return 0;
  }
  const size_t count = listen_at_all(found, fds, why);
  freeaddrinfo(found);
  return count;
}

size_t tcp_listen_option(const char *option, const char *address, int fds[TCP_ADDRESSES_MAX]) {
  char local[64];
  const char *port = strchr(address, ':') == NULL ? address
                     : address[0] == ':'          ? address + 1
                                                  : NULL;
  const char *why;
  if (port != NULL) {
    snprintf(local, sizeof local, "127.0.0.1:%s", port);
  }
  const size_t count = tcp_listen(port != NULL ? local : address, fds, &why);
  if (count == 0) {
    fprintf(stderr, "dipoled: --%s %s: %s. Write HOST:PORT, or a PORT of this machine\n", option,
            address, why);
  }
  return count;
}

int tcp_lowest_descriptor(void) {
  const int lowest = fcntl(STDERR_FILENO, F_DUPFD_CLOEXEC, 0);
  if (lowest >= 0) {
    syscall(SYS_close,
            lowest); /* as libuv does: close() would tell a sanitizer of another's number */
  }
  return lowest;
}

bool tcp_has_descriptor(void) {
  struct rlimit limit;
  const int lowest = tcp_lowest_descriptor();
  if (lowest < 0 || getrlimit(RLIMIT_NOFILE, &limit) != 0) {
    return false;
  }
  const rlim_t share = limit.rlim_cur / KEPT_SHARE;
  errno = EMFILE;
  return (rlim_t)lowest < limit.rlim_cur - (share < KEPT_MOST ? share : KEPT_MOST);
}
