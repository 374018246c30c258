/* echo: the least that a server can do. It counts the bytes that arrive and, for each
 * target->request_bytes of them, writes the one reply that there is, with the request's id if it is
 * framed: the plainest loop of epoll_wait(), read() and write(), in a process of its own on the
 * servers' core. What a server of the same sizes takes beyond this is its own doing. */
#ifndef DIPOLED_BENCH_SERVICE_ECHO_H
#define DIPOLED_BENCH_SERVICE_ECHO_H

#include "tests/bench/service/target.h"

/* Serves target, at its address (a TCP address gets its port), until the benchmark ends. */
void echo_start(struct target *target);

#endif
