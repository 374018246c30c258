#include <stdlib.h>
#include <string.h>
#include <sys/un.h>

#include "clients/c/client.h"

const char *libdipole_address_default(void) {
  const char *named = getenv("DIPOLED");
  return named != NULL && named[0] != '\0' ? named : "private:";
}

/* Copies length bytes with a terminating zero; false when they do not fit or there are none. */
static bool copy_part(char *to, size_t capacity, const char *from, size_t length) {
  if (length == 0 || length >= capacity) {
    return false;
  }
  memcpy(to, from, length);
  to[length] = '\0';
  return true;
}

static bool is_port(const char *text) {
  const size_t digits = strspn(text, "0123456789");
  const long port = digits > 0 && digits <= 5 ? strtol(text, NULL, 10) : 0;
  return text[digits] == '\0' && port >= 1 && port <= 65535;
}

static bool parse_tcp(const char *whole, const char *text, libdipole_address *address,
                      dipole_error *error) {
  const char *colon = strrchr(text, ':');
  const char *host = text;
  size_t host_bytes = colon != NULL ? (size_t)(colon - text) : 0;
  if (host_bytes >= 2 && host[0] == '[' && host[host_bytes - 1] == ']') {
    host++;
    host_bytes -= 2;
  } else if (memchr(host, ':', host_bytes) != NULL) {
    return libdipole_fail(error, DIPOLE_ERROR_ADDRESS,
                          "address '%.80s': put an IPv6 address in brackets: tcp:[::1]:PORT",
                          whole);
  }
  if (colon == NULL || !is_port(colon + 1) ||
      !copy_part(address->host, sizeof address->host, host, host_bytes) ||
      !copy_part(address->port, sizeof address->port, colon + 1, strlen(colon + 1))) {
    return libdipole_fail(error, DIPOLE_ERROR_ADDRESS,
                          "address '%.80s': write tcp:HOST:PORT, with a port from 1 to 65535",
                          whole);
  }
  return true;
}

bool libdipole_address_parse(const char *text, libdipole_address *address, dipole_error *error) {
  static const struct {
    const char *scheme;
    enum libdipole_address_kind kind;
  } schemes[] = {
      {"unix:", LIBDIPOLE_UNIX}, {"tcp:", LIBDIPOLE_TCP}, {"private:", LIBDIPOLE_PRIVATE}};
  const size_t unix_path_bytes = sizeof((struct sockaddr_un *)0)->sun_path;
  const char *rest = NULL;

  *address = (libdipole_address){0};
  for (size_t i = 0; i < sizeof schemes / sizeof schemes[0] && rest == NULL; i++) {
    const size_t scheme_bytes = strlen(schemes[i].scheme);
    if (strncmp(text, schemes[i].scheme, scheme_bytes) == 0) {
      address->kind = schemes[i].kind;
      rest = text + scheme_bytes;
    }
  }
  if (rest == NULL) {
    return libdipole_fail(error, DIPOLE_ERROR_ADDRESS,
                          "address '%.80s': write unix:PATH, tcp:HOST:PORT or private:", text);
  }
  if (address->kind == LIBDIPOLE_TCP) {
    return parse_tcp(text, rest, address, error);
  }
  const bool unix_socket = address->kind == LIBDIPOLE_UNIX;
  const size_t capacity = unix_socket ? unix_path_bytes : sizeof address->path;
  if (!copy_part(address->path, capacity, rest, strlen(rest)) && (unix_socket || rest[0] != '\0')) {
    return libdipole_fail(error, DIPOLE_ERROR_ADDRESS,
                          "address '%.80s': the path must have 1 to %zu bytes", text, capacity - 1);
  }
  return true;
}
