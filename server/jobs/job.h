/* job: one eval or sample request being answered, slice by slice. Independent of how requests
 * arrive. A sample is an eval whose radii are drawn first, for each channel. */
#ifndef DIPOLED_JOB_H
#define DIPOLED_JOB_H

#include "proto/sample.h"
#include "server/jobs/backlog.h"
#include "server/jobs/job_state.h"
#include "server/jobs/repeat.h"
#include "server/store/profiles.h"

struct job_scratch;

struct job {
  eval_request request; /* of a sample: its radii are the numbers u */
  core_grid grid;
  bool draws;     /* a sample, */
  core_draw draw; /* and its numbers */
  eval_layout layout;
  uint8_t *reply;              /* payload of the part, layout.payload_bytes */
  struct profiles_order order; /* for the profile of the channel being evaluated */
  uint64_t part_radii;         /* in each part of the reply but the last */
  uint64_t first;              /* radius of the part that is being filled in */
  uint64_t count;              /* of its radii */
  uint32_t part;               /* its number, */
  uint32_t part_count;         /* and how many there are */
  uint32_t channel;
  uint64_t index; /* the next radius of that channel in the part */
  bool radii_done;
  struct backlog_share share;
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

/* Likewise, of a sample. */
wire_error job_check_sample(struct job *job, const struct server *server, const uint8_t *payload,
                            size_t payload_bytes);

/* What is wanted, as proto/eval.h has it. */
unsigned job_wanted(const struct job *job);

/* Of job_check.c, for a job that has been checked. The medium of a channel. */
core_medium job_medium(const struct job *job, uint32_t channel);

/* The layout of the part that begins at job->first; false: it would exceed max_bytes. */
bool job_lay_out_part(struct job *job, uint64_t max_bytes);

/* When what was chosen for a tolerance cannot be prepared after all, the next best; false: there is
 * none. A lack of memory decides nothing: the same request gets the same model. */
bool job_choose_again(struct job *job);

/* What could answer a request of model EVAL_ANY_MODEL. */
struct choice;
wire_error job_offers(const struct server *server, const uint8_t *payload, size_t payload_bytes,
                      struct choice *choice);

/* Starts to fill in the reply, or its first part, which starts at a multiple of 8. */
void job_start(struct job *job, uint8_t *reply);

/* After JOB_PART_DONE: layout says what the next part needs; then it is begun there. */
void job_next_part(struct job *job);
void job_start_part(struct job *job, uint8_t *reply);

/* Notes what the job will cost its worker, or why it is not to be started now. */
wire_error job_admit(struct job *job, const struct server *server, struct job_scratch *scratch);

/* Lets go of what a job holds or waits for that is given up before its reply is complete, or that
 * is. A job that has not been started is all 0, but for who is told: order.on_ready. */
void job_end(struct job *job);

/* The most that a slice draws: of tables, which cost least. */
enum { JOB_DRAW_RADII = JOB_SLICE_RADII / 4 };

/* What the jobs of a worker share: room for a slice's radii, for grids whose radii are not wanted;
 * and what is short is gathered, and is in the replies after batch_finish(). */
struct job_scratch {
  double radii[JOB_SLICE_RADII];
  double numbers[JOB_DRAW_RADII];
  struct batch batch;
  struct repeat repeat;
  struct backlog backlog;
};

/* Evaluates one slice and subtracts what it cost, in radii of a dipole, from *budget (down to 0).
 */
enum job_state job_slice(struct job *job, struct server *server, struct profiles *profiles,
                         struct job_scratch *scratch, uint64_t *budget);

#endif
