/* eval: evaluates a model for media (channels) at radii, slice by slice. A sample is an eval whose
 * radii are drawn first, for each channel (sample.c). */
#ifndef DIPOLED_EVAL_H
#define DIPOLED_EVAL_H

#include "core/draw.h"
#include "proto/eval.h"
#include "server/jobs/choice.h"
#include "server/jobs/job.h"

struct eval_job {
  struct job job;
  const struct repeat_entry *repeated; /* answers the request; NULL if the members below do */
  const uint8_t *payload;              /* of a request that is repeated */

  eval_request request; /* of a sample: its radii are the numbers u */
  core_grid grid;
  struct choice_state choice; /* for a request that names a tolerance in place of a model */
  bool covers_all;            /* the model covers all radii */
  core_radii_range radii;     /* least and largest, for which the reply states its errors */

  /* Draws the next n radii of the channel. NULL unless the job is a sample. */
  const void *(*draw_radii)(const struct eval_job *eval, size_t n);
  core_draw draw; /* of a sample: its numbers */

  eval_layout layout;  /* of the part */
  uint8_t *reply;      /* payload of the part, layout.payload_bytes */
  uint64_t part_radii; /* radii in each part but the last */
  uint32_t part;       /* number of the part, from 0 */
  uint32_t part_count;
  uint64_t first; /* number of the part's first radius */
  uint64_t count; /* how many radii the part has */

  uint32_t channel;              /* the channel that is being evaluated */
  uint64_t index;                /* next radius of that channel, from the part's start */
  bool radii_done;               /* the radii have been written, or are not wanted */
  unsigned notes;                /* bits of the channels so far */
  struct profiles_lookup lookup; /* for the channel's profile */
};

/* ---- for sample.c -----------------------------------------------------------------------------
 */

/* Checks the media of a request that has been taken apart. Sets eval->covers_all, and *radii to the
 * range in which all channels can be evaluated. */
wire_error eval_job_check_media(struct eval_job *eval, core_radii_range *radii);

/* Starts a request that has been checked, unless an error has been found. */
enum job_outcome eval_job_start(struct eval_job *eval, wire_error error,
                                const struct job_request *request);

/* These do what job.h says of the functions of a kind. */
enum job_outcome eval_job_begin_part(struct job *job, uint8_t *payload);
enum job_outcome eval_job_step(struct job *job, uint64_t *budget);
void eval_job_end(struct job *job);

/* Bits of all that is wanted, as proto/eval.h has them. */
unsigned eval_job_wanted(const struct eval_job *eval);

static inline size_t eval_job_value_bytes(const struct eval_job *eval) {
  return core_evaluator_bytes(eval->request.fixed.evaluator);
}

/* Where the listed radii, or numbers u, go on. */
const uint8_t *eval_job_listed(const struct eval_job *eval);

/* Where the channel's values of a wanted quantity go on in the reply. */
void *eval_job_array(const struct eval_job *eval, enum core_quantity quantity);

/* ---- for offers.c -----------------------------------------------------------------------------
 */

/* Takes a request of model EVAL_ANY_MODEL apart and checks all of it. */
wire_error eval_job_offers(struct eval_job *eval, const struct job_request *request);

#endif
