/* metrics: serves /metrics, in the text format of Prometheus, and /healthz and /readyz over HTTP.
 * The server has its own thread, which reads the workers' counters and never waits for a
 * worker. */
#ifndef DIPOLED_METRICS_H
#define DIPOLED_METRICS_H

#include "server/server.h"

struct metrics;

/* Listens at [HOST]:PORT, where no HOST means the loopback interface, and logs the address. Call
 * this after the workers have started. On failure, prints a message to standard error and returns
 * NULL. */
struct metrics *metrics_open(struct server *server, const char *address);

/* Stops the server and cuts off replies that are not complete. `metrics` may be NULL. */
void metrics_close(struct metrics *metrics);

#endif
