/* load: a generator of requests over many connections with many requests in flight on each, over
 * non-blocking sockets and epoll.
 *
 * Closed loop: each answer is followed by a request; what it measures is how much a server does.
 * Open loop: requests are due at a fixed rate, whatever the server does, and a latency is counted
 * from when its request was due, not from when it could be sent (otherwise a server that stops for
 * a second would have one late answer in place of all that were due in that second).
 */
#ifndef DIPOLED_BENCH_SERVICE_LOAD_H
#define DIPOLED_BENCH_SERVICE_LOAD_H

#include "tests/bench/service/samples.h"
#include "tests/bench/service/target.h"

struct load;

/* Connects. in_flight: requests that a connection may have under way, at most 4096. The target
 * stays the caller's. */
struct load *load_new(const struct target *target, size_t connections, size_t in_flight);
void load_free(struct load *load);

/* All connections have all their requests in flight for duration_ns; returns when the last is
 * answered. *samples is cleared, and then has the latencies, sorted. The answers per second that
 * arrived within duration_ns. */
double load_closed(struct load *load, uint64_t duration_ns, struct samples *samples);

/* Requests at an even rate for duration_ns, over the connections in turn; returns when the last is
 * answered. Samples likewise. */
void load_open(struct load *load, double rate_per_s, uint64_t duration_ns, struct samples *samples);

#endif
