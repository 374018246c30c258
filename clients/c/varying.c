/* Evaluates values each of which has its own medium: requests them from a daemon, or evaluates at home with
 * the daemon's own code. The parts of a reply are put together as they arrive. */
#include "proto/varying.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/query.h"
#include "clients/c/request.h"
#include "clients/c/table.h"

/* ---- parts --------------------------------------------------------------------------------- */

static varying_layout layout_of(const wire_varying_reply *fixed) {
  return varying_reply_layout(fixed->evaluator, fixed->wanted, fixed->coefficients, fixed->count);
}

static double largest(double a, double b) {
  return isnan(a) || isnan(b) ? (double)NAN : fmax(a, b);
}

static bool merge_part(const libdipole_pending *pending, const void *part, void *whole) {
  const wire_varying_reply *fixed = part;
  wire_varying_reply *all = whole;
  if (all != NULL) {
    all->computed_count += fixed->computed_count;
    all->numerical_error = largest(all->numerical_error, fixed->numerical_error);
    all->model_error = largest(all->model_error, fixed->model_error);
  }
  return fixed->computed_count <= fixed->count && fixed->model == pending->model &&
         fixed->moments == pending->moments && fixed->evaluator == pending->evaluator &&
         fixed->wanted == pending->wanted && fixed->coefficients == pending->medium_count;
}

static const libdipole_kind kind = {
    .repeatable = true, .reply = &schema_varying_reply, .merge = merge_part};

/* ---- requests ------------------------------------------------------------------------------ */

static bool check(const dipole_varying_query *query, dipole_error *error) {
  const bool coloured = query->colours != NULL || query->lengths_mm != NULL;
  const void *first = coloured ? query->colours : query->sigma_a_per_mm;
  const void *second = coloured ? query->lengths_mm : query->sigma_s_per_mm;
  if (!libdipole_query_check(query->model,
                             query->evaluator | query->moments | query->wanted |
                                 query->coefficients | query->given | query->light,
                             query->parameters, query->parameter_count, error)) {
    return false;
  }
  if (query->evaluator != DIPOLE_F64 && query->evaluator != DIPOLE_F32) {
    return libdipole_fail_argument(error, "evaluator is neither DIPOLE_F64 nor DIPOLE_F32");
  }
  if ((first == NULL || second == NULL) && query->value_count > 0) {
    return libdipole_fail_argument(error,
                                   "sigma_a_per_mm and sigma_s_per_mm, or colours and lengths_mm, "
                                   "are NULL although value_count is not 0");
  }
  if (coloured && (query->sigma_a_per_mm != NULL || query->sigma_s_per_mm != NULL)) {
    return libdipole_fail_argument(error, "both coefficients and colours are given");
  }
  if (coloured != (query->given != 0)) {
    return libdipole_fail_argument(error, "given has to be set with colours, and 0 without them");
  }
  if (query->radii != NULL && query->numbers != NULL) {
    return libdipole_fail_argument(error, "both radii and numbers are given");
  }
  if (query->value_count > UINT32_MAX / (2 * sizeof(float))) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "%llu values are more than a frame holds: request fewer at a time",
                          (unsigned long long)query->value_count);
  }
  return true;
}

static wire_varying_request request_of(const dipole_varying_query *query) {
  return (wire_varying_request){.model = (uint16_t)query->model,
                                .evaluator = (uint16_t)query->evaluator,
                                .moments = (uint16_t)query->moments,
                                .wanted = query->wanted,
                                .coefficients = (uint16_t)query->coefficients,
                                .given = (uint16_t)query->given,
                                .light = (uint16_t)query->light,
                                .specular = query->specular,
                                .numbers = query->radii != NULL     ? VARYING_RADII
                                           : query->numbers != NULL ? VARYING_DRAWN
                                                                    : VARYING_NONE,
                                .parameter_count = (uint32_t)query->parameter_count,
                                .value_count = query->value_count,
                                .g = query->g,
                                .eta = query->eta};
}

/* The parts of a request: those that are not there have no values. */
enum { PARTS = 7 };
#define PARTS_OF(query)                                                                            \
  {                                                                                                \
    (query)->parameters, (query)->sigma_a_per_mm, (query)->colours, (query)->sigma_s_per_mm,       \
        (query)->lengths_mm, (query)->radii, (query)->numbers                                      \
  }

/* Makes a result of a frame that holds a whole reply. */
static bool make_result(libdipole_frame *frame, dipole_varying_result **result) {
  const wire_varying_reply *fixed = (const void *)frame->payload;
  frame->varying = (dipole_varying_result){
      .model = fixed->model,
      .evaluator = fixed->evaluator,
      .moments = fixed->moments,
      .wanted = fixed->wanted,
      .coefficients = fixed->coefficients,
      .notes = fixed->notes,
      .value_count = fixed->count,
      .computed_count = fixed->computed_count,
      .statuses = frame->payload + layout_of(fixed).status_offset,
      .numerical_error = fixed->numerical_error,
      .model_error = fixed->model_error,
      .colour_least = fixed->colour_least,
      .colour_most = fixed->colour_most,
      .specular = fixed->specular,
  };
  *result = &frame->varying;
  return true;
}

bool dipole_varying(dipole_client *client, const dipole_varying_query *query,
                    dipole_varying_result **result, dipole_error *error) {
  error = error != NULL ? error : &(dipole_error){0};
  if (!check(query, error)) {
    return false;
  }
  const wire_varying_reply most = {.evaluator = (uint16_t)query->evaluator,
                                   .wanted = query->wanted,
                                   .coefficients = (uint16_t)query->coefficients,
                                   .count = query->value_count};
  const libdipole_shape shape = {&schema_varying_reply, &most, true};
  libdipole_pending pending = {.kind = &kind,
                               .type = WIRE_TYPE_VARYING,
                               .deadline_ms = query->deadline_ms,
                               .model = query->model,
                               .evaluator = (uint16_t)query->evaluator,
                               .wanted = query->wanted,
                               .moments = (uint16_t)query->moments,
                               .medium_count = query->coefficients,
                               .radius_count = query->value_count};
  const wire_varying_request fixed = request_of(query);
  const void *const parts[PARTS] = PARTS_OF(query);
  libdipole_frame *frame =
      libdipole_ask(client, &pending, &schema_varying_request, &fixed, parts, &shape, error);
  return frame != NULL && make_result(frame, result);
}

/* ---- at home ------------------------------------------------------------------------------- */

/* Returns the prepared model of a request, which the surface owns. */
static const core_varying *prepared(const dipole_surface *surface, const varying_request *request,
                                    dipole_error *error) {
  const core_varying *varying = libdipole_surface_varying(surface, request);
  if (varying == NULL) {
    libdipole_fail_argument(error,
                            "the surface is not that of this query's model, moments, g, eta and "
                            "parameters");
    return NULL;
  }
  const core_fault wrong = request->fixed.given != 0 ? core_colour_check(varying, &request->colour)
                                                     : (core_fault){NULL, NULL, 0};
  if (wrong.field != NULL) {
    libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "%s: allowed: %s", wrong.field, wrong.allowed);
    return NULL;
  }
  return varying;
}

/* Evaluates all values of a request into the frame of a reply. */
static void evaluate_at_home(const varying_request *request, const core_varying *varying,
                             double *scratch, libdipole_frame *frame) {
  varying_part part;
  const uint64_t count = request->fixed.value_count;
  varying_part_start(&part, request, frame->payload, 0, count);
  for (uint64_t at = 0; at < count; at += VARYING_SLICE_VALUES) {
    const uint64_t left = count - at;
    varying_part_evaluate(&part, request, varying, NULL, at,
                          left < VARYING_SLICE_VALUES ? (size_t)left : VARYING_SLICE_VALUES,
                          scratch);
  }
  varying_part_end(&part, request, varying, NULL, 0, 1);
}

/* Parses the request that a daemon would get, and makes the reply. */
static libdipole_frame *reply_at_home(const dipole_surface *surface, const uint8_t *payload,
                                      size_t bytes, dipole_error *error) {
  varying_request request;
  const wire_error wrong = varying_request_parse(payload, bytes, &request);
  if (wrong.status != WIRE_STATUS_OK) {
    libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "%s: allowed: %s", wrong.field, wrong.allowed);
    return NULL;
  }
  const core_varying *varying = prepared(surface, &request, error);
  if (varying == NULL) {
    return NULL;
  }
  const wire_varying_request *fixed = &request.fixed;
  const uint64_t reply_bytes =
      varying_reply_layout(fixed->evaluator, fixed->wanted, fixed->coefficients, fixed->value_count)
          .payload_bytes;
  double *scratch = malloc(VARYING_SCRATCH_ARRAYS * VARYING_SLICE_VALUES * sizeof *scratch);
  libdipole_frame *frame = libdipole_frame_new(&(wire_header){0}, reply_bytes, 0, error);
  if (scratch != NULL && frame != NULL) {
    evaluate_at_home(&request, varying, scratch, frame);
  } else {
    libdipole_fail_memory(error);
    free(frame);
    frame = NULL;
  }
  free(scratch);
  return frame;
}

bool dipole_varying_at_home(const dipole_surface *surface, const dipole_varying_query *query,
                            dipole_varying_result **result, dipole_error *error) {
  error = error != NULL ? error : &(dipole_error){0};
  if (!check(query, error)) {
    return false;
  }
  const wire_varying_request fixed = request_of(query);
  const void *const parts[PARTS] = PARTS_OF(query);
  schema_layout layout = {.payload_bytes = UINT64_MAX};
  schema_lay_out(&schema_varying_request, &fixed, UINT64_MAX, &layout, NULL);
  uint8_t *payload = malloc((size_t)layout.payload_bytes);
  if (payload == NULL) {
    return libdipole_fail_memory(error);
  }
  libdipole_payload_put(payload, &schema_varying_request, &layout, &fixed, parts);
  libdipole_frame *frame = reply_at_home(surface, payload, (size_t)layout.payload_bytes, error);
  free(payload);
  return frame != NULL && make_result(frame, result);
}

/* ---- results ------------------------------------------------------------------------------- */

static const void *array_of(const dipole_varying_result *result, bool single, uint32_t array) {
  const libdipole_frame *frame = (const void *)result;
  const varying_layout layout = layout_of((const void *)frame->payload);
  return (result->evaluator == DIPOLE_F32) == single && array != 0 && (array & (array - 1)) == 0 &&
                 (layout.arrays & array) != 0
             ? frame->payload + varying_array_offset(&layout, array)
             : NULL;
}

const double *dipole_varying_f64(const dipole_varying_result *result, unsigned quantity) {
  return array_of(result, false, VARYING_QUANTITY(quantity));
}

const float *dipole_varying_f32(const dipole_varying_result *result, unsigned quantity) {
  return array_of(result, true, VARYING_QUANTITY(quantity));
}

const double *dipole_coefficients_f64(const dipole_varying_result *result, unsigned coefficient) {
  return array_of(result, false, coefficient & (VARYING_QUANTITY(1) - 1));
}

const float *dipole_coefficients_f32(const dipole_varying_result *result, unsigned coefficient) {
  return array_of(result, true, coefficient & (VARYING_QUANTITY(1) - 1));
}
