#include "clients/c/address.h"

#include <stdlib.h>
#include <string.h>
#include <sys/un.h>

#include "clients/c/error.h"

static const struct {
  const char *scheme;
  enum libdipole_address_kind kind;
} schemes[] = {{"unix:", LIBDIPOLE_UNIX},
               {"tcp:", LIBDIPOLE_TCP},
               {"tls:", LIBDIPOLE_TLS},
               {"private:", LIBDIPOLE_PRIVATE}};

enum { SCHEMES = sizeof schemes / sizeof schemes[0] };

/* Reads the scheme, such as "unix:", at the start of the text. Returns the text behind the scheme,
 * or NULL if the text starts with no known scheme. */
static const char *skip_scheme(const char *text, enum libdipole_address_kind *kind) {
  for (size_t i = 0; i < SCHEMES; i++) {
    const size_t bytes = strlen(schemes[i].scheme);
    if (strncmp(text, schemes[i].scheme, bytes) == 0) {
      *kind = schemes[i].kind;
      return text + bytes;
    }
  }
  return NULL;
}

/* Copies length bytes and adds a zero byte. Returns false if they do not fit or length is 0. */
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
  if (strpbrk(text, " \t,;") != NULL) {
    return libdipole_fail(error, DIPOLE_ERROR_ADDRESS,
                          "address '%.80s': write several as tcp:HOST:PORT,tcp:HOST:PORT, with "
                          "nothing but a comma between them",
                          whole);
  }
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
                          "address '%.80s': write %s:HOST:PORT, with a port from 1 to 65535", whole,
                          address->kind == LIBDIPOLE_TLS ? "tls" : "tcp");
  }
  return true;
}

bool libdipole_address_parse(const char *text, libdipole_address *address, dipole_error *error) {
  *address = (libdipole_address){0};
  const char *rest = skip_scheme(text, &address->kind);
  if (rest == NULL) {
    return libdipole_fail(
        error, DIPOLE_ERROR_ADDRESS,
        "address '%.80s': write unix:PATH, tcp:HOST:PORT, tls:HOST:PORT or private:", text);
  }
  if (address->kind == LIBDIPOLE_TCP || address->kind == LIBDIPOLE_TLS) {
    return parse_tcp(text, rest, address, error);
  }
  const bool unix_socket = address->kind == LIBDIPOLE_UNIX;
  const size_t capacity =
      unix_socket ? sizeof((struct sockaddr_un *)0)->sun_path : sizeof address->path;
  if (!copy_part(address->path, capacity, rest, strlen(rest)) && (unix_socket || rest[0] != '\0')) {
    return libdipole_fail(error, DIPOLE_ERROR_ADDRESS,
                          "address '%.80s': the path must have 1 to %zu bytes", text, capacity - 1);
  }
  return true;
}

/* ---- lists of addresses -------------------------------------------------------------------- */

/* Returns the comma before the next address of the list, or NULL after the last address. A comma
 * that no scheme follows is part of a path. */
static char *find_comma(char *text) {
  enum libdipole_address_kind kind;
  char *comma = strchr(text, ',');
  while (comma != NULL && skip_scheme(comma + 1, &kind) == NULL) {
    comma = strchr(comma + 1, ',');
  }
  return comma;
}

static bool check(const libdipole_addresses *addresses, dipole_error *error) {
  libdipole_address address;
  for (size_t i = 0; i < addresses->count; i++) {
    if (!libdipole_address_parse(addresses->texts[i], &address, error)) {
      return false;
    }
    if (address.kind == LIBDIPOLE_PRIVATE && addresses->count > 1) {
      return libdipole_fail(error, DIPOLE_ERROR_ADDRESS,
                            "address '%.80s': a private daemon cannot be one of several addresses",
                            addresses->texts[i]);
    }
  }
  return true;
}

bool libdipole_addresses_parse(const char *text, libdipole_addresses *addresses,
                               dipole_error *error) {
  if (text == NULL) {
    const char *named = getenv("DIPOLED");
    text = named != NULL && named[0] != '\0' ? named : "private:";
  }
  *addresses = (libdipole_addresses){.whole = strdup(text)};
  if (addresses->whole == NULL) {
    return libdipole_fail_memory(error);
  }
  for (char *next = addresses->whole; next != NULL;) {
    if (addresses->count == DIPOLE_ADDRESSES_MAX) {
      return libdipole_fail(error, DIPOLE_ERROR_ADDRESS, "there are more than %d addresses",
                            DIPOLE_ADDRESSES_MAX);
    }
    addresses->texts[addresses->count++] = next;
    next = find_comma(next);
    if (next != NULL) {
      *next++ = '\0';
    }
  }
  return check(addresses, error);
}

bool libdipole_addresses_is_private(const libdipole_addresses *addresses) {
  return strncmp(addresses->texts[0], "private:", strlen("private:")) == 0;
}

/* Copies a text, or the variable's value if it is NULL. An empty text counts as not given. */
static bool copy_text(const char *text, const char *variable, const char **copy) {
  text = text != NULL ? text : getenv(variable);
  if (text == NULL || text[0] == '\0') {
    return true;
  }
  *copy = strdup(text);
  return *copy != NULL;
}

bool libdipole_addresses_set_tls(libdipole_addresses *addresses, const libdipole_tls_files *files,
                                 dipole_error *error) {
  libdipole_tls_files *to = &addresses->tls;
  return (copy_text(files->ca, "DIPOLED_CA", &to->ca) &&
          copy_text(files->certificate, "DIPOLED_CERTIFICATE", &to->certificate) &&
          copy_text(files->key, "DIPOLED_KEY", &to->key)) ||
         libdipole_fail_memory(error);
}

void libdipole_addresses_free(libdipole_addresses *addresses) {
  free((char *)addresses->tls.ca);
  free((char *)addresses->tls.certificate);
  free((char *)addresses->tls.key);
  free(addresses->whole);
  *addresses = (libdipole_addresses){0};
}
