#include "server/jobs/invert_job.h"

#include <math.h>

/* What a probe takes, in radii of a dipole: preparing a dipole; as long as a slice for what costs
 * more; what is prepared on another thread costs the worker no more than asking for it. */
enum {
  PROBE_RADII = 1024,
  COSTLY_PROBE_RADII = JOB_SLICE_RADII,
  SLOW_PROBE_RADII = JOB_STEP_RADII,
  PROBES = 8, /* for a medium, on average */
};

/* ---- checking ---------------------------------------------------------------------------------
 */

/* All are looked at without a branch; only those with a fault are gone through again. */
static wire_error check_media(const invert_request *request) {
  const uint64_t count = request->fixed.medium_count;
  const double *albedos = request->albedos;
  const double *lengths = request->lengths;
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

/* A reply that fits into a frame is one part; a larger one comes in parts of max_part_bytes. */
static void cut(struct invert_job *job, const struct options *options) {
  const uint64_t count = job->request.fixed.medium_count;
  job->part_media = count;
  if (invert_reply_bytes(count) > options->max_frame_bytes) {
    job->part_media = invert_part_media(options->max_part_bytes < options->max_frame_bytes
                                            ? options->max_part_bytes
                                            : options->max_frame_bytes);
  }
  job->first = 0;
  job->count = job->part_media;
  job->part = 0;
  job->part_count = (uint32_t)((count - 1) / job->part_media + 1); /* a frame holds fewer */
}

wire_error invert_job_check(struct invert_job *job, const struct server *server,
                            const uint8_t *payload, size_t payload_bytes) {
  wire_error error = invert_request_parse(payload, payload_bytes, &job->request);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  const wire_invert_request *fixed = &job->request.fixed;
  const core_fault fault =
      core_inverter_start(&job->inverter, fixed->model, fixed->moments, fixed->g, fixed->eta, 1);
  if (fault.field != NULL) {
    return job_error(fault);
  }
  job->slow = core_prepares_slowly(fixed->model, CORE_EVALUATOR_F64);
  if (job->slow && fixed->medium_count > server->options.max_media) {
    return job_too_large("medium_count", server->options.max_media,
                         "media of a model that takes long to prepare");
  }
  error = check_media(&job->request);
  if (error.status == WIRE_STATUS_OK) {
    const bool costly = core_worth_keeping(fixed->model, CORE_EVALUATOR_F64);
    job->probe_radii = job->slow ? SLOW_PROBE_RADII : costly ? COSTLY_PROBE_RADII : PROBE_RADII;
    job->reach_known = false;
    job->seeking = false;
    const core_parameters none = core_parameters_none();
    profiles_start(&job->order, fixed->model, fixed->moments, CORE_EVALUATOR_F64, &none);
    cut(job, &server->options);
  }
  return error;
}

static uint64_t medium_radii(const struct invert_job *job) {
  return PROBES * job->probe_radii;
}

wire_error invert_job_admit(struct invert_job *job, const struct server *server,
                            struct backlog *backlog) {
  const double radii = (double)job->request.fixed.medium_count * (double)medium_radii(job);
  return backlog_admit(backlog, &job->share, &server->options, radii, "medium_count");
}

/* ---- parts ------------------------------------------------------------------------------------
 */

uint64_t invert_job_part_bytes(const struct invert_job *job) {
  return invert_reply_bytes(job->count);
}

void invert_job_start_part(struct invert_job *job, uint8_t *reply) {
  job->reply = reply;
  job->index = 0;
  job->missing = 0;
}

void invert_job_next_part(struct invert_job *job) {
  job->first += job->count;
  job->part++;
  const uint64_t left = job->request.fixed.medium_count - job->first;
  job->count = left < job->part_media ? left : job->part_media;
}

static enum job_state end_part(struct invert_job *job) {
  const wire_invert_request *fixed = &job->request.fixed;
  const wire_invert_reply start = {
      .model = fixed->model,
      .moments = fixed->moments,
      .given = fixed->given,
      .part = job->part,
      .part_count = job->part_count,
      .medium_count = job->count,
      .medium_first = job->first,
      .missing_count = job->missing,
      .albedo_least = job->inverter.albedo_least,
      .albedo_most = job->inverter.albedo_most,
  };
  wire_put_invert_reply(job->reply, &start);
  return job->part + 1 < job->part_count ? JOB_PART_DONE : JOB_DONE;
}

/* ---- looking for media ------------------------------------------------------------------------
 */

static double *array(const struct invert_job *job, enum invert_array which) {
  return (double *)(void *)(job->reply + invert_array_offset(which, job->count));
}

/* What the search for the medium at index has come to. */
static void put_medium(struct invert_job *job) {
  const core_inverter *inverter = &job->inverter;
  const bool found = inverter->found;
  array(job, INVERT_SIGMA_A)[job->index] = found ? inverter->medium.sigma_a_per_mm : (double)NAN;
  array(job, INVERT_SIGMA_S)[job->index] = found ? inverter->medium.sigma_s_per_mm : (double)NAN;
  array(job, INVERT_ALBEDO)[job->index] = found ? inverter->albedo : (double)NAN;
  job->missing += !found;
  job->index++;
  job->seeking = false;
}

static enum job_state refuse(struct invert_job *job, wire_error refusal) {
  job->refusal = refusal;
  return JOB_REFUSED;
}

/* The albedo of the medium that is to be probed. */
static enum job_state probe(struct invert_job *job, struct server *server,
                            struct profiles *profiles, double *albedo) {
  core_profile profile;
  const wire_invert_request *fixed = &job->request.fixed;
  if (!job->slow) {
    const core_fault fault =
        core_profile_prepare(&profile, server->isa, fixed->model, fixed->moments,
                             CORE_EVALUATOR_F64, &job->inverter.medium, NULL);
    if (fault.field != NULL) {
      return refuse(job, job_fault(fault, (uint32_t)(job->first + job->index)));
    }
    *albedo = profile.albedo;
    core_profile_free(&profile);
    return JOB_GOES_ON;
  }
  switch (profiles_get(profiles, &job->order, &job->inverter.medium)) {
  case PROFILES_WAIT:
    return JOB_WAITS;
  case PROFILES_FAULT:
    return refuse(job, job_fault(job->order.fault, (uint32_t)(job->first + job->index)));
  case PROFILES_READY:
    break;
  }
  *albedo = job->order.profile.albedo;
  profiles_return(&job->order);
  return JOB_GOES_ON;
}

/* Takes what a probe has found. */
static enum job_state take(struct invert_job *job, double albedo) {
  if (!core_inverter_take(&job->inverter, albedo)) {
    return JOB_GOES_ON;
  }
  if (job->reach_known) {
    put_medium(job);
    return JOB_GOES_ON;
  }
  job->reach_known = true;
  const core_fault fault = core_inverter_check(&job->inverter);
  return fault.field == NULL ? JOB_GOES_ON : refuse(job, job_error(fault));
}

/* One step: a medium that there cannot be, or a probe for one that there may be. */
static enum job_state step(struct invert_job *job, struct server *server,
                           struct profiles *profiles) {
  const uint64_t i = job->first + job->index;
  if (job->reach_known && !job->seeking) {
    job->seeking = true;
    if (core_inverter_seek(&job->inverter, job->request.albedos[i], job->request.fixed.given,
                           job->request.lengths[i])) {
      put_medium(job);
      return JOB_GOES_ON;
    }
  }
  double albedo;
  const enum job_state state = probe(job, server, profiles, &albedo);
  if (state != JOB_GOES_ON) {
    return state;
  }
  stats_add(&server->stats, STATS_INVERSION_PROBES, 1);
  return take(job, albedo);
}

enum job_state invert_job_run(struct invert_job *job, struct server *server,
                              struct profiles *profiles, struct backlog *backlog,
                              uint64_t *budget) {
  uint64_t spent = JOB_STEP_RADII;
  enum job_state state = JOB_GOES_ON;
  const uint64_t begun = job->index;
  while (state == JOB_GOES_ON && job->index < job->count && spent < JOB_SLICE_RADII) {
    state = step(job, server, profiles);
    spent += job->probe_radii;
  }
  const uint64_t done = job->index - begun;
  stats_add(&server->stats, STATS_MEDIA_INVERTED, done);
  backlog_pay(backlog, &job->share, done * medium_radii(job));
  *budget -= spent < *budget ? spent : *budget;
  return state == JOB_GOES_ON && job->index == job->count ? end_part(job) : state;
}

void invert_job_end(struct invert_job *job) {
  profiles_return(&job->order);
}
