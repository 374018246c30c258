/* job: one eval request being answered, slice by slice. Independent of how requests arrive. */
#ifndef DIPOLED_JOB_H
#define DIPOLED_JOB_H

#include "proto/eval.h"
#include "server/profiles.h"
#include "server/repeat.h"

/* A slice's evaluations of a dipole: about 25 to 100 microseconds, which is what a small request may
 * have to wait for when a large one is being evaluated on its worker. Costlier profiles get slices
 * with fewer radii. */
enum { JOB_SLICE_RADII = 16384 };

/* What a step costs besides, in radii: preparing a profile, or taking a frame apart. */
enum { JOB_STEP_RADII = 64 };

/* What a client that is told BUSY should wait: long enough for a worker to finish what it has. */
enum { JOB_RETRY_AFTER_MS = 20 };

struct job_scratch;

struct job {
  eval_request request;
  core_grid grid;
  eval_layout layout;
  uint8_t *reply;              /* payload of the part, layout.payload_bytes */
  struct profiles_order order; /* for the profile of the channel being evaluated */
  uint64_t part_radii;         /* in each part of the reply but the last */
  uint64_t first;              /* radius of the part that is being filled in */
  uint64_t count;              /* of its radii */
  uint32_t part;               /* its number, */
  uint32_t part_count;         /* and how many there are */
  uint32_t channel;
  uint64_t index;      /* the next radius of that channel in the part */
  uint64_t owed_radii; /* its share of the worker's, */
  bool rests;          /* which does not hold it at the moment */
  bool radii_done;
  unsigned notes;     /* of the channels so far */
  double tolerance;   /* that was asked for instead of a model; NAN: a model was */
  double model_error; /* of what was chosen for it */
  size_t choice;      /* how many candidates have been tried */
  bool covers_all;    /* radii: the model does */
  wire_error refusal;
};

/* Checks all of a request before any of it is evaluated; the payload has to stay while the job
 * runs. OK: layout.payload_bytes says what the reply, or its first part, needs. */
wire_error job_check(struct job *job, const struct server *server, const uint8_t *payload,
                     size_t payload_bytes);

/* What could answer a request of model EVAL_ANY_MODEL. */
struct choice;
wire_error job_offers(const struct server *server, const uint8_t *payload, size_t payload_bytes,
                      struct choice *choice);

/* Starts to fill in the reply, or its first part, which starts at a multiple of 8. */
void job_start(struct job *job, uint8_t *reply);

/* After JOB_PART_DONE: layout says what the next part needs; then it is begun there. */
void job_next_part(struct job *job);
void job_start_part(struct job *job, uint8_t *reply);

/* BUSY for a large job while the worker has more to do than max_backlog_ms; small ones are always
 * taken: they take turns with the large ones. Otherwise what the job owes is noted. */
wire_error job_admit(struct job *job, const struct server *server, struct job_scratch *scratch);

/* It owes nothing any more. */
void job_forgive(struct job *job, struct job_scratch *scratch);

/* Between parts, while the reader does not keep up: what is not being worked on keeps nobody else
 * from being admitted; and when it goes on. */
void job_rest(struct job *job, struct job_scratch *scratch);
void job_resume(struct job *job, struct job_scratch *scratch);

/* Lets go of what a job holds or waits for that is given up before its reply is complete, or that
 * is. A job that has not been started is all 0, but for who is told: order.on_ready. */
void job_end(struct job *job);

/* What the jobs of a worker share: room for a slice's radii, for grids whose radii are not wanted; and
 * what is short is gathered, and is in the replies after batch_finish(). */
struct job_scratch {
  double radii[JOB_SLICE_RADII];
  struct batch batch;
  struct repeat repeat;
  uint64_t owed_radii; /* that jobs under way have still to evaluate, once for each array */
};

/* BUSY, for what there are no bytes for now; and the error of a fault in preparing a channel. */
wire_error job_busy(void);
wire_error job_fault(core_fault fault, uint32_t channel);

enum job_state {
  JOB_GOES_ON,
  JOB_WAITS,     /* for a profile: goes on when order.on_ready() has been called */
  JOB_PART_DONE, /* the part is complete, and not the last */
  JOB_DONE,      /* the reply is complete */
  JOB_REFUSED,   /* there will be no reply; job->refusal says why */
};

/* Evaluates one slice and subtracts what it cost, in radii of a dipole, from *budget (down to 0).
 */
enum job_state job_slice(struct job *job, struct server *server, struct profiles *profiles,
                         struct job_scratch *scratch, uint64_t *budget);

#endif
