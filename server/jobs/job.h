/* job: what every request is while it is being answered, whatever its message.
 *
 * Each message of proto/messages.def has one `struct job_kind`, named job_kind_<IDENT>. Whoever
 * answers requests (server/jobs/requests.c for the binary protocol, server/modbus for registers)
 * calls these functions, and knows nothing else of a kind of job:
 *
 *   start() checks the request. It returns JOB_NEXT_PART if the size of the reply is known, or
 *   JOB_GOES_ON if that takes steps. begin_part() is then given room for part_bytes, and step() is
 *   called until the part is complete. A reply that is larger than a frame has several parts, so
 *   that step() returns JOB_NEXT_PART again. After JOB_DONE or JOB_REFUSED, end() releases what the
 *   job holds.
 *
 * For example, an eval: start -> NEXT_PART, begin_part -> GOES_ON, step -> WAITS (its profile is
 * being prepared), step -> GOES_ON, step -> DONE, end.
 *
 * A new kind of job takes a line in proto/messages.def, its layout in proto/, and a file in
 * server/jobs/ that defines its structure and its job_kind_<IDENT>.
 */
#ifndef DIPOLED_JOB_H
#define DIPOLED_JOB_H

#include "proto/wire.h"
#include "server/jobs/batch.h"
#include "server/observe/latency.h"
#include "server/store/profiles.h"

/* What a call of a job's functions has come to. */
enum job_outcome {
  JOB_GOES_ON,   /* call step() */
  JOB_WAITS,     /* for a profile; call step() when on_ready() has been called */
  JOB_NEXT_PART, /* the part before, if any, is complete; call begin_part() for the next one */
  JOB_DONE,      /* the reply is complete after batch_finish() */
  JOB_REFUSED,   /* there will be no more of the reply; the job's refusal says why */
  JOB_DETACHED,  /* start() only: the job answers later and needs the payload no more */
};

/* A slice is as many evaluations of a dipole: about 25 to 100 microseconds. That is how long a
 * small request may have to wait while a large one is being evaluated on its worker. Profiles that
 * cost more get slices with fewer radii. */
enum { JOB_SLICE_RADII = 16384 };

/* What a step costs besides its radii, in radii: preparing a profile, or taking a frame apart. */
enum { JOB_STEP_RADII = 64 };

/* How long a client that is refused with BUSY should wait. A worker finishes what it has by then.
 */
enum { JOB_RETRY_AFTER_MS = 20 };

/* The most numbers that a slice draws: of tables, which cost least. */
enum { JOB_DRAW_RADII = JOB_SLICE_RADII / 4 };

/* What the jobs of one worker share. Only that worker's thread touches it. */
struct job_context {
  struct server *server;
  uv_loop_t *loop;
  struct latency *latency;
  struct profiles profiles;
  struct batch batch;     /* short requests, until batch_finish() writes their values */
  struct repeat repeat;   /* requests that can be answered like an earlier one */
  uint64_t owed_radii;    /* radii of a dipole that the jobs under way still have to evaluate */
  LIST_HEAD(, job) large; /* the large jobs under way: at most one of each client */
  double radii[JOB_SLICE_RADII]; /* scratch: a slice's radii where the reply has no room for them */
  double numbers[JOB_DRAW_RADII]; /* scratch: a slice's random numbers */
};

/* Why a detached job is to end early. */
enum job_stop { JOB_CANCELLED, JOB_DAEMON_STOPS };

struct job;

/* A request as it has arrived. */
struct job_request {
  const wire_header *header;
  const uint8_t *payload; /* header->payload_bytes, at a multiple of 8 */
  struct job_context *context;
  /* Called on the worker's thread: when a job that waits can go on, and when a detached job has
   * something new. */
  void (*on_ready)(void *owner);
  void (*on_news)(void *owner);
  void *owner;
  struct cache_owner *profiles; /* the client, in whose turns slow profiles are prepared */
  struct job **detached; /* the connection's list of detached jobs; NULL if there can be none */
};

/* A message of the protocol. Functions may be NULL where it says so. */
struct job_kind {
  /* Checks all of the request. The payload stays until the job ends, unless it becomes detached. A
   * detached job allocates itself and appears in request->detached. Returns any outcome but DONE
   * and WAITS; end() is called unless the outcome is REFUSED or DETACHED. */
  enum job_outcome (*start)(struct job *job, const struct job_request *request);

  /* Writes to part_bytes at a multiple of 8. The room stays until the part is complete. Returns
   * GOES_ON or DONE. */
  enum job_outcome (*begin_part)(struct job *job, uint8_t *payload);

  /* Works for about one slice at most and subtracts what that cost, in radii of a dipole, from
   * *budget, down to 0. Returns any outcome but DETACHED. NULL if begin_part() completes the
   * reply. */
  enum job_outcome (*step)(struct job *job, uint64_t *budget);

  /* Releases what the job holds or waits for, whether it is complete or given up. NULL if it holds
   * nothing. */
  void (*end)(struct job *job);

  /* Has a detached job end soon with what it has. NULL if jobs of this kind are never detached. */
  void (*stop)(struct job *job, enum job_stop why);
};

/* Every kind's own structure begins with this. */
struct job {
  const struct job_kind *kind;
  struct job_context *context;
  wire_header header;  /* of the request */
  uint64_t part_bytes; /* with JOB_NEXT_PART: what begin_part() needs */
  uint64_t owed_radii; /* this job's part of context->owed_radii */
  bool rests;          /* owed_radii is not counted in the context at the moment */
  bool large;          /* is in the context's list */
  LIST_ENTRY(job) in_large;
  enum latency_class latency;
  struct job *next;   /* detached: in the connection's list */
  bool reader_idle;   /* detached: nothing else waits to be written, so that progress may be */
  wire_error refusal; /* set with JOB_REFUSED */
};

/* Room for a job of any kind. Each kind asserts that its structure fits. */
enum { JOB_SLOT_BYTES = 1600 };

struct job_slot {
  _Alignas(16) uint8_t bytes[JOB_SLOT_BYTES];
};

#define JOB_FITS_SLOT(type) _Static_assert(sizeof(type) <= JOB_SLOT_BYTES, "a job fits its slot")

/* Starts a job in a slot that no job is in; *job is that slot then. Returns what the kind's start()
 * returns, or REFUSED for an unknown message. */
enum job_outcome job_start(struct job_slot *slot, const struct job_request *request,
                           struct job **job);

/* Ends a job that start() has neither refused nor detached: it owes nothing any more, and has
 * released what it held. */
void job_end(struct job *job);

/* Prepares a lookup of profiles for a job. The request says whom to call when the job can go on. */
void job_init_lookup(struct profiles_lookup *lookup, const struct job_request *request);

/* ---- admission control ------------------------------------------------------------------------
 */

/* Adds what the job will have to evaluate to what its worker owes; radii: of any size.
 *
 * A large job is refused with BUSY and `field` if the other large jobs would delay it by
 * max_backlog_ms or more. Clients take turns. So each other job delays it by at most what that job
 * still owes, and by at most what the new job costs itself. Besides, none counts for more than
 * 1/JOB_BACKLOG_SHARES of max_backlog_ms: so a few clients with endless work keep nobody out.
 *
 * A small job is always admitted. */
enum { JOB_BACKLOG_SHARES = 16 };
wire_error job_admit(struct job *job, double radii, const char *field);

/* The job has evaluated so many radii. */
void job_pay(struct job *job, uint64_t radii);

/* While a slow reader keeps a job from going on, what it owes keeps nobody else out. */
void job_rest(struct job *job);
void job_resume(struct job *job);

/* ---- refusals ---------------------------------------------------------------------------------
 */

/* Sets the refusal and returns JOB_REFUSED. */
enum job_outcome job_refuse(struct job *job, wire_error refusal);

/* BAD_VALUE, for what core found to be wrong. */
wire_error job_error(core_fault fault);

/* The error of a fault in preparing a channel: BUSY if it may succeed later, else BAD_VALUE. */
wire_error job_fault(core_fault fault, uint32_t channel);

/* BUSY: the budget of all buffers is exhausted. */
wire_error job_busy(void);

/* BAD_LENGTH, for a payload that does not have the size that is allowed. */
wire_error job_bad_length(const char *allowed);

/* TOO_LARGE: "at most MOST WHAT". */
wire_error job_too_large(const char *field, uint64_t most, const char *what);

#define WIRE_MESSAGE(type, IDENT, name) extern const struct job_kind job_kind_##IDENT;
#include "proto/messages.def"

#endif
