/* call: one request of a client that has no frames of its own, such as HTTP, SCPI or a Modbus unit: its
 * payload is made in memory, and the whole reply, or the refusal, is in memory when it has ended. It is
 * the sink of a run, and goes on in the turns of its client. Call all functions on the worker's thread.
 */
#ifndef DIPOLED_CALL_H
#define DIPOLED_CALL_H

#include "server/jobs/run.h"
#include "server/net/client.h"
#include "server/net/text.h"

struct call {
  struct run run;
  struct client *client;
  enum {
    CALL_NONE,
    CALL_RUNS,
    CALL_ENDS, /* its values may be in the batch; the client's finish() is called behind that */
    CALL_DONE, /* the reply is complete */
  } state;
  bool counts;         /* whether it counts in the statistics of requests */
  struct text payload; /* the client writes it before call_start() */
  struct text reply;   /* payload of the reply, or of the latest report of progress */
  wire_error error;    /* why it was refused, or OK; set when it ends */
  uint64_t arrived_ns;
  struct points *points;             /* the set that it sends, whole or not at all; NULL: none */
  void (*report)(struct call *call); /* called when a report is in `reply`; or NULL */
};

/* Prepares a call whose memory counts against this budget. */
void call_init(struct call *call, struct client *client, struct budget *budget, bool counts);

/* Starts the job of the payload. profiles: in whose turns slow profiles are prepared; deadline_ms: from
 * now on; 0: none. */
void call_start(struct call *call, enum wire_type type, struct cache_owner *profiles,
                uint64_t deadline_ms);

/* Does slices until the budget is spent, the job waits or it has ended; sees to its next turn. */
void call_on(struct call *call, uint64_t *budget);

/* Call this in the client's deadline(). */
void call_expire(struct call *call);

/* Call this in the client's finish(): returns whether the call has ended since, by its reply or by
 * `error`. */
bool call_take_end(struct call *call);

/* Returns whether the job can end soon, with its results so far: Monte Carlo. */
bool call_may_stop(const struct call *call);

/* Lets a job that runs end so, or else drops it. */
void call_stop(struct call *call, enum job_stop why);

/* Ends the job, if it runs, and forgets payload and reply. */
void call_drop(struct call *call);

/* Besides, frees their memory. */
void call_free(struct call *call);

#endif
