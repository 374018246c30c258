/* requests: serves the requests of one connection, each from its frame in the input to its reply
 * or refusal in the output. One request at a time is served in its turn, because its job uses the
 * payload in place. Requests that take long (job_kind.detached) leave the input, and those behind them
 * are served meanwhile.
 *
 * This module frames all replies and refusals. It knows neither the connection, which moves the
 * bytes, nor any kind of job (server/jobs/job.h). Call it on the worker's thread only.
 */
#ifndef DIPOLED_REQUESTS_H
#define DIPOLED_REQUESTS_H

#include "server/jobs/run.h"
#include "server/net/buffers.h"

struct detached;

/* The requests of one connection. The owner sets all members to 0 and calls requests_init(). Before
 * the first step, it sets `context` and `profiles`. */
struct requests {
  struct job_context *context;  /* context of the worker */
  struct cache_owner *profiles; /* the client, whose turns are used to prepare slow profiles */
  struct input *input;
  struct output *output;
  void (*wake)(void *owner); /* called when requests_step() can go on after it returned false */
  void *owner;
  /* Is called when requests_end() ends the connection with an error. */
  void (*tell_end)(void *owner, const wire_error *error);

  unsigned roles; /* roles of the client (server/net/roles.h) */

  struct run run;      /* the request that is served in its turn, which is the first in the input */
  wire_header header;  /* header of the request that is being served */
  uint64_t arrived_ns; /* when that request had arrived */
  TAILQ_HEAD(, detached) detached; /* in the order of their turns */
  unsigned detached_count;
  uint64_t detached_bytes; /* bytes of their payloads */
  bool blocked;            /* whether the next frame waits until a detached request ends */
  struct points *points;   /* the set of points that the client is sending; NULL if there is none */
  bool ended;              /* whether frames are no longer accepted */
  bool no_room;   /* whether not even an error fitted into the output: abort the connection */
  uint64_t taken; /* number of frames taken so far */
};

void requests_init(struct requests *requests, struct input *input, struct output *output,
                   void (*wake)(void *owner), void *owner);

/* Returns whether a request is under way. */
static inline bool requests_wait(const struct requests *requests) {
  return requests->run.state != RUN_IDLE || requests->detached_count > 0;
}

/* Returns whether the first frame of the input is in use, or waits. */
static inline bool requests_hold_input(const struct requests *requests) {
  return requests->run.state != RUN_IDLE || requests->blocked;
}

/* Drops all jobs at once, without replies. */
void requests_drop(struct requests *requests);

/* Gives up the set of points that the client is sending, if it takes too long. */
void requests_trim(struct requests *requests, uint64_t now_ms);

/* Does one step: takes the next frame, or continues with the request that is served in its turn.
 * Subtracts the cost of the step from *budget, down to 0. Returns false if there is nothing to do. */
bool requests_step(struct requests *requests, uint64_t *budget);

/* Lets detached requests go on until the budget is spent, and write into the output what they have,
 * unless the other request has a part open. Returns whether there is more to do. */
bool requests_step_detached(struct requests *requests, uint64_t *budget);

/* Returns when the caller should call requests_expire(); 0 if no waiting request has a deadline. */
uint64_t requests_deadline_ms(const struct requests *requests);

/* Refuses waiting requests whose deadline has passed. Returns whether there were any. */
bool requests_expire(struct requests *requests);

/* Refuses the requests that wait for a preparation; all: every request that is under way. Returns
 * whether there were any. */
bool requests_give_up(struct requests *requests, const wire_error *error, bool all);

/* Returns the header of a request that is under way or detached; NULL if there is none. */
const wire_header *requests_under_way(const struct requests *requests);

/* Makes detached requests end soon that can end with a part of their results. Returns whether there
 * are any detached requests. */
bool requests_stop_detached(struct requests *requests, enum job_stop why);

/* Writes a refusal, with the id of a request or 0. Returns false if the output has no room. */
bool requests_refuse(struct requests *requests, uint64_t request_id, const wire_error *error);

/* Writes a refusal like requests_refuse(), takes no more frames, and drops all detached requests. */
void requests_end(struct requests *requests, uint64_t request_id, wire_error error);

#endif
