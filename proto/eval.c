#include "proto/eval.h"

#include <stdio.h>

#include "proto/parameters.h"

static unsigned all_quantities(void) {
  unsigned all = 0;
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    all |= quantity->id;
  }
  return all;
}

bool eval_is_array(unsigned wanted, unsigned quantity) {
  return (wanted & quantity) != 0 && core_quantity_elementwise(quantity);
}

uint64_t eval_request_bytes(uint32_t medium_count, uint32_t parameter_count, uint64_t radii_bytes) {
  return WIRE_BYTES_eval_request + (uint64_t)medium_count * WIRE_BYTES_medium +
         (uint64_t)parameter_count * WIRE_BYTES_parameter + wire_padded(radii_bytes);
}

static wire_error check_choices(const wire_eval_request *fixed) {
  if (fixed->model != EVAL_ANY_MODEL && core_choice_by_id(core_models, fixed->model) == NULL) {
    return wire_error_not_in_list("model", core_models, "one of");
  }
  if (core_choice_by_id(core_evaluators, fixed->evaluator) == NULL) {
    return wire_error_not_in_list("evaluator", core_evaluators, "one of");
  }
  if (core_choice_by_id(core_moments_list, fixed->moments) == NULL) {
    return wire_error_not_in_list("moments", core_moments_list, "one of");
  }
  if (core_choice_by_id(core_spacings, fixed->spacing) == NULL) {
    return wire_error_not_in_list("spacing", core_spacings, "one of");
  }
  if (fixed->wanted == 0 || (fixed->wanted & ~all_quantities()) != 0) {
    return wire_error_not_in_list("wanted", core_quantities, "a sum of");
  }
  return wire_error_none();
}

static wire_error check_padding(const uint8_t *padding, size_t bytes) {
  for (size_t i = 0; i < bytes; i++) {
    if (padding[i] != 0) {
      return wire_error_make(WIRE_STATUS_BAD_VALUE, "r", "zero bytes of padding after the list");
    }
  }
  return wire_error_none();
}

/* The list of radii is what remains after the media, exactly. Lengths are compared by subtraction
 * and counts before they are multiplied, so that no count can wrap. */
static wire_error parse_radii(const uint8_t *at, size_t remaining, eval_request *request) {
  const wire_eval_request *fixed = &request->fixed;
  if (fixed->spacing != CORE_SPACING_LIST) {
    request->radii = NULL;
    return remaining == 0
               ? wire_error_none()
               : wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes",
                                 "nothing after media and parameters when the radii are a grid");
  }
  if (fixed->radius_start != 0 || fixed->radius_stop != 0) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE,
                           fixed->radius_start != 0 ? "radius_start" : "radius_stop",
                           "0 when the radii are a list");
  }
  const size_t value_bytes = core_evaluator_bytes(fixed->evaluator);
  if (fixed->radius_count > remaining / value_bytes) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "radius_count",
                           "no more radii than the payload holds after media and parameters");
  }
  const size_t list_bytes = (size_t)fixed->radius_count * value_bytes;
  if (remaining != wire_padded(list_bytes)) {
    return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes",
                           "nothing after the listed radii but padding to a multiple of 8");
  }
  request->radii = at;
  return check_padding(at + list_bytes, remaining - list_bytes);
}

static wire_error parse_parameters(const uint8_t *at, size_t remaining, eval_request *request) {
  if (request->fixed.parameter_count > remaining / WIRE_BYTES_parameter) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "parameter_count",
                           "no more parameters than the payload holds after the media");
  }
  return parameters_parse(at, request->fixed.parameter_count, &request->parameters);
}

wire_error eval_request_parse(const uint8_t *payload, size_t payload_bytes, eval_request *request) {
  char allowed[64];
  if (payload_bytes < WIRE_BYTES_eval_request) {
    snprintf(allowed, sizeof allowed, "at least %d", WIRE_BYTES_eval_request);
    return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes", allowed);
  }
  wire_get_eval_request(payload, &request->fixed);
  const wire_error choices = check_choices(&request->fixed);
  if (choices.status != WIRE_STATUS_OK) {
    return choices;
  }
  const uint8_t *at = payload + WIRE_BYTES_eval_request;
  const size_t remaining = payload_bytes - WIRE_BYTES_eval_request;
  if (request->fixed.medium_count == 0) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "medium_count", "at least 1");
  }
  if (request->fixed.medium_count > remaining / WIRE_BYTES_medium) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "medium_count",
                           "no more media than the payload holds");
  }
  const size_t media_bytes = (size_t)request->fixed.medium_count * WIRE_BYTES_medium;
  request->media = at;
  const wire_error parameters =
      parse_parameters(at + media_bytes, remaining - media_bytes, request);
  if (parameters.status != WIRE_STATUS_OK) {
    return parameters;
  }
  const size_t before_radii =
      media_bytes + (size_t)request->fixed.parameter_count * WIRE_BYTES_parameter;
  return parse_radii(at + before_radii, remaining - before_radii, request);
}

/* What the arrays of a reply may take each, rounded down to whole padding, so that padding one that
 * fits does not make it too large; `arrays` and the bytes before them. False: not even those fit. */
static bool array_room(unsigned wanted, uint32_t channel_count, uint64_t max_payload_bytes,
                       eval_layout *layout, uint64_t *arrays, uint64_t *room) {
  *layout = (eval_layout){.channels_offset = WIRE_BYTES_eval_reply};
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    layout->arrays_per_channel += eval_is_array(wanted, quantity->id);
  }
  /* At most 2^32 channels of 32 bytes and a few arrays each: nothing here can wrap before the
   * arrays' own length is multiplied, and that is checked by division. */
  const bool radii_wanted = (wanted & CORE_QUANTITY_RADIUS) != 0;
  *arrays = (uint64_t)channel_count * layout->arrays_per_channel + radii_wanted;
  layout->radius_offset = WIRE_BYTES_eval_reply + (uint64_t)channel_count * WIRE_BYTES_channel;
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
  const bool radii_wanted = (wanted & CORE_QUANTITY_RADIUS) != 0;
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

bool eval_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_eval_reply *fixed,
                      eval_layout *layout) {
  if (payload_bytes < WIRE_BYTES_eval_reply) {
    return false;
  }
  wire_get_eval_reply(payload, fixed);
  if (core_evaluator_bytes(fixed->evaluator) == 0 || (fixed->wanted & ~all_quantities()) != 0) {
    return false;
  }
  return fixed->part < fixed->part_count &&
         eval_reply_layout(fixed->evaluator, fixed->wanted, fixed->channel_count,
                           fixed->radius_count, payload_bytes, layout) &&
         layout->payload_bytes == payload_bytes;
}
