/* Fit: finds the coefficients of media from sets of readings, set by set. The design that they
 * share is prepared on another thread and kept in the cache. */
#include "proto/fit.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>

#include "server/jobs/job.h"

/* The cost of a profile that is prepared on this thread, in radii of a dipole. */
enum { PROFILE_RADII = JOB_SLICE_RADII };

/* A request of one set is small if that costs at most this: with few readings some 200 evaluations look
 * for a second solution. */
enum { SMALL_SET_RADII = 8 * JOB_SLICE_RADII };

/* A set whose errors are so small that its fit is refined with profiles of the model. */
struct refining {
  struct profiles_lookup lookup; /* gets the profiles */
  core_fit_result result;
  core_medium medium; /* of the next profile */
  unsigned steps;
  bool goes_on;
};

struct fit_job {
  struct job job;
  fit_request request;
  struct lookup lookup;      /* gets the prepared design */
  struct refining *refining; /* NULL as long as no set was refined */
  core_fit_search *search;   /* of the next set; NULL before the first */
  bool searches;             /* whether `search` has begun */
  uint64_t evaluation_radii; /* the cost of an evaluation, in radii of a dipole */
  uint64_t set_radii;        /* average cost of a set, in radii of a dipole */
  uint32_t residuals;        /* how many the reply has for each set: 0, or one for a reading */
  uint64_t fitted;           /* how many sets of the part are a success so far */
  uint32_t notes;
};

JOB_STRUCTURE(struct fit_job, fit_of)

/* ---- designs in the cache -------------------------------------------------------------------- */

static core_fault prepare_design(void *thing, const struct cache_key *key, const core_isa *isa,
                                 const atomic_bool *stop) {
  fit_design read;
  (void)stop;
  fit_design_read(key->content, &read);
  return core_fit_create(thing, isa, &read.design);
}

static void free_design(void *thing) {
  core_fit_free(*(core_fit **)thing);
}

static uint64_t design_bytes_of(const void *thing) {
  return core_fit_bytes(*(core_fit *const *)thing);
}

static const struct cache_kind design_kind = {.thing_bytes = sizeof(core_fit *),
                                              .prepare = prepare_design,
                                              .free = free_design,
                                              .bytes = design_bytes_of};

/* Returns the fit of a design that was looked up; NULL if there is none. */
static const core_fit *found_fit(const struct fit_job *fit) {
  core_fit *const *found = lookup_thing(&fit->lookup);
  return found != NULL ? *found : NULL;
}

/* ---- starting -------------------------------------------------------------------------------- */

static wire_error check_fit(struct fit_job *fit, const struct job_request *from) {
  const wire_error error = fit_request_parse(from->payload, &from->layout, &fit->request);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  fit_design read;
  fit_design_read(fit->request.design_bytes, &read);
  const core_fault fault = core_fit_check(&read.design);
  if (fault.field != NULL) {
    return job_error(fault);
  }
  const core_fit_cost cost = core_fit_cost_of(&read.design);
  fit->evaluation_radii = (uint64_t)cost.evaluation;
  fit->set_radii = cost.evaluations * fit->evaluation_radii;
  fit->residuals = fit->request.fixed.residuals != 0 ? fit->request.design.reading_count : 0;
  return wire_error_none();
}

/* Returns the work that admission control counts. */
static double radii_of(const struct fit_job *fit) {
  const uint64_t sets = fit->request.fixed.set_count;
  return sets == 1 && fit->set_radii <= SMALL_SET_RADII
             ? fmin((double)fit->set_radii, JOB_SLICE_RADII)
             : (double)sets * (double)fit->set_radii;
}

static enum job_outcome start_fit(struct job *job, const struct job_request *request) {
  struct fit_job *fit = fit_of(job);
  if (!job_passes(job, check_fit(fit, request)) ||
      !job_passes(job, job_admit(job, radii_of(fit), "set_count"))) {
    return JOB_REFUSED;
  }
  fit->fitted = 0;
  fit->notes = 0;
  fit->refining = NULL;
  fit->search = NULL;
  fit->searches = false;
  job_init_other(job, &fit->lookup, request);
  /* A reply is larger than its request only if a set has few readings: many sets fit into a part. */
  const wire_fit_reply start = {.reading_count = fit->residuals};
  job_parts_fit(job, &schema_fit_reply, &start, 1, fit->request.fixed.set_count);
  return JOB_NEXT_PART;
}

/* ---- parts ----------------------------------------------------------------------------------- */

static enum job_outcome end_fit_part(struct fit_job *fit) {
  const wire_fit_reply start = {
      .fitted_count = fit->fitted,
      .reading_count = fit->residuals,
      .notes = fit->notes,
  };
  fit->fitted = 0;
  return job_part_end(&fit->job, &schema_fit_reply, &start);
}

/* ---- fitting --------------------------------------------------------------------------------- */

static enum job_outcome get_design(struct fit_job *fit) {
  const enum job_outcome outcome =
      job_get(&fit->job, &fit->lookup, &design_kind, fit->request.design_bytes,
              fit->request.design_bytes_count, CACHE_SLOW);
  if (outcome != JOB_GOES_ON) {
    return outcome;
  }
  fit->search = core_fit_search_new();
  return fit->search != NULL ? JOB_GOES_ON : job_refuse(&fit->job, job_no_memory());
}

/* The next set: its readings, and room for its residuals or NULL. */
struct set {
  const double *values;
  const double *errors;
  double *residuals;
};

static struct set next_set(const struct fit_job *fit) {
  const size_t readings = fit->request.design.reading_count;
  const size_t at = (size_t)(fit->job.parts.first + fit->job.parts.index) * readings;
  struct set set = {fit->request.values + at, fit->request.errors + at, NULL};
  if (fit->residuals > 0) {
    set.residuals =
        (double *)(void *)(fit->job.parts.payload + fit_residuals_offset(fit->job.parts.count)) +
        (size_t)fit->job.parts.index * readings;
  }
  return set;
}

_Static_assert(offsetof(core_fit_result, notes) == WIRE_BYTES_fitted, "a result has its layout");

static void put_result(struct fit_job *fit, const core_fit_result *result) {
  memcpy(fit->job.parts.payload + WIRE_BYTES_fit_reply + fit->job.parts.index * WIRE_BYTES_fitted,
         result, WIRE_BYTES_fitted);
  fit->fitted += result->status == CORE_FIT_STATUS_FITTED;
  fit->notes |= result->notes;
  fit->job.parts.index++;
}

/* Begins to refine the next set from a result. */
static enum job_outcome begin_refining(struct fit_job *fit, const core_fit_result *result,
                                       const core_medium *medium) {
  if (fit->refining == NULL) {
    fit_design read;
    fit_design_read(fit->request.design_bytes, &read);
    fit->refining = malloc(sizeof *fit->refining);
    if (fit->refining == NULL) {
      return job_refuse(&fit->job, job_no_memory());
    }
    struct profiles_lookup *lookup = &fit->refining->lookup;
    *lookup = (struct profiles_lookup){.cached = {.on_ready = fit->lookup.on_ready,
                                                  .context = fit->lookup.context,
                                                  .owner = &fit->job.owner}};
    profiles_start(lookup, read.design.model, read.design.moments, CORE_EVALUATOR_F64,
                   &read.parameters);
  }
  fit->refining->result = *result;
  fit->refining->medium = *medium;
  fit->refining->steps = 0;
  fit->refining->goes_on = true;
  return JOB_GOES_ON;
}

/* Does one step of refining the next set. */
static enum job_outcome refine_set(struct fit_job *fit) {
  struct refining *refining = fit->refining;
  const enum lookup_state state =
      profiles_get(&fit->job.context->profiles, &refining->lookup, &refining->medium);
  if (state == LOOKUP_FAULT && !lookup_is_busy(refining->lookup.fault)) {
    refining->goes_on = false; /* the model takes the medium of the table, but not this one */
    put_result(fit, &refining->result);
    return JOB_GOES_ON;
  }
  if (state != LOOKUP_READY) {
    return job_follow(&fit->job, state, &refining->lookup.fault, 0);
  }
  const struct set set = next_set(fit);
  const bool more =
      core_fit_refine(found_fit(fit), &refining->lookup.profile, set.values, set.errors,
                      &refining->result, set.residuals, &refining->medium);
  profiles_return(&refining->lookup);
  refining->goes_on = more && ++refining->steps < CORE_FIT_REFINE_MOST;
  if (!refining->goes_on) {
    put_result(fit, &refining->result);
  }
  return JOB_GOES_ON;
}

/* Begins with the next set, or does a step of fitting or refining it. Adds what that cost to *spent,
 * in radii of a dipole. */
static enum job_outcome fit_next(struct job *job, uint64_t *spent) {
  struct fit_job *fit = fit_of(job);
  if (fit->refining != NULL && fit->refining->goes_on) {
    *spent += PROFILE_RADII;
    return refine_set(fit);
  }
  const struct set set = next_set(fit);
  core_fit_result result;
  core_medium medium;
  *spent += fit->evaluation_radii;
  fit->searches = fit->searches ? core_fit_step(fit->search, &result, set.residuals)
                                : core_fit_begin(fit->search, found_fit(fit), set.values,
                                                 set.errors, &result, set.residuals);
  if (fit->searches) {
    return JOB_GOES_ON;
  }
  if (core_fit_wants_exact(found_fit(fit), set.values, set.errors, &result, &medium)) {
    return begin_refining(fit, &result, &medium);
  }
  put_result(fit, &result);
  return JOB_GOES_ON;
}

static enum job_outcome step_fit(struct job *job, uint64_t *budget) {
  struct fit_job *fit = fit_of(job);
  enum job_outcome outcome = fit->lookup.entry != NULL ? JOB_GOES_ON : get_design(fit);
  if (outcome != JOB_GOES_ON) {
    return outcome;
  }
  outcome = job_part_run(job, budget, fit->set_radii, STATS_SETS_FITTED, fit_next);
  return outcome == JOB_GOES_ON && job_part_is_done(job) ? end_fit_part(fit) : outcome;
}

static void end_fit(struct job *job) {
  struct fit_job *fit = fit_of(job);
  lookup_return(&fit->lookup);
  core_fit_search_free(fit->search);
  if (fit->refining != NULL) {
    profiles_return(&fit->refining->lookup);
    free(fit->refining);
  }
}

const struct job_kind job_kind_FIT = {.request = &schema_fit_request,
                                      .start = start_fit,
                                      .begin_part = job_part_begin,
                                      .step = step_fit,
                                      .end = end_fit};
