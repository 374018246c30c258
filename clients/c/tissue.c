#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/query.h"
#include "clients/c/request.h"

bool dipole_tissue(dipole_client *client, const dipole_tissue_query *query, dipole_medium *media,
                   dipole_error *error) {
  error = error != NULL ? error : &(dipole_error){0};
  if (!libdipole_query_check(1, query->tissue | query->haemoglobin, query->properties,
                             query->property_count, error)) {
    return false;
  }
  if (query->wavelengths_nm == NULL && query->wavelength_count > 0) {
    return libdipole_fail_argument(error,
                                   "wavelengths_nm is NULL although wavelength_count is not 0");
  }
  const wire_tissue_request start = {.tissue = (uint16_t)query->tissue,
                                     .haemoglobin = (uint16_t)query->haemoglobin,
                                     .property_count = (uint32_t)query->property_count,
                                     .wavelength_count = query->wavelength_count};
  const void *const parts[] = {query->properties, query->wavelengths_nm};
  const wire_tissue_reply wanted = {.wavelength_count = query->wavelength_count};
  const libdipole_shape shape = {&schema_tissue_reply, &wanted, false};
  libdipole_pending pending = {
      .kind = &libdipole_plain, .type = WIRE_TYPE_TISSUE, .deadline_ms = query->deadline_ms};
  libdipole_frame *frame =
      libdipole_ask(client, &pending, &schema_tissue_request, &start, parts, &shape, error);
  if (frame == NULL) {
    return false;
  }
  const wire_tissue_reply *fixed = (const void *)frame->payload;
  const bool fits = fixed->wavelength_count == query->wavelength_count &&
                    fixed->haemoglobin == query->haemoglobin;
  if (fits) {
    memcpy(media, fixed + 1, (size_t)query->wavelength_count * sizeof *media);
  }
  free(frame);
  return fits || libdipole_bad_reply(client, "media are of another tissue", error);
}

/* ---- fits ------------------------------------------------------------------------------------ */

/* The arrays of a frame are used in place. */
_Static_assert(sizeof(dipole_sought) == WIRE_BYTES_sought, "the structures are the same");
_Static_assert(sizeof(dipole_fitted_tissue) == WIRE_BYTES_fitted_tissue, "they are the same");
_Static_assert(sizeof(dipole_tissue_estimate) == WIRE_BYTES_tissue_estimate, "they are the same");

static bool merge_part(const libdipole_pending *pending, const void *part, void *whole) {
  const wire_fit_tissue_reply *fixed = part;
  wire_fit_tissue_reply *all = whole;
  if (all != NULL) {
    all->fitted_count += fixed->fitted_count;
  }
  return fixed->fitted_count <= fixed->count && fixed->reading_count == pending->medium_count &&
         (all == NULL ||
          (fixed->sought_count == all->sought_count && fixed->haemoglobin == all->haemoglobin));
}

static const libdipole_kind fit_kind = {
    .repeatable = true, .reply = &schema_fit_tissue_reply, .merge = merge_part};

static bool check_fit(const dipole_tissue_fit_query *query, dipole_error *error) {
  const dipole_tissue_query *tissue = &query->tissue;
  if (!libdipole_query_check(query->model,
                             query->axis | query->scale | tissue->tissue | tissue->haemoglobin,
                             tissue->properties, tissue->property_count, error)) {
    return false;
  }
  const bool given = (query->sought != NULL || query->sought_count == 0) &&
                     (query->at != NULL || query->place_count == 0) &&
                     (tissue->wavelengths_nm != NULL || tissue->wavelength_count == 0) &&
                     ((query->values != NULL && query->errors != NULL) || query->set_count == 0);
  return (given && query->sought_count <= UINT16_MAX &&
          (uint64_t)query->place_count * tissue->wavelength_count <= UINT16_MAX) ||
         libdipole_fail_argument(error,
                                 "sought, wavelengths_nm, at, values or errors is NULL although "
                                 "its count is not 0, or a set has more than 65535 readings");
}

bool dipole_fit_tissue(dipole_client *client, const dipole_tissue_fit_query *query,
                       dipole_tissue_fits **fits, dipole_error *error) {
  const dipole_tissue_query *tissue = &query->tissue;
  error = error != NULL ? error : &(dipole_error){0};
  if (!check_fit(query, error)) {
    return false;
  }
  const wire_fit_tissue_request start = {.set_count = query->set_count,
                                         .model = (uint16_t)query->model,
                                         .axis = (uint16_t)query->axis,
                                         .scale = (uint16_t)query->scale,
                                         .residuals = query->residuals,
                                         .tissue = (uint16_t)tissue->tissue,
                                         .haemoglobin = (uint16_t)tissue->haemoglobin,
                                         .property_count = (uint32_t)tissue->property_count,
                                         .sought_count = query->sought_count,
                                         .wavelength_count = tissue->wavelength_count,
                                         .place_count = query->place_count,
                                         .detector_na = query->detector_na};
  const wire_fit_tissue_reply most = {
      .count = query->set_count,
      .sought_count = (uint16_t)query->sought_count,
      .reading_count = query->residuals ? query->place_count * tissue->wavelength_count : 0};
  const void *const parts[] = {tissue->properties, query->sought,          query->at,
                               query->source_mm,   query->detector_mm,     query->mhz,
                               query->quantity,    tissue->wavelengths_nm, query->values,
                               query->errors};
  const libdipole_shape shape = {&schema_fit_tissue_reply, &most, true};
  libdipole_pending pending = {.kind = &fit_kind,
                               .type = WIRE_TYPE_FIT_TISSUE,
                               .deadline_ms = tissue->deadline_ms,
                               .medium_count = most.reading_count,
                               .radius_count = query->set_count};
  libdipole_frame *frame =
      libdipole_ask(client, &pending, &schema_fit_tissue_request, &start, parts, &shape, error);
  if (frame == NULL) {
    return false;
  }
  const wire_fit_tissue_reply *fixed = (const void *)frame->payload;
  if (fixed->sought_count != query->sought_count || fixed->haemoglobin != tissue->haemoglobin) {
    free(frame);
    return libdipole_bad_reply(client, "a fit is of another tissue", error);
  }
  schema_layout layout;
  schema_lay_out(&schema_fit_tissue_reply, frame->payload, UINT64_MAX, &layout, NULL);
  frame->tissue_fits = (dipole_tissue_fits){
      .set_count = fixed->count,
      .fitted_count = fixed->fitted_count,
      .sought_count = fixed->sought_count,
      .reading_count = fixed->reading_count,
      .haemoglobin = fixed->haemoglobin,
      .g = fixed->g,
      .eta = fixed->eta,
      .sets = (const void *)(frame->payload + layout.parts[0].at),
      .estimates = (const void *)(frame->payload + layout.parts[1].at),
      .covariance = (const void *)(frame->payload + layout.parts[2].at),
      .residuals =
          fixed->reading_count > 0 ? (const void *)(frame->payload + layout.parts[3].at) : NULL,
  };
  *fits = &frame->tissue_fits;
  return true;
}
