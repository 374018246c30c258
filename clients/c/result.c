/* The answers to eval requests, into results. */
#include <stdlib.h>
#include <string.h>

#include "clients/c/client.h"

/* Values are used where they lie in the frames, which are little-endian. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "this machine's arrays need swapping");

/* ---- answers ------------------------------------------------------------------------------- */

static unsigned wanted_of(const libdipole_frame *frame, unsigned wanted) {
  return libdipole_wanted(frame->header.type & ~WIRE_REPLY, wanted);
}

/* In the caller's memory the arrays lie one behind the other, without padding; radii apart. */
static const void *array_at(const libdipole_frame *frame, const eval_layout *layout,
                            unsigned wanted, uint64_t values_bytes, uint32_t channel,
                            enum core_quantity quantity) {
  if ((wanted & quantity) == 0) {
    return NULL;
  }
  const uint64_t offset = eval_array_offset(layout, wanted, channel, quantity);
  if (frame->into_values == NULL) {
    return frame->payload + offset;
  }
  const uint64_t before =
      layout->array_bytes > 0 ? (offset - layout->arrays_offset) / layout->array_bytes : 0;
  return (const uint8_t *)frame->into_values + before * values_bytes;
}

static void get_channel(const libdipole_frame *frame, const eval_layout *layout,
                        const wire_eval_reply *fixed, uint32_t index, dipole_channel *channel) {
  wire_channel from;
  wire_get_channel(frame->payload + layout->channels_offset + (size_t)index * WIRE_BYTES_channel,
                   &from);
  *channel = (dipole_channel){.albedo = from.albedo,
                              .numerical_error = from.numerical_error,
                              .numerical_error_per_mm = from.numerical_error_per_mm,
                              .model_error = from.model_error};
  const unsigned wanted = wanted_of(frame, fixed->wanted);
  const uint64_t bytes = fixed->radius_count * core_evaluator_bytes(fixed->evaluator);
  const void *R = array_at(frame, layout, wanted, bytes, index, CORE_QUANTITY_R);
  const void *cdf = array_at(frame, layout, wanted, bytes, index, CORE_QUANTITY_CDF);
  if (fixed->evaluator == DIPOLE_F64) {
    channel->R_f64 = R;
    channel->cdf_f64 = cdf;
  } else {
    channel->R_f32 = R;
    channel->cdf_f32 = cdf;
  }
}

/* Of any model the daemon chooses the evaluator, but not the type of the values. */
static bool is_asked_for(const libdipole_pending *pending, const wire_eval_reply *fixed) {
  return pending->model == DIPOLE_ANY_MODEL
             ? core_evaluator_bytes(fixed->evaluator) == core_evaluator_bytes(pending->evaluator)
             : fixed->evaluator == pending->evaluator;
}

/* Where a part starts, and how many radii it has; an answer in one frame is one part, of all. */
static bool is_next_part(const libdipole_pending *pending, const wire_eval_reply *fixed) {
  const uint64_t left = pending->radius_count - pending->next_radius;
  const bool is_last = fixed->part + 1 == fixed->part_count;
  return fixed->part == pending->next_part && fixed->radius_first == pending->next_radius &&
         fixed->radius_count <= left && is_last == (fixed->radius_count == left) &&
         (fixed->radius_count > 0 || fixed->part_count == 1);
}

bool libdipole_answer_parse(const libdipole_pending *pending, const libdipole_frame *frame,
                            wire_eval_reply *fixed, eval_layout *layout, dipole_error *error) {
  if (eval_reply_parse(frame->payload, (size_t)frame->payload_bytes,
                       pending->type == WIRE_TYPE_SAMPLE, fixed, layout) &&
      is_asked_for(pending, fixed) && fixed->wanted == pending->wanted &&
      fixed->channel_count == pending->medium_count && is_next_part(pending, fixed)) {
    return true;
  }
  return libdipole_fail(error, DIPOLE_ERROR_PROTOCOL,
                        "the peer does not speak this protocol: it answered an eval request with "
                        "another shape than was asked for");
}

const dipole_result *libdipole_result_make(libdipole_frame *frame, const wire_eval_reply *fixed,
                                           const eval_layout *layout) {
  const unsigned wanted = wanted_of(frame, fixed->wanted);
  const void *radii = frame->into_radii;
  dipole_channel *channels = (dipole_channel *)(void *)(frame->payload + frame->stored_bytes);
  if ((wanted & CORE_QUANTITY_RADIUS) == 0 || eval_is_array(wanted, CORE_QUANTITY_RADIUS)) {
    radii = NULL;
  } else if (radii == NULL) {
    radii = frame->payload + layout->radius_offset;
  }
  for (uint32_t i = 0; i < fixed->channel_count; i++) {
    get_channel(frame, layout, fixed, i, &channels[i]);
  }
  frame->result = (dipole_result){.model = fixed->model,
                                  .evaluator = fixed->evaluator,
                                  .moments = fixed->moments,
                                  .wanted = fixed->wanted,
                                  .notes = fixed->notes,
                                  .radius_count = fixed->radius_count,
                                  .radius_f64 = fixed->evaluator == DIPOLE_F64 ? radii : NULL,
                                  .radius_f32 = fixed->evaluator == DIPOLE_F64 ? NULL : radii,
                                  .channel_count = fixed->channel_count,
                                  .channels = channels};
  return &frame->result;
}

bool libdipole_refusal_check(const dipole_client *client, const libdipole_pending *pending,
                             dipole_error *error) {
  return pending->frame->header.type != WIRE_TYPE_ERROR ||
         libdipole_refused(client, pending, pending->frame, error);
}

bool libdipole_result_take(dipole_client *client, libdipole_pending *pending,
                           dipole_result **result, dipole_error *error) {
  libdipole_frame *frame = pending->frame;
  wire_eval_reply fixed;
  eval_layout layout;
  if (!libdipole_refusal_check(client, pending, error)) {
    free(frame);
    return false;
  }
  if (!libdipole_answer_parse(pending, frame, &fixed, &layout, error)) {
    client->broken = *error;
    free(frame);
    return false;
  }
  frame->into_values = pending->into_values;
  frame->into_radii = pending->into_radii;
  libdipole_result_make(frame, &fixed, &layout);
  *result = &frame->result;
  return true;
}

/* ---- what the caller reads ------------------------------------------------------------------- */

/* The layout follows from the result's own counts, as it did when the answer was parsed. */
static const void *values(const dipole_result *result, uint32_t channel, unsigned quantity,
                          size_t value_bytes) {
  const libdipole_frame *frame = (const libdipole_frame *)(const void *)result;
  const unsigned wanted = wanted_of(frame, result->wanted);
  eval_layout layout;
  if (core_evaluator_bytes(result->evaluator) != value_bytes || channel >= result->channel_count ||
      !eval_is_array(wanted, quantity) ||
      !eval_reply_layout(result->evaluator, wanted, result->channel_count, result->radius_count,
                         frame->payload_bytes, &layout)) {
    return NULL;
  }
  return array_at(frame, &layout, wanted, result->radius_count * value_bytes, channel, quantity);
}

const double *dipole_values_f64(const dipole_result *result, uint32_t channel, unsigned quantity) {
  return values(result, channel, quantity, sizeof(double));
}

const float *dipole_values_f32(const dipole_result *result, uint32_t channel, unsigned quantity) {
  return values(result, channel, quantity, sizeof(float));
}

void dipole_result_free(dipole_result *result) {
  free(result); /* the first member of the frame that holds it all */
}
