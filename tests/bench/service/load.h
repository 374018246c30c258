/* load: sends requests over many connections, with many requests in flight on each. It uses
 * non-blocking sockets and epoll. Each answer is followed by a new request, which measures how many
 * requests a server can answer. */
#ifndef DIPOLED_BENCH_SERVICE_LOAD_H
#define DIPOLED_BENCH_SERVICE_LOAD_H

#include "tests/bench/service/samples.h"
#include "tests/bench/service/target.h"

struct load;

/* Opens the connections. Each may have in_flight unanswered requests, at most 4096. The caller
 * keeps the target and frees it after load_free(). */
struct load *load_new(const struct target *target, size_t connections, size_t in_flight);
void load_free(struct load *load);

/* Keeps in_flight requests in flight on every connection for duration_ns, and returns when the last
 * one is answered. Replaces the contents of *samples by the sorted latencies. Returns the number of
 * answers per second that arrived within duration_ns. */
double load_closed(struct load *load, uint64_t duration_ns, struct samples *samples);

#endif
