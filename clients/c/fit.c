/* Fits coefficients to readings. The parts of a reply are put together as they arrive. */
#include "proto/fit.h"

#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/message.h"

/* The caller's structure is that of the wire, so the arrays of a frame are used in place. */
_Static_assert(sizeof(dipole_fitted) == WIRE_BYTES_fitted, "the structures are the same");
_Static_assert(offsetof(dipole_fitted, sigma_a_per_mm) == 16, "the structures are the same");

_Static_assert(sizeof(dipole_estimate) == WIRE_BYTES_estimate, "the structures are the same");

/* ---- parts --------------------------------------------------------------------------------- */

static bool merge_part(const libdipole_pending *pending, const void *part, void *whole) {
  const wire_fit_reply *fixed = part;
  wire_fit_reply *all = whole;
  if (all != NULL) {
    all->fitted_count += fixed->fitted_count;
    all->notes |= fixed->notes;
  }
  return fixed->fitted_count <= fixed->count && fixed->reading_count == pending->medium_count;
}

static const libdipole_kind kind = {
    .repeatable = true, .reply = &schema_fit_reply, .merge = merge_part};

/* ---- requests ------------------------------------------------------------------------------ */

bool dipole_fit(dipole_client *client, const dipole_fit_query *query, dipole_fits **fits,
                dipole_error *error) {
  const uint64_t count = query->reading_count, all = count * query->set_count;
  const bool known = query->scale == DIPOLE_REFERENCE;
  const uint32_t residuals = query->residuals ? (uint32_t)count : 0;
  const dipole_field fields[] = {
      {"model", .number = query->model},
      {"moments", .number = query->moments},
      {"axis", .number = query->axis},
      {"scale", .number = query->scale},
      {"g", .number = query->g},
      {"eta", .number = query->eta},
      {"thickness", .number = query->thickness_mm},
      {"residuals", .number = query->residuals},
      {"set_count", .number = (double)query->set_count},
      {"parameter", .elements = query->parameters, .count = query->parameter_count},
      {"reference", .elements = known ? &query->reference : NULL, .count = known},
      {"at", .elements = query->at, .count = count},
      LIBDIPOLE_OR_ZEROS("source", query->source_mm, count),
      LIBDIPOLE_OR_ZEROS("detector", query->detector_mm, count),
      {"values", .elements = query->values, .count = all},
      {"errors", .elements = query->errors, .count = all}};
  libdipole_made made;
  error = error != NULL ? error : &(dipole_error){0};
  if (!libdipole_make(&made, &schema_fit_request, fields, LIBDIPOLE_COUNT(fields), error)) {
    return false;
  }
  const wire_fit_reply most = {.count = query->set_count, .reading_count = residuals};
  const libdipole_shape shape = {&schema_fit_reply, &most, true};
  libdipole_pending pending = {.kind = &kind,
                               .type = WIRE_TYPE_FIT,
                               .deadline_ms = query->deadline_ms,
                               .medium_count = residuals,
                               .radius_count = query->set_count};
  libdipole_frame *frame =
      libdipole_ask(client, &pending, made.payload, made.start, made.parts, &shape, error);
  if (frame == NULL) {
    return false;
  }
  const wire_fit_reply *fixed = (const void *)frame->payload;
  const uint8_t *sets = frame->payload + WIRE_BYTES_fit_reply;
  frame->fits = (dipole_fits){
      .set_count = fixed->count,
      .fitted_count = fixed->fitted_count,
      .reading_count = fixed->reading_count,
      .notes = fixed->notes,
      .sets = (const void *)sets,
      .residuals = residuals > 0 ? (const void *)(sets + fixed->count * WIRE_BYTES_fitted) : NULL,
  };
  *fits = &frame->fits;
  return true;
}

/* ---- layers -------------------------------------------------------------------------------- */

bool dipole_fit_layers(dipole_client *client, const dipole_layers_query *query,
                       dipole_layers_fit **fit, dipole_error *error) {
  const uint64_t count = query->reading_count;
  const dipole_field fields[] = {{"scale", .number = query->scale},
                                 {"unknowns", .number = query->unknowns},
                                 {"medium", .elements = query->layers, .count = query->layer_count},
                                 {"at", .elements = query->at, .count = count},
                                 {"values", .elements = query->values, .count = count},
                                 {"errors", .elements = query->errors, .count = count}};
  dipole_reply *reply;
  if (!dipole_call(client, "fit_layers", fields, LIBDIPOLE_COUNT(fields), query->deadline_ms,
                   &reply, error)) {
    return false;
  }
  libdipole_frame *frame = (void *)reply;
  const wire_fit_layers_reply *fixed = (const void *)frame->payload;
  const dipole_estimate *estimates = (const void *)(fixed + 1);
  const size_t found = (size_t)__builtin_popcount(fixed->unknowns);
  frame->layers_fit = (dipole_layers_fit){
      .status = fixed->status,
      .estimate_count = found,
      .estimates = estimates,
      .factor = fixed->factor,
      .factor_error = fixed->factor_error,
      .chi_squared = fixed->chi_squared,
      .reduced_chi_squared = fixed->reduced_chi_squared,
      .numerical_error = fixed->numerical_error,
      .reading_count = fixed->reading_count,
      .residuals = (const void *)(estimates + found),
  };
  *fit = &frame->layers_fit;
  return true;
}
