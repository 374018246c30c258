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
  const size_t media_bytes = (size_t)query->wavelength_count * sizeof *media;
  libdipole_pending pending = {.kind = &libdipole_plain,
                               .type = WIRE_TYPE_TISSUE,
                               .deadline_ms = query->deadline_ms,
                               .reply_bytes_min = WIRE_BYTES_tissue_reply + media_bytes,
                               .reply_bytes_max = WIRE_BYTES_tissue_reply + media_bytes};
  libdipole_frame *frame = NULL;
  if (!libdipole_request_put(client, &pending, &schema_tissue_request, &start, parts, error) ||
      (frame = libdipole_reply(client, &pending, error)) == NULL) {
    return false;
  }
  const wire_tissue_reply *fixed = (const void *)frame->payload;
  const bool fits = fixed->wavelength_count == query->wavelength_count &&
                    fixed->haemoglobin == query->haemoglobin;
  if (fits) {
    memcpy(media, fixed + 1, media_bytes);
  }
  free(frame);
  return fits || libdipole_bad_reply(client, "media are of another tissue", error);
}
