/* Varying: evaluates values each of which has its own medium, slice by slice. */
#include "proto/varying.h"

#include "core/ruler.h"
#include "server/jobs/job.h"

struct varying_job {
  struct job job;
  varying_request request;
  struct lookup lookup;
  struct lookup ruler;  /* surface of transport, if the model error needs it */
  bool compares;        /* whether the model error needs it */
  uint64_t value_radii; /* the cost of a value, in radii of a dipole */
  varying_part part;
};

JOB_STRUCTURE(struct varying_job, varying_of)

_Static_assert(VARYING_SCRATCH_ARRAYS *(int)VARYING_SLICE_VALUES <= (int)JOB_SLICE_RADII,
               "the worker's scratch holds that of a slice");

/* ---- checking -------------------------------------------------------------------------------- */

/* What steps cost, in radii of a dipole (`build/bench varying`). */
enum { CHECK_RADII = 2, VALUE_RADII = 6, INVERT_RADII = 10, DRAW_RADII = 15 };

static uint64_t value_cost(const wire_varying_request *fixed) {
  const unsigned quantities = (unsigned)__builtin_popcount(fixed->wanted);
  return CHECK_RADII + quantities * VALUE_RADII + (fixed->given != 0 ? INVERT_RADII : 0) +
         (fixed->numbers == VARYING_DRAWN ? DRAW_RADII : 0);
}

/* Checks the model, g, eta and the parameters with a medium that every model takes. What depends on
 * more than that is found when they are prepared. */
static wire_error check_model(const varying_request *request) {
  const wire_varying_request *fixed = &request->fixed;
  const core_medium medium = {1, 1, fixed->g, fixed->eta};
  const core_fault fault = core_profile_check(fixed->model, fixed->moments, fixed->evaluator,
                                              &medium, &request->parameters, NULL);
  return job_error(fault);
}

static enum job_outcome start_varying(struct job *job, const struct job_request *from) {
  struct varying_job *varying = varying_of(job);
  varying_request *request = &varying->request;
  const wire_varying_request *fixed = &request->fixed;
  if (!job_passes(job,
                  varying_request_parse(from->payload, from->header->payload_bytes, request)) ||
      !job_passes(job, check_model(request))) {
    return JOB_REFUSED;
  }
  const wire_varying_reply start = {
      .evaluator = fixed->evaluator, .wanted = fixed->wanted, .coefficients = fixed->coefficients};
  if (!job_parts_fit(job, &schema_varying_reply, &start, VARYING_PART_VALUES, fixed->value_count)) {
    return job_refuse(job, wire_error_make(WIRE_STATUS_TOO_LARGE, "wanted",
                                           "fewer quantities, or values: they do not fit into a "
                                           "part (max_part_bytes)"));
  }
  varying->compares = (fixed->wanted & CORE_QUANTITY_MODEL_ERROR) != 0 &&
                      core_ruler_is_needed(fixed->model, &request->parameters,
                                           &(core_medium){1, 1, fixed->g, fixed->eta}, false);
  varying->value_radii = value_cost(fixed) * (varying->compares ? 2 : 1);
  const double radii = (double)fixed->value_count * (double)varying->value_radii;
  if (!job_passes(job, job_admit(job, radii, "value_count"))) {
    return JOB_REFUSED;
  }
  job_init_other(job, &varying->ruler, from);
  job_init_other(job, &varying->lookup, from);
  return JOB_NEXT_PART;
}

/* ---- parts ----------------------------------------------------------------------------------- */

static enum job_outcome begin_varying_part(struct job *job, uint8_t *payload) {
  struct varying_job *varying = varying_of(job);
  varying_part_start(&varying->part, &varying->request, payload, varying->job.parts.first,
                     varying->job.parts.count);
  return job_part_begin(job, payload);
}

static enum job_outcome end_varying_part(struct varying_job *varying) {
  struct job_parts *parts = &varying->job.parts;
  varying_part_end(&varying->part, &varying->request, varyings_found(&varying->lookup),
                   varyings_found(&varying->ruler), parts->part, parts->part_count);
  return job_part_end(&varying->job, &schema_varying_reply, parts->payload);
}

/* Prepares transport for the comparison. If no surface of it can be made, there is none. */
static enum job_outcome prepare_ruler(struct varying_job *varying) {
  struct job *job = &varying->job;
  const wire_varying_request *fixed = &varying->request.fixed;
  const core_parameters none = core_parameters_none();
  const enum lookup_state state =
      varyings_get(&job->context->profiles.lookups, &varying->ruler, CORE_MODEL_TRANSPORT,
                   CORE_MOMENTS_EXACT, fixed->evaluator, &none, fixed->g, fixed->eta);
  if (state != LOOKUP_FAULT || lookup_is_busy(varying->ruler.fault)) {
    varying->compares = state == LOOKUP_WAIT;
    return job_follow(job, state, &varying->ruler.fault, 0);
  }
  varying->compares = false;
  return JOB_GOES_ON;
}

/* Prepares what all values share, and checks what the colours mean. */
static enum job_outcome prepare_media(struct varying_job *varying) {
  struct job *job = &varying->job;
  const varying_request *request = &varying->request;
  const wire_varying_request *fixed = &request->fixed;
  enum job_outcome outcome = varying->compares ? prepare_ruler(varying) : JOB_GOES_ON;
  if (outcome == JOB_GOES_ON) {
    const enum lookup_state state =
        varyings_get(&job->context->profiles.lookups, &varying->lookup, fixed->model,
                     fixed->moments, fixed->evaluator, &request->parameters, fixed->g, fixed->eta);
    outcome = job_follow(job, state, &varying->lookup.fault, 0);
  }
  if (outcome != JOB_GOES_ON) {
    return outcome;
  }
  const core_fault fault =
      request->fixed.given != 0
          ? core_colour_check(varyings_found(&varying->lookup), &request->colour)
          : (core_fault){NULL, NULL, 0};
  return job_check(job, job_error(fault));
}

static size_t slice_length(const struct varying_job *varying) {
  const uint64_t left = varying->part.count - varying->job.parts.index;
  uint64_t most =
      JOB_SLICE_RADII / varying->value_radii / VARYING_PART_VALUES * VARYING_PART_VALUES;
  most = most < VARYING_PART_VALUES ? VARYING_PART_VALUES : most;
  most = most > VARYING_SLICE_VALUES ? VARYING_SLICE_VALUES : most;
  return (size_t)(left < most ? left : most);
}

static enum job_outcome step_varying(struct job *job, uint64_t *budget) {
  struct varying_job *varying = varying_of(job);
  uint64_t spent = JOB_STEP_RADII;
  enum job_outcome outcome =
      varyings_found(&varying->lookup) != NULL ? JOB_GOES_ON : prepare_media(varying);
  if (outcome == JOB_GOES_ON) {
    const size_t n = slice_length(varying);
    varying_part_evaluate(&varying->part, &varying->request, varyings_found(&varying->lookup),
                          varyings_found(&varying->ruler), varying->job.parts.index, n,
                          job->context->radii);
    varying->job.parts.index += n;
    spent += n * varying->value_radii;
    job_pay(job, n * varying->value_radii);
    struct stats *stats = &job->context->server->stats;
    stats_count_radii(stats, varying->request.fixed.model, n);
    outcome =
        varying->job.parts.index < varying->part.count ? JOB_GOES_ON : end_varying_part(varying);
  }
  *budget -= spent < *budget ? spent : *budget;
  return outcome;
}

static void end_varying(struct job *job) {
  lookup_return(&varying_of(job)->lookup);
  lookup_return(&varying_of(job)->ruler);
}

const struct job_kind job_kind_VARYING = {.start = start_varying,
                                          .begin_part = begin_varying_part,
                                          .step = step_varying,
                                          .end = end_varying};
