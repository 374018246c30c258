/* systemd: takes the sockets that a service manager passes, and notifies the manager, through
 * libsystemd. The library is loaded only if a service manager has set its variables, so that
 * dipoled also runs on systems without libsystemd. */
#ifndef DIPOLED_SYSTEMD_H
#define DIPOLED_SYSTEMD_H

#include <stdbool.h>

/* SYSTEMD_FUNCTION(name, parameters) for every function that is used, as sd-daemon.h declares it.
 * All of them return an int. */
#define SYSTEMD_FUNCTIONS                                                                          \
  SYSTEMD_FUNCTION(listen_fds, (int unset_environment))                                            \
  SYSTEMD_FUNCTION(notify, (int unset_environment, const char *state))

/* The functions of libsystemd. All are NULL if no service manager passes sockets or waits for
 * notifications. */
struct systemd {
#define SYSTEMD_FUNCTION(name, parameters) int(*name) parameters;
  SYSTEMD_FUNCTIONS
#undef SYSTEMD_FUNCTION
};

enum { SYSTEMD_SOCKETS_MAX = 32 };

/* Loads the library if it is needed; it stays loaded. If it cannot be loaded: returns false and
 * sets *why if a manager passes sockets, and only logs this if a manager waits for notifications.
 */
bool systemd_open(struct systemd *systemd, const char **why);

/* Returns how many descriptors the manager has passed, at most SYSTEMD_SOCKETS_MAX, and sets *first
 * to the first of them. The caller closes the descriptors. On failure, returns -1 and sets *why. */
int systemd_sockets(const struct systemd *systemd, int *first, const char **why);

/* These notify the manager that the daemon serves all addresses, and that it stops. */
void systemd_tell_ready(const struct systemd *systemd);
void systemd_tell_stopping(const struct systemd *systemd);

#endif
