/* Fit: finds the coefficients of media from sets of readings, set by set. The design that they
 * share is prepared on another thread and kept in the cache. */
#include "proto/fit.h"
#include "server/jobs/job.h"

/* The cost of evaluating the model for one medium that a fit tries, in radii of a dipole: of the
 * medium, and besides of each reading. Evaluations for a set of readings, on average. */
enum {
  MEDIUM_RADII = 256,
  COSTLY_MEDIUM_RADII = JOB_SLICE_RADII,
  READING_RADII = 8,
  EVALUATIONS = 16,
};

struct fit_job {
  struct job job;
  fit_request request;
  struct profiles_lookup lookup; /* gets the prepared design */
  uint64_t evaluation_radii;     /* the cost of an evaluation, in radii of a dipole */
  uint32_t residuals;            /* how many the reply has for each set: 0, or one for a reading */
  uint8_t *reply;                /* payload of the current part */
  struct job_parts parts;        /* of the sets */
  uint64_t index;                /* position in the part of the next set */
  uint64_t fitted;               /* how many sets of the part before index are a success */
  uint32_t notes;
};

JOB_FITS_SLOT(struct fit_job);

static struct fit_job *of(struct job *job) {
  return (struct fit_job *)(void *)job;
}

static uint64_t set_radii(const struct fit_job *fit) {
  return EVALUATIONS * fit->evaluation_radii;
}

/* ---- starting -------------------------------------------------------------------------------- */

/* Cuts the reply into parts: one if it fits into a frame, else parts of max_part_bytes. A reply is
 * larger than its request only if a set has few readings, so that many sets fit into a part. */
static void cut(struct fit_job *fit, const struct options *options) {
  const uint64_t count = fit->request.fixed.set_count;
  const bool fits = fit_reply_bytes(count, fit->residuals) <= options->max_frame_bytes;
  job_parts_cut(&fit->parts, count,
                fits ? count : fit_part_sets(fit->residuals, options->max_part_bytes));
}

static wire_error check(struct fit_job *fit, const struct job_request *from) {
  const wire_error error =
      fit_request_parse(from->payload, from->header->payload_bytes, &fit->request);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  fit_design read;
  fit_design_read(fit->request.design_bytes, &read);
  const core_fault fault = core_fit_check(&read.design);
  if (fault.field != NULL) {
    return job_error(fault);
  }
  const bool costly = read.design.model != CORE_MODEL_TRANSPORT &&
                      core_worth_keeping(read.design.model, CORE_EVALUATOR_F64);
  fit->evaluation_radii =
      (costly ? COSTLY_MEDIUM_RADII : MEDIUM_RADII) + READING_RADII * (uint64_t)read.design.count;
  fit->residuals = fit->request.fixed.residuals != 0 ? fit->request.design.reading_count : 0;
  cut(fit, &fit->job.context->server->options);
  return wire_error_none();
}

static enum job_outcome start(struct job *job, const struct job_request *request) {
  struct fit_job *fit = of(job);
  wire_error error = check(fit, request);
  if (error.status == WIRE_STATUS_OK) {
    const double radii = (double)fit->request.fixed.set_count * (double)set_radii(fit);
    error = job_admit(job, radii, "set_count");
  }
  if (error.status != WIRE_STATUS_OK) {
    return job_refuse(job, error);
  }
  fit->notes = 0;
  job_init_lookup(job, &fit->lookup, request);
  job->part_bytes = fit_reply_bytes(fit->parts.count, fit->residuals);
  return JOB_NEXT_PART;
}

/* ---- parts ----------------------------------------------------------------------------------- */

static enum job_outcome begin_part(struct job *job, uint8_t *payload) {
  struct fit_job *fit = of(job);
  fit->reply = payload;
  fit->index = 0;
  fit->fitted = 0;
  return JOB_GOES_ON;
}

static enum job_outcome end_part(struct fit_job *fit) {
  const wire_fit_reply start = {
      .part = fit->parts.part,
      .part_count = fit->parts.part_count,
      .set_count = fit->parts.count,
      .set_first = fit->parts.first,
      .fitted_count = fit->fitted,
      .reading_count = fit->residuals,
      .notes = fit->notes,
  };
  wire_put_fit_reply(fit->reply, &start);
  if (!job_parts_next(&fit->parts)) {
    return JOB_DONE;
  }
  fit->job.part_bytes = fit_reply_bytes(fit->parts.count, fit->residuals);
  return JOB_NEXT_PART;
}

/* ---- fitting --------------------------------------------------------------------------------- */

static enum job_outcome get_design(struct fit_job *fit) {
  struct job_context *context = fit->job.context;
  switch (profiles_get_fit(&context->profiles, &fit->lookup, fit->request.design_bytes,
                           fit->request.design_bytes_count)) {
  case PROFILES_WAIT:
    return JOB_WAITS;
  case PROFILES_FAULT:
    return job_refuse(&fit->job, job_fault(fit->lookup.fault, (uint32_t)fit->lookup.fault.index));
  case PROFILES_READY:
    break;
  }
  return JOB_GOES_ON;
}

/* Fits the next set. Returns what that cost, in radii of a dipole. */
static uint64_t fit_next(struct fit_job *fit) {
  const size_t readings = fit->request.design.reading_count;
  const size_t at = (size_t)(fit->parts.first + fit->index) * readings;
  double *residuals = NULL;
  if (fit->residuals > 0) {
    residuals = (double *)(void *)(fit->reply + fit_residuals_offset(fit->parts.count)) +
                (size_t)fit->index * readings;
  }
  core_fit_result result;
  core_fit_run(fit->lookup.fit, fit->request.values + at, fit->request.errors + at, &result,
               residuals);
  const wire_fitted fitted = fit_result_encode(&result);
  wire_put_fitted(fit->reply + WIRE_BYTES_fit_reply + fit->index * WIRE_BYTES_fitted, &fitted);
  fit->fitted += result.status == CORE_FIT_STATUS_FITTED;
  fit->notes |= result.notes;
  fit->index++;
  return (result.evaluations + 1) * fit->evaluation_radii;
}

static enum job_outcome step(struct job *job, uint64_t *budget) {
  struct fit_job *fit = of(job);
  const enum job_outcome outcome = fit->lookup.ready ? JOB_GOES_ON : get_design(fit);
  if (outcome != JOB_GOES_ON) {
    return outcome;
  }
  uint64_t spent = JOB_STEP_RADII;
  const uint64_t begun = fit->index;
  while (fit->index < fit->parts.count && spent < JOB_SLICE_RADII) {
    spent += fit_next(fit);
  }
  stats_add(&job->context->server->stats, STATS_SETS_FITTED, fit->index - begun);
  job_pay(job, (fit->index - begun) * set_radii(fit));
  *budget -= spent < *budget ? spent : *budget;
  return fit->index == fit->parts.count ? end_part(fit) : JOB_GOES_ON;
}

static void end(struct job *job) {
  profiles_return(&of(job)->lookup);
}

const struct job_kind job_kind_FIT = {
    .start = start, .begin_part = begin_part, .step = step, .end = end};
