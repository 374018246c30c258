/* ping: measures round trips over one connection with one request at a time. The socket blocks, so
 * that the client makes as few system calls as possible. */
#ifndef DIPOLED_BENCH_SERVICE_PING_H
#define DIPOLED_BENCH_SERVICE_PING_H

#include "tests/bench/service/samples.h"
#include "tests/bench/service/target.h"

struct ping {
  const struct target *target;
  int fd;
  uint8_t *requests; /* a copy of the target's requests, with ids */
  uint8_t *reply;
  uint64_t count; /* number of requests so far */
};

/* Connects. The caller keeps the target and frees it after ping_close(). */
void ping_open(struct ping *ping, const struct target *target);
void ping_close(struct ping *ping);

/* Sends requests for about duration_ns, and at least one. Replaces the contents of *samples by the
 * sorted round trips. */
void ping_run(struct ping *ping, uint64_t duration_ns, struct samples *samples);

#endif
