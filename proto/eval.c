#include "proto/eval.h"

#include <math.h>

#include "proto/schema.h"

/* Returns the wanted quantities that have an array for each channel. */
static unsigned arrays_of(unsigned wanted) {
  return wanted & (CORE_ARRAYS | ((wanted & EVAL_DRAWN) != 0 ? (unsigned)CORE_QUANTITY_RADIUS : 0));
}

bool eval_is_array(unsigned wanted, unsigned quantity) {
  return (arrays_of(wanted) & quantity) != 0;
}

/* Takes what follows the structure of a request to eval or to sample. listed: whether the radii or
 * numbers u are. */
static wire_error take_parts(const uint8_t *payload, const schema_layout *layout, bool listed,
                             eval_request *request) {
  request->media = (const void *)(payload + layout->parts[EVAL_MEDIA].at);
  request->radii = listed ? payload + layout->parts[EVAL_RADII].at : NULL;
  return schema_parse_parameters(payload + layout->parts[EVAL_PARAMETERS].at,
                                 request->fixed.parameter_count, request->fixed.layer_count,
                                 &request->parameters);
}

wire_error eval_request_parse(const uint8_t *payload, size_t payload_bytes, eval_request *request) {
  schema_layout layout;
  const wire_error error = schema_check(&schema_eval_request, payload, payload_bytes, &layout);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  wire_get_eval_request(payload, &request->fixed);
  return take_parts(payload, &layout, request->fixed.spacing == CORE_SPACING_LIST, request);
}

wire_error sample_request_parse(const uint8_t *payload, size_t payload_bytes, core_draw *draw,
                                eval_request *request) {
  schema_layout layout;
  wire_sample_request fixed;
  const wire_error error = schema_check(&schema_sample_request, payload, payload_bytes, &layout);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
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
  return take_parts(payload, &layout, fixed.draw == CORE_DRAW_LIST, request);
}

static const schema_payload *payload_of(unsigned wanted) {
  return (wanted & EVAL_DRAWN) != 0 ? &schema_sample_reply : &schema_eval_reply;
}

bool eval_reply_layout(unsigned evaluator, unsigned wanted, uint32_t channel_count,
                       uint64_t radius_count, uint64_t max_payload_bytes, eval_layout *layout) {
  enum { ALBEDOS, BALANCES, ERRORS, RADII, ARRAYS };
  const wire_eval_reply fixed = {.count = radius_count,
                                 .evaluator = (uint16_t)evaluator,
                                 .wanted = wanted & ~EVAL_DRAWN,
                                 .channel_count = channel_count};
  schema_layout all;
  if (!schema_lay_out(payload_of(wanted), &fixed, max_payload_bytes, &all, NULL)) {
    return false;
  }
  *layout = (eval_layout){.payload_bytes = all.payload_bytes,
                          .radius_offset = all.parts[RADII].at,
                          .balances_offset = all.parts[BALANCES].at,
                          .errors_offset = all.parts[ERRORS].at,
                          .errors_per_channel = schema_bit_count(fixed.wanted),
                          .arrays_per_channel = schema_bit_count(arrays_of(wanted)),
                          .arrays_offset = all.parts[ARRAYS].at};
  layout->array_bytes =
      all.payload_bytes > layout->radius_offset ? all.parts[ARRAYS].array_bytes : 0;
  return true;
}

uint64_t eval_part_radii(unsigned evaluator, unsigned wanted, uint32_t channel_count,
                         uint64_t max_payload_bytes) {
  const wire_eval_reply fixed = {.evaluator = (uint16_t)evaluator,
                                 .wanted = wanted & ~EVAL_DRAWN,
                                 .channel_count = channel_count};
  return schema_part_values(payload_of(wanted), &fixed, EVAL_PART_RADII, max_payload_bytes);
}

uint64_t eval_array_offset(const eval_layout *layout, unsigned wanted, uint32_t channel,
                           enum core_quantity quantity) {
  const unsigned before = schema_bit_count(arrays_of(wanted) & (quantity - 1U));
  return layout->arrays_offset +
         ((uint64_t)channel * layout->arrays_per_channel + before) * layout->array_bytes;
}

uint64_t eval_albedo_offset(uint32_t channel) {
  return WIRE_BYTES_eval_reply + (uint64_t)channel * sizeof(double);
}

uint64_t eval_error_offset(const eval_layout *layout, unsigned wanted, uint32_t channel,
                           unsigned quantity) {
  const uint64_t before = schema_bit_count(wanted & (quantity - 1));
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
  /* the largest of all quantities; NAN if one of them is not known */
  if ((wanted & CORE_QUANTITY_MODEL_ERROR) != 0) {
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
  return (fixed->wanted & ~schema_all_bits(core_quantities)) == 0 &&
         core_evaluator_bytes(fixed->evaluator) != 0 && fixed->part < fixed->part_count &&
         eval_reply_layout(fixed->evaluator, fixed->wanted | (drawn ? EVAL_DRAWN : 0),
                           fixed->channel_count, fixed->count, payload_bytes, layout) &&
         layout->payload_bytes == payload_bytes;
}
