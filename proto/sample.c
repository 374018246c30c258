#include "proto/sample.h"

#include "proto/channels.h"

uint64_t sample_request_bytes(uint32_t medium_count, uint32_t parameter_count,
                              uint64_t number_bytes) {
  return WIRE_BYTES_sample_request + (uint64_t)medium_count * WIRE_BYTES_medium +
         (uint64_t)parameter_count * WIRE_BYTES_parameter + wire_padded(number_bytes);
}

static wire_error check_choices(const wire_sample_request *fixed) {
  if (core_choice_by_id(core_models, fixed->model) == NULL) {
    return wire_error_not_in_list("model", core_models, "one of");
  }
  wire_error error = channels_check(fixed->evaluator, fixed->moments);
  if (error.status == WIRE_STATUS_OK) {
    error = channels_check_wanted(fixed->wanted);
  }
  if (error.status == WIRE_STATUS_OK && core_choice_by_id(core_draws, fixed->draw) == NULL) {
    error = wire_error_not_in_list("draw", core_draws, "one of");
  }
  return error;
}

static wire_error parse_numbers(struct channels_cursor *cursor, const wire_sample_request *fixed,
                                eval_request *request) {
  if (fixed->draw == CORE_DRAW_LIST) {
    return channels_parse_list(cursor, &CHANNELS_NUMBERS, fixed->sample_count, fixed->evaluator,
                               &request->radii);
  }
  request->radii = NULL;
  return cursor->remaining == 0
             ? wire_error_none()
             : wire_error_make(
                   WIRE_STATUS_BAD_LENGTH, "payload_bytes",
                   "nothing after the media and parameters unless the draw is 1 (list)");
}

wire_error sample_request_parse(const uint8_t *payload, size_t payload_bytes, core_draw *draw,
                                eval_request *request) {
  if (payload_bytes < WIRE_BYTES_sample_request) {
    return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes",
                           "at least 40: a sample_request");
  }
  wire_sample_request fixed;
  wire_get_sample_request(payload, &fixed);
  wire_error error = check_choices(&fixed);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  request->fixed = (wire_eval_request){
      .model = fixed.model,
      .evaluator = fixed.evaluator,
      .moments = fixed.moments,
      .wanted = fixed.wanted,
      .medium_count = fixed.medium_count,
      .spacing = CORE_SPACING_LIST,
      .parameter_count = fixed.parameter_count,
      .radius_count = fixed.sample_count,
  };
  *draw = (core_draw){fixed.draw, fixed.sample_count, fixed.sample_first, fixed.seed};
  struct channels_cursor cursor = {payload + WIRE_BYTES_sample_request,
                                   payload_bytes - WIRE_BYTES_sample_request};
  error = channels_parse(&cursor, fixed.medium_count, fixed.parameter_count, &request->media,
                         &request->parameters);
  return error.status == WIRE_STATUS_OK ? parse_numbers(&cursor, &fixed, request) : error;
}
