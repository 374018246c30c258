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
};

/* Starts the daemon and returns when it is ready. name is the file name of its Unix socket in the
 * temporary folder. */
void daemon_start(struct daemon *daemon, enum child_side side, const char *name, unsigned workers);

void daemon_end(struct daemon *daemon);

#endif
