/* redis: starts a redis-server without persistence on the servers' core. It holds values of 64
 * bytes, the size of 16 radii in single precision. */
#ifndef DIPOLED_BENCH_SERVICE_REDIS_H
#define DIPOLED_BENCH_SERVICE_REDIS_H

#include "tests/bench/service/target.h"

/* Starts and fills the server, and makes a target of GETs of existing values. Prints a message and
 * returns false if there is no redis-server in PATH. */
bool redis_start(struct target *target);

#endif
