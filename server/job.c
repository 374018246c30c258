#include "server/job.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

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

static wire_error check_media(const struct job *job) {
  const wire_eval_request *fixed = &job->request.fixed;
  for (uint32_t channel = 0; channel < fixed->medium_count; channel++) {
    const core_medium medium = medium_at(job, channel);
    core_fault fault = core_profile_check(fixed->model, fixed->moments, fixed->evaluator, &medium);
    if (fault.field != NULL) {
      fault.index = channel;
      return from_fault(fault);
    }
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
  } else if (fixed->evaluator == CORE_EVALUATOR_F32) {
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

wire_error job_check(struct job *job, const struct server *server, const uint8_t *payload,
                     size_t payload_bytes) {
  wire_error error = eval_request_parse(payload, payload_bytes, &job->request);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  const wire_eval_request *fixed = &job->request.fixed;
  job->grid =
      (core_grid){fixed->spacing, fixed->radius_count, fixed->radius_start, fixed->radius_stop};
  if (fixed->medium_count > server->options.max_media) {
    return too_large("medium_count", server->options.max_media, "media");
  }
  error = check_media(job);
  if (error.status == WIRE_STATUS_OK) {
    error = check_radii(job);
  }
  if (error.status == WIRE_STATUS_OK &&
      !eval_reply_layout(fixed->evaluator, fixed->wanted, fixed->medium_count, fixed->radius_count,
                         server->options.max_frame_bytes, &job->layout)) {
    error = too_large("radius_count", server->options.max_frame_bytes, "bytes of reply");
  }
  return error;
}

/* ---- evaluating -------------------------------------------------------------------------------
 */

void job_start(struct job *job, uint8_t *reply) {
  const wire_eval_request *fixed = &job->request.fixed;
  const wire_eval_reply start = {
      .model = fixed->model,
      .evaluator = fixed->evaluator,
      .moments = fixed->moments,
      .wanted = fixed->wanted,
      .channel_count = fixed->medium_count,
      .radius_count = fixed->radius_count,
  };
  wire_put_eval_reply(reply, &start);
  job->reply = reply;
  job->channel = 0;
  job->index = 0;
  job->radii_done = (fixed->wanted & CORE_QUANTITY_RADIUS) == 0;
}

static size_t value_bytes(const struct job *job) {
  return eval_value_bytes(job->request.fixed.evaluator);
}

/* Arrays are padded with zero bytes; called when the last value of an array has been written. */
static void pad(const struct job *job, uint64_t array_offset) {
  const size_t used = (size_t)job->request.fixed.radius_count * value_bytes(job);
  memset(job->reply + array_offset + used, 0, (size_t)job->layout.array_bytes - used);
}

static void expand_grid(const struct job *job, size_t n, void *radii) {
  if (job->request.fixed.evaluator == CORE_EVALUATOR_F32) {
    core_grid_radii_f32(&job->grid, job->index, n, radii);
  } else {
    core_grid_radii_f64(&job->grid, job->index, n, radii);
  }
}

static void copy_radii(const struct job *job, size_t n) {
  const size_t offset = (size_t)job->index * value_bytes(job);
  uint8_t *to = job->reply + job->layout.radius_offset + offset;
  if (job->request.radii != NULL) {
    memcpy(to, (const uint8_t *)job->request.radii + offset, n * value_bytes(job));
  } else {
    expand_grid(job, n, to);
  }
}

/* Radii come from the request, from the reply if they are in it, or are made anew. */
static const void *slice_radii(const struct job *job, struct job_scratch *scratch, size_t n) {
  const size_t offset = (size_t)job->index * value_bytes(job);
  if (job->request.radii != NULL) {
    return (const uint8_t *)job->request.radii + offset;
  }
  if (job->request.fixed.wanted & CORE_QUANTITY_RADIUS) {
    return job->reply + job->layout.radius_offset + offset;
  }
  expand_grid(job, n, scratch->radii);
  return scratch->radii;
}

static void start_channel(struct job *job, const struct server *server) {
  const wire_eval_request *fixed = &job->request.fixed;
  const core_medium medium = medium_at(job, job->channel);
  const core_fault fault = core_profile_prepare(&job->profile, server->isa, fixed->model,
                                                fixed->moments, fixed->evaluator, &medium);
  assert(fault.field == NULL); /* job_check() has seen to it */
  const bool albedo_wanted = (fixed->wanted & CORE_QUANTITY_ALBEDO) != 0;
  const wire_channel channel = {
      .albedo = albedo_wanted ? job->profile.albedo : (double)NAN,
      .numerical_error = job->profile.numerical_error,
      .numerical_error_per_mm = job->profile.numerical_error_per_mm,
      .model_error = job->profile.model_error,
  };
  wire_put_channel(job->reply + job->layout.channels_offset +
                       (size_t)job->channel * WIRE_BYTES_channel,
                   &channel);
}

/* Evaluates the n radii of a slice for every array that is wanted. */
static void evaluate(struct job *job, struct job_scratch *scratch, size_t n) {
  const void *r = slice_radii(job, scratch, n);
  const unsigned wanted = job->request.fixed.wanted;
  const size_t done = (size_t)job->index * value_bytes(job);
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    if (!eval_is_array(wanted, quantity->id)) {
      continue;
    }
    void *to =
        job->reply + eval_array_offset(&job->layout, wanted, job->channel, quantity->id) + done;
    if (job->request.fixed.evaluator == CORE_EVALUATOR_F32) {
      core_eval_f32(&job->profile, quantity->id, n, r, to);
    } else {
      core_eval_f64(&job->profile, quantity->id, n, r, to);
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
  if (job->index < job->request.fixed.radius_count) {
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

static void channel_step(struct job *job, struct server *server, struct job_scratch *scratch,
                         size_t n) {
  if (job->index == 0) {
    start_channel(job, server);
  }
  if (job->layout.arrays_per_channel == 0) {
    job->channel++;
    return;
  }
  evaluate(job, scratch, n);
  stats_add(&server->stats, STATS_RADII_EVALUATED, n);
  stats_add(&server->stats, STATS_SLICES_EVALUATED, 1);
  if (advance(job, n)) {
    pad_channel(job);
    job->channel++;
  }
}

bool job_slice(struct job *job, struct server *server, struct job_scratch *scratch,
               uint64_t *budget) {
  const uint64_t left = job->request.fixed.radius_count - job->index;
  const size_t n = left < JOB_SLICE_RADII ? (size_t)left : JOB_SLICE_RADII;
  if (job->radii_done) {
    channel_step(job, server, scratch, n);
  } else {
    radii_step(job, n);
  }
  const uint64_t spent = n + JOB_STEP_RADII;
  *budget -= spent < *budget ? spent : *budget;
  return job->channel < job->request.fixed.medium_count;
}
