/* systemd: the sockets that a service manager passes, and what it is told, through libsystemd. The
 * library is loaded only where a service manager has set its variables: a daemon that is started in
 * any other way does without, and so does a system that has none. */
#ifndef DIPOLED_SYSTEMD_H
#define DIPOLED_SYSTEMD_H

#include <stdbool.h>

/* SYSTEMD_FUNCTION(name, parameters): every one that is used, as sd-daemon.h declares it. All
 * return an int. */
#define SYSTEMD_FUNCTIONS                                                                          \
  SYSTEMD_FUNCTION(listen_fds, (int unset_environment))                                            \
  SYSTEMD_FUNCTION(notify, (int unset_environment, const char *state))

/* All zero: nobody passes sockets or waits for word. */
struct systemd {
#define SYSTEMD_FUNCTION(name, parameters) int(*name) parameters;
  SYSTEMD_FUNCTIONS
#undef SYSTEMD_FUNCTION
};

enum { SYSTEMD_SOCKETS_MAX = 32 };

/* Loads the library if it is needed; it stays loaded. False: sockets are passed, and cannot be had;
 * *why says why. A manager that only waits for word is no reason to fail: that goes to the log. */
bool systemd_open(struct systemd *systemd, const char **why);

/* How many descriptors were passed, from *first on; the caller's to close. At most
 * SYSTEMD_SOCKETS_MAX; -1: *why says why. */
int systemd_sockets(const struct systemd *systemd, int *first, const char **why);

/* Tells the manager that all addresses are served, or that the daemon stops. */
void systemd_tell_ready(const struct systemd *systemd);
void systemd_tell_stopping(const struct systemd *systemd);

#endif
