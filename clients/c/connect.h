/* connect: connects to a daemon, or starts one. */
#ifndef LIBDIPOLE_CONNECT_H
#define LIBDIPOLE_CONNECT_H

#include <sys/types.h>

#include "clients/c/address.h"

/* Connects to an address, or starts a private daemon. *fd is then a non-blocking socket, which the
 * caller closes. *daemon is the process of the private daemon, which the caller ends with
 * libdipole_daemon_end(), or 0. timeout_ms: the longest time for connecting; 0 is no limit. It
 * covers neither the look-up of a host name nor the start of a daemon. Failures are of kind
 * CONNECT. */
bool libdipole_connect(const libdipole_address *address, unsigned timeout_ms, int *fd,
                       pid_t *daemon, dipole_error *error);

/* Waits until a private daemon has ended, whose connection the caller has closed. Sends SIGTERM
 * after 5 s and SIGKILL after 10 s. */
void libdipole_daemon_end(pid_t daemon);

#endif
