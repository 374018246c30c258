/* Sample: draws radii that are distributed as the light that leaves, and evaluates quantities at
 * these radii. */

#include <math.h>
#include <string.h>

#include "server/jobs/eval.h"

static wire_error check_numbers(const struct eval_job *eval) {
  core_fault fault = core_draw_check(&eval->draw);
  if (fault.field != NULL && strcmp(fault.field, "sample_count") == 0) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, fault.field, fault.allowed);
  }
  if (fault.field == NULL && eval->request.radii != NULL) {
    const uint64_t count = eval->request.fixed.radius_count;
    fault = eval_job_value_bytes(eval) == sizeof(float)
                ? core_numbers_check_f32(count, eval->request.radii)
                : core_numbers_check_f64(count, eval->request.radii);
  }
  return job_error(fault);
}

/* Checks a sample request. Any radius may be drawn, so the model must cover all radii. */
static wire_error check_sample(struct eval_job *eval) {
  core_radii_range range;
  /* Any radius may be drawn, 0 included, and the model error at 0 is known only for transport. */
  eval->radii = (core_radii_range){0, 0};
  const wire_error error = eval_job_check_media(eval, &range);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  return eval->covers_all
             ? check_numbers(eval)
             : wire_error_make(WIRE_STATUS_BAD_VALUE, "model", "a model that covers all radii");
}

/* Draws the next n radii: into the reply if they are wanted, else into scratch memory. */
static const void *draw_radii(const struct eval_job *eval, size_t n) {
  struct job_context *scratch = eval->job.context;
  const bool single = eval_job_value_bytes(eval) == sizeof(float);
  const bool wanted = eval_is_array(eval_job_wanted(eval), CORE_QUANTITY_RADIUS);
  void *r = wanted ? eval_job_array(eval, CORE_QUANTITY_RADIUS) : scratch->radii;
  const void *u = scratch->numbers;
  if (eval->request.radii != NULL) {
    u = eval_job_listed(eval);
  } else if (single) {
    core_draw_f32(&eval->draw, eval->parts.first + eval->index, n,
                  (float *)(void *)scratch->numbers);
  } else {
    core_draw_f64(&eval->draw, eval->parts.first + eval->index, n, scratch->numbers);
  }
  if (single) {
    core_sample_f32(&eval->lookup.profile, n, u, r);
  } else {
    core_sample_f64(&eval->lookup.profile, n, u, r);
  }
  return r;
}

static enum job_outcome start_sample(struct job *job, const struct job_request *request) {
  struct eval_job *eval = (struct eval_job *)(void *)job;
  wire_error error = sample_request_parse(request->payload, request->header->payload_bytes,
                                          &eval->draw, &eval->request);
  eval->draw_radii = draw_radii;
  eval->value_bytes = core_evaluator_bytes(eval->request.fixed.evaluator);
  eval->choice = (struct choice_state){.tolerance = (double)NAN};
  if (error.status == WIRE_STATUS_OK) {
    error = check_sample(eval);
  }
  return eval_job_start(eval, error, request);
}

const struct job_kind job_kind_SAMPLE = {.start = start_sample,
                                         .begin_part = eval_job_begin_part,
                                         .step = eval_job_step,
                                         .end = eval_job_end};
