/* Drawing radii. The answer is that of an eval, whose radii are each channel's own. */
#include <string.h>

#include "clients/c/client.h"
#include "core/draw.h"
#include "proto/sample.h"

/* Listed numbers go into the frame as they lie in memory, and that is little-endian. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "this machine's arrays need swapping");

unsigned libdipole_wanted(uint16_t type, unsigned wanted) {
  return type == WIRE_TYPE_SAMPLE ? wanted | EVAL_DRAWN : wanted;
}

/* Only what the frame's layout depends on: everything else is the daemon's to judge. */
static bool check(const dipole_sample_query *query, uint64_t *number_bytes, dipole_error *error) {
  *number_bytes = 0;
  if ((query->model | query->evaluator | query->moments | query->wanted | query->draw) >
      UINT16_MAX) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "model, evaluator, moments, wanted and draw are at most 65535");
  }
  return libdipole_parameters_check(query->parameters, query->parameter_count, error) &&
         libdipole_media_check(query->media, query->medium_count, query->evaluator, error) &&
         (query->draw != DIPOLE_DRAW_LIST ||
          libdipole_list_check(query->numbers, query->sample_count, query->evaluator, "numbers",
                               "sample_count", number_bytes, error));
}

static void put(uint8_t *at, const dipole_sample_query *query, size_t number_bytes) {
  const wire_sample_request fixed = {.model = (uint16_t)query->model,
                                     .evaluator = (uint16_t)query->evaluator,
                                     .moments = (uint16_t)query->moments,
                                     .wanted = (uint16_t)query->wanted,
                                     .medium_count = query->medium_count,
                                     .draw = (uint16_t)query->draw,
                                     .parameter_count = (uint16_t)query->parameter_count,
                                     .sample_count = query->sample_count,
                                     .sample_first = query->sample_first,
                                     .seed = query->seed};
  wire_put_sample_request(at, &fixed);
  at += WIRE_BYTES_sample_request;
  for (uint32_t i = 0; i < query->medium_count; i++) {
    at = libdipole_medium_put(at, &query->media[i]);
  }
  at = libdipole_parameters_put(at, query->parameters, query->parameter_count);
  if (number_bytes > 0) {
    memcpy(at, query->numbers, number_bytes);
    memset(at + number_bytes, 0, (size_t)wire_padded(number_bytes) - number_bytes);
  }
}

static bool send(dipole_client *client, const dipole_sample_query *query,
                 libdipole_pending *pending, dipole_error *error) {
  uint64_t number_bytes;
  uint8_t *payload;
  eval_layout layout;
  if (!check(query, &number_bytes, error)) {
    return false;
  }
  pending->reply_bytes_min = UINT64_MAX; /* what nothing could hold: the refusal says the limit */
  if (eval_reply_layout(query->evaluator, query->wanted | EVAL_DRAWN, query->medium_count,
                        query->sample_count, UINT64_MAX, &layout)) {
    pending->reply_bytes_min = layout.arrays_offset;
    pending->reply_bytes_max = layout.payload_bytes;
  }
  const uint64_t bytes =
      sample_request_bytes(query->medium_count, (uint32_t)query->parameter_count, number_bytes);
  if (!libdipole_request_begin(client, pending, bytes, &payload, error)) {
    return false;
  }
  put(payload, query, (size_t)number_bytes);
  return libdipole_request_send(client, error);
}

bool dipole_sample(dipole_client *client, const dipole_sample_query *query, dipole_result **result,
                   dipole_error *error) {
  dipole_error unwanted;
  libdipole_pending pending = {.type = WIRE_TYPE_SAMPLE,
                               .deadline_ms = query->deadline_ms,
                               .model = (uint16_t)query->model,
                               .evaluator = (uint16_t)query->evaluator,
                               .wanted = (uint16_t)query->wanted,
                               .medium_count = query->medium_count,
                               .radius_count = query->sample_count};
  error = error != NULL ? error : &unwanted;
  return send(client, query, &pending, error) &&
         libdipole_request_wait(client, pending.id, &pending, error) &&
         libdipole_result_take(client, &pending, result, error);
}

bool dipole_sample_numbers(const dipole_sample_query *query, uint64_t begin, size_t n, void *u,
                           dipole_error *error) {
  dipole_error unwanted;
  error = error != NULL ? error : &unwanted;
  const core_draw draw = {query->draw, query->sample_count, query->sample_first, query->seed};
  if (core_choice_by_id(core_draws, query->draw) == NULL || query->draw == DIPOLE_DRAW_LIST) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "draw is %u: numbers are made for DIPOLE_DRAW_REGULAR, "
                          "DIPOLE_DRAW_STRATIFIED and DIPOLE_DRAW_RANDOM",
                          query->draw);
  }
  const core_fault fault = core_draw_check(&draw);
  if (fault.field != NULL) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "%s: allowed: %s", fault.field,
                          fault.allowed);
  }
  if (begin > draw.count || n > draw.count - begin) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "there are only %llu numbers",
                          (unsigned long long)draw.count);
  }
  switch (core_evaluator_bytes(query->evaluator)) {
  case sizeof(double):
    core_draw_f64(&draw, begin, n, u);
    return true;
  case sizeof(float):
    core_draw_f32(&draw, begin, n, u);
    return true;
  default:
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "evaluator is %u", query->evaluator);
  }
}
