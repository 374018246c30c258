/* eval: evaluates a model for media (channels) at radii, slice by slice. A sample is an eval whose
 * radii are drawn first, for each channel, as the light that leaves is distributed. */
#ifndef DIPOLED_EVAL_H
#define DIPOLED_EVAL_H

#include "core/draw.h"
#include "proto/eval.h"
#include "server/jobs/choice.h"
#include "server/jobs/job.h"

struct eval_job {
  struct job job;
  struct repeat_entry *repeated; /* the request that this one repeats; NULL: none */

  eval_request request; /* if the job is a sample: its radii are the numbers u */
  size_t value_bytes;   /* of a radius, and of a value; choosing an evaluator does not change it */
  core_grid grid;
  struct choice_state choice; /* for a request that names a tolerance in place of a model */
  bool covers_all;            /* whether the model covers all radii */
  core_radii_range radii;     /* the range of radii for which the reply states its errors */

  bool drawn;     /* whether the job is a sample */
  core_draw draw; /* the rule for the numbers of a sample */

  eval_layout layout; /* layout of the current part of the reply */
  uint8_t *reply;     /* [layout.payload_bytes], payload of the current part */
  uint8_t *head;      /* albedos and errors of a first part that is not the last; else NULL */

  uint32_t channel;              /* the channel that is being evaluated */
  uint64_t index;                /* position in the part of the channel's next radius */
  bool radii_done;               /* whether the radii have been written or are not wanted */
  unsigned notes;                /* the notes of all channels so far */
  struct profiles_lookup lookup; /* for the channel's profile */
  struct profiles_lookup ruler;  /* for that of transport, if the model error needs it */
  struct repeat_channel channels[REPEAT_CHANNELS]; /* the first ones */
};

/* The functions that follow are for offers.c. end() is that of struct job_kind. */

void eval_job_end(struct job *job);

/* Returns the layers of the medium of a channel. */
static inline const core_medium *eval_job_medium(const struct eval_job *eval, uint32_t channel) {
  return &eval->request.media[(size_t)channel * eval->request.fixed.layer_count];
}

/* Reads and checks a request of model EVAL_ANY_MODEL. */
wire_error eval_job_offers(struct eval_job *eval, const struct job_request *request);

#endif
