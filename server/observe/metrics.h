/* metrics: what the daemon tells of itself, over HTTP: /metrics in Prometheus' text format, and
 * /healthz. On a thread of its own; the workers are not asked, only read. */
#ifndef DIPOLED_METRICS_H
#define DIPOLED_METRICS_H

#include "server/server.h"

struct metrics;

/* Listens at [HOST]:PORT (without a host on the loopback interface) and logs the address; the
 * workers have started. NULL, with a message on standard error, when that cannot be done. */
struct metrics *metrics_open(struct server *server, const char *address);

/* Ends all answers under way; may be NULL. */
void metrics_close(struct metrics *metrics);

#endif
