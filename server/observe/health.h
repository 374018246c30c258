/* health: whether the daemon serves, and whether new clients should come to it: what /healthz and
 * /readyz respond at --metrics and --http. Any thread may call these functions. */
#ifndef DIPOLED_HEALTH_H
#define DIPOLED_HEALTH_H

#include "proto/wire.h"
#include "server/server.h"

enum {
  HEALTH_STALLED_MS = 3000,  /* the silence after which the workers count as stalled */
  HEALTH_OVERLOAD_MS = 1000, /* how long the daemon is overloaded after it has refused a request */
};

enum health {
  HEALTH_OK,
  HEALTH_DRAINING,
  HEALTH_STALLED,
  HEALTH_OVERLOADED, /* reported by health_readiness() alone */
};

/* Returns whether the daemon serves. It does not while it drains, or while all workers are busy
 * with a single turn. */
enum health health_of(const struct server *server);

/* Returns whether the daemon serves and has capacity for more clients. */
enum health health_readiness(const struct server *server);

/* The name of each, as ok, and the reason: a sentence, or empty. */
extern const struct health_text { const char *name, *reason; } health_texts[];

/* Notes that a request or a connection was refused. Only BUSY for lack of the daemon's capacity
 * counts: a client that exceeds its own share does not make the daemon overloaded. */
void health_note_refusal(struct server *server, const wire_error *error);

#endif
