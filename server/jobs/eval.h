/* eval: an eval or sample request, checked (eval_check.c) and evaluated slice by slice (eval.c). A
 * sample is an eval whose radii are drawn first, for each channel. */
#ifndef DIPOLED_EVAL_H
#define DIPOLED_EVAL_H

#include "proto/sample.h"
#include "server/jobs/choice.h"
#include "server/jobs/job.h"

struct eval_job {
  struct job job;
  const struct repeat_entry *repeated; /* answers the request; NULL: all that follows is set */
  const uint8_t *payload;              /* of the request */

  eval_request request; /* of a sample: its radii are the numbers u */
  core_grid grid;
  bool draws;         /* is a sample */
  core_draw draw;     /* of a sample: its numbers */
  bool covers_all;    /* the model covers all radii */
  double tolerance;   /* that was asked for instead of a model; NAN if a model was */
  double model_error; /* of the model that was chosen for the tolerance */
  size_t choice;      /* how many candidates have been tried */

  eval_layout layout;  /* of the part */
  uint8_t *reply;      /* payload of the part, layout.payload_bytes */
  uint64_t part_radii; /* radii in each part but the last */
  uint32_t part;       /* number of the part, from 0 */
  uint32_t part_count;
  uint64_t first; /* the part's first radius among all */
  uint64_t count; /* radii of the part */

  uint32_t channel;            /* that is being evaluated */
  uint64_t index;              /* next radius of that channel, within the part */
  bool radii_done;             /* the radii have been written, or are not wanted */
  unsigned notes;              /* of the channels so far */
  struct profiles_order order; /* for the channel's profile */
};

/* Checks all of a request before any of it is evaluated, and lays out the first part. The payload
 * has to stay while the job runs. */
wire_error eval_job_check(struct eval_job *eval, const struct server *server,
                          const uint8_t *payload, size_t payload_bytes);
wire_error eval_job_check_sample(struct eval_job *eval, const struct server *server,
                                 const uint8_t *payload, size_t payload_bytes);

/* Lists what could answer a request of model EVAL_ANY_MODEL. */
wire_error eval_job_offers(const struct server *server, const uint8_t *payload,
                           size_t payload_bytes, struct choice *choice);

/* For a request that has been checked: the bits of all that is wanted, as proto/eval.h has them. */
unsigned eval_job_wanted(const struct eval_job *eval);

/* Likewise: the medium of a channel. */
core_medium eval_job_medium(const struct eval_job *eval, uint32_t channel);

/* Lays out the part that begins at eval->first; returns false if it would exceed max_bytes. */
bool eval_job_lay_out_part(struct eval_job *eval, uint64_t max_bytes);

/* Takes the next best model and evaluator, when what was chosen for a tolerance cannot be prepared
 * after all; returns false if there is none. Lack of memory is no reason to choose again, because
 * the same request has to get the same model. */
bool eval_job_choose_again(struct eval_job *eval);

#endif
