#include "proto/channels.h"

#include <math.h>

const struct channels_list CHANNELS_RADII = {
    "r", "radius_count", "no more radii than the payload holds after media and parameters",
    "nothing after the listed radii but padding to a multiple of 8"};

const struct channels_list CHANNELS_NUMBERS = {
    "u", "sample_count", "no more numbers than the payload holds after media and parameters",
    "nothing after the listed numbers but padding to a multiple of 8"};

/* ---- choices --------------------------------------------------------------------------------- */

wire_error channels_check(unsigned evaluator, unsigned moments) {
  if (core_choice_by_id(core_evaluators, evaluator) == NULL) {
    return wire_error_not_in_list("evaluator", core_evaluators, "one of");
  }
  return core_choice_by_id(core_moments_list, moments) == NULL
             ? wire_error_not_in_list("moments", core_moments_list, "one of")
             : wire_error_none();
}

bool channels_has_others(unsigned wanted) {
  unsigned all = 0;
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    all |= quantity->id;
  }
  return (wanted & ~all) != 0;
}

wire_error channels_check_wanted(unsigned wanted) {
  return wanted == 0 || channels_has_others(wanted)
             ? wire_error_not_in_list("wanted", core_quantities, "a sum of")
             : wire_error_none();
}

/* ---- parameters ------------------------------------------------------------------------------ */

static wire_error parse_parameter(const uint8_t *at, core_parameters *parameters) {
  wire_parameter parameter;
  wire_get_parameter(at, &parameter);
  if (core_choice_by_id(core_parameter_list, parameter.parameter) == NULL) {
    return wire_error_not_in_list("parameter", core_parameter_list, "one of");
  }
  if (parameter.zero != 0 || parameter.zero_too != 0) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, parameter.zero != 0 ? "zero" : "zero_too", "0");
  }
  if (!isnan(parameters->value[parameter.parameter])) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "parameter", "each at most once");
  }
  if (isnan(parameter.value)) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE,
                           core_choice_by_id(core_parameter_list, parameter.parameter)->name,
                           "a number; a parameter that is not wanted is left out");
  }
  parameters->value[parameter.parameter] = parameter.value;
  return wire_error_none();
}

wire_error channels_parse_parameters(const uint8_t *at, uint32_t count,
                                     core_parameters *parameters) {
  *parameters = core_parameters_none();
  for (uint32_t i = 0; i < count; i++) {
    wire_error error = parse_parameter(at + (size_t)i * WIRE_BYTES_parameter, parameters);
    if (error.status != WIRE_STATUS_OK) {
      error.index = i;
      return error;
    }
  }
  return wire_error_none();
}

uint32_t channels_count_parameters(const core_parameters *parameters) {
  uint32_t count = 0;
  for (unsigned id = 0; id < CORE_PARAMETERS_END; id++) {
    count += !isnan(parameters->value[id]);
  }
  return count;
}

size_t channels_put_parameters(uint8_t *at, const core_parameters *parameters) {
  size_t bytes = 0;
  for (unsigned id = 0; id < CORE_PARAMETERS_END; id++) {
    if (!isnan(parameters->value[id])) {
      const wire_parameter parameter = {.parameter = (uint16_t)id, .value = parameters->value[id]};
      wire_put_parameter(at + bytes, &parameter);
      bytes += WIRE_BYTES_parameter;
    }
  }
  return bytes;
}

/* ---- media and lists ------------------------------------------------------------------------- */

static void advance(struct channels_cursor *cursor, size_t bytes) {
  cursor->at += bytes;
  cursor->remaining -= bytes;
}

wire_error channels_parse(struct channels_cursor *cursor, uint32_t medium_count,
                          uint32_t parameter_count, const uint8_t **media,
                          core_parameters *parameters) {
  if (medium_count == 0) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "medium_count", "at least 1");
  }
  if (medium_count > cursor->remaining / WIRE_BYTES_medium) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "medium_count",
                           "no more media than the payload holds");
  }
  *media = cursor->at;
  advance(cursor, (size_t)medium_count * WIRE_BYTES_medium);
  if (parameter_count > cursor->remaining / WIRE_BYTES_parameter) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "parameter_count",
                           "no more parameters than the payload holds after the media");
  }
  const wire_error error = channels_parse_parameters(cursor->at, parameter_count, parameters);
  advance(cursor, (size_t)parameter_count * WIRE_BYTES_parameter);
  return error;
}

wire_error channels_parse_list(struct channels_cursor *cursor, const struct channels_list *names,
                               uint64_t count, unsigned evaluator, const void **list) {
  const size_t value_bytes = core_evaluator_bytes(evaluator);
  if (count > cursor->remaining / value_bytes) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, names->count_field, names->too_many);
  }
  const size_t list_bytes = (size_t)count * value_bytes;
  if (cursor->remaining != wire_padded(list_bytes)) {
    return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes", names->too_long);
  }
  *list = cursor->at;
  advance(cursor, list_bytes);
  for (size_t i = 0; i < cursor->remaining; i++) {
    if (cursor->at[i] != 0) {
      return wire_error_make(WIRE_STATUS_BAD_VALUE, names->field,
                             "zero bytes of padding after the list");
    }
  }
  return wire_error_none();
}
