/* Fits coefficients to readings. The parts of an answer are put together as they arrive. */
#include "proto/fit.h"

#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/query.h"
#include "clients/c/request.h"

/* The fits that the caller gets, and the frame that holds their arrays. */
struct fits {
  dipole_fits public;
  libdipole_frame *frame;
};

/* The caller's structure is that of the wire, so the arrays of a frame are used in place. */
_Static_assert(sizeof(dipole_fitted) == WIRE_BYTES_fitted, "the structures are the same");
_Static_assert(offsetof(dipole_fitted, sigma_a_per_mm) == 16, "the structures are the same");

/* ---- parts --------------------------------------------------------------------------------- */

static void copy_sets(const libdipole_pending *pending, const libdipole_frame *part,
                      const wire_fit_reply *fixed) {
  const size_t residuals_bytes = fixed->reading_count * sizeof(double);
  uint8_t *whole = pending->gathered->payload;
  memcpy(whole + fit_residuals_offset(fixed->first), part->payload + WIRE_BYTES_fit_reply,
         (size_t)fixed->count * WIRE_BYTES_fitted);
  memcpy(whole + fit_residuals_offset(pending->radius_count) + fixed->first * residuals_bytes,
         part->payload + fit_residuals_offset(fixed->count),
         (size_t)fixed->count * residuals_bytes);
}

static bool take_part(libdipole_pending *pending, const libdipole_frame *frame,
                      dipole_error *error) {
  wire_fit_reply fixed;
  if (!fit_reply_parse(frame->payload, (size_t)frame->payload_bytes, &fixed) || fixed.count == 0 ||
      fixed.reading_count != pending->medium_count) {
    return libdipole_fail_protocol(error, "it answered a fit request with another shape than was "
                                          "asked for");
  }
  wire_fit_reply whole = fixed;
  if (pending->gathered != NULL) {
    wire_fit_reply before;
    wire_get_fit_reply(pending->gathered->payload, &before);
    whole.fitted_count += before.fitted_count;
    whole.notes |= before.notes;
  }
  if (!libdipole_gather(pending, frame, fit_reply_bytes(pending->radius_count, fixed.reading_count),
                        error)) {
    return false;
  }
  copy_sets(pending, frame, &fixed);
  wire_put_fit_reply(pending->gathered->payload, &whole);
  libdipole_part_end(pending, frame);
  return true;
}

static const libdipole_kind kind = {.repeatable = true, .part = take_part};

/* ---- asking -------------------------------------------------------------------------------- */

static bool check(const dipole_fit_query *query, dipole_error *error) {
  if (!libdipole_model_check(query->model, error) ||
      !libdipole_check_u16(query->model | query->moments | query->axis | query->scale,
                           "model, moments, axis and scale", error) ||
      !libdipole_parameters_check(query->parameters, query->parameter_count, error)) {
    return false;
  }
  if ((query->at == NULL && query->reading_count > 0) ||
      ((query->values == NULL || query->errors == NULL) && query->set_count > 0)) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "at, values or errors is NULL, reading_count or set_count is not 0");
  }
  if (query->reading_count > CORE_FIT_READINGS_MAX) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "reading_count is at most %d",
                          CORE_FIT_READINGS_MAX);
  }
  const uint64_t numbers = 2 * query->reading_count * sizeof(double);
  if (numbers > 0 && query->set_count > UINT32_MAX / numbers) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "%llu sets are more than a frame holds: ask for fewer at a time",
                          (unsigned long long)query->set_count);
  }
  return true;
}

static void put_query(uint8_t *payload, const fit_start *start, const schema_layout *layout,
                      const dipole_fit_query *query) {
  memcpy(payload, start, sizeof *start);
  libdipole_parameters_put(payload + layout->parts[FIT_PARAMETERS].at, query->parameters,
                           query->parameter_count);
  schema_put_part(payload, layout, FIT_REFERENCE, &query->reference);
  schema_put_part(payload, layout, FIT_AT, query->at);
  schema_put_part(payload, layout, FIT_SOURCE, query->source_mm);
  schema_put_part(payload, layout, FIT_DETECTOR, query->detector_mm);
  schema_put_part(payload, layout, FIT_VALUES, query->values);
  schema_put_part(payload, layout, FIT_ERRORS, query->errors);
}

static bool send(dipole_client *client, const dipole_fit_query *query, libdipole_pending *pending,
                 dipole_error *error) {
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
                            .eta = query->eta}};
  schema_layout layout;
  uint8_t *at;
  schema_lay_out(&schema_fit_request, &start, UINT64_MAX, &layout, NULL);
  if (!libdipole_request_begin(client, pending, layout.payload_bytes, &at, error)) {
    return false;
  }
  put_query(at, &start, &layout, query);
  return libdipole_request_send(client, error);
}

/* Makes fits of a frame, which they then own. */
static bool take(libdipole_frame *frame, uint64_t count, dipole_fits **fits, dipole_error *error) {
  struct fits *made = calloc(1, sizeof *made);
  wire_fit_reply fixed;
  if (made == NULL) {
    free(frame);
    return libdipole_fail_memory(error);
  }
  wire_get_fit_reply(frame->payload, &fixed);
  made->frame = frame;
  made->public = (dipole_fits){
      .set_count = count,
      .fitted_count = fixed.fitted_count,
      .reading_count = fixed.reading_count,
      .notes = fixed.notes,
      .sets = (const dipole_fitted *)(const void *)(frame->payload + WIRE_BYTES_fit_reply),
  };
  if (fixed.reading_count > 0) {
    made->public.residuals =
        (const double *)(const void *)(frame->payload + fit_residuals_offset(count));
  }
  *fits = &made->public;
  return true;
}

bool dipole_fit(dipole_client *client, const dipole_fit_query *query, dipole_fits **fits,
                dipole_error *error) {
  const uint32_t residuals = query->residuals ? (uint32_t)query->reading_count : 0;
  libdipole_pending pending = {.kind = &kind,
                               .type = WIRE_TYPE_FIT,
                               .deadline_ms = query->deadline_ms,
                               .reply_bytes_min = WIRE_BYTES_fit_reply,
                               .reply_bytes_max = fit_reply_bytes(query->set_count, residuals),
                               .medium_count = residuals,
                               .radius_count = query->set_count};
  error = error != NULL ? error : &(dipole_error){0};
  if (!send(client, query, &pending, error)) {
    return false;
  }
  libdipole_frame *frame = libdipole_reply(client, &pending, error);
  return frame != NULL && take(frame, query->set_count, fits, error);
}

void dipole_fits_free(dipole_fits *fits) {
  struct fits *made = (struct fits *)(void *)fits;
  if (made != NULL) {
    free(made->frame);
    free(made);
  }
}
