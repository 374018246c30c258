/* ping: one connection with one request at a time, over a blocking socket: the round trip with the
 * fewest system calls that a client can make. */
#ifndef DIPOLED_BENCH_SERVICE_PING_H
#define DIPOLED_BENCH_SERVICE_PING_H

#include "tests/bench/service/samples.h"
#include "tests/bench/service/target.h"

struct ping {
  const struct target *target;
  int fd;
  uint8_t *requests; /* the target's, with ids */
  uint8_t *reply;
  uint64_t count; /* requests so far */
};

/* Connects; the target stays the caller's. */
void ping_open(struct ping *ping, const struct target *target);
void ping_close(struct ping *ping);

/* Asks for about duration_ns, once at the least; *samples is cleared, and then has a round trip for
 * each request, sorted. */
void ping_run(struct ping *ping, uint64_t duration_ns, struct samples *samples);

#endif
