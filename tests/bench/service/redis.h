/* redis: a redis-server of our own on the servers' core, without persistence, that holds values of
 * 64 bytes, which is what 16 radii take in single precision. */
#ifndef DIPOLED_BENCH_SERVICE_REDIS_H
#define DIPOLED_BENCH_SERVICE_REDIS_H

#include "tests/bench/service/target.h"

/* Starts it, fills it, and makes the target, GETs of values that exist. False, with a message:
 * there is no redis-server in PATH. */
bool redis_start(struct target *target);

#endif
