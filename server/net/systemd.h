/* systemd: takes the sockets that a service manager passes, and notifies the manager, as the protocols
 * of sd_listen_fds(3) and sd_notify(3) say. */
#ifndef DIPOLED_SYSTEMD_H
#define DIPOLED_SYSTEMD_H

enum {
  SYSTEMD_FIRST_SOCKET = 3,
  SYSTEMD_SOCKETS_MAX = 32,
};

/* Returns how many descriptors the manager has passed, from SYSTEMD_FIRST_SOCKET on, or -1 if that is
 * no number up to SYSTEMD_SOCKETS_MAX. The caller closes the descriptors. */
int systemd_sockets(void);

/* Notifies the manager, if one waits for that. Ignores failures, because the manager has then ended.
 * state: lines NAME=VALUE */
void systemd_tell(const char *state);

#endif
