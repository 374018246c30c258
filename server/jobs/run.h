/* run: one job under way, from its start to its last part or its refusal, whoever requests it: a
 * connection of the binary protocol, or a call (server/jobs/call.h) of HTTP, SCPI or a Modbus unit. That
 * one is the sink, which has room for the parts and is told of the end. The run knows deadlines and how to give a job up; the
 * sink knows turns. Call all functions on the worker's thread.
 */
#ifndef DIPOLED_RUN_H
#define DIPOLED_RUN_H

#include "server/jobs/job.h"

struct run;

struct run_sink {
  /* Returns room for job->part_bytes at a multiple of 8, which stays valid until the part is complete
   * and the batch has been evaluated. Returns NULL and sets *error if there is none. */
  uint8_t *(*reserve)(void *owner, const struct job *job, wire_error *error);
  void (*commit)(void *owner, bool last); /* called when a part is complete; or NULL */
  void (*cancel)(void *owner);            /* called when a part is given up; or NULL */
  void (*wake)(void *owner);              /* called when a job that waited can continue */
  /* called at the end; refusal NULL: the reply is complete */
  void (*end)(struct run *run, const wire_error *refusal);
  bool waits_for_room; /* whether a part without room is begun later; else the job is refused */
};

enum run_state {
  RUN_IDLE,    /* there is no job */
  RUN_GOES_ON, /* call run_step() */
  RUN_WAITS,   /* for a profile or for threads: wake() tells when the job continues */
  RUN_HAS_PART /* between two parts, or before the first: call run_step() when there is room */
};

struct run {
  const struct run_sink *sink;
  void *owner;
  enum run_state state;
  bool part_open;             /* whether a part has been reserved and is not complete */
  uint64_t deadline_ms;       /* on the loop's clock, in ms; 0: none */
  enum latency_class latency; /* class in the statistics of latency; set at the end */
  struct job_slot *slot;      /* lent by the worker unless the state is RUN_IDLE */
  struct job *job;            /* the job in the slot */
};

/* Prepares a run whose state is RUN_IDLE. */
void run_init(struct run *run, const struct run_sink *sink, void *owner);

/* Frees the slots that a worker has kept for further jobs. */
void run_free_slots(struct job_context *context);

/* Starts the job of a request, whose on_ready and owner this sets. The state is RUN_IDLE after it if
 * the sink has been told of the end. */
void run_start(struct run *run, struct job_request *request, uint64_t deadline_ms);

/* Does one step of a job that continues or has a part. Subtracts its cost from *budget, down to
 * 0. */
void run_step(struct run *run, uint64_t *budget);

/* Does steps until the budget is spent, the job waits, or it has ended. */
void run_on(struct run *run, uint64_t *budget);

/* Ends the job with a refusal, or, if that is NULL, with its last part. */
void run_end(struct run *run, const wire_error *refusal);

/* Returns whether there is a deadline that has passed, also before the start. */
bool run_is_late(const struct run *run, const struct job_context *context);

/* If the deadline has passed, ends the job with DEADLINE and returns true. */
bool run_expire(struct run *run);

/* Ends the job, if there is one, without telling the sink. */
void run_drop(struct run *run);

#endif
