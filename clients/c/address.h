/* address: parses the addresses of daemons. */
#ifndef LIBDIPOLE_ADDRESS_H
#define LIBDIPOLE_ADDRESS_H

#include <limits.h>

#include "clients/c/dipole.h"
#include "clients/c/tls.h"

enum libdipole_address_kind { LIBDIPOLE_UNIX, LIBDIPOLE_TCP, LIBDIPOLE_TLS, LIBDIPOLE_PRIVATE };

typedef struct libdipole_address {
  enum libdipole_address_kind kind;
  char host[256]; /* TCP and TLS only */
  char port[6];   /* TCP and TLS only */
  /* of the Unix socket; or of the private daemon's program, "" for the default */
  char path[PATH_MAX];
} libdipole_address;

/* Parses one address. Failures are of kind ADDRESS. */
bool libdipole_address_parse(const char *text, libdipole_address *address, dipole_error *error);

/* The addresses of a client, at least one. */
typedef struct libdipole_addresses {
  char *whole; /* one block that holds all texts */
  size_t count;
  size_t at; /* index of the address that the client is connected to or tries first */
  const char *texts[DIPOLE_ADDRESSES_MAX];
  libdipole_tls_files tls; /* files for tls: addresses, which this structure owns */
} libdipole_addresses;

/* Parses a list of addresses. If text is NULL, takes $DIPOLED, or else a private daemon. The
 * caller frees *addresses with libdipole_addresses_free(), also after a failure. */
bool libdipole_addresses_parse(const char *text, libdipole_addresses *addresses,
                               dipole_error *error);

/* Returns whether the client starts a private daemon. */
bool libdipole_addresses_is_private(const libdipole_addresses *addresses);

/* Copies names of files; NULL means $DIPOLED_CA, $DIPOLED_CERTIFICATE and $DIPOLED_KEY. */
bool libdipole_addresses_set_tls(libdipole_addresses *addresses, const libdipole_tls_files *files,
                                 dipole_error *error);

void libdipole_addresses_free(libdipole_addresses *addresses);

#endif
