#include "proto/channels.h"

#include <math.h>

bool channels_has_others(unsigned wanted) {
  unsigned all = 0;
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    all |= quantity->id;
  }
  return (wanted & ~all) != 0;
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

wire_error channels_parse_parameters(const uint8_t *at, uint32_t count, uint32_t layer_count,
                                     core_parameters *parameters) {
  *parameters = core_parameters_none();
  parameters->layer_count = layer_count;
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
