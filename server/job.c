#include "server/job.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "server/choice.h"

/* ---- checking ---------------------------------------------------------------------------------
 */

static wire_error from_fault(core_fault fault) {
  wire_error error = wire_error_make(WIRE_STATUS_BAD_VALUE, fault.field, fault.allowed);
  error.index = fault.index;
  return error;
}

static core_medium medium_at(const struct job *job, uint32_t channel) {
  wire_medium medium;
  wire_get_medium(job->request.media + (size_t)channel * WIRE_BYTES_medium, &medium);
  return (core_medium){medium.sigma_a, medium.sigma_s, medium.g, medium.eta};
}

/* *radii: where all channels may be evaluated. */
static wire_error check_media(const struct job *job, core_radii_range *radii) {
  const wire_eval_request *fixed = &job->request.fixed;
  *radii = (core_radii_range){0, (double)INFINITY};
  for (uint32_t channel = 0; channel < fixed->medium_count; channel++) {
    const core_medium medium = medium_at(job, channel);
    core_radii_range range;
    core_fault fault = core_profile_check(fixed->model, fixed->moments, fixed->evaluator, &medium,
                                          &job->request.parameters, &range);
    if (fault.field != NULL) {
      fault.index = channel;
      return from_fault(fault);
    }
    radii->least_mm = fmax(radii->least_mm, range.least_mm);
    radii->most_mm = fmin(radii->most_mm, range.most_mm);
  }
  return wire_error_none();
}

/* Radii that the model does not cover, where it covers less than all. */
static wire_error check_range(const struct job *job, const core_radii_range *range) {
  const wire_eval_request *fixed = &job->request.fixed;
  if (fixed->spacing == CORE_SPACING_LIST) {
    const core_fault fault =
        eval_value_bytes(fixed->evaluator) == sizeof(float)
            ? core_radii_range_check_f32(range, fixed->radius_count, job->request.radii)
            : core_radii_range_check_f64(range, fixed->radius_count, job->request.radii);
    return fault.field == NULL ? wire_error_none() : from_fault(fault);
  }
  char allowed[80];
  const bool low = fixed->radius_count > 0 && job->grid.start_mm < range->least_mm;
  const bool high = fixed->radius_count > 1 && job->grid.stop_mm > range->most_mm;
  if (low) {
    snprintf(allowed, sizeof allowed, "at least fit_from: %.6g mm", range->least_mm);
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "radius_start", allowed);
  }
  if (high) {
    snprintf(allowed, sizeof allowed, "at most fit_to: %.6g mm", range->most_mm);
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "radius_stop", allowed);
  }
  return wire_error_none();
}

/* A grid with no radii is as good as an empty list when nothing is evaluated at radii. */
static wire_error check_radii(const struct job *job) {
  const wire_eval_request *fixed = &job->request.fixed;
  core_fault fault = {0};
  if (fixed->spacing != CORE_SPACING_LIST) {
    if (fixed->wanted != CORE_QUANTITY_ALBEDO || fixed->radius_count > 0) {
      fault = core_grid_check(&job->grid);
    }
    if (fault.field != NULL && strcmp(fault.field, "radius_count") == 0) {
      return wire_error_make(WIRE_STATUS_BAD_COUNT, fault.field, fault.allowed);
    }
  } else if (eval_value_bytes(fixed->evaluator) == sizeof(float)) {
    fault = core_radii_check_f32(fixed->radius_count, job->request.radii);
  } else {
    fault = core_radii_check_f64(fixed->radius_count, job->request.radii);
  }
  return fault.field == NULL ? wire_error_none() : from_fault(fault);
}

static wire_error too_large(const char *field, uint64_t most, const char *what) {
  char allowed[80];
  snprintf(allowed, sizeof allowed, "at most %llu %s", (unsigned long long)most, what);
  return wire_error_make(WIRE_STATUS_TOO_LARGE, field, allowed);
}

/* Takes the candidate after those that have been tried; false: none is left that keeps the
 * tolerance. */
static bool take_next(struct job *job, const struct choice *choice) {
  if (job->choice >= choice->count || !choice->candidates[job->choice].meets) {
    return false;
  }
  const core_candidate *candidate = &choice->candidates[job->choice++];
  job->model_error = candidate->model_error;
  choice_take(candidate, &job->request);
  return true;
}

/* A model and evaluator for a request that names none. */
static wire_error choose(struct job *job) {
  wire_error error = choice_check(&job->request);
  if (error.status == WIRE_STATUS_OK) {
    error = check_radii(job);
  }
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  struct choice choice;
  job->tolerance = job->request.parameters.value[CORE_PARAMETER_TOLERANCE];
  choice_list(&job->request, &choice);
  return take_next(job, &choice) ? wire_error_none() : choice_none(&choice);
}

/* When what was chosen cannot be prepared after all, the next best; false: there is none. A lack of
 * memory decides nothing: the same request gets the same model. */
static bool choose_again(struct job *job) {
  if (isnan(job->tolerance) || strcmp(job->order.fault.field, CORE_FIELD_MEMORY) == 0) {
    return false;
  }
  struct choice choice;
  job->request.parameters.value[CORE_PARAMETER_TOLERANCE] = job->tolerance;
  choice_list(&job->request, &choice);
  return take_next(job, &choice);
}

/* Takes a request apart; what it says of the layout is right. */
static wire_error parse(struct job *job, const struct server *server, const uint8_t *payload,
                        size_t payload_bytes) {
  const wire_error error = eval_request_parse(payload, payload_bytes, &job->request);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  const wire_eval_request *fixed = &job->request.fixed;
  job->tolerance = (double)NAN;
  job->choice = 0;
  job->grid =
      (core_grid){fixed->spacing, fixed->radius_count, fixed->radius_start, fixed->radius_stop};
  return fixed->medium_count > server->options.max_media
             ? too_large("medium_count", server->options.max_media, "media")
             : wire_error_none();
}

wire_error job_offers(const struct server *server, const uint8_t *payload, size_t payload_bytes,
                      struct choice *choice) {
  struct job job;
  wire_error error = parse(&job, server, payload, payload_bytes);
  if (error.status == WIRE_STATUS_OK && job.request.fixed.model != EVAL_ANY_MODEL) {
    error = wire_error_make(WIRE_STATUS_BAD_VALUE, "model", "0: any");
  }
  if (error.status == WIRE_STATUS_OK) {
    error = choice_check(&job.request);
  }
  if (error.status == WIRE_STATUS_OK) {
    error = check_radii(&job);
  }
  if (error.status == WIRE_STATUS_OK) {
    choice_list(&job.request, choice);
  }
  return error;
}

/* The layout of the part that begins at job->first. */
static bool lay_out_part(struct job *job, uint64_t max_bytes) {
  const wire_eval_request *fixed = &job->request.fixed;
  const uint64_t left = fixed->radius_count - job->first;
  job->count = left < job->part_radii ? left : job->part_radii;
  return eval_reply_layout(fixed->evaluator, fixed->wanted, fixed->medium_count, job->count,
                           max_bytes, &job->layout);
}

/* A reply that fits into a frame is one part; a larger one comes in parts of max_part_bytes, so that
 * what it takes in memory does not depend on its size. */
static wire_error cut(struct job *job, const struct server *server) {
  const wire_eval_request *fixed = &job->request.fixed;
  const struct options *options = &server->options;
  if (fixed->radius_count > options->max_radii) {
    return too_large("radius_count", options->max_radii, "radii");
  }
  job->first = 0;
  job->part = 0;
  job->part_count = 1;
  job->part_radii = fixed->radius_count;
  if (lay_out_part(job, options->max_frame_bytes)) {
    return wire_error_none();
  }
  const uint64_t most_bytes = options->max_part_bytes < options->max_frame_bytes
                                  ? options->max_part_bytes
                                  : options->max_frame_bytes;
  job->part_radii =
      eval_part_radii(fixed->evaluator, fixed->wanted, fixed->medium_count, most_bytes);
  if (job->part_radii == 0) {
    return wire_error_make(WIRE_STATUS_TOO_LARGE, "medium_count",
                           "fewer: a part of max_part_bytes has no room for them");
  }
  const uint64_t parts = (fixed->radius_count - 1) / job->part_radii + 1;
  if (parts > UINT32_MAX) { /* 2^40 radii in parts of 256 */
    return too_large("radius_count", UINT32_MAX * job->part_radii,
                     "radii in parts as small as these");
  }
  job->part_count = (uint32_t)parts;
  const bool fits = lay_out_part(job, most_bytes);
  assert(fits);
  return wire_error_none();
}

wire_error job_check(struct job *job, const struct server *server, const uint8_t *payload,
                     size_t payload_bytes) {
  wire_error error = parse(job, server, payload, payload_bytes);
  const wire_eval_request *fixed = &job->request.fixed;
  if (error.status == WIRE_STATUS_OK && fixed->model == EVAL_ANY_MODEL) {
    error = choose(job);
  }
  core_radii_range range;
  if (error.status == WIRE_STATUS_OK) {
    error = check_media(job, &range);
  }
  if (error.status == WIRE_STATUS_OK) {
    error = check_radii(job);
  }
  if (error.status == WIRE_STATUS_OK) {
    job->covers_all = range.least_mm <= 0 && range.most_mm >= (double)INFINITY;
    error = check_range(job, &range);
  }
  return error.status == WIRE_STATUS_OK ? cut(job, server) : error;
}

/* ---- evaluating -------------------------------------------------------------------------------
 */

void job_start_part(struct job *job, uint8_t *reply) {
  const wire_eval_request *fixed = &job->request.fixed;
  /* The notes are known when all channels have been prepared. */
  const wire_eval_reply start = {
      .model = fixed->model,
      .evaluator = fixed->evaluator,
      .moments = fixed->moments,
      .wanted = fixed->wanted,
      .channel_count = fixed->medium_count,
      .radius_count = job->count,
      .radius_first = job->first,
      .part = job->part,
      .part_count = job->part_count,
  };
  wire_put_eval_reply(reply, &start);
  job->reply = reply;
  job->notes = 0;
  job->channel = 0;
  job->index = 0;
  job->radii_done = (fixed->wanted & CORE_QUANTITY_RADIUS) == 0;
}

void job_start(struct job *job, uint8_t *reply) {
  const wire_eval_request *fixed = &job->request.fixed;
  profiles_start(&job->order, fixed->model, fixed->moments, fixed->evaluator,
                 &job->request.parameters);
  job_start_part(job, reply);
}

void job_next_part(struct job *job) {
  job->first += job->count;
  job->part++;
  const bool fits = lay_out_part(job, UINT64_MAX);
  assert(fits);
}

static size_t value_bytes(const struct job *job) {
  return eval_value_bytes(job->request.fixed.evaluator);
}

/* Arrays are padded with zero bytes; called when the last value of an array has been written. */
static void pad(const struct job *job, uint64_t array_offset) {
  const size_t used = (size_t)job->count * value_bytes(job);
  memset(job->reply + array_offset + used, 0, (size_t)job->layout.array_bytes - used);
}

static void expand_grid(const struct job *job, size_t n, void *radii) {
  if (value_bytes(job) == sizeof(float)) {
    core_grid_radii_f32(&job->grid, job->first + job->index, n, radii);
  } else {
    core_grid_radii_f64(&job->grid, job->first + job->index, n, radii);
  }
}

/* The listed radii from the next one on. */
static const uint8_t *listed(const struct job *job) {
  return (const uint8_t *)job->request.radii + (size_t)(job->first + job->index) * value_bytes(job);
}

static void copy_radii(const struct job *job, size_t n) {
  const size_t offset = (size_t)job->index * value_bytes(job);
  uint8_t *to = job->reply + job->layout.radius_offset + offset;
  if (job->request.radii != NULL) {
    memcpy(to, listed(job), n * value_bytes(job));
  } else {
    expand_grid(job, n, to);
  }
}

/* Radii come from the request, from the reply if they are in it, or are made anew. */
static const void *slice_radii(const struct job *job, struct job_scratch *scratch, size_t n) {
  const size_t offset = (size_t)job->index * value_bytes(job);
  if (job->request.radii != NULL) {
    return listed(job);
  }
  if (job->request.fixed.wanted & CORE_QUANTITY_RADIUS) {
    return job->reply + job->layout.radius_offset + offset;
  }
  expand_grid(job, n, scratch->radii);
  return scratch->radii;
}

void job_end(struct job *job) {
  profiles_return(&job->order);
}

wire_error job_busy(void) {
  wire_error error =
      wire_error_make(WIRE_STATUS_BUSY, "", "less at a time: max_total_bytes is in use");
  error.retry_after_ms = JOB_RETRY_AFTER_MS;
  return error;
}

wire_error job_fault(core_fault fault, uint32_t channel) {
  fault.index = channel;
  wire_error error = from_fault(fault);
  if (strcmp(fault.field, CORE_FIELD_MEMORY) == 0) {
    error.status = WIRE_STATUS_BUSY;
    error.retry_after_ms = JOB_RETRY_AFTER_MS;
  }
  return error;
}

/* About what a radius takes, ns: of a dipole on a slow machine. */
#define RADIUS_NS 2

wire_error job_admit(struct job *job, const struct server *server, struct job_scratch *scratch) {
  const wire_eval_request *fixed = &job->request.fixed;
  const uint64_t backlog_ms = scratch->owed_radii * RADIUS_NS / 1000000;
  const uint64_t arrays = job->layout.arrays_per_channel * (uint64_t)fixed->medium_count;
  /* within max_radii 2^40, and a frame's 2^25 media and eight arrays, for a part of 256 radii */
  const double owed = (double)fixed->radius_count * (double)arrays;
  job->owed_radii = owed < 1e15 ? (uint64_t)owed : (uint64_t)1000000000000000;
  job->rests = false;
  if (job->owed_radii > JOB_SLICE_RADII && backlog_ms >= server->options.max_backlog_ms) {
    job->owed_radii = 0;
    wire_error error = wire_error_make(WIRE_STATUS_BUSY, "radius_count",
                                       "fewer, or later: max_backlog_ms is to do");
    error.retry_after_ms = backlog_ms < 60000 ? (uint32_t)backlog_ms : 60000;
    return error;
  }
  scratch->owed_radii += job->owed_radii;
  return wire_error_none();
}

static void pay(struct job *job, struct job_scratch *scratch, uint64_t radii) {
  const uint64_t paid = radii < job->owed_radii ? radii : job->owed_radii;
  job->owed_radii -= paid;
  scratch->owed_radii -= job->rests ? 0 : paid;
}

void job_forgive(struct job *job, struct job_scratch *scratch) {
  pay(job, scratch, job->owed_radii);
}

void job_rest(struct job *job, struct job_scratch *scratch) {
  scratch->owed_radii -= job->rests ? 0 : job->owed_radii;
  job->rests = true;
}

void job_resume(struct job *job, struct job_scratch *scratch) {
  scratch->owed_radii += job->rests ? job->owed_radii : 0;
  job->rests = false;
}

/* Writes what holds for all values of the channel. */
static void start_channel(struct job *job) {
  const core_profile *profile = &job->order.profile;
  job->notes |= profile->notes;
  const bool albedo_wanted = (job->request.fixed.wanted & CORE_QUANTITY_ALBEDO) != 0;
  const wire_channel channel = {
      .albedo = albedo_wanted ? profile->albedo : (double)NAN,
      .numerical_error = profile->numerical_error,
      .numerical_error_per_mm = profile->numerical_error_per_mm,
      .model_error = isnan(job->tolerance) ? profile->model_error : job->model_error,
  };
  wire_put_channel(job->reply + job->layout.channels_offset +
                       (size_t)job->channel * WIRE_BYTES_channel,
                   &channel);
}

/* Begins again with what is the next best. */
static bool start_again(struct job *job, struct server *server, struct job_scratch *scratch) {
  if (!choose_again(job)) {
    return false;
  }
  /* What has been gathered for earlier channels would be written over the values that come now. */
  batch_finish(&scratch->batch, &server->stats);
  job_start(job, job->reply);
  return true;
}

/* The profile of a channel that has none yet. */
static enum job_state get_profile(struct job *job, struct server *server, struct profiles *profiles,
                                  struct job_scratch *scratch) {
  const core_medium medium = medium_at(job, job->channel);
  switch (profiles_get(profiles, &job->order, &medium)) {
  case PROFILES_WAIT:
    return JOB_WAITS;
  case PROFILES_FAULT:
    if (start_again(job, server, scratch)) {
      return JOB_GOES_ON;
    }
    job->refusal = job_fault(job->order.fault, job->channel);
    return JOB_REFUSED;
  case PROFILES_READY:
    break;
  }
  start_channel(job);
  return JOB_GOES_ON;
}

/* Evaluates the n radii of a slice for every array that is wanted, or leaves it to the batch: of
 * a request that is short as a whole. */
static void evaluate(struct job *job, struct server *server, struct job_scratch *scratch,
                     size_t n) {
  const bool is_short = job->count == n && n <= BATCH_SHORT_RADII && n > 0;
  const void *r = slice_radii(job, scratch, n);
  const unsigned wanted = job->request.fixed.wanted;
  const size_t done = (size_t)job->index * value_bytes(job);
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    if (!eval_is_array(wanted, quantity->id)) {
      continue;
    }
    void *to =
        job->reply + eval_array_offset(&job->layout, wanted, job->channel, quantity->id) + done;
    if (is_short &&
        batch_take(&scratch->batch, &server->stats, &job->order, quantity->id, n, r, to)) {
      continue;
    }
    if (value_bytes(job) == sizeof(float)) {
      core_eval_f32(&job->order.profile, quantity->id, n, r, to);
    } else {
      core_eval_f64(&job->order.profile, quantity->id, n, r, to);
    }
  }
}

/* The arrays of a channel lie one behind the other. */
static void pad_channel(const struct job *job) {
  const uint64_t channel_bytes = job->layout.arrays_per_channel * job->layout.array_bytes;
  uint64_t offset = job->layout.arrays_offset + job->channel * channel_bytes;
  for (unsigned array = 0; array < job->layout.arrays_per_channel; array++) {
    pad(job, offset);
    offset += job->layout.array_bytes;
  }
}

/* Steps to the radii behind a slice of n; true when it was the last of its array. */
static bool advance(struct job *job, size_t n) {
  job->index += n;
  if (job->index < job->count) {
    return false;
  }
  job->index = 0;
  return true;
}

static void radii_step(struct job *job, size_t n) {
  copy_radii(job, n);
  job->radii_done = advance(job, n);
  if (job->radii_done) {
    pad(job, job->layout.radius_offset);
  }
}

/* The bits that start_channel() has gathered, into the start of the reply. */
static void put_notes(const struct job *job) {
  wire_eval_reply start;
  wire_get_eval_reply(job->reply, &start);
  start.notes = job->notes;
  wire_put_eval_reply(job->reply, &start);
}

static void channel_step(struct job *job, struct server *server, struct job_scratch *scratch,
                         size_t n) {
  if (job->layout.arrays_per_channel > 0) {
    evaluate(job, server, scratch, n);
    pay(job, scratch, n * (uint64_t)job->layout.arrays_per_channel);
    stats_add(&server->stats, STATS_RADII_EVALUATED, n);
    stats_add(&server->stats, STATS_SLICES_EVALUATED, 1);
  }
  if (job->layout.arrays_per_channel == 0 || advance(job, n)) {
    pad_channel(job);
    job->channel++;
    if (job->channel == job->request.fixed.medium_count) {
      put_notes(job);
      repeat_learn(&scratch->repeat, job);
    }
    job_end(job);
  }
}

static size_t slice_length(const struct job *job, double cost) {
  const uint64_t left = job->count - job->index;
  const size_t most = (size_t)fmax(JOB_SLICE_RADII / cost, 1);
  return left < most ? (size_t)left : most;
}

enum job_state job_slice(struct job *job, struct server *server, struct profiles *profiles,
                         struct job_scratch *scratch, uint64_t *budget) {
  size_t n;
  double cost = 1;
  if (!job->radii_done) {
    n = slice_length(job, cost);
    radii_step(job, n);
  } else {
    const enum job_state state =
        job->order.ready ? JOB_GOES_ON : get_profile(job, server, profiles, scratch);
    if (state != JOB_GOES_ON || !job->order.ready) {
      return state;
    }
    cost = job->order.profile.cost;
    n = slice_length(job, cost);
    channel_step(job, server, scratch, n);
  }
  const uint64_t spent = (uint64_t)((double)n * cost) + JOB_STEP_RADII;
  *budget -= spent < *budget ? spent : *budget;
  if (job->channel < job->request.fixed.medium_count) {
    return JOB_GOES_ON;
  }
  return job->part + 1 < job->part_count ? JOB_PART_DONE : JOB_DONE;
}
