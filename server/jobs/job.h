/* job: the interface of all requests that are being served, whatever their message.
 *
 * Each message of proto/messages.def has one `struct job_kind`, named job_kind_<IDENT>, which says all
 * that the daemon knows of it. Its functions are called by server/jobs/run.c alone:
 *
 *   start() checks the request. It returns JOB_NEXT_PART if the size of the reply is known, or
 *   JOB_GOES_ON if that takes steps. begin_part() is then given room for part_bytes, and step() is
 *   called until the part is complete. A reply that is larger than a frame has several parts, so
 *   that step() returns JOB_NEXT_PART again. After JOB_DONE or JOB_REFUSED, end() releases what the
 *   job holds. Where the reply is one part whose first structure says its size, the job gives that
 *   to job_reply(), and put() takes the place of begin_part().
 *
 * For example, an eval: start -> NEXT_PART, begin_part -> GOES_ON, step -> WAITS (its profile is
 * being prepared), step -> GOES_ON, step -> DONE, end.
 *
 * A new kind of job takes its message in proto/messages.def, and a file in server/jobs/ that defines
 * its structure (JOB_STRUCTURE) and its job_kind_<IDENT>.
 */
#ifndef DIPOLED_JOB_H
#define DIPOLED_JOB_H

#include "proto/schema.h"
#include "server/jobs/batch.h"
#include "server/net/roles.h"
#include "server/observe/latency.h"
#include "server/store/profiles.h"

/* The outcome of a call of a job's functions. */
enum job_outcome {
  JOB_GOES_ON,   /* call step() */
  JOB_WAITS,     /* the job waits for a profile or for threads; call step() after on_ready() */
  JOB_NEXT_PART, /* the current part, if any, is complete; call begin_part() for the next one */
  JOB_DONE,      /* the reply is complete when batch_finish() returns */
  JOB_REFUSED,   /* the reply ends here; the job's refusal says why */
};

/* The work of one slice, in radii of a dipole: about 25 to 100 microseconds. A small request may
 * have to wait for one slice of a large request on its worker. A slice of a profile that costs more
 * has fewer radii. */
enum { JOB_SLICE_RADII = 16384 };

/* The cost of a step besides its radii, in radii: preparing a profile, or reading a frame. */
enum { JOB_STEP_RADII = 64 };

/* How long a client should wait after BUSY: a worker finishes a typical backlog in this time. */
enum { JOB_RETRY_AFTER_MS = 20 };

/* The most numbers that one slice draws. This many are drawn from tables, which cost least. */
enum { JOB_DRAW_RADII = JOB_SLICE_RADII / 4 };

/* The state that all jobs of one worker share. Only the thread of that worker uses it. */
struct job_context {
  struct server *server;
  struct budget *buffers; /* budget of the memory of jobs, except for replies */
  uv_loop_t *loop;
  struct latency *latency;
  struct profiles profiles;
  struct batch batch;     /* short requests that batch_finish() evaluates */
  struct repeat repeat;   /* requests that later requests may repeat */
  uint64_t owed_radii;    /* work that all running jobs still have to do, in radii of a dipole */
  LIST_HEAD(, job) large; /* the running large jobs: at most two of each client */
  SLIST_HEAD(, job_slot) free_slots; /* of run.c */
  unsigned free_slot_count;
  double radii[JOB_SLICE_RADII];  /* scratch for a slice's radii, if the reply does not hold them */
  double numbers[JOB_DRAW_RADII]; /* memory for the random numbers of a slice */
};

/* Why a detached job has to end early. */
enum job_stop { JOB_CANCELLED, JOB_DAEMON_STOPS };

struct job;

/* A request that has arrived. */
struct job_request {
  const struct job_type *type; /* type of the request; NULL: unknown */
  const wire_header *header;
  const uint8_t *payload; /* [header->payload_bytes], aligned to 8 */
  struct job_context *context;
  void (*on_ready)(void *owner); /* called on the worker's thread when a waiting job can go on */
  void *owner;
  schema_layout layout;         /* of the payload; set by job_start() for kinds with `request` */
  struct cache_owner *profiles; /* the client, whose turns are used to prepare slow profiles */
  bool whole;             /* whether the reply has to be one part, as far as its size allows */
  struct points **points; /* the set that the client is sending, *points NULL if there is none */
  /* Ends the detached requests of the connection with this id, and returns whether there were any.
   * NULL: there are none. */
  bool (*cancel)(void *canceller, uint64_t request_id);
  void *canceller;
};

/* The functions of the jobs of one message. A function may be NULL where its comment says so. */
struct job_kind {
  /* Checks the whole request. The payload stays valid until the job ends. Returns any outcome except
   * DONE and WAITS. The caller calls end() later unless the outcome is REFUSED. */
  enum job_outcome (*start)(struct job *job, const struct job_request *request);

  /* Begins to write a part to `payload`: part_bytes at a multiple of 8, which stay valid until the
   * part is complete. Returns GOES_ON or DONE. A detached job completes the part at once. NULL if the
   * job calls job_reply(). */
  enum job_outcome (*begin_part)(struct job *job, uint8_t *payload);

  /* Does at most about one slice of work and subtracts its cost, in radii of a dipole, from
   * *budget, down to 0. NULL if begin_part() completes the reply. */
  enum job_outcome (*step)(struct job *job, uint64_t *budget);

  /* Releases everything that the job holds, and ends its waiting. Also called for a job that is not
   * complete. NULL if such a job holds nothing. */
  void (*end)(struct job *job);

  /* Makes a detached job end soon with its results so far. NULL: a cancel request ends it at once. */
  void (*stop)(struct job *job, enum job_stop why);

  /* What job_start() checks before start(); NULL: start() checks the payload. */
  const schema_payload *request;

  /* For job_reply(): the reply, and what writes its parts. NULL if there are none. */
  const schema_payload *reply;
  void (*put)(struct job *job, uint8_t *parts);

  /* Whether such requests take long: a connection serves the requests behind them meanwhile. */
  bool detached;
};

/* The parts of a reply that is a list of radii, sets, media or values. */
struct job_parts {
  uint64_t most;  /* number of entries in each part except the last */
  uint64_t first; /* position in the list of the current part's first entry */
  uint64_t count; /* number of entries in the current part */
  uint64_t left;  /* number of entries after the current part */
  uint32_t part;  /* number of the current part, from 0 */
  uint32_t part_count;
  uint8_t *payload; /* of the current part */
  uint64_t index;   /* position in the part of the entry that is next */
};

/* The most bytes of the structure with which the reply of job_reply() begins. */
enum { JOB_HEAD_BYTES = 128 };

/* The first member of each kind's own job structure. */
struct job {
  const struct job_kind *kind;
  struct job_context *context;
  wire_header header;     /* header of the request */
  const uint8_t *payload; /* of the request; valid until the job ends */
  uint64_t part_bytes;    /* after JOB_NEXT_PART: the size of the part, for begin_part() */
  uint64_t owed_radii;    /* work that this job still has to do, in radii of a dipole */
  bool rests;             /* whether context->owed_radii leaves this job out, see job_rest() */
  bool large;             /* whether the job is in context->large */
  LIST_ENTRY(job) in_large;
  enum latency_class latency;
  struct cache_owner *owner; /* the client, whose turns its lookups use */
  bool reader_idle;          /* whether all parts are sent, so that it may report progress */
  wire_error refusal;        /* why the job is refused; set with JOB_REFUSED */
  struct job_parts parts;
  _Alignas(8) uint8_t head[JOB_HEAD_BYTES]; /* the reply's structure, after job_reply() */
};

/* Accepts a request: its reply begins with this structure of job->kind->reply, as on the wire, whose
 * counts say its size. Refuses it if the request's counts make that larger than a frame may be. */
enum job_outcome job_reply(struct job *job, const void *head);

/* Writes that reply to `payload`. */
void job_put_reply(struct job *job, uint8_t *payload);

/* Cuts a reply into parts: one if it fits into a frame, else parts of up to max_part_bytes, which have
 * a multiple of `unit` entries; sets job->part_bytes. start: the reply's structure, which begins with
 * wire_part. Returns false if not even one unit fits. */
bool job_parts_fit(struct job *job, const schema_payload *reply, const void *start, unsigned unit,
                   uint64_t total);

/* Begins to write the current part at `payload`: begin_part() of jobs that need no more. */
enum job_outcome job_part_begin(struct job *job, uint8_t *payload);

/* Does the next entries of the part, up to a slice. next() does one, or a step of it, and adds its cost
 * to *spent, in radii of a dipole. radii: what an entry that is done has paid; done: counts them. Returns
 * what next() does. */
enum job_outcome job_part_run(struct job *job, uint64_t *budget, uint64_t radii,
                              enum stats_index done,
                              enum job_outcome (*next)(struct job *job, uint64_t *spent));

/* Returns whether the part has all entries. */
static inline bool job_part_is_done(const struct job *job) {
  return job->parts.index == job->parts.count;
}

/* Writes the structure with which the current part begins, and goes on to the next part: sets
 * job->part_bytes, or returns DONE. */
enum job_outcome job_part_end(struct job *job, const schema_payload *reply, const void *start);

/* Cuts a list into fewer than 2^32 parts, and begins with the first. most is 0 only if total is 0. */
void job_parts_cut(struct job_parts *parts, uint64_t total, uint64_t most);

/* Goes on to the next part. Returns false if the current part is the last one. */
bool job_parts_next(struct job_parts *parts);

/* The size of a slot, which can hold a job of any kind. Each kind asserts that it fits. */
enum { JOB_SLOT_BYTES = 5248 };

struct job_slot {
  _Alignas(16) uint8_t bytes[JOB_SLOT_BYTES];
  SLIST_ENTRY(job_slot) next; /* while it is free */
};

/* The structure of a job, whose first member is a struct job, and the function that casts to it. */
#define JOB_STRUCTURE(type, name)                                                                  \
  _Static_assert(sizeof(type) <= JOB_SLOT_BYTES, "a job fits its slot");                           \
  static inline type *name(struct job *job) {                                                      \
    return (type *)(void *)job;                                                                    \
  }

/* A message, as proto/messages.def lists it. */
struct job_type {
  const struct job_kind *kind;
  enum role role;             /* role that a client needs */
  enum latency_class latency; /* class in the statistics of latency */
  enum stats_index requests;  /* counter of its requests */
};

/* Returns the message of a type; NULL if there is none. */
const struct job_type *job_type_of(unsigned type);

/* Starts a job in a free slot. Returns what the kind's start() returns, or REFUSED for an unknown
 * message. */
enum job_outcome job_start(struct job_slot *slot, struct job_request *request);

/* Ends a job that start() has not refused: removes its work from the worker's
 * owed_radii and calls the kind's end(). */
void job_end(struct job *job);

/* Set up a lookup of things of other kinds, or of profiles, which calls request->on_ready() after a
 * wait. */
void job_init_other(struct job *job, struct lookup *lookup, const struct job_request *request);
void job_init_lookup(struct job *job, struct profiles_lookup *lookup,
                     const struct job_request *request);

/* ---- admission control ----------------------------------------------------------------------- */

/* Admits a job and adds its work to the worker's owed_radii, or refuses it. radii: the work, of any
 * size, in radii of a dipole.
 *
 * A small job is always admitted. A large job is refused with BUSY and `field` if the other large
 * jobs would delay it by max_backlog_ms or more. Clients take turns, so another job delays the new
 * one by at most the work that either of them has left. Besides, another job counts for at most
 * 1/JOB_BACKLOG_SHARES of max_backlog_ms, so that a few endless jobs do not keep new ones out. */
enum { JOB_BACKLOG_SHARES = 16 };
wire_error job_admit(struct job *job, double radii, const char *field);

/* Subtracts radii that the job has evaluated from the work that it owes. */
void job_pay(struct job *job, uint64_t radii);

/* Call these when a slow reader stops a job, and when the job continues. The work of a stopped job
 * does not count in admission control. */
void job_rest(struct job *job);
void job_resume(struct job *job);

/* ---- refusals -------------------------------------------------------------------------------- */

/* Sets the refusal and returns JOB_REFUSED. */
enum job_outcome job_refuse(struct job *job, wire_error refusal);

/* Returns whether there is no error; else sets the refusal, for the caller to return JOB_REFUSED. */
bool job_passes(struct job *job, wire_error error);

/* Returns JOB_GOES_ON if there is no error; else refuses the job with it. */
enum job_outcome job_check(struct job *job, wire_error error);

/* Gets the thing of this content from the cache, and follows the lookup. */
enum job_outcome job_get(struct job *job, struct lookup *lookup, const struct cache_kind *kind,
                         const void *content, size_t bytes, enum cache_pace pace);

/* Follows a lookup for a channel: continues with what is READY, WAITS, or refuses the job by
 * *fault. */
enum job_outcome job_follow(struct job *job, enum lookup_state state, const core_fault *fault,
                            uint64_t channel);

/* Makes the error BAD_VALUE of a fault that core has found, or no error. */
wire_error job_error(core_fault fault);

/* The same for a fault in what begins at position `first` of a list. */
wire_error job_error_behind(core_fault fault, uint64_t first);

/* Makes the error of a fault in preparing a channel: BUSY if the preparation may succeed later,
 * else BAD_VALUE. */
wire_error job_fault(core_fault fault, uint64_t channel);

/* Makes the error BUSY for memory that the system does not give. */
wire_error job_no_memory(void);

/* Makes the error BUSY for a budget of all buffers that is exhausted. */
wire_error job_busy(void);

/* Makes the error TOO_LARGE if there are more media than --max-media, or no error. */
wire_error job_check_count(const struct job *job, uint64_t medium_count);

/* Makes the error TOO_LARGE, whose `allowed` is the text "at most MOST WHAT". */
wire_error job_too_large(const char *field, uint64_t most, const char *what);

#define WIRE_MESSAGE(type, IDENT, name, ...) extern const struct job_kind job_kind_##IDENT;
#include "proto/messages.def"

#endif
