#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/message.h"

bool dipole_tissue(dipole_client *client, const dipole_tissue_query *query, dipole_medium *media,
                   dipole_error *error) {
  const dipole_field fields[] = {
      {"tissue", .number = query->tissue},
      {"haemoglobin", .number = query->haemoglobin},
      {"property", .elements = query->properties, .count = query->property_count},
      {"wavelength", .elements = query->wavelengths_nm, .count = query->wavelength_count}};
  dipole_reply *reply;
  uint64_t count;
  if (!dipole_call(client, "tissue", fields, LIBDIPOLE_COUNT(fields), query->deadline_ms, &reply,
                   error)) {
    return false;
  }
  memcpy(media, dipole_reply_array(reply, "media", &count),
         (size_t)query->wavelength_count * sizeof *media);
  dipole_reply_free(reply);
  return true;
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

bool dipole_fit_tissue(dipole_client *client, const dipole_tissue_fit_query *query,
                       dipole_tissue_fits **fits, dipole_error *error) {
  const dipole_tissue_query *tissue = &query->tissue;
  const uint64_t places = query->place_count;
  const uint64_t all = places * tissue->wavelength_count * query->set_count;
  const dipole_field fields[] = {
      {"model", .number = query->model},
      {"axis", .number = query->axis},
      {"scale", .number = query->scale},
      {"tissue", .number = tissue->tissue},
      {"haemoglobin", .number = tissue->haemoglobin},
      {"residuals", .number = query->residuals},
      {"detector_na", .number = query->detector_na},
      {"set_count", .number = (double)query->set_count},
      {"property", .elements = tissue->properties, .count = tissue->property_count},
      {"sought", .elements = query->sought, .count = query->sought_count},
      {"at", .elements = query->at, .count = places},
      LIBDIPOLE_OR_ZEROS("source", query->source_mm, places),
      LIBDIPOLE_OR_ZEROS("detector", query->detector_mm, places),
      LIBDIPOLE_OR_ZEROS("mhz", query->mhz, places),
      LIBDIPOLE_OR_ZEROS("quantity", query->quantity, places),
      {"wavelength", .elements = tissue->wavelengths_nm, .count = tissue->wavelength_count},
      {"values", .elements = query->values, .count = all},
      {"errors", .elements = query->errors, .count = all}};
  libdipole_made made;
  error = error != NULL ? error : &(dipole_error){0};
  if (!libdipole_make(&made, &schema_fit_tissue_request, fields, LIBDIPOLE_COUNT(fields), error)) {
    return false;
  }
  const wire_fit_tissue_reply most = {
      .count = query->set_count,
      .sought_count = (uint16_t)query->sought_count,
      .reading_count = query->residuals ? query->place_count * tissue->wavelength_count : 0};
  const libdipole_shape shape = {&schema_fit_tissue_reply, &most, true};
  libdipole_pending pending = {.kind = &fit_kind,
                               .type = WIRE_TYPE_FIT_TISSUE,
                               .deadline_ms = tissue->deadline_ms,
                               .medium_count = most.reading_count,
                               .radius_count = query->set_count};
  libdipole_frame *frame =
      libdipole_ask(client, &pending, made.payload, made.start, made.parts, &shape, error);
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
