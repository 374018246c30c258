#include "server/jobs/job.h"

#include <assert.h>
#include <math.h>
#include <string.h>

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
  job->radii_done = job->draws || (fixed->wanted & CORE_QUANTITY_RADIUS) == 0;
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
  const bool fits = job_lay_out_part(job, UINT64_MAX);
  assert(fits);
}

static size_t value_bytes(const struct job *job) {
  return core_evaluator_bytes(job->request.fixed.evaluator);
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

/* What a radius of a channel costs when all is evaluated by the cheapest means there is. */
static uint64_t least_cost(const struct job *job) {
  const unsigned arrays = job->layout.arrays_per_channel;
  const core_profile dipole = {.evaluator = job->request.fixed.evaluator, .cost = 1};
  return arrays > 0 && job->draws ? arrays + (uint64_t)core_draw_cost(&dipole) : arrays;
}

wire_error job_admit(struct job *job, const struct server *server, struct job_scratch *scratch) {
  const wire_eval_request *fixed = &job->request.fixed;
  /* within max_radii 2^40, and a frame's 2^25 media and eight arrays, for a part of 256 radii */
  const double radii = (double)fixed->radius_count * fixed->medium_count;
  return backlog_admit(&scratch->backlog, &job->share, &server->options,
                       radii * (double)least_cost(job),
                       job->draws ? "sample_count" : "radius_count");
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
  if (!job_choose_again(job)) {
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
  const core_medium medium = job_medium(job, job->channel);
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

/* Where the values of a quantity go that is wanted, from the next radius on. */
static void *place(const struct job *job, enum core_quantity quantity) {
  return job->reply + eval_array_offset(&job->layout, job_wanted(job), job->channel, quantity) +
         (size_t)job->index * value_bytes(job);
}

/* Draws the n radii of a slice, into the reply if they are wanted. */
static const void *draw_radii(const struct job *job, struct job_scratch *scratch, size_t n) {
  const bool wanted = eval_is_array(job_wanted(job), CORE_QUANTITY_RADIUS);
  void *r = wanted ? place(job, CORE_QUANTITY_RADIUS) : scratch->radii;
  const void *u = scratch->numbers;
  if (job->request.radii != NULL) {
    u = listed(job);
  } else if (value_bytes(job) == sizeof(float)) {
    core_draw_f32(&job->draw, job->first + job->index, n, (float *)(void *)scratch->numbers);
  } else {
    core_draw_f64(&job->draw, job->first + job->index, n, scratch->numbers);
  }
  if (value_bytes(job) == sizeof(float)) {
    core_sample_f32(&job->order.profile, n, u, r);
  } else {
    core_sample_f64(&job->order.profile, n, u, r);
  }
  return r;
}

/* Evaluates the n radii of a slice for every array that is wanted, or leaves it to the batch: of
 * a request that is short as a whole. */
static void evaluate(struct job *job, struct server *server, struct job_scratch *scratch,
                     size_t n) {
  const bool is_short = job->count == n && n <= BATCH_SHORT_RADII && n > 0;
  const void *r = job->draws ? draw_radii(job, scratch, n) : slice_radii(job, scratch, n);
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    if (!core_quantity_elementwise(quantity->id) ||
        (job->request.fixed.wanted & quantity->id) == 0) {
      continue;
    }
    void *to = place(job, quantity->id);
    if (is_short &&
        batch_take(&scratch->batch, &server->stats, job->order.place, quantity->id, n, r, to)) {
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

/* Others may repeat the request with radii of their own, unless its check depends on the radii. */
static void learn(const struct job *job, struct job_scratch *scratch) {
  if (!job->draws && job->part_count == 1 && job->covers_all && isnan(job->tolerance)) {
    repeat_learn(&scratch->repeat, &job->request, &job->grid, &job->layout, job->reply,
                 job->order.place);
  }
}

static void channel_step(struct job *job, struct server *server, struct job_scratch *scratch,
                         size_t n) {
  if (job->layout.arrays_per_channel > 0) {
    evaluate(job, server, scratch, n);
    backlog_pay(&scratch->backlog, &job->share, n * least_cost(job));
    stats_count_radii(&server->stats, job->request.fixed.model, n);
    stats_add(&server->stats, STATS_RADII_DRAWN, job->draws ? n : 0);
    stats_add(&server->stats, STATS_SLICES_EVALUATED, 1);
  }
  if (job->layout.arrays_per_channel == 0 || advance(job, n)) {
    pad_channel(job);
    job->channel++;
    if (job->channel == job->request.fixed.medium_count) {
      put_notes(job);
      learn(job, scratch);
    }
    job_end(job);
  }
}

/* Kernels that draw evaluate whole vectors, again and again. */
enum { DRAW_VECTOR = 8 };

static size_t slice_length(const struct job *job, double cost) {
  const uint64_t left = job->count - job->index;
  size_t most = (size_t)fmax(JOB_SLICE_RADII / cost, 1);
  if (job->draws) {
    most = most < DRAW_VECTOR ? DRAW_VECTOR : most / DRAW_VECTOR * DRAW_VECTOR;
  }
  return left < most ? (size_t)left : most;
}

/* Of one radius of the channel. */
static double cost_of(const struct job *job) {
  const core_profile *profile = &job->order.profile;
  return profile->cost + (job->draws ? core_draw_cost(profile) : 0);
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
    cost = cost_of(job);
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
