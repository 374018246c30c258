/* answer: a connection's requests, from a frame that has arrived to the end of its answer, step by
 * step; how bytes come and go is connection.c's. On the worker's thread. */
#ifndef DIPOLED_ANSWER_H
#define DIPOLED_ANSWER_H

#include "server/net/connection.h"

/* Of a new connection. */
void answer_init(struct connection *c);

/* Lets go of whatever is under way. */
void answer_end(struct connection *c);

/* A request has been taken up, and its answer is not complete: its frame stays in the input. */
bool answer_is_under_way(const struct connection *c);

/* Part of the output has been reserved and is being filled in. */
bool answer_holds_output(const struct connection *c);

/* One step of the work at hand, which may be to take up the next frame; what it costs is subtracted
 * from *budget, down to 0. False: there is nothing to do. */
bool answer_step(struct connection *c, uint64_t *budget);

/* What waits is answered with DEADLINE if it is late. */
void answer_deadline(struct connection *c);

#endif
