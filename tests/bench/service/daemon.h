/* daemon: the dipoled beside this program, on the servers' core, with its defaults but for the
 * number of workers. */
#ifndef DIPOLED_BENCH_SERVICE_DAEMON_H
#define DIPOLED_BENCH_SERVICE_DAEMON_H

#include "tests/bench/service/target.h"

struct daemon {
  pid_t child;
  struct target_address at_unix;
  struct target_address at_tcp;
  struct target_address at_modbus;
};

/* name: of its socket, in the temporary folder. Returns when it is ready. */
void daemon_start(struct daemon *daemon, const char *name, unsigned workers);
void daemon_end(struct daemon *daemon);

#endif
