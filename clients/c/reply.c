#include "clients/c/reply.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "proto/eval.h"

/* Returns the wanted quantities as proto/eval.h takes them: with a flag for a sample's radii. */
static unsigned wanted_of(uint16_t type, unsigned wanted) {
  return (type & ~WIRE_REPLY) == WIRE_TYPE_SAMPLE ? wanted | EVAL_DRAWN : wanted;
}

void libdipole_reply_expect(libdipole_pending *pending, unsigned model, unsigned evaluator,
                            unsigned wanted, uint32_t medium_count, uint64_t radius_count) {
  const bool drawn = pending->type == WIRE_TYPE_SAMPLE;
  eval_layout layout;
  pending->model = model;
  pending->evaluator = (uint16_t)evaluator;
  pending->wanted = wanted;
  pending->medium_count = medium_count;
  pending->radius_count = radius_count;
  pending->reply_bytes_min = UINT64_MAX;
  if (core_evaluator_bytes(evaluator) > 0 &&
      eval_reply_layout(evaluator, wanted_of(pending->type, wanted), medium_count, radius_count,
                        UINT64_MAX, &layout)) {
    pending->reply_bytes_min = drawn ? layout.arrays_offset : layout.radius_offset;
    pending->reply_bytes_max = layout.payload_bytes;
  }
}

/* ---- checks -------------------------------------------------------------------------------- */

/* Returns whether a reply has what was requested. With DIPOLE_ANY_MODEL the daemon chooses the
 * model and the evaluator, but not the type of the values. All parts begin alike, up to their
 * arrays. */
static bool merge_part(const libdipole_pending *pending, const void *part, void *whole) {
  const wire_eval_reply *fixed = part;
  const size_t evaluator_bytes = core_evaluator_bytes(fixed->evaluator);
  return (pending->model == DIPOLE_ANY_MODEL
              ? evaluator_bytes == core_evaluator_bytes(pending->evaluator)
              : fixed->evaluator == pending->evaluator) &&
         fixed->wanted == pending->wanted && fixed->channel_count == pending->medium_count &&
         (whole == NULL ||
          memcmp((const uint8_t *)part + WIRE_BYTES_part, (const uint8_t *)whole + WIRE_BYTES_part,
                 (size_t)pending->reply_bytes_min - WIRE_BYTES_part) == 0);
}

/* Checks that a frame is the next part of the reply and has the counts of the request, so that a
 * caller who indexes the arrays by these counts stays inside. */
static bool parse(const libdipole_pending *pending, const libdipole_frame *frame,
                  wire_eval_reply *fixed, eval_layout *layout, dipole_error *error) {
  return (eval_reply_parse(frame->payload, (size_t)frame->payload_bytes,
                           pending->type == WIRE_TYPE_SAMPLE, fixed, layout) &&
          merge_part(pending, frame->payload, NULL) &&
          libdipole_part_is_next(pending, (const void *)frame->payload)) ||
         libdipole_fail_protocol(error, "it replied to an eval request with another shape than was "
                                        "requested");
}

/* ---- results ------------------------------------------------------------------------------- */

/* Returns the array of a quantity, or NULL if there is none. */
static const void *array_at(const libdipole_frame *frame, const eval_layout *layout,
                            unsigned wanted, uint32_t channel, enum core_quantity quantity) {
  return (wanted & quantity) != 0
             ? frame->payload + eval_array_offset(layout, wanted, channel, quantity)
             : NULL;
}

static void get_channel(const libdipole_frame *frame, const eval_layout *layout,
                        const wire_eval_reply *fixed, uint32_t index, dipole_channel *channel) {
  const unsigned wanted = wanted_of(frame->header.type, fixed->wanted);
  const wire_quantity_error most = eval_largest_error(frame->payload, layout, wanted, index);
  *channel = (dipole_channel){.numerical_error = most.numerical_error,
                              .numerical_error_per_mm = most.numerical_error_per_mm,
                              .model_error = most.model_error};
  memcpy(&channel->albedo, frame->payload + eval_albedo_offset(index), sizeof channel->albedo);
  if ((wanted & CORE_QUANTITY_BALANCE) != 0) {
    channel->balance =
        (const dipole_balance *)(const void *)(frame->payload + layout->balances_offset) + index;
  }
  const void *R = array_at(frame, layout, wanted, index, CORE_QUANTITY_R);
  const void *cdf = array_at(frame, layout, wanted, index, CORE_QUANTITY_CDF);
  if (fixed->evaluator == DIPOLE_F64) {
    channel->R_f64 = R;
    channel->cdf_f64 = cdf;
  } else {
    channel->R_f32 = R;
    channel->cdf_f32 = cdf;
  }
}

/* Fills in frame->result, whose arrays are those in the payload of the frame. */
static dipole_result *make_result(libdipole_frame *frame, const wire_eval_reply *fixed,
                                  const eval_layout *layout) {
  const unsigned wanted = wanted_of(frame->header.type, fixed->wanted);
  const void *radii = frame->payload + layout->radius_offset;
  dipole_channel *channels = (dipole_channel *)(void *)(frame->payload + frame->payload_bytes);
  if ((wanted & CORE_QUANTITY_RADIUS) == 0 || eval_is_array(wanted, CORE_QUANTITY_RADIUS)) {
    radii = NULL;
  }
  for (uint32_t i = 0; i < fixed->channel_count; i++) {
    get_channel(frame, layout, fixed, i, &channels[i]);
  }
  frame->result = (dipole_result){.model = fixed->model,
                                  .evaluator = fixed->evaluator,
                                  .moments = fixed->moments,
                                  .wanted = fixed->wanted,
                                  .notes = fixed->notes,
                                  .radius_count = fixed->count,
                                  .radius_f64 = fixed->evaluator == DIPOLE_F64 ? radii : NULL,
                                  .radius_f32 = fixed->evaluator == DIPOLE_F64 ? NULL : radii,
                                  .channel_count = fixed->channel_count,
                                  .channels = channels};
  return &frame->result;
}

/* Copies the arrays into the caller's memory. */
static void copy_into(const libdipole_pending *pending, const libdipole_frame *frame,
                      const wire_eval_reply *fixed, const eval_layout *layout) {
  const size_t bytes = (size_t)fixed->count * core_evaluator_bytes(fixed->evaluator);
  const uint64_t arrays = fixed->channel_count * (uint64_t)layout->arrays_per_channel;
  for (uint64_t i = 0; i < arrays && bytes > 0; i++) {
    memcpy((uint8_t *)pending->into_values + i * bytes,
           frame->payload + layout->arrays_offset + i * layout->array_bytes, bytes);
  }
  if ((fixed->wanted & CORE_QUANTITY_RADIUS) != 0 && bytes > 0) {
    memcpy(pending->into_radii, frame->payload + layout->radius_offset, bytes);
  }
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
  if (!parse(pending, frame, &fixed, &layout, error)) {
    client->broken = *error;
    free(frame);
    return false;
  }
  if (pending->into_values != NULL || pending->into_radii != NULL) {
    copy_into(pending, frame, &fixed, &layout);
  }
  *result = make_result(frame, &fixed, &layout);
  return true;
}

/* Returns the array of a quantity; NULL if there is none or its values have another size. Computes
 * the layout again from the counts of the result. */
static const void *values(const dipole_result *result, uint32_t channel, unsigned quantity,
                          size_t value_bytes) {
  const libdipole_frame *frame = (const libdipole_frame *)(const void *)result;
  const unsigned wanted = wanted_of(frame->header.type, result->wanted);
  eval_layout layout;
  if (core_evaluator_bytes(result->evaluator) != value_bytes || channel >= result->channel_count ||
      !eval_is_array(wanted, quantity) ||
      !eval_reply_layout(result->evaluator, wanted, result->channel_count, result->radius_count,
                         frame->payload_bytes, &layout)) {
    return NULL;
  }
  return array_at(frame, &layout, wanted, channel, quantity);
}

const double *dipole_values_f64(const dipole_result *result, uint32_t channel, unsigned quantity) {
  return values(result, channel, quantity, sizeof(double));
}

const float *dipole_values_f32(const dipole_result *result, uint32_t channel, unsigned quantity) {
  return values(result, channel, quantity, sizeof(float));
}

dipole_errors dipole_errors_of(const dipole_result *result, uint32_t channel, unsigned quantity) {
  const libdipole_frame *frame = (const libdipole_frame *)(const void *)result;
  const unsigned wanted = wanted_of(frame->header.type, result->wanted);
  eval_layout layout;
  wire_quantity_error error = {(double)NAN, (double)NAN, (double)NAN};
  if (channel < result->channel_count && (result->wanted & quantity) != 0 &&
      (quantity & (quantity - 1)) == 0 &&
      eval_reply_layout(result->evaluator, wanted, result->channel_count, result->radius_count,
                        frame->payload_bytes, &layout)) {
    wire_get_quantity_error(frame->payload + eval_error_offset(&layout, wanted, channel, quantity),
                            &error);
  }
  return (dipole_errors){error.numerical_error, error.numerical_error_per_mm, error.model_error};
}

static void hand_on(libdipole_pending *pending, libdipole_frame *part) {
  libdipole_reader *reader = pending->reader;
  const wire_eval_reply *fixed = (const void *)part->payload;
  eval_layout layout;
  eval_reply_layout(fixed->evaluator, wanted_of(pending->type, fixed->wanted), fixed->channel_count,
                    fixed->count, part->payload_bytes, &layout);
  reader->stopped = !reader->part(reader->context, make_result(part, fixed, &layout), fixed->first);
  pending->dropped = reader->stopped && fixed->part + 1 < fixed->part_count;
}

const libdipole_kind libdipole_eval_kind = {.repeatable = true,
                                            .reply = &schema_eval_reply,
                                            .merge = merge_part,
                                            .checked_later = true,
                                            .hand_on = hand_on};

const libdipole_kind libdipole_sample_kind = {
    .repeatable = true, .reply = &schema_sample_reply, .merge = merge_part, .checked_later = true};
