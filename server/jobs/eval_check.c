/* A request before any of it is evaluated: whether it can be, by what, and in how many parts. */
#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "server/jobs/eval.h"

core_medium eval_job_medium(const struct eval_job *eval, uint32_t channel) {
  wire_medium medium;
  wire_get_medium(eval->request.media + (size_t)channel * WIRE_BYTES_medium, &medium);
  return (core_medium){medium.sigma_a, medium.sigma_s, medium.g, medium.eta};
}

/* *radii: where all channels may be evaluated. */
static wire_error check_media(const struct eval_job *eval, core_radii_range *radii) {
  const wire_eval_request *fixed = &eval->request.fixed;
  *radii = (core_radii_range){0, (double)INFINITY};
  for (uint32_t channel = 0; channel < fixed->medium_count; channel++) {
    const core_medium medium = eval_job_medium(eval, channel);
    core_radii_range range;
    core_fault fault = core_profile_check(fixed->model, fixed->moments, fixed->evaluator, &medium,
                                          &eval->request.parameters, &range);
    if (fault.field != NULL) {
      fault.index = channel;
      return job_error(fault);
    }
    radii->least_mm = fmax(radii->least_mm, range.least_mm);
    radii->most_mm = fmin(radii->most_mm, range.most_mm);
  }
  return wire_error_none();
}

/* Radii that the model does not cover, where it covers less than all. */
static wire_error check_range(const struct eval_job *eval, const core_radii_range *range) {
  const wire_eval_request *fixed = &eval->request.fixed;
  if (fixed->spacing == CORE_SPACING_LIST) {
    const core_fault fault =
        core_evaluator_bytes(fixed->evaluator) == sizeof(float)
            ? core_radii_range_check_f32(range, fixed->radius_count, eval->request.radii)
            : core_radii_range_check_f64(range, fixed->radius_count, eval->request.radii);
    return fault.field == NULL ? wire_error_none() : job_error(fault);
  }
  char allowed[80];
  const bool low = fixed->radius_count > 0 && eval->grid.start_mm < range->least_mm;
  const bool high = fixed->radius_count > 1 && eval->grid.stop_mm > range->most_mm;
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
static wire_error check_radii(const struct eval_job *eval) {
  const wire_eval_request *fixed = &eval->request.fixed;
  core_fault fault = {0};
  if (fixed->spacing != CORE_SPACING_LIST) {
    if (fixed->wanted != CORE_QUANTITY_ALBEDO || fixed->radius_count > 0) {
      fault = core_grid_check(&eval->grid);
    }
    if (fault.field != NULL && strcmp(fault.field, "radius_count") == 0) {
      return wire_error_make(WIRE_STATUS_BAD_COUNT, fault.field, fault.allowed);
    }
  } else if (core_evaluator_bytes(fixed->evaluator) == sizeof(float)) {
    fault = core_radii_check_f32(fixed->radius_count, eval->request.radii);
  } else {
    fault = core_radii_check_f64(fixed->radius_count, eval->request.radii);
  }
  return fault.field == NULL ? wire_error_none() : job_error(fault);
}

/* Takes the candidate after those that have been tried; false: none is left that keeps the
 * tolerance. */
static bool take_next(struct eval_job *eval, const struct choice *choice) {
  if (eval->choice >= choice->count || !choice->candidates[eval->choice].meets) {
    return false;
  }
  const core_candidate *candidate = &choice->candidates[eval->choice++];
  eval->model_error = candidate->model_error;
  choice_take(candidate, &eval->request);
  return true;
}

/* A model and evaluator for a request that names none. */
static wire_error choose(struct eval_job *eval) {
  wire_error error = choice_check(&eval->request);
  if (error.status == WIRE_STATUS_OK) {
    error = check_radii(eval);
  }
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  struct choice choice;
  eval->tolerance = eval->request.parameters.value[CORE_PARAMETER_TOLERANCE];
  choice_list(&eval->request, &choice);
  return take_next(eval, &choice) ? wire_error_none() : choice_none(&choice);
}

bool eval_job_choose_again(struct eval_job *eval) {
  if (isnan(eval->tolerance) || strcmp(eval->order.fault.field, CORE_FIELD_MEMORY) == 0) {
    return false;
  }
  struct choice choice;
  eval->request.parameters.value[CORE_PARAMETER_TOLERANCE] = eval->tolerance;
  choice_list(&eval->request, &choice);
  return take_next(eval, &choice);
}

unsigned eval_job_wanted(const struct eval_job *eval) {
  return eval->request.fixed.wanted | (eval->draws ? EVAL_DRAWN : 0);
}

/* What a request says how many radii it wants by. */
static const char *count_field(const struct eval_job *eval) {
  return eval->draws ? "sample_count" : "radius_count";
}

static wire_error check_medium_count(const struct eval_job *eval, const struct server *server) {
  return eval->request.fixed.medium_count > server->options.max_media
             ? job_too_large("medium_count", server->options.max_media, "media")
             : wire_error_none();
}

/* Takes a request apart; what it says of the layout is right. */
static wire_error parse(struct eval_job *eval, const struct server *server, const uint8_t *payload,
                        size_t payload_bytes) {
  const wire_error error = eval_request_parse(payload, payload_bytes, &eval->request);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  const wire_eval_request *fixed = &eval->request.fixed;
  eval->draws = false;
  eval->tolerance = (double)NAN;
  eval->choice = 0;
  eval->grid =
      (core_grid){fixed->spacing, fixed->radius_count, fixed->radius_start, fixed->radius_stop};
  return check_medium_count(eval, server);
}

wire_error eval_job_offers(const struct server *server, const uint8_t *payload,
                           size_t payload_bytes, struct choice *choice) {
  struct eval_job eval;
  wire_error error = parse(&eval, server, payload, payload_bytes);
  if (error.status == WIRE_STATUS_OK && eval.request.fixed.model != EVAL_ANY_MODEL) {
    error = wire_error_make(WIRE_STATUS_BAD_VALUE, "model", "0: any");
  }
  if (error.status == WIRE_STATUS_OK) {
    error = choice_check(&eval.request);
  }
  if (error.status == WIRE_STATUS_OK) {
    error = check_radii(&eval);
  }
  if (error.status == WIRE_STATUS_OK) {
    choice_list(&eval.request, choice);
  }
  return error;
}

bool eval_job_lay_out_part(struct eval_job *eval, uint64_t max_bytes) {
  const wire_eval_request *fixed = &eval->request.fixed;
  const uint64_t left = fixed->radius_count - eval->first;
  eval->count = left < eval->part_radii ? left : eval->part_radii;
  return eval_reply_layout(fixed->evaluator, eval_job_wanted(eval), fixed->medium_count,
                           eval->count, max_bytes, &eval->layout);
}

/* A reply that fits into a frame is one part; a larger one comes in parts of max_part_bytes, so
 * that what it takes in memory does not depend on its size. */
static wire_error cut(struct eval_job *eval, const struct server *server) {
  const wire_eval_request *fixed = &eval->request.fixed;
  const struct options *options = &server->options;
  if (fixed->radius_count > options->max_radii) {
    return job_too_large(count_field(eval), options->max_radii, "radii");
  }
  eval->first = 0;
  eval->part = 0;
  eval->part_count = 1;
  eval->part_radii = fixed->radius_count;
  if (eval_job_lay_out_part(eval, options->max_frame_bytes)) {
    return wire_error_none();
  }
  const uint64_t most_bytes = options->max_part_bytes < options->max_frame_bytes
                                  ? options->max_part_bytes
                                  : options->max_frame_bytes;
  eval->part_radii =
      eval_part_radii(fixed->evaluator, eval_job_wanted(eval), fixed->medium_count, most_bytes);
  if (eval->part_radii == 0) {
    return wire_error_make(WIRE_STATUS_TOO_LARGE, "medium_count",
                           "fewer: a part of max_part_bytes has no room for them");
  }
  const uint64_t parts = (fixed->radius_count - 1) / eval->part_radii + 1;
  if (parts > UINT32_MAX) { /* 2^40 radii in parts of 256 */
    return job_too_large(count_field(eval), UINT32_MAX * eval->part_radii,
                         "radii in parts as small as these");
  }
  eval->part_count = (uint32_t)parts;
  const bool fits = eval_job_lay_out_part(eval, most_bytes);
  assert(fits);
  return wire_error_none();
}

wire_error eval_job_check(struct eval_job *eval, const struct server *server,
                          const uint8_t *payload, size_t payload_bytes) {
  wire_error error = parse(eval, server, payload, payload_bytes);
  const wire_eval_request *fixed = &eval->request.fixed;
  if (error.status == WIRE_STATUS_OK && fixed->model == EVAL_ANY_MODEL) {
    error = choose(eval);
  }
  core_radii_range range;
  if (error.status == WIRE_STATUS_OK) {
    error = check_media(eval, &range);
  }
  if (error.status == WIRE_STATUS_OK) {
    error = check_radii(eval);
  }
  if (error.status == WIRE_STATUS_OK) {
    eval->covers_all = range.least_mm <= 0 && range.most_mm >= (double)INFINITY;
    error = check_range(eval, &range);
  }
  return error.status == WIRE_STATUS_OK ? cut(eval, server) : error;
}

static wire_error check_numbers(const struct eval_job *eval) {
  core_fault fault = core_draw_check(&eval->draw);
  if (fault.field != NULL && strcmp(fault.field, "sample_count") == 0) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, fault.field, fault.allowed);
  }
  if (fault.field == NULL && eval->request.radii != NULL) {
    const wire_eval_request *fixed = &eval->request.fixed;
    fault = core_evaluator_bytes(fixed->evaluator) == sizeof(float)
                ? core_numbers_check_f32(fixed->radius_count, eval->request.radii)
                : core_numbers_check_f64(fixed->radius_count, eval->request.radii);
  }
  return fault.field == NULL ? wire_error_none() : job_error(fault);
}

wire_error eval_job_check_sample(struct eval_job *eval, const struct server *server,
                                 const uint8_t *payload, size_t payload_bytes) {
  wire_error error = sample_request_parse(payload, payload_bytes, &eval->draw, &eval->request);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  eval->draws = true;
  eval->tolerance = (double)NAN;
  eval->choice = 0;
  error = check_medium_count(eval, server);
  core_radii_range range;
  if (error.status == WIRE_STATUS_OK) {
    error = check_media(eval, &range);
  }
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  eval->covers_all = range.least_mm <= 0 && range.most_mm >= (double)INFINITY;
  if (!eval->covers_all) { /* any radius may be drawn */
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "model", "a model that covers all radii");
  }
  error = check_numbers(eval);
  return error.status == WIRE_STATUS_OK ? cut(eval, server) : error;
}
