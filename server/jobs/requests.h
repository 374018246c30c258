/* requests: the requests of one connection, each from its frame in the input to its reply or
 * refusal in the output. One request at a time holds the input; detached jobs answer when they can.
 *
 * This module frames all replies and refusals. It knows neither the connection, which moves the
 * bytes, nor any kind of job (server/jobs/job.h). Call it on the worker's thread only.
 */
#ifndef DIPOLED_REQUESTS_H
#define DIPOLED_REQUESTS_H

#include "server/jobs/job.h"
#include "server/net/buffers.h"

/* Zeroed, except for what requests_init() sets. */
struct requests {
  struct job_context *context;  /* of the worker; set by the owner before the first step */
  struct cache_owner *profiles; /* in whose turns slow profiles are prepared; set likewise */
  struct input *input;
  struct output *output;
  void (*wake)(void *owner); /* called when requests_step() has something to do again */
  void *owner;

  struct job *job; /* its request holds the input; NULL if no request does */
  struct job_slot slot;
  struct job *detached; /* jobs that answer later */
  bool waiting;         /* the job waits for a profile */
  bool part_open;       /* the output has a reservation, which the job is filling in */
  bool between_parts;   /* the next part begins when the reader has made room */
  bool ended;           /* no more frames are taken */
  bool no_room;         /* not even an error fitted into the output: abort the connection */
  uint64_t taken;       /* frames so far */
  uint64_t arrived_ns;  /* when the request that is being answered had arrived */
  uint64_t deadline_ms; /* of that request, on the loop's clock; 0 if it has none */
};

void requests_init(struct requests *requests, struct input *input, struct output *output,
                   void (*wake)(void *owner), void *owner);

/* Gives up all jobs at once, without a word. */
void requests_drop(struct requests *requests);

/* Does one step: takes the next frame, or goes on with its job. Subtracts what that cost from
 * *budget, down to 0. Returns false if there is nothing to do. */
bool requests_step(struct requests *requests, uint64_t *budget);

/* Puts what detached jobs have to say into the output, unless a job is filling it in: results, and
 * progress when nothing else waits to be written. */
void requests_step_detached(struct requests *requests);

/* The time at which requests_expire() should be called; 0 if nothing waits for a deadline. */
uint64_t requests_deadline_ms(const struct requests *requests);

/* Answers the request that waits with DEADLINE if it is late; returns whether it was. */
bool requests_expire(struct requests *requests);

/* Has all detached jobs end soon; returns whether there are any. */
bool requests_stop_detached(struct requests *requests, enum job_stop why);

/* Refuses a request, with its id or 0; there may be no room to say so, which returns false. */
bool requests_refuse(struct requests *requests, uint64_t request_id, const wire_error *error);

/* Refuses likewise, takes no more frames, and drops all detached jobs. */
void requests_end(struct requests *requests, uint64_t request_id, wire_error error);

#endif
