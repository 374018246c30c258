/* invert_job: one invert request being answered, slice by slice. */
#ifndef DIPOLED_INVERT_JOB_H
#define DIPOLED_INVERT_JOB_H

#include "core/inversion.h"
#include "proto/invert.h"
#include "server/jobs/backlog.h"
#include "server/jobs/job_state.h"
#include "server/store/profiles.h"

struct invert_job {
  invert_request request;
  core_inverter inverter;
  bool reach_known;            /* of the model: what the first probes are for */
  bool seeking;                /* the medium at index */
  bool slow;                   /* its probes are prepared elsewhere, */
  struct profiles_order order; /* by this */
  uint64_t probe_radii;        /* what a probe costs */
  struct backlog_share share;
  uint8_t *reply;      /* payload of the part, */
  uint64_t part_media; /* with so many media, but the last */
  uint64_t first;      /* medium of the part that is being filled in */
  uint64_t count;      /* of its media */
  uint64_t index;      /* of the part's medium that is looked for */
  uint64_t missing;    /* of those before it */
  uint32_t part;       /* its number, */
  uint32_t part_count; /* and how many there are */
  wire_error refusal;
};

/* Checks all of a request but what only shows when the model's reach is known; the payload has to
 * stay while the job runs. */
wire_error invert_job_check(struct invert_job *job, const struct server *server,
                            const uint8_t *payload, size_t payload_bytes);

/* Notes what the job will cost its worker, or why it is not to be started now. */
wire_error invert_job_admit(struct invert_job *job, const struct server *server,
                            struct backlog *backlog);

/* What the part that comes next needs for its payload. */
uint64_t invert_job_part_bytes(const struct invert_job *job);

/* Starts to fill in the reply, or its next part, which starts at a multiple of 8. */
void invert_job_start_part(struct invert_job *job, uint8_t *reply);

/* After JOB_PART_DONE. */
void invert_job_next_part(struct invert_job *job);

/* Looks for some media and subtracts what that cost, in radii of a dipole, from *budget (down to
 * 0).
 */
enum job_state invert_job_run(struct invert_job *job, struct server *server,
                              struct profiles *profiles, struct backlog *backlog, uint64_t *budget);

/* Lets go of what it holds or waits for. */
void invert_job_end(struct invert_job *job);

#endif
