#include "proto/channels.h"

#include "proto/parameters.h"

const struct channels_list CHANNELS_RADII = {
    "r", "radius_count", "no more radii than the payload holds after media and parameters",
    "nothing after the listed radii but padding to a multiple of 8"};

const struct channels_list CHANNELS_NUMBERS = {
    "u", "sample_count", "no more numbers than the payload holds after media and parameters",
    "nothing after the listed numbers but padding to a multiple of 8"};

/* ---- choices ----------------------------------------------------------------------------------
 */

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

/* ---- what follows -----------------------------------------------------------------------------
 */

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
  const wire_error error = parameters_parse(cursor->at, parameter_count, parameters);
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
