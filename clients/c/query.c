/* Queries into requests: of an evaluation, and of what could answer one. */
#include <string.h>

#include "clients/c/client.h"
#include "proto/eval.h"

/* Listed radii go into the frame as they lie in memory, and that is little-endian. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "this machine's arrays need swapping");

/* ---- parameters ---------------------------------------------------------------------------- */

bool libdipole_parameters_check(const dipole_parameter *parameters, size_t count,
                                dipole_error *error) {
  if (parameters == NULL && count > 0) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "parameters is NULL, parameter_count is not 0");
  }
  if (count > UINT16_MAX) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "parameter_count is at most 65535");
  }
  for (size_t i = 0; i < count; i++) {
    if (parameters[i].id > UINT16_MAX) {
      return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "the id of a parameter is at most 65535");
    }
  }
  return true;
}

uint8_t *libdipole_parameters_put(uint8_t *at, const dipole_parameter *parameters, size_t count) {
  for (size_t i = 0; i < count; i++) {
    const wire_parameter parameter = {.parameter = (uint16_t)parameters[i].id,
                                      .value = parameters[i].value};
    wire_put_parameter(at, &parameter);
    at += WIRE_BYTES_parameter;
  }
  return at;
}

uint8_t *libdipole_medium_put(uint8_t *at, const dipole_medium *from) {
  const wire_medium medium = {.sigma_a = from->sigma_a_per_mm,
                              .sigma_s = from->sigma_s_per_mm,
                              .g = from->g,
                              .eta = from->eta};
  wire_put_medium(at, &medium);
  return at + WIRE_BYTES_medium;
}

/* ---- queries ------------------------------------------------------------------------------- */

bool libdipole_media_check(const dipole_medium *media, uint32_t medium_count, unsigned evaluator,
                           dipole_error *error) {
  if (media == NULL && medium_count > 0) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "media is NULL, medium_count is not 0");
  }
  if (core_evaluator_bytes(evaluator) == 0) {
    return libdipole_fail(
        error, DIPOLE_ERROR_ARGUMENT,
        "evaluator is %u: this library knows DIPOLE_F64, DIPOLE_F32 and DIPOLE_LUT", evaluator);
  }
  return true;
}

bool libdipole_list_check(const void *list, uint64_t count, unsigned evaluator, const char *name,
                          const char *count_name, uint64_t *bytes, dipole_error *error) {
  const size_t value_bytes = core_evaluator_bytes(evaluator);
  if (list == NULL && count > 0) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "%s is NULL, %s is not 0", name,
                          count_name);
  }
  if (count > UINT32_MAX / value_bytes) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "%llu %s are more than a frame holds: ask for fewer at a time",
                          (unsigned long long)count, name);
  }
  *bytes = count * value_bytes;
  return true;
}

/* Only what the frame's layout depends on: everything else is the daemon's to judge. */
static bool check_query(const dipole_query *query, uint64_t *radii_bytes, dipole_error *error) {
  *radii_bytes = 0;
  if ((query->model | query->evaluator | query->moments | query->wanted) > UINT16_MAX) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "model, evaluator, moments and wanted are at most 65535");
  }
  if (query->spacing > UINT16_MAX) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "spacing is at most 65535");
  }
  return libdipole_parameters_check(query->parameters, query->parameter_count, error) &&
         libdipole_media_check(query->media, query->medium_count, query->evaluator, error) &&
         (query->spacing != DIPOLE_LIST ||
          libdipole_list_check(query->radii, query->radius_count, query->evaluator, "radii",
                               "radius_count", radii_bytes, error));
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
    at = libdipole_medium_put(at, &query->media[i]);
  }
  at = libdipole_parameters_put(at, query->parameters, query->parameter_count);
  if (radii_bytes > 0) {
    memcpy(at, query->radii, radii_bytes);
    memset(at + radii_bytes, 0, (size_t)wire_padded(radii_bytes) - radii_bytes);
  }
}

bool libdipole_query_send(dipole_client *client, const dipole_query *query,
                          libdipole_pending *pending, dipole_error *error) {
  uint64_t radii_bytes;
  uint8_t *payload;
  if (!check_query(query, &radii_bytes, error)) {
    return false;
  }
  pending->deadline_ms = query->deadline_ms;
  pending->medium_count = query->medium_count;
  pending->radius_count = query->radius_count;
  const uint64_t bytes =
      eval_request_bytes(query->medium_count, (uint32_t)query->parameter_count, radii_bytes);
  if (!libdipole_request_begin(client, pending, bytes, &payload, error)) {
    return false;
  }
  put_query(payload, query, (size_t)radii_bytes);
  return libdipole_request_send(client, error);
}
