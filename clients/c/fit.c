/* Fits coefficients to readings. The parts of a reply are put together as they arrive. */
#include "proto/fit.h"

#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/query.h"
#include "clients/c/request.h"

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

static bool check(const dipole_fit_query *query, dipole_error *error) {
  if (!libdipole_query_check(query->model, query->moments | query->axis | query->scale,
                             query->parameters, query->parameter_count, error)) {
    return false;
  }
  if ((query->at == NULL && query->reading_count > 0) ||
      ((query->values == NULL || query->errors == NULL) && query->set_count > 0)) {
    return libdipole_fail_argument(
        error, "at, values or errors is NULL although reading_count and set_count are not 0");
  }
  if (query->reading_count > CORE_FIT_READINGS_MAX) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "reading_count is at most %d",
                          CORE_FIT_READINGS_MAX);
  }
  return true;
}

bool dipole_fit(dipole_client *client, const dipole_fit_query *query, dipole_fits **fits,
                dipole_error *error) {
  const uint32_t residuals = query->residuals ? (uint32_t)query->reading_count : 0;
  error = error != NULL ? error : &(dipole_error){0};
  if (!check(query, error)) {
    return false;
  }
  const fit_start start = {{.set_count = query->set_count, .residuals = query->residuals},
                           {.model = (uint16_t)query->model,
                            .moments = (uint16_t)query->moments,
                            .axis = (uint16_t)query->axis,
                            .scale = (uint16_t)query->scale,
                            .reading_count = (uint32_t)query->reading_count,
                            .parameter_count = (uint16_t)query->parameter_count,
                            .g = query->g,
                            .eta = query->eta,
                            .thickness = query->thickness_mm}};
  const void *const parts[] = {query->parameters, &query->reference,  query->at,
                               query->source_mm,  query->detector_mm, query->values,
                               query->errors};
  const wire_fit_reply most = {.count = query->set_count, .reading_count = residuals};
  const libdipole_shape shape = {&schema_fit_reply, &most, true};
  libdipole_pending pending = {.kind = &kind,
                               .type = WIRE_TYPE_FIT,
                               .deadline_ms = query->deadline_ms,
                               .medium_count = residuals,
                               .radius_count = query->set_count};
  libdipole_frame *frame =
      libdipole_ask(client, &pending, &schema_fit_request, &start, parts, &shape, error);
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
  error = error != NULL ? error : &(dipole_error){0};
  if (query->unknowns > UINT16_MAX || query->scale > UINT16_MAX ||
      query->layer_count > CORE_LAYERS_MAX || query->reading_count > CORE_FIT_READINGS_MAX) {
    return libdipole_fail_argument(error,
                                   "unknowns or scale is above 65535, layer_count above 8 or "
                                   "reading_count above 1024");
  }
  const wire_fit_layers_request start = {.scale = (uint16_t)query->scale,
                                         .unknowns = (uint16_t)query->unknowns,
                                         .layer_count = query->layer_count,
                                         .reading_count = (uint32_t)query->reading_count};
  const wire_fit_layers_reply wanted = {.unknowns = start.unknowns,
                                        .reading_count = start.reading_count};
  const libdipole_shape shape = {&schema_fit_layers_reply, &wanted, false};
  const void *const parts[] = {query->layers, query->at, query->values, query->errors};
  libdipole_pending pending = {
      .kind = &libdipole_plain, .type = WIRE_TYPE_FIT_LAYERS, .deadline_ms = query->deadline_ms};
  libdipole_frame *frame =
      libdipole_ask(client, &pending, &schema_fit_layers_request, &start, parts, &shape, error);
  if (frame == NULL) {
    return false;
  }
  const wire_fit_layers_reply *fixed = (const void *)frame->payload;
  if (fixed->unknowns != wanted.unknowns || fixed->reading_count != wanted.reading_count) {
    free(frame);
    return libdipole_bad_reply(client, "a fit of layers is of other readings", error);
  }
  const dipole_estimate *estimates = (const void *)(fixed + 1);
  const size_t count = (size_t)__builtin_popcount(fixed->unknowns);
  frame->layers_fit = (dipole_layers_fit){
      .status = fixed->status,
      .estimate_count = count,
      .estimates = estimates,
      .factor = fixed->factor,
      .factor_error = fixed->factor_error,
      .chi_squared = fixed->chi_squared,
      .reduced_chi_squared = fixed->reduced_chi_squared,
      .numerical_error = fixed->numerical_error,
      .reading_count = fixed->reading_count,
      .residuals = (const void *)(estimates + count),
  };
  *fit = &frame->layers_fit;
  return true;
}
