/* Queries into eval requests, and the answers into results. */
#include <stdlib.h>
#include <string.h>

#include "clients/c/client.h"
#include "proto/eval.h"

/* Radii and values are used where they lie in the frames, which are little-endian. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "this machine's arrays need swapping");

/* ---- asking -------------------------------------------------------------------------------- */

static bool check_parameters(const dipole_query *query, dipole_error *error) {
  if (query->parameters == NULL && query->parameter_count > 0) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "parameters is NULL, parameter_count is not 0");
  }
  for (size_t i = 0; i < query->parameter_count; i++) {
    if (query->parameters[i].id > UINT16_MAX) {
      return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "the id of a parameter is at most 65535");
    }
  }
  return true;
}

/* Only what the frame's layout depends on: everything else is the daemon's to judge. */
static bool check_query(const dipole_query *query, uint64_t *radii_bytes, dipole_error *error) {
  *radii_bytes = 0;
  if ((query->model | query->evaluator | query->moments | query->wanted) > UINT16_MAX) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "model, evaluator, moments and wanted are at most 65535");
  }
  if (query->spacing > UINT16_MAX || query->parameter_count > UINT16_MAX) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "spacing and parameter_count are at most 65535");
  }
  if (!check_parameters(query, error)) {
    return false;
  }
  if (query->media == NULL && query->medium_count > 0) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "media is NULL, medium_count is not 0");
  }
  const size_t value_bytes = eval_value_bytes(query->evaluator);
  if (value_bytes == 0) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "evaluator is %u: this library knows DIPOLE_F64, DIPOLE_F32 and DIPOLE_LUT",
                          query->evaluator);
  }
  if (query->spacing != DIPOLE_LIST) {
    return true;
  }
  if (query->radii == NULL && query->radius_count > 0) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "radii is NULL, radius_count is not 0");
  }
  if (query->radius_count > UINT32_MAX / value_bytes) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "%llu radii are more than a frame holds: ask for fewer at a time",
                          (unsigned long long)query->radius_count);
  }
  *radii_bytes = query->radius_count * value_bytes;
  return true;
}

static void put_query(uint8_t *at, const dipole_query *query, size_t radii_bytes) {
  const bool list = query->spacing == DIPOLE_LIST;
  const wire_eval_request fixed = {.model = (uint16_t)query->model,
                                   .evaluator = (uint16_t)query->evaluator,
                                   .moments = (uint16_t)query->moments,
                                   .wanted = (uint16_t)query->wanted,
                                   .medium_count = query->medium_count,
                                   .spacing = (uint16_t)query->spacing,
                                   .parameter_count = (uint16_t)query->parameter_count,
                                   .radius_count = query->radius_count,
                                   .radius_start = list ? 0 : query->radius_start_mm,
                                   .radius_stop = list ? 0 : query->radius_stop_mm};
  wire_put_eval_request(at, &fixed);
  at += WIRE_BYTES_eval_request;
  for (uint32_t i = 0; i < query->medium_count; i++) {
    const wire_medium medium = {.sigma_a = query->media[i].sigma_a_per_mm,
                                .sigma_s = query->media[i].sigma_s_per_mm,
                                .g = query->media[i].g,
                                .eta = query->media[i].eta};
    wire_put_medium(at, &medium);
    at += WIRE_BYTES_medium;
  }
  for (size_t i = 0; i < query->parameter_count; i++) {
    const wire_parameter parameter = {.parameter = (uint16_t)query->parameters[i].id,
                                      .value = query->parameters[i].value};
    wire_put_parameter(at, &parameter);
    at += WIRE_BYTES_parameter;
  }
  if (radii_bytes > 0) {
    memcpy(at, query->radii, radii_bytes);
    memset(at + radii_bytes, 0, (size_t)wire_padded(radii_bytes) - radii_bytes);
  }
}

static bool submit(dipole_client *client, const dipole_query *query, uint64_t *id,
                   dipole_error *error) {
  uint64_t radii_bytes;
  uint8_t *payload;
  eval_layout layout;
  if (!check_query(query, &radii_bytes, error)) {
    return false;
  }
  libdipole_pending pending = {.type = WIRE_TYPE_EVAL,
                               .evaluator = (uint16_t)query->evaluator,
                               .wanted = (uint16_t)query->wanted,
                               .medium_count = query->medium_count,
                               .radius_count = query->radius_count};
  /* A reply that would not fit into a frame is one that the daemon will refuse; it is asked all the
   * same, because its refusal says what the limit is. */
  if (eval_reply_layout(query->evaluator, query->wanted, query->medium_count, query->radius_count,
                        UINT32_MAX, &layout)) {
    pending.reply_bytes_min = pending.reply_bytes_max = layout.payload_bytes;
  } else {
    pending.reply_bytes_min = UINT64_MAX;
  }
  const uint64_t bytes =
      eval_request_bytes(query->medium_count, (uint32_t)query->parameter_count, radii_bytes);
  if (!libdipole_request_begin(client, &pending, bytes, &payload, error)) {
    return false;
  }
  *id = pending.id;
  put_query(payload, query, (size_t)radii_bytes);
  return libdipole_request_send(client, error);
}

/* ---- answers ------------------------------------------------------------------------------- */

static const void *array_at(const libdipole_frame *frame, const eval_layout *layout,
                            unsigned wanted, uint32_t channel, enum core_quantity quantity) {
  return (wanted & quantity) != 0
             ? frame->payload + eval_array_offset(layout, wanted, channel, quantity)
             : NULL;
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
  const void *R = array_at(frame, layout, fixed->wanted, index, CORE_QUANTITY_R);
  const void *cdf = array_at(frame, layout, fixed->wanted, index, CORE_QUANTITY_CDF);
  if (eval_value_bytes(fixed->evaluator) == sizeof(double)) {
    channel->R_f64 = R;
    channel->cdf_f64 = cdf;
  } else {
    channel->R_f32 = R;
    channel->cdf_f32 = cdf;
  }
}

/* The answer must have the shape that was asked for, so that a caller who indexes with its own
 * counts stays inside the arrays. */
static bool parse_answer(const libdipole_pending *pending, wire_eval_reply *fixed,
                         eval_layout *layout, dipole_error *error) {
  const libdipole_frame *frame = pending->frame;
  if (eval_reply_parse(frame->payload, frame->header.payload_bytes, fixed, layout) &&
      fixed->evaluator == pending->evaluator && fixed->wanted == pending->wanted &&
      fixed->channel_count == pending->medium_count &&
      fixed->radius_count == pending->radius_count) {
    return true;
  }
  return libdipole_fail(error, DIPOLE_ERROR_PROTOCOL,
                        "the peer does not speak this protocol: it answered an eval request with "
                        "another shape than was asked for");
}

bool libdipole_result_take(dipole_client *client, libdipole_pending *pending,
                           dipole_result **result, dipole_error *error) {
  libdipole_frame *frame = pending->frame;
  wire_eval_reply fixed;
  eval_layout layout;
  if (frame->header.type == WIRE_TYPE_ERROR) {
    libdipole_refused(client, pending, frame, error);
    free(frame);
    return false;
  }
  if (!parse_answer(pending, &fixed, &layout, error)) {
    client->broken = *error;
    free(frame);
    return false;
  }
  const void *radii =
      (fixed.wanted & CORE_QUANTITY_RADIUS) != 0 ? frame->payload + layout.radius_offset : NULL;
  dipole_channel *channels = (dipole_channel *)(frame->payload + frame->header.payload_bytes);
  const bool wide = eval_value_bytes(fixed.evaluator) == sizeof(double);
  for (uint32_t i = 0; i < fixed.channel_count; i++) {
    get_channel(frame, &layout, &fixed, i, &channels[i]);
  }
  frame->result = (dipole_result){.model = fixed.model,
                                  .evaluator = fixed.evaluator,
                                  .moments = fixed.moments,
                                  .wanted = fixed.wanted,
                                  .notes = fixed.notes,
                                  .radius_count = fixed.radius_count,
                                  .radius_f64 = wide ? radii : NULL,
                                  .radius_f32 = wide ? NULL : radii,
                                  .channel_count = fixed.channel_count,
                                  .channels = channels};
  *result = &frame->result;
  return true;
}

/* ---- the public calls ---------------------------------------------------------------------- */

bool dipole_submit(dipole_client *client, const dipole_query *query, uint64_t *id,
                   dipole_error *error) {
  dipole_error unwanted;
  return submit(client, query, id, error != NULL ? error : &unwanted);
}

bool dipole_collect(dipole_client *client, uint64_t *id, dipole_result **result,
                    dipole_error *error) {
  dipole_error unwanted;
  libdipole_pending pending;
  error = error != NULL ? error : &unwanted;
  if (!libdipole_request_wait(client, 0, &pending, error)) {
    return false;
  }
  *id = pending.id;
  return libdipole_result_take(client, &pending, result, error);
}

bool dipole_eval(dipole_client *client, const dipole_query *query, dipole_result **result,
                 dipole_error *error) {
  dipole_error unwanted;
  libdipole_pending pending;
  uint64_t id;
  error = error != NULL ? error : &unwanted;
  return submit(client, query, &id, error) && libdipole_request_wait(client, id, &pending, error) &&
         libdipole_result_take(client, &pending, result, error);
}

/* The layout follows from the result's own counts, as it did when the answer was parsed. */
static const void *values(const dipole_result *result, uint32_t channel, unsigned quantity,
                          size_t value_bytes) {
  const libdipole_frame *frame = (const libdipole_frame *)(const void *)result;
  eval_layout layout;
  if (eval_value_bytes(result->evaluator) != value_bytes || channel >= result->channel_count ||
      !eval_is_array(result->wanted, quantity) ||
      !eval_reply_layout(result->evaluator, result->wanted, result->channel_count, result->radius_count,
                         frame->header.payload_bytes, &layout)) {
    return NULL;
  }
  return array_at(frame, &layout, result->wanted, channel, quantity);
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
