/* Invert: finds media of given albedos and lengths, slice by slice. */
#include <math.h>

#include "core/inverter.h"
#include "core/ruler.h"
#include "server/jobs/job.h"

/* The cost of a probe, which finds the albedo of a medium, in radii of a dipole. A slow profile is
 * prepared on another thread and costs the worker only the request for it. `transport` solves for
 * the albedo alone, in about half a millisecond. */
enum {
  PROBE_RADII = 1024,
  COSTLY_PROBE_RADII = JOB_SLICE_RADII,
  SOLVED_PROBE_RADII = 32 * JOB_SLICE_RADII,
  SLOW_PROBE_RADII = JOB_STEP_RADII,
  PROBES = 8,       /* average number of probes for a medium */
  BOUND_PROBES = 2, /* and for its errors */
  /* that of transport's albedo, from the table of solutions, for the model error: 70 us */
  COMPARISON_RADII = 2 * JOB_SLICE_RADII,
};

struct invert_job {
  struct job job;
  wire_invert_request fixed;
  const double *albedos, *lengths; /* [fixed.medium_count], in the payload; lengths in mm */
  core_inverter inverter;
  bool reach_known;              /* whether the range of albedos that the model reaches is known */
  bool seeking;                  /* whether the search for the medium at index has begun */
  bool slow;                     /* whether the profiles of probes are prepared on another thread */
  struct profiles_lookup lookup; /* profiles of probes that are slow to prepare */
  uint64_t probe_radii;          /* cost of a probe, in radii of a dipole */
  uint64_t missing;              /* how many media of the part do not exist, so far */
};

JOB_STRUCTURE(struct invert_job, invert_of)

/* ---- checking -------------------------------------------------------------------------------- */

/* Checks albedos and lengths. The first loop checks all values without a branch. The second loop
 * runs only if a value is wrong, and finds the first wrong one. */
static wire_error check_media(const struct invert_job *invert) {
  const uint64_t count = invert->fixed.medium_count;
  const double *albedos = invert->albedos, *lengths = invert->lengths;
  int good = 1;
  for (uint64_t i = 0; i < count; i++) {
    good &= (albedos[i] >= 0) & (albedos[i] <= 1) & (lengths[i] >= CORE_MEAN_FREE_PATH_MIN_MM) &
            (lengths[i] <= CORE_MEAN_FREE_PATH_MAX_MM);
  }
  for (uint64_t i = 0; !good && i < count; i++) {
    core_fault fault = core_inversion_check(albedos[i], lengths[i]);
    if (fault.field != NULL) {
      fault.index = i;
      return job_error(fault);
    }
  }
  return wire_error_none();
}

static wire_error check_invert(struct invert_job *invert, const struct job_request *from) {
  const struct options *options = &invert->job.context->server->options;
  const wire_invert_request *fixed = &invert->fixed;
  wire_get_invert_request(from->payload, &invert->fixed);
  invert->albedos = (const double *)(const void *)(from->payload + from->layout.parts[0].at);
  invert->lengths = (const double *)(const void *)(from->payload + from->layout.parts[1].at);
  const core_fault fault =
      core_inverter_start(&invert->inverter, fixed->model, fixed->moments,
                          fixed->light == 0 ? CORE_LIGHT_BEAM : fixed->light - 1,
                          fixed->specular != 0, fixed->g, fixed->eta, 1);
  if (fault.field != NULL) {
    return job_error(fault);
  }
  invert->slow = core_finds_albedo_slowly(fixed->model);
  if (invert->slow && fixed->medium_count > options->max_media) {
    return job_too_large("medium_count", options->max_media,
                         "media of a model that takes long to prepare");
  }
  return check_media(invert);
}

static bool compares(const struct invert_job *invert) {
  return invert->fixed.errors == 2 && !core_solves(invert->fixed.model);
}

static uint64_t medium_radii(const struct invert_job *invert) {
  const bool bounds = invert->fixed.errors > 0;
  return (PROBES + (bounds ? BOUND_PROBES : 0)) * invert->probe_radii +
         (compares(invert) ? COMPARISON_RADII : 0);
}

static enum job_outcome start_invert(struct job *job, const struct job_request *request) {
  struct invert_job *invert = invert_of(job);
  const wire_invert_request *fixed = &invert->fixed;
  if (!job_passes(job, check_invert(invert, request))) {
    return JOB_REFUSED;
  }
  const core_medium medium = {1, 1 / (1 - fixed->g), fixed->g, fixed->eta};
  const core_parameters none = core_parameters_none();
  const bool solved = invert->inverter.light != CORE_LIGHT_BEAM ||
                      core_prepares_slowly(fixed->model, CORE_EVALUATOR_F64, &medium, &none);
  const bool costly = core_worth_keeping(fixed->model, CORE_EVALUATOR_F64, NULL);
  invert->probe_radii = invert->slow ? SLOW_PROBE_RADII
                        : solved     ? SOLVED_PROBE_RADII
                        : costly     ? COSTLY_PROBE_RADII
                                     : PROBE_RADII;
  const double radii = (double)fixed->medium_count * (double)medium_radii(invert);
  if (!job_passes(job, job_admit(job, radii, "medium_count"))) {
    return JOB_REFUSED;
  }
  invert->inverter.finds_errors = fixed->errors > 0;
  invert->missing = 0;
  invert->reach_known = false;
  invert->seeking = false;
  job_init_lookup(job, &invert->lookup, request);
  profiles_start(&invert->lookup, fixed->model, fixed->moments, CORE_EVALUATOR_F64, &none);
  const wire_invert_reply start = {.errors = fixed->errors};
  job_parts_fit(job, &schema_invert_reply, &start, 1, fixed->medium_count);
  return JOB_NEXT_PART;
}

/* ---- parts ----------------------------------------------------------------------------------- */

static enum job_outcome end_invert_part(struct invert_job *invert) {
  const wire_invert_request *fixed = &invert->fixed;
  const wire_invert_reply start = {
      .model = fixed->model,
      .moments = fixed->moments,
      .given = fixed->given,
      .errors = fixed->errors,
      .missing_count = invert->missing,
      .albedo_least = core_inverter_seen(&invert->inverter, invert->inverter.albedo_least),
      .albedo_most = core_inverter_seen(&invert->inverter, invert->inverter.albedo_most),
  };
  invert->missing = 0;
  return job_part_end(&invert->job, &schema_invert_reply, &start);
}

/* ---- looking for media ----------------------------------------------------------------------- */

/* Writes the medium at index, for which the search has ended. */
static void put_medium(struct invert_job *invert) {
  const core_inverter *inverter = &invert->inverter;
  const bool found = inverter->found;
  const unsigned errors = invert->fixed.errors;
  const double results[] = {
      inverter->medium.sigma_a_per_mm,
      inverter->medium.sigma_s_per_mm,
      found ? core_inverter_seen(inverter, inverter->albedo) : (double)NAN,
      inverter->sigma_a_error_per_mm,
      inverter->sigma_s_error_per_mm,
      found && errors == 2
          ? core_ruler_albedo_error(invert->job.context->server->isa, inverter->model,
                                    &inverter->medium, inverter->albedo)
          : (double)NAN,
  };
  double *arrays = (double *)(void *)(invert->job.parts.payload + WIRE_BYTES_invert_reply);
  for (size_t i = 0; i < 3 + (errors > 0 ? 1 + errors : 0); i++) {
    arrays[i * invert->job.parts.count + invert->job.parts.index] =
        found ? results[i] : (double)NAN;
  }
  invert->missing += !found;
  invert->job.parts.index++;
  invert->seeking = false;
}

/* Sets *albedo to the albedo of the medium that the inverter tries next, and *error to its error. */
static enum job_outcome try_medium(struct invert_job *invert, double *albedo, double *error) {
  struct job_context *context = invert->job.context;
  const wire_invert_request *fixed = &invert->fixed;
  const uint64_t i = invert->job.parts.first + invert->job.parts.index;
  if (!invert->slow) {
    const core_fault fault =
        core_albedo(context->server->isa, fixed->model, fixed->moments, invert->inverter.light,
                    &invert->inverter.medium, albedo, error);
    return job_follow(&invert->job, fault.field == NULL ? LOOKUP_READY : LOOKUP_FAULT, &fault, i);
  }
  const enum lookup_state state =
      profiles_get(&context->profiles, &invert->lookup, &invert->inverter.medium);
  if (state == LOOKUP_READY) {
    *albedo = invert->lookup.profile.albedo;
    *error = invert->lookup.profile.numerical_errors[CORE_ERROR_BANDS];
    profiles_return(&invert->lookup);
  }
  return job_follow(&invert->job, state, &invert->lookup.fault, i);
}

/* Gives the albedo of a probe to the inverter. The first probes find out which albedos the model
 * can reach. */
static enum job_outcome take_albedo(struct invert_job *invert, double albedo, double error,
                                    uint64_t *spent) {
  if (!core_inverter_take(&invert->inverter, albedo, error)) {
    return JOB_GOES_ON;
  }
  if (invert->reach_known) {
    *spent += compares(invert) ? COMPARISON_RADII : 0;
    put_medium(invert);
    return JOB_GOES_ON;
  }
  invert->reach_known = true;
  const core_fault fault = core_inverter_check(&invert->inverter);
  return job_check(&invert->job, job_error(fault));
}

/* Does one step of the search: begins with the next medium, or probes once more. An albedo that the
 * model cannot reach needs no probe. */
static enum job_outcome seek_medium(struct job *job, uint64_t *spent) {
  struct invert_job *invert = invert_of(job);
  const uint64_t i = invert->job.parts.first + invert->job.parts.index;
  *spent += invert->probe_radii;
  if (invert->reach_known && !invert->seeking) {
    invert->seeking = true;
    if (core_inverter_seek(&invert->inverter, invert->albedos[i], invert->fixed.given,
                           invert->lengths[i])) {
      put_medium(invert);
      return JOB_GOES_ON;
    }
  }
  double albedo, error;
  const enum job_outcome outcome = try_medium(invert, &albedo, &error);
  if (outcome != JOB_GOES_ON) {
    return outcome;
  }
  return take_albedo(invert, albedo, error, spent);
}

static enum job_outcome step_invert(struct job *job, uint64_t *budget) {
  struct invert_job *invert = invert_of(job);
  const enum job_outcome outcome =
      job_part_run(job, budget, medium_radii(invert), STATS_MEDIA_INVERTED, seek_medium);
  return outcome == JOB_GOES_ON && job_part_is_done(job) ? end_invert_part(invert) : outcome;
}

static void end_invert(struct job *job) {
  profiles_return(&invert_of(job)->lookup);
}

const struct job_kind job_kind_INVERT = {.request = &schema_invert_request,
                                         .start = start_invert,
                                         .begin_part = job_part_begin,
                                         .step = step_invert,
                                         .end = end_invert};
