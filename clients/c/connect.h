/* connect: connects to a daemon, or starts one. */
#ifndef LIBDIPOLE_CONNECT_H
#define LIBDIPOLE_CONNECT_H

#include <sys/types.h>

#include "clients/c/address.h"

/* Connects to an address; starts the daemon of a private one. *fd is then a non-blocking socket,
 * which the caller closes. *daemon is the private daemon's process, or 0: the caller ends it with
 * libdipole_daemon_end(). timeout_ms: 0 is no limit. It does not hold for finding a host's
 * addresses by name, nor for a private daemon. Failures are of kind CONNECT. */
bool libdipole_connect(const libdipole_address *address, unsigned timeout_ms, int *fd,
                       pid_t *daemon, dipole_error *error);

/* Waits until a private daemon whose connection is closed has ended. After some seconds it is
 * stopped by force. */
void libdipole_daemon_end(pid_t daemon);

#endif
