#include "proto/fit.h"

#include <math.h>
#include <string.h>

#include "proto/schema.h"

wire_error fit_request_parse(const uint8_t *payload, const schema_layout *layout,
                             fit_request *request) {
  core_parameters parameters;
  wire_get_fit_request(payload, &request->fixed);
  wire_get_fit_design(payload + WIRE_BYTES_fit_request, &request->design);
  if (request->design.scale == CORE_FIT_SCALE_FREE && request->design.reading_count < 3) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, "reading_count", "3 or more with the scale free");
  }
  request->design_bytes = payload + WIRE_BYTES_fit_request;
  request->design_bytes_count = (size_t)layout->parts[FIT_VALUES].at - WIRE_BYTES_fit_request;
  request->values = (const double *)(const void *)(payload + layout->parts[FIT_VALUES].at);
  request->errors = (const double *)(const void *)(payload + layout->parts[FIT_ERRORS].at);
  return schema_parse_parameters(payload + layout->parts[FIT_PARAMETERS].at,
                                 request->design.parameter_count, 1, &parameters);
}

void fit_design_read(const uint8_t *bytes, fit_design *read) {
  wire_fit_design fixed;
  schema_layout layout;
  wire_get_fit_design(bytes, &fixed);
  const fit_start start = {{.set_count = 0}, fixed};
  schema_lay_out(&schema_fit_request, &start, UINT64_MAX, &layout, NULL);
  bytes -= WIRE_BYTES_fit_request; /* offsets of the layout count from the start of the request */
  const wire_error error = schema_parse_parameters(bytes + layout.parts[FIT_PARAMETERS].at,
                                                   fixed.parameter_count, 1, &read->parameters);
  (void)error; /* fit_request_parse() has checked the parameters */
  const double *places = (const double *)(const void *)(bytes + layout.parts[FIT_AT].at);
  read->design = (core_fit_design){
      .model = fixed.model,
      .moments = fixed.moments,
      .g = fixed.g,
      .eta = fixed.eta,
      .thickness_mm = fixed.thickness,
      .parameters = &read->parameters,
      .axis = fixed.axis,
      .count = fixed.reading_count,
      .at = places,
      .source_mm = places + fixed.reading_count,
      .detector_mm = places + 2 * (size_t)fixed.reading_count,
      .scale = fixed.scale,
  };
  double *aperture = &read->parameters.value[CORE_PARAMETER_DETECTOR_NA];
  if (!isnan(*aperture)) { /* detector_na belongs to the design, not to the model */
    /* fit_design uses 0 for `no aperture`; NaN makes the check refuse a 0 that was sent. */
    read->design.detector_na = *aperture == 0 ? (double)NAN : *aperture;
    *aperture = (double)NAN;
  }
  if (layout.parts[FIT_REFERENCE].count > 0) {
    wire_medium medium;
    wire_get_medium(bytes + layout.parts[FIT_REFERENCE].at, &medium);
    read->design.reference =
        (core_medium){medium.sigma_a, medium.sigma_s, medium.g, medium.eta, medium.thickness};
  }
}

uint64_t fit_residuals_offset(uint64_t set_count) {
  return WIRE_BYTES_fit_reply + set_count * WIRE_BYTES_fitted;
}
