#include "proto/fit.h"

#include <math.h>
#include <string.h>

#include "proto/channels.h"

/* Arrays are used in place, so this machine must be little-endian like the protocol. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "this machine's arrays need swapping");

enum {
  PLACES = 3,  /* arrays of a design: where each reading was taken, and both diameters */
  NUMBERS = 2, /* of each reading of a set: its value and its error */
};

static bool has_reference(const wire_fit_design *design) {
  return design->scale == CORE_FIT_SCALE_REFERENCE;
}

static size_t places_offset(const wire_fit_design *design) {
  return WIRE_BYTES_fit_design + design->parameter_count * (size_t)WIRE_BYTES_parameter +
         (has_reference(design) ? WIRE_BYTES_medium : 0);
}

static size_t design_bytes(const wire_fit_design *design) {
  return places_offset(design) + PLACES * design->reading_count * sizeof(double);
}

/* ---- requests -------------------------------------------------------------------------------- */

static wire_error check_choices(const wire_fit_design *design) {
  if (core_choice_by_id(core_models, design->model) == NULL) {
    return wire_error_not_in_list("model", core_models, "one of");
  }
  if (core_choice_by_id(core_moments_list, design->moments) == NULL) {
    return wire_error_not_in_list("moments", core_moments_list, "one of");
  }
  if (core_choice_by_id(core_fit_axes, design->axis) == NULL) {
    return wire_error_not_in_list("axis", core_fit_axes, "one of");
  }
  if (core_choice_by_id(core_fit_scales, design->scale) == NULL) {
    return wire_error_not_in_list("scale", core_fit_scales, "one of");
  }
  return wire_error_none();
}

static wire_error check_fixed(const fit_request *request) {
  const wire_fit_request *fixed = &request->fixed;
  const wire_fit_design *design = &request->design;
  const wire_error error = check_choices(design);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  if (fixed->residuals > 1) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "residuals", "0 or 1");
  }
  if (fixed->zero != 0 || fixed->zero_too != 0 || design->zero != 0) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "zero", "0");
  }
  const uint32_t unknowns = design->scale == CORE_FIT_SCALE_FREE ? 3 : 2;
  if (design->reading_count < unknowns || design->reading_count > CORE_FIT_READINGS_MAX) {
    wire_error count = wire_error_make(WIRE_STATUS_BAD_COUNT, "reading_count",
                                       "2 to 1024, or 3 to 1024 with the scale free");
    count.index = design->reading_count;
    return count;
  }
  return fixed->set_count > 0 ? wire_error_none()
                              : wire_error_make(WIRE_STATUS_BAD_COUNT, "set_count", "at least 1");
}

wire_error fit_request_parse(const uint8_t *payload, size_t payload_bytes, fit_request *request) {
  const size_t fixed_bytes = WIRE_BYTES_fit_request + WIRE_BYTES_fit_design;
  if (payload_bytes < fixed_bytes) {
    return wire_error_make(WIRE_STATUS_BAD_LENGTH, "payload_bytes",
                           "at least 48: a fit_request and a fit_design");
  }
  wire_get_fit_request(payload, &request->fixed);
  wire_get_fit_design(payload + WIRE_BYTES_fit_request, &request->design);
  const wire_error error = check_fixed(request);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  const wire_fit_design *design = &request->design;
  const size_t left = payload_bytes - WIRE_BYTES_fit_request;
  const size_t taken = design_bytes(design); /* the counts bound it by 2 MiB */
  if (design->parameter_count > CORE_PARAMETERS_END || left < taken) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT,
                           left < places_offset(design) ||
                                   design->parameter_count > CORE_PARAMETERS_END
                               ? "parameter_count"
                               : "reading_count",
                           "as many as the payload holds");
  }
  request->design_bytes = payload + WIRE_BYTES_fit_request;
  request->design_bytes_count = taken;
  core_parameters parameters;
  const wire_error wrong = channels_parse_parameters(request->design_bytes + WIRE_BYTES_fit_design,
                                                     design->parameter_count, &parameters);
  if (wrong.status != WIRE_STATUS_OK) {
    return wrong;
  }
  const size_t set_bytes = NUMBERS * design->reading_count * sizeof(double);
  const uint64_t count = request->fixed.set_count;
  if ((left - taken) % set_bytes != 0 || (left - taken) / set_bytes != count) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "set_count",
                           "as many sets of values, and of errors, as the payload holds");
  }
  request->values = (const double *)(const void *)(request->design_bytes + taken);
  request->errors = request->values + count * design->reading_count;
  return wire_error_none();
}

void fit_design_read(const uint8_t *bytes, fit_design *read) {
  wire_fit_design fixed;
  wire_get_fit_design(bytes, &fixed);
  const wire_error error = channels_parse_parameters(bytes + WIRE_BYTES_fit_design,
                                                     fixed.parameter_count, &read->parameters);
  (void)error; /* fit_request_parse() has found none */
  const double *places = (const double *)(const void *)(bytes + places_offset(&fixed));
  read->design = (core_fit_design){
      .model = fixed.model,
      .moments = fixed.moments,
      .g = fixed.g,
      .eta = fixed.eta,
      .parameters = &read->parameters,
      .axis = fixed.axis,
      .count = fixed.reading_count,
      .at = places,
      .source_mm = places + fixed.reading_count,
      .detector_mm = places + 2 * (size_t)fixed.reading_count,
      .scale = fixed.scale,
  };
  double *aperture = &read->parameters.value[CORE_PARAMETER_DETECTOR_NA];
  if (!isnan(*aperture)) { /* it is of the design, and not of the model */
    /* 0 is out of its range, but would mean that there is none. */
    read->design.detector_na = *aperture == 0 ? (double)NAN : *aperture;
    *aperture = (double)NAN;
  }
  if (has_reference(&fixed)) {
    wire_medium medium;
    wire_get_medium(bytes + places_offset(&fixed) - WIRE_BYTES_medium, &medium);
    read->design.reference = (core_medium){medium.sigma_a, medium.sigma_s, medium.g, medium.eta};
  }
}

uint64_t fit_request_bytes(const wire_fit_design *design, uint64_t set_count) {
  return WIRE_BYTES_fit_request + design_bytes(design) +
         set_count * (NUMBERS * design->reading_count * sizeof(double));
}

uint8_t *fit_request_put(uint8_t *payload, const wire_fit_request *request,
                         const wire_fit_design *design) {
  wire_put_fit_request(payload, request);
  wire_put_fit_design(payload + WIRE_BYTES_fit_request, design);
  return payload + WIRE_BYTES_fit_request + WIRE_BYTES_fit_design;
}

/* Writes an array of the design, or zeros if there is none. Returns the address behind it. */
static uint8_t *put_places(uint8_t *at, const double *places, size_t count) {
  const size_t bytes = count * sizeof *places;
  if (places != NULL) {
    memcpy(at, places, bytes);
  } else {
    memset(at, 0, bytes);
  }
  return at + bytes;
}

uint8_t *fit_places_put(uint8_t *at, const core_fit_design *design) {
  if (design->scale == CORE_FIT_SCALE_REFERENCE) {
    const core_medium *known = &design->reference;
    const wire_medium medium = {known->sigma_a_per_mm, known->sigma_s_per_mm, known->g, known->eta};
    wire_put_medium(at, &medium);
    at += WIRE_BYTES_medium;
  }
  at = put_places(at, design->at, design->count);
  at = put_places(at, design->source_mm, design->count);
  return put_places(at, design->detector_mm, design->count);
}

/* ---- replies --------------------------------------------------------------------------------- */

wire_fitted fit_result_encode(const core_fit_result *result) {
  const double nan = (double)NAN;
  const core_fit_covariance none = {nan, nan, nan, nan, nan, nan};
  const bool refused = result->status == CORE_FIT_STATUS_REFUSED;
  const core_fit_covariance *covariance = refused ? &none : &result->covariance;
  return (wire_fitted){
      .status = (uint16_t)result->status,
      .bounds = (uint16_t)result->bounds,
      .field = !refused                                    ? 0
               : strcmp(result->fault.field, "error") == 0 ? 2
                                                           : 1,
      .index = refused ? (uint32_t)result->fault.index : 0,
      .evaluations = result->evaluations,
      .sigma_a = result->best.sigma_a_per_mm,
      .sigma_s_prime = result->best.sigma_s_prime_per_mm,
      .factor = result->best.factor,
      .chi_squared = result->best.chi_squared,
      .reduced_chi_squared = result->reduced_chi_squared,
      .condition = result->condition,
      .variance_a = covariance->a_a,
      .covariance_a_s = covariance->a_s,
      .variance_s = covariance->s_s,
      .covariance_a_factor = covariance->a_factor,
      .covariance_s_factor = covariance->s_factor,
      .variance_factor = covariance->factor_factor,
      .second_sigma_a = result->second.sigma_a_per_mm,
      .second_sigma_s_prime = result->second.sigma_s_prime_per_mm,
      .second_factor = result->second.factor,
      .second_chi_squared = result->second.chi_squared,
      .model_error = result->model_error,
  };
}

uint64_t fit_residuals_offset(uint64_t set_count) {
  return WIRE_BYTES_fit_reply + set_count * WIRE_BYTES_fitted;
}

uint64_t fit_reply_bytes(uint64_t set_count, uint32_t residuals) {
  return fit_residuals_offset(set_count) + set_count * (residuals * sizeof(double));
}

uint64_t fit_part_sets(uint32_t residuals, uint64_t max_payload_bytes) {
  const uint64_t set_bytes = WIRE_BYTES_fitted + residuals * sizeof(double);
  return max_payload_bytes > WIRE_BYTES_fit_reply
             ? (max_payload_bytes - WIRE_BYTES_fit_reply) / set_bytes
             : 0;
}

bool fit_reply_parse(const uint8_t *payload, size_t payload_bytes, wire_fit_reply *fixed) {
  if (payload_bytes < WIRE_BYTES_fit_reply) {
    return false;
  }
  wire_get_fit_reply(payload, fixed);
  const size_t set_bytes = WIRE_BYTES_fitted + fixed->reading_count * sizeof(double);
  const size_t sets_bytes = payload_bytes - WIRE_BYTES_fit_reply;
  return fixed->part < fixed->part_count && sets_bytes % set_bytes == 0 &&
         sets_bytes / set_bytes == fixed->count && fixed->fitted_count <= fixed->count;
}
