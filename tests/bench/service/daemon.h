/* daemon: starts the dipoled that lies beside this program. All its options except the number of
 * workers have their defaults. */
#ifndef DIPOLED_BENCH_SERVICE_DAEMON_H
#define DIPOLED_BENCH_SERVICE_DAEMON_H

#include "tests/bench/service/child.h"
#include "tests/bench/service/target.h"

struct daemon {
  pid_t child;
  struct target_address at_unix;
  struct target_address at_tcp;
  struct target_address at_modbus;
  struct target_address at_http;
  struct target_address at_tls; /* of daemon_start_tls() */
};

/* Starts the daemon and returns when it is ready. name is the file name of its Unix socket in the
 * temporary folder. */
void daemon_start(struct daemon *daemon, enum child_side side, const char *name, unsigned workers);

/* The same on the servers' core, and the daemon also listens with TLS. certificate, key: the paths of its files. */
void daemon_start_tls(struct daemon *daemon, const char *name, unsigned workers,
                      const char *certificate, const char *key);

void daemon_end(struct daemon *daemon);

#endif
