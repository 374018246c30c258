#include "proto/eval.h"

#include <math.h>
#include <stdio.h>

#include "proto/channels.h"

bool eval_is_array(unsigned wanted, unsigned quantity) {
  const bool drawn = quantity == CORE_QUANTITY_RADIUS && (wanted & EVAL_DRAWN) != 0;
  return (wanted & quantity) != 0 && (drawn || core_quantity_elementwise(quantity));
}

/* Returns true if one array of radii comes before all channels. */
static bool radii_come_once(unsigned wanted) {
  return (wanted & CORE_QUANTITY_RADIUS) != 0 && (wanted & EVAL_DRAWN) == 0;
}

uint64_t eval_request_bytes(uint32_t medium_count, uint32_t parameter_count, uint64_t radii_bytes) {
  return WIRE_BYTES_eval_request + (uint64_t)medium_count * WIRE_BYTES_medium +
         (uint64_t)parameter_count * WIRE_BYTES_parameter + wire_padded(radii_bytes);
}

static wire_error check_choices(const wire_eval_request *fixed) {
  if (fixed->model != EVAL_ANY_MODEL && core_choice_by_id(core_models, fixed->model) == NULL) {
    return wire_error_not_in_list("model", core_models, "one of");
  }
  wire_error error = channels_check(fixed->evaluator, fixed->moments);
  if (error.status == WIRE_STATUS_OK && core_choice_by_id(core_spacings, fixed->spacing) == NULL) {
    error = wire_error_not_in_list("spacing", core_spacings, "one of");
  }
  return error.status == WIRE_STATUS_OK ? channels_check_wanted(fixed->wanted) : error;
}

/* Parses the list of radii, which must be all that is left after the media and the parameters. */
static wire_error parse_radii(struct channels_cursor *cursor, eval_request *request) {
  const wire_eval_request *fixed = &request->fixed;
  if (fixed->spacing != CORE_SPACING_LIST) {
    request->radii = NULL;
    return cursor->remaining == 0
               ? wire_error_none()
               : wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes",
                                 "nothing after media and parameters when the radii are a grid");
  }
  if (fixed->radius_start != 0 || fixed->radius_stop != 0) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE,
                           fixed->radius_start != 0 ? "radius_start" : "radius_stop",
                           "0 when the radii are a list");
  }
  return channels_parse_list(cursor, &CHANNELS_RADII, fixed->radius_count, fixed->evaluator,
                             &request->radii);
}

wire_error eval_request_parse(const uint8_t *payload, size_t payload_bytes, eval_request *request) {
  char allowed[64];
  if (payload_bytes < WIRE_BYTES_eval_request) {
    snprintf(allowed, sizeof allowed, "at least %d", WIRE_BYTES_eval_request);
    return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes", allowed);
  }
  wire_get_eval_request(payload, &request->fixed);
  struct channels_cursor cursor = {payload + WIRE_BYTES_eval_request,
                                   payload_bytes - WIRE_BYTES_eval_request};
  wire_error error = check_choices(&request->fixed);
  if (error.status == WIRE_STATUS_OK) {
    error = channels_parse(&cursor, request->fixed.medium_count, request->fixed.parameter_count,
                           &request->media, &request->parameters);
  }
  return error.status == WIRE_STATUS_OK ? parse_radii(&cursor, request) : error;
}

/* Sets *room to the bytes that each array of a reply may take. It is a multiple of 8, so that an
 * array that fits also fits with its padding. Also sets *arrays, the number of arrays, and the
 * offset of the first one in *layout. Returns false if the bytes before the arrays do not fit. */
static bool array_room(unsigned wanted, uint32_t channel_count, uint64_t max_payload_bytes,
                       eval_layout *layout, uint64_t *arrays, uint64_t *room) {
  *layout = (eval_layout){.errors_offset = eval_albedo_offset(channel_count)};
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    layout->arrays_per_channel += eval_is_array(wanted, quantity->id);
    layout->errors_per_channel += (wanted & quantity->id) != 0;
  }
  /* There are at most 2^32 channels of some hundred bytes, with a few arrays each, so nothing wraps
   * here. The caller checks the length of the arrays by division before it multiplies. */
  const bool radii_wanted = radii_come_once(wanted);
  *arrays = (uint64_t)channel_count * layout->arrays_per_channel + radii_wanted;
  layout->radius_offset = layout->errors_offset + (uint64_t)channel_count *
                                                      layout->errors_per_channel *
                                                      WIRE_BYTES_quantity_error;
  if (layout->radius_offset > max_payload_bytes) {
    return false;
  }
  const uint64_t left = max_payload_bytes - layout->radius_offset;
  *room = *arrays > 0 ? left / *arrays & ~UINT64_C(7) : 0;
  return true;
}

bool eval_reply_layout(unsigned evaluator, unsigned wanted, uint32_t channel_count,
                       uint64_t radius_count, uint64_t max_payload_bytes, eval_layout *layout) {
  const size_t value_bytes = core_evaluator_bytes(evaluator);
  uint64_t arrays;
  uint64_t room;
  if (!array_room(wanted, channel_count, max_payload_bytes, layout, &arrays, &room) ||
      (arrays > 0 && radius_count > room / value_bytes)) {
    return false;
  }
  const uint64_t before = layout->radius_offset;
  const bool radii_wanted = radii_come_once(wanted);
  layout->array_bytes = arrays > 0 ? wire_padded(radius_count * value_bytes) : 0;
  layout->arrays_offset = before + (radii_wanted ? layout->array_bytes : 0);
  layout->payload_bytes = before + arrays * layout->array_bytes;
  return layout->payload_bytes <= max_payload_bytes;
}

uint64_t eval_part_radii(unsigned evaluator, unsigned wanted, uint32_t channel_count,
                         uint64_t max_payload_bytes) {
  eval_layout layout;
  uint64_t arrays;
  uint64_t room;
  if (!array_room(wanted, channel_count, max_payload_bytes, &layout, &arrays, &room)) {
    return 0;
  }
  return arrays > 0 ? room / core_evaluator_bytes(evaluator) / EVAL_PART_RADII * EVAL_PART_RADII
                    : UINT64_MAX;
}

uint64_t eval_array_offset(const eval_layout *layout, unsigned wanted, uint32_t channel,
                           enum core_quantity quantity) {
  uint64_t array = (uint64_t)channel * layout->arrays_per_channel;
  for (const core_choice *before = core_quantities; before->id != (unsigned)quantity; before++) {
    array += eval_is_array(wanted, before->id);
  }
  return layout->arrays_offset + array * layout->array_bytes;
}

uint64_t eval_albedo_offset(uint32_t channel) {
  return WIRE_BYTES_eval_reply + (uint64_t)channel * sizeof(double);
}

uint64_t eval_error_offset(const eval_layout *layout, unsigned wanted, uint32_t channel,
                           unsigned quantity) {
  const uint64_t before = (unsigned)__builtin_popcount(wanted & (quantity - 1));
  return layout->errors_offset +
         ((uint64_t)channel * layout->errors_per_channel + before) * WIRE_BYTES_quantity_error;
}

wire_quantity_error eval_largest_error(const uint8_t *payload, const eval_layout *layout,
                                       unsigned wanted, uint32_t channel) {
  wire_quantity_error most = {.model_error = (double)NAN};
  for (unsigned i = 0; i < layout->errors_per_channel; i++) {
    wire_quantity_error one;
    wire_get_quantity_error(payload + eval_error_offset(layout, wanted, channel, 1) +
                                i * (size_t)WIRE_BYTES_quantity_error,
                            &one);
    most.numerical_error = fmax(most.numerical_error, one.numerical_error);
    most.numerical_error_per_mm = fmax(most.numerical_error_per_mm, one.numerical_error_per_mm);
  }
  if ((wanted & CORE_QUANTITY_MODEL_ERROR) != 0) { /* NAN if that of one quantity is not known */
    wire_quantity_error all;
    wire_get_quantity_error(
        payload + eval_error_offset(layout, wanted, channel, CORE_QUANTITY_MODEL_ERROR), &all);
    most.model_error = all.model_error;
  }
  return most;
}

bool eval_reply_parse(const uint8_t *payload, size_t payload_bytes, bool drawn,
                      wire_eval_reply *fixed, eval_layout *layout) {
  if (payload_bytes < WIRE_BYTES_eval_reply) {
    return false;
  }
  wire_get_eval_reply(payload, fixed);
  if (core_evaluator_bytes(fixed->evaluator) == 0 || channels_has_others(fixed->wanted)) {
    return false;
  }
  return fixed->part < fixed->part_count &&
         eval_reply_layout(fixed->evaluator, fixed->wanted | (drawn ? EVAL_DRAWN : 0),
                           fixed->channel_count, fixed->count, payload_bytes, layout) &&
         layout->payload_bytes == payload_bytes;
}
