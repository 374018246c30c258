/* Evaluates values each of which has its own medium: requests them from a daemon, or evaluates at home with
 * the daemon's own code. The parts of a reply are put together as they arrive. */
#include "proto/varying.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/message.h"
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

static bool make_request(const dipole_varying_query *query, libdipole_made *made,
                         dipole_error *error) {
  const uint64_t count = query->value_count, coloured = query->given != 0 ? count : 0;
  const dipole_field fields[] = {
      {"model", .number = query->model},
      {"evaluator", .number = query->evaluator},
      {"moments", .number = query->moments},
      {"coefficients", .number = query->coefficients},
      {"given", .number = query->given},
      {"light", .number = query->light},
      {"specular", .number = query->specular},
      {"numbers", .number = query->radii != NULL     ? VARYING_RADII
                            : query->numbers != NULL ? VARYING_DRAWN
                                                     : VARYING_NONE},
      {"wanted", .number = query->wanted},
      {"g", .number = query->g},
      {"eta", .number = query->eta},
      {"parameter", .elements = query->parameters, .count = query->parameter_count},
      {"sigma_a", .elements = query->sigma_a_per_mm, .count = count - coloured},
      {"colour", .elements = query->colours, .count = coloured},
      {"sigma_s", .elements = query->sigma_s_per_mm, .count = count - coloured},
      {"length", .elements = query->lengths_mm, .count = coloured},
      LIBDIPOLE_OR_ZEROS("r", query->radii, count),
      LIBDIPOLE_OR_ZEROS("u", query->numbers, count)};
  const bool colours = query->colours != NULL || query->lengths_mm != NULL;
  const bool coefficients = query->sigma_a_per_mm != NULL || query->sigma_s_per_mm != NULL;
  if (query->given != 0 ? coefficients : colours) {
    return libdipole_fail_argument(error, "given has to be set with colours, and 0 without them");
  }
  return libdipole_make(made, &schema_varying_request, fields, LIBDIPOLE_COUNT(fields), error);
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
  libdipole_made made;
  error = error != NULL ? error : &(dipole_error){0};
  if (!make_request(query, &made, error)) {
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
  libdipole_frame *frame =
      libdipole_ask(client, &pending, made.payload, made.start, made.parts, &shape, error);
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
  libdipole_made made;
  schema_layout layout;
  error = error != NULL ? error : &(dipole_error){0};
  if (!make_request(query, &made, error)) {
    return false;
  }
  schema_lay_out(made.payload, made.start, UINT64_MAX, &layout, NULL);
  uint8_t *payload = malloc((size_t)layout.payload_bytes);
  if (payload == NULL) {
    return libdipole_fail_memory(error);
  }
  libdipole_payload_put(payload, made.payload, &layout, made.start, made.parts);
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
