/* echo: a server that does as little as possible, for comparison. It counts the bytes that arrive
 * and writes a fixed reply for each target->request_bytes of them, with the request's id if the
 * target is framed. It is a plain loop of epoll_wait(), read() and write() in a process of its own
 * on the servers' core. A server with the same sizes that takes longer spends the difference on its
 * own work. */
#ifndef DIPOLED_BENCH_SERVICE_ECHO_H
#define DIPOLED_BENCH_SERVICE_ECHO_H

#include "tests/bench/service/target.h"

/* Starts a server at target->address that runs until the benchmark ends. If it is a TCP address
 * with port 0, target->address gets the port that the system chose. */
void echo_start(struct target *target);

#endif
