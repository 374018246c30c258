#include "proto/sample.h"

#include "proto/schema.h"

wire_error sample_request_parse(const uint8_t *payload, size_t payload_bytes, core_draw *draw,
                                eval_request *request) {
  schema_layout layout;
  const wire_error error = schema_check(&schema_sample_request, payload, payload_bytes, &layout);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  wire_sample_request fixed;
  wire_get_sample_request(payload, &fixed);
  request->fixed = (wire_eval_request){
      .model = fixed.model,
      .evaluator = fixed.evaluator,
      .moments = fixed.moments,
      .wanted = fixed.wanted,
      .medium_count = fixed.medium_count,
      .spacing = CORE_SPACING_LIST,
      .parameter_count = fixed.parameter_count,
      .radius_count = fixed.sample_count,
      .layer_count = fixed.layer_count,
  };
  *draw = (core_draw){fixed.draw, fixed.sample_count, fixed.sample_first, fixed.seed};
  request->media = (const void *)(payload + layout.parts[EVAL_MEDIA].at);
  request->radii = fixed.draw == CORE_DRAW_LIST ? payload + layout.parts[EVAL_RADII].at : NULL;
  return schema_parse_parameters(payload + layout.parts[EVAL_PARAMETERS].at, fixed.parameter_count,
                                 fixed.layer_count, &request->parameters);
}
