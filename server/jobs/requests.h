/* requests: answers the requests of one connection, each from its frame in the input to its reply
 * or refusal in the output. One request at a time holds the input, because its job uses the payload
 * in place. A detached job does not hold the input and answers when it can. A request that takes long
 * is kept beside the input, and so are those of its kind behind it, so that a cancel request is found
 * that names one of them.
 *
 * This module frames all replies and refusals. It knows neither the connection, which moves the
 * bytes, nor any kind of job (server/jobs/job.h). Call it on the worker's thread only.
 */
#ifndef DIPOLED_REQUESTS_H
#define DIPOLED_REQUESTS_H

#include "server/jobs/job.h"
#include "server/net/buffers.h"
#include "server/net/roles.h"

/* A request that is kept beside the input. */
struct aside {
  struct aside *next;
  wire_header header;
  uint64_t arrived_ns;
  struct input_block block;
};

/* The requests of one connection. The owner sets all members to 0 and calls requests_init(). Before
 * the first step, it sets `context` and `profiles`. */
struct requests {
  struct job_context *context;  /* of the worker */
  struct cache_owner *profiles; /* the client, whose turns are used to prepare slow profiles */
  struct input *input;
  struct output *output;
  void (*wake)(void *owner); /* called when requests_step() can go on after it returned false */
  void *owner;
  /* Set by the owner after requests_init(), or NULL. Is called when requests_end() ends the
   * connection with an error. */
  void (*tell_end)(void *owner, const wire_error *error);

  bool whole; /* whether each answer has to be one part, as far as its size allows */

  unsigned roles; /* of the client (server/net/roles.h): all of them, unless the owner says less */

  struct job *job;   /* the job that answers in turn; NULL if there is none */
  struct aside *own; /* its request, if that is beside the input; NULL: it holds the input */
  struct aside *waiting_aside; /* the list of further ones, which come before those in the input */
  struct aside **aside_end;    /* where the next one is linked to */
  unsigned aside_count;        /* of the list */
  uint64_t aside_bytes;
  struct job_slot slot;
  struct job *detached;  /* the list of detached jobs */
  struct points *points; /* the set of points that the client is sending; NULL if there is none */
  bool waiting;          /* whether the job waits for a profile */
  bool part_open;        /* whether the output has a reservation that the job is filling in */
  bool between_parts;    /* whether the next part waits until the reader has made room */
  bool ended;            /* whether no more frames are taken */
  bool no_room;         /* whether not even an error fitted into the output: abort the connection */
  uint64_t taken;       /* number of frames taken so far */
  uint64_t arrived_ns;  /* when the request of the job had arrived */
  uint64_t deadline_ms; /* of the request of the job, on the loop's clock; 0 if it has none */
};

void requests_init(struct requests *requests, struct input *input, struct output *output,
                   void (*wake)(void *owner), void *owner);

/* Returns how many requests have arrived completely and are not answered, or whose answers are not
 * written completely. */
unsigned requests_count(const struct requests *requests);

/* Returns whether the next frame may be taken as soon as it has arrived, so that nothing in the input
 * is in use. */
bool requests_take_on(struct requests *requests);

/* Gives up all jobs at once, without answers. */
void requests_drop(struct requests *requests);

/* Gives up the set of points that the client is sending, if it takes too long. */
void requests_trim(struct requests *requests, uint64_t now_ms);

/* Does one step: takes the next frame, or goes on with the current job. Subtracts the cost of the
 * step from *budget, down to 0. Returns false if there is nothing to do. */
bool requests_step(struct requests *requests, uint64_t *budget);

/* Lets detached jobs write their results into the output, and reports of progress if the output is
 * empty. Does nothing while another job has a part open. */
void requests_step_detached(struct requests *requests);

/* Returns when the caller should call requests_expire(); 0 if no waiting request has a deadline. */
uint64_t requests_deadline_ms(const struct requests *requests);

/* If the deadline of the waiting request has passed, answers with DEADLINE and returns true. */
bool requests_expire(struct requests *requests);

/* Makes all detached jobs end soon. Returns whether there are any. */
bool requests_stop_detached(struct requests *requests, enum job_stop why);

/* Writes a refusal, with the id of a request or 0. Returns false if the output has no room. */
bool requests_refuse(struct requests *requests, uint64_t request_id, const wire_error *error);

/* Writes a refusal like requests_refuse(), takes no more frames, and drops all detached jobs. */
void requests_end(struct requests *requests, uint64_t request_id, wire_error error);

#endif
