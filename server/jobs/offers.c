/* Offers: lists the models and evaluators that could answer an eval with a tolerance. */
#include "server/jobs/eval.h"

static struct choice list(const struct job *job) {
  struct choice choice;
  const struct eval_job *eval = (const struct eval_job *)(const void *)job;
  choice_list(&eval->request, eval->radii, &choice);
  return choice;
}

/* Checks the request and finds the size of the list. The list itself is too large for a slot, so
 * begin_part() makes it again. */
static enum job_outcome start(struct job *job, const struct job_request *request) {
  const wire_error error = eval_job_offers((struct eval_job *)(void *)job, request);
  if (error.status != WIRE_STATUS_OK) {
    return job_refuse(job, error);
  }
  job->part_bytes = WIRE_BYTES_offers_reply + list(job).count * (size_t)WIRE_BYTES_offer;
  return JOB_NEXT_PART;
}

static enum job_outcome put(struct job *job, uint8_t *at) {
  struct choice choice = list(job);
  const size_t taken = choice_sort_by_cost(&choice);
  const wire_offers_reply reply = {.count = (uint32_t)choice.count, .taken = (uint32_t)taken};
  wire_put_offers_reply(at, &reply);
  at += WIRE_BYTES_offers_reply;
  for (size_t i = 0; i < choice.count; i++) {
    const core_candidate *candidate = &choice.candidates[i];
    const wire_offer offer = {
        .model = (uint16_t)candidate->model,
        .evaluator = (uint16_t)candidate->evaluator,
        .meets = candidate->meets,
        .error = candidate->error,
        .numerical_error = candidate->numerical_error,
        .cost = candidate->cost_ns,
        .prepare_cost = candidate->prepare_ns,
    };
    wire_put_offer(at, &offer);
    at += WIRE_BYTES_offer;
  }
  return JOB_DONE;
}

const struct job_kind job_kind_OFFERS = {.start = start, .begin_part = put};
