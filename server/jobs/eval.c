#include "server/jobs/eval.h"

#include <assert.h>
#include <math.h>
#include <string.h>

JOB_FITS_SLOT(struct eval_job);

static struct eval_job *of(struct job *job) {
  return (struct eval_job *)(void *)job;
}

static struct stats *stats_of(const struct eval_job *eval) {
  return &eval->job.context->server->stats;
}

static size_t value_bytes(const struct eval_job *eval) {
  return core_evaluator_bytes(eval->request.fixed.evaluator);
}

/* Arrays are padded with zero bytes; called when the last value of an array has been written. */
static void pad(const struct eval_job *eval, uint64_t array_offset) {
  const size_t used = (size_t)eval->count * value_bytes(eval);
  memset(eval->reply + array_offset + used, 0, (size_t)eval->layout.array_bytes - used);
}

static void expand_grid(const struct eval_job *eval, size_t n, void *radii) {
  if (value_bytes(eval) == sizeof(float)) {
    core_grid_radii_f32(&eval->grid, eval->first + eval->index, n, radii);
  } else {
    core_grid_radii_f64(&eval->grid, eval->first + eval->index, n, radii);
  }
}

/* The listed radii from the next one on. */
static const uint8_t *listed(const struct eval_job *eval) {
  return (const uint8_t *)eval->request.radii +
         (size_t)(eval->first + eval->index) * value_bytes(eval);
}

static void copy_radii(const struct eval_job *eval, size_t n) {
  const size_t offset = (size_t)eval->index * value_bytes(eval);
  uint8_t *to = eval->reply + eval->layout.radius_offset + offset;
  if (eval->request.radii != NULL) {
    memcpy(to, listed(eval), n * value_bytes(eval));
  } else {
    expand_grid(eval, n, to);
  }
}

/* Radii come from the request, from the reply if they are in it, or are made anew. */
static const void *slice_radii(const struct eval_job *eval, size_t n) {
  const size_t offset = (size_t)eval->index * value_bytes(eval);
  if (eval->request.radii != NULL) {
    return listed(eval);
  }
  if (eval->request.fixed.wanted & CORE_QUANTITY_RADIUS) {
    return eval->reply + eval->layout.radius_offset + offset;
  }
  expand_grid(eval, n, eval->job.context->radii);
  return eval->job.context->radii;
}

/* What a radius of a channel costs when all is evaluated by the cheapest means there is. */
static uint64_t least_cost(const struct eval_job *eval) {
  const unsigned arrays = eval->layout.arrays_per_channel;
  const core_profile dipole = {.evaluator = eval->request.fixed.evaluator, .cost = 1};
  return arrays > 0 && eval->draws ? arrays + (uint64_t)core_draw_cost(&dipole) : arrays;
}

/* Writes what holds for all values of the channel. */
static void start_channel(struct eval_job *eval) {
  const core_profile *profile = &eval->order.profile;
  eval->notes |= profile->notes;
  const bool albedo_wanted = (eval->request.fixed.wanted & CORE_QUANTITY_ALBEDO) != 0;
  const wire_channel channel = {
      .albedo = albedo_wanted ? profile->albedo : (double)NAN,
      .numerical_error = profile->numerical_error,
      .numerical_error_per_mm = profile->numerical_error_per_mm,
      .model_error = isnan(eval->tolerance) ? profile->model_error : eval->model_error,
  };
  wire_put_channel(eval->reply + eval->layout.channels_offset +
                       (size_t)eval->channel * WIRE_BYTES_channel,
                   &channel);
}

static void start_part(struct eval_job *eval) {
  const wire_eval_request *fixed = &eval->request.fixed;
  /* put_notes() sets the notes when all channels have been prepared. */
  const wire_eval_reply start = {
      .model = fixed->model,
      .evaluator = fixed->evaluator,
      .moments = fixed->moments,
      .wanted = fixed->wanted,
      .channel_count = fixed->medium_count,
      .radius_count = eval->count,
      .radius_first = eval->first,
      .part = eval->part,
      .part_count = eval->part_count,
  };
  wire_put_eval_reply(eval->reply, &start);
  eval->notes = 0;
  eval->channel = 0;
  eval->index = 0;
  eval->radii_done = eval->draws || (fixed->wanted & CORE_QUANTITY_RADIUS) == 0;
}

static void start_profiles(struct eval_job *eval) {
  const wire_eval_request *fixed = &eval->request.fixed;
  profiles_start(&eval->order, fixed->model, fixed->moments, fixed->evaluator,
                 &eval->request.parameters);
}

/* Begins again with the next best model for a tolerance; returns false if there is none. */
static bool start_again(struct eval_job *eval) {
  if (!eval_job_choose_again(eval)) {
    return false;
  }
  /* Values that are gathered for earlier channels would be written over those that come now. */
  batch_finish(&eval->job.context->batch, stats_of(eval));
  start_profiles(eval);
  start_part(eval);
  return true;
}

/* Gets the profile of a channel that has none yet. */
static enum job_outcome get_profile(struct eval_job *eval) {
  const core_medium medium = eval_job_medium(eval, eval->channel);
  switch (profiles_get(&eval->job.context->profiles, &eval->order, &medium)) {
  case PROFILES_WAIT:
    return JOB_WAITS;
  case PROFILES_FAULT:
    return start_again(eval) ? JOB_GOES_ON
                             : job_refuse(&eval->job, job_fault(eval->order.fault, eval->channel));
  case PROFILES_READY:
    break;
  }
  start_channel(eval);
  return JOB_GOES_ON;
}

/* Where the values of a quantity go that is wanted, from the next radius on. */
static void *place(const struct eval_job *eval, enum core_quantity quantity) {
  return eval->reply +
         eval_array_offset(&eval->layout, eval_job_wanted(eval), eval->channel, quantity) +
         (size_t)eval->index * value_bytes(eval);
}

/* Draws the n radii of a slice, into the reply if they are wanted. */
static const void *draw_radii(const struct eval_job *eval, size_t n) {
  struct job_context *scratch = eval->job.context;
  const bool wanted = eval_is_array(eval_job_wanted(eval), CORE_QUANTITY_RADIUS);
  void *r = wanted ? place(eval, CORE_QUANTITY_RADIUS) : scratch->radii;
  const void *u = scratch->numbers;
  if (eval->request.radii != NULL) {
    u = listed(eval);
  } else if (value_bytes(eval) == sizeof(float)) {
    core_draw_f32(&eval->draw, eval->first + eval->index, n, (float *)(void *)scratch->numbers);
  } else {
    core_draw_f64(&eval->draw, eval->first + eval->index, n, scratch->numbers);
  }
  if (value_bytes(eval) == sizeof(float)) {
    core_sample_f32(&eval->order.profile, n, u, r);
  } else {
    core_sample_f64(&eval->order.profile, n, u, r);
  }
  return r;
}

/* Evaluates the n radii of a slice for every array that is wanted, or leaves it to the batch: of
 * a request that is short as a whole. */
static void evaluate(struct eval_job *eval, size_t n) {
  const bool is_short = eval->count == n && n <= BATCH_SHORT_RADII && n > 0;
  const void *r = eval->draws ? draw_radii(eval, n) : slice_radii(eval, n);
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    if (!core_quantity_elementwise(quantity->id) ||
        (eval->request.fixed.wanted & quantity->id) == 0) {
      continue;
    }
    void *to = place(eval, quantity->id);
    if (is_short && batch_take(&eval->job.context->batch, stats_of(eval), eval->order.place,
                               quantity->id, n, r, to)) {
      continue;
    }
    if (value_bytes(eval) == sizeof(float)) {
      core_eval_f32(&eval->order.profile, quantity->id, n, r, to);
    } else {
      core_eval_f64(&eval->order.profile, quantity->id, n, r, to);
    }
  }
}

/* The arrays of a channel lie one behind the other. */
static void pad_channel(const struct eval_job *eval) {
  const uint64_t channel_bytes = eval->layout.arrays_per_channel * eval->layout.array_bytes;
  uint64_t offset = eval->layout.arrays_offset + eval->channel * channel_bytes;
  for (unsigned array = 0; array < eval->layout.arrays_per_channel; array++) {
    pad(eval, offset);
    offset += eval->layout.array_bytes;
  }
}

/* Steps to the radii behind a slice of n; true when it was the last of its array. */
static bool advance(struct eval_job *eval, size_t n) {
  eval->index += n;
  if (eval->index < eval->count) {
    return false;
  }
  eval->index = 0;
  return true;
}

static void radii_step(struct eval_job *eval, size_t n) {
  copy_radii(eval, n);
  eval->radii_done = advance(eval, n);
  if (eval->radii_done) {
    pad(eval, eval->layout.radius_offset);
  }
}

/* The bits that start_channel() has gathered, into the start of the reply. */
static void put_notes(const struct eval_job *eval) {
  wire_eval_reply start;
  wire_get_eval_reply(eval->reply, &start);
  start.notes = eval->notes;
  wire_put_eval_reply(eval->reply, &start);
}

/* Later requests may repeat this one with other radii, unless its check depends on the radii. */
static void learn(const struct eval_job *eval) {
  if (!eval->draws && eval->part_count == 1 && eval->covers_all && isnan(eval->tolerance)) {
    repeat_learn(&eval->job.context->repeat, &eval->request, &eval->grid, &eval->layout,
                 eval->reply, eval->order.place);
  }
}

static void channel_step(struct eval_job *eval, size_t n) {
  if (eval->layout.arrays_per_channel > 0) {
    evaluate(eval, n);
    job_pay(&eval->job, n * least_cost(eval));
    stats_count_radii(stats_of(eval), eval->request.fixed.model, n);
    stats_add(stats_of(eval), STATS_RADII_DRAWN, eval->draws ? n : 0);
    stats_add(stats_of(eval), STATS_SLICES_EVALUATED, 1);
  }
  if (eval->layout.arrays_per_channel == 0 || advance(eval, n)) {
    pad_channel(eval);
    eval->channel++;
    if (eval->channel == eval->request.fixed.medium_count) {
      put_notes(eval);
      learn(eval);
    }
    profiles_return(&eval->order);
  }
}

/* Kernels that draw evaluate whole vectors, again and again. */
enum { DRAW_VECTOR = 8 };

static size_t slice_length(const struct eval_job *eval, double cost) {
  const uint64_t left = eval->count - eval->index;
  size_t most = (size_t)fmax(JOB_SLICE_RADII / cost, 1);
  if (eval->draws) {
    most = most < DRAW_VECTOR ? DRAW_VECTOR : most / DRAW_VECTOR * DRAW_VECTOR;
  }
  return left < most ? (size_t)left : most;
}

/* Of one radius of the channel. */
static double cost_of(const struct eval_job *eval) {
  const core_profile *profile = &eval->order.profile;
  return profile->cost + (eval->draws ? core_draw_cost(profile) : 0);
}

/* ---- the kinds eval and sample ------------------------------------------------------------------
 */

static enum job_outcome admit(struct eval_job *eval, wire_error error,
                              const struct job_request *request) {
  const wire_eval_request *fixed = &eval->request.fixed;
  if (error.status == WIRE_STATUS_OK) {
    /* At most 2^40 radii (max_radii), 2^25 media in a frame, and eight arrays. */
    const double radii = (double)fixed->radius_count * fixed->medium_count;
    error = job_admit(&eval->job, radii * (double)least_cost(eval),
                      eval->draws ? "sample_count" : "radius_count");
  }
  if (error.status != WIRE_STATUS_OK) {
    return job_refuse(&eval->job, error);
  }
  eval->repeated = NULL;
  eval->payload = request->payload;
  job_init_order(&eval->order, request);
  start_profiles(eval);
  eval->job.part_bytes = eval->layout.payload_bytes;
  return JOB_NEXT_PART;
}

static enum job_outcome start_eval(struct job *job, const struct job_request *request) {
  struct eval_job *eval = of(job);
  eval->repeated =
      repeat_find(&job->context->repeat, request->payload, request->header->payload_bytes);
  if (eval->repeated != NULL) {
    eval->payload = request->payload;
    job->latency = LATENCY_EVAL_SHORT;
    job->part_bytes = eval->repeated->reply_bytes;
    return JOB_NEXT_PART;
  }
  const wire_error error =
      eval_job_check(eval, job->context->server, request->payload, request->header->payload_bytes);
  if (error.status == WIRE_STATUS_OK) {
    job->latency = eval->request.fixed.radius_count <= BATCH_SHORT_RADII ? LATENCY_EVAL_SHORT
                                                                         : LATENCY_EVAL_LONG;
  }
  return admit(eval, error, request);
}

static enum job_outcome start_sample(struct job *job, const struct job_request *request) {
  struct eval_job *eval = of(job);
  const wire_error error = eval_job_check_sample(eval, job->context->server, request->payload,
                                                 request->header->payload_bytes);
  return admit(eval, error, request);
}

static enum job_outcome begin_part(struct job *job, uint8_t *payload) {
  struct eval_job *eval = of(job);
  if (eval->repeated != NULL) {
    struct job_context *context = job->context;
    repeat_answer(eval->repeated, &context->batch, stats_of(eval), eval->payload, context->radii,
                  payload);
    return JOB_DONE;
  }
  eval->reply = payload;
  start_part(eval);
  return JOB_GOES_ON;
}

/* The part is complete. */
static enum job_outcome end_part(struct eval_job *eval) {
  if (eval->part + 1 == eval->part_count) {
    return JOB_DONE;
  }
  eval->first += eval->count;
  eval->part++;
  const bool fits = eval_job_lay_out_part(eval, UINT64_MAX);
  assert(fits);
  eval->job.part_bytes = eval->layout.payload_bytes;
  return JOB_NEXT_PART;
}

static enum job_outcome step(struct job *job, uint64_t *budget) {
  struct eval_job *eval = of(job);
  size_t n;
  double cost = 1;
  if (!eval->radii_done) {
    n = slice_length(eval, cost);
    radii_step(eval, n);
  } else {
    const enum job_outcome outcome = eval->order.ready ? JOB_GOES_ON : get_profile(eval);
    if (outcome != JOB_GOES_ON || !eval->order.ready) {
      return outcome;
    }
    cost = cost_of(eval);
    n = slice_length(eval, cost);
    channel_step(eval, n);
  }
  const uint64_t spent = (uint64_t)((double)n * cost) + JOB_STEP_RADII;
  *budget -= spent < *budget ? spent : *budget;
  return eval->channel < eval->request.fixed.medium_count ? JOB_GOES_ON : end_part(eval);
}

static void end(struct job *job) {
  struct eval_job *eval = of(job);
  if (eval->repeated == NULL) {
    profiles_return(&eval->order);
  }
}

const struct job_kind job_kind_EVAL = {
    .start = start_eval, .begin_part = begin_part, .step = step, .end = end};

const struct job_kind job_kind_SAMPLE = {
    .start = start_sample, .begin_part = begin_part, .step = step, .end = end};
