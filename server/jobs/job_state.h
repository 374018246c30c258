/* job_state: what the jobs that answer requests step by step have in common. */
#ifndef DIPOLED_JOB_STATE_H
#define DIPOLED_JOB_STATE_H

#include "core/core.h"
#include "proto/wire.h"

enum job_state {
  JOB_GOES_ON,
  JOB_WAITS,     /* for a profile: goes on when order.on_ready() has been called */
  JOB_PART_DONE, /* the part is complete, and not the last */
  JOB_DONE,      /* the reply is complete; it is reserved in the output */
  JOB_REFUSED,   /* there will be no reply; the job's refusal says why */
};

/* A slice's evaluations of a dipole: about 25 to 100 microseconds, which is what a small request
 * may have to wait for when a large one is being evaluated on its worker. Costlier profiles get
 * slices with fewer radii. */
enum { JOB_SLICE_RADII = 16384 };

/* What a step costs besides, in radii: preparing a profile, or taking a frame apart. */
enum { JOB_STEP_RADII = 64 };

/* What a client that is told BUSY should wait: long enough for a worker to finish what it has. */
enum { JOB_RETRY_AFTER_MS = 20 };

/* What is wrong, as an answer. */
wire_error job_error(core_fault fault);

/* BUSY, for what there are no bytes for now; and the error of a fault in preparing a channel. */
wire_error job_busy(void);
wire_error job_fault(core_fault fault, uint32_t channel);

/* TOO_LARGE: "at most MOST WHAT". */
wire_error job_too_large(const char *field, uint64_t most, const char *what);

#endif
