/* tls: TLS 1.2 and 1.3 by OpenSSL on a connected socket. */
#ifndef LIBDIPOLE_TLS_H
#define LIBDIPOLE_TLS_H

#include <sys/types.h>

#include "clients/c/dipole.h"

/* Files in PEM format; each may be NULL. */
typedef struct libdipole_tls_files {
  const char *ca; /* whose certificates the daemon's is checked against; NULL: the system's */
  const char *certificate; /* the client's certificate; `key` is its private key */
  const char *key;
} libdipole_tls_files;

/* One connection. */
typedef struct libdipole_tls libdipole_tls;

/* Shakes hands on a connected, non-blocking socket, which stays the caller's, and checks that the
 * daemon's certificate is good for the host. timeout_ms: 0 is no limit. Returns NULL if that fails:
 * kind CONNECT, and if trying again cannot help, status NOT_ALLOWED. */
libdipole_tls *libdipole_tls_open(int fd, const char *host, const libdipole_tls_files *files,
                                  unsigned timeout_ms, dipole_error *error);

/* is_sent: whether to send the peer the end of the connection. tls may be NULL. */
void libdipole_tls_free(libdipole_tls *tls, bool is_sent);

/* These return a number of bytes above 0; or 0 (reading) if the peer sends no more; or -1 and set
 * errno: to EAGAIN if the socket is not ready, and to EPROTO if TLS has failed. */
ssize_t libdipole_tls_read(libdipole_tls *tls, void *to, size_t bytes);
ssize_t libdipole_tls_write(libdipole_tls *tls, const void *from, size_t bytes);

/* Returns whether bytes can be read without waiting for the socket. */
bool libdipole_tls_pending(const libdipole_tls *tls);

/* Returns why the daemon refuses the client's certificate, after EPROTO, or NULL if it does not. */
const char *libdipole_tls_refusal(const libdipole_tls *tls);

#endif
