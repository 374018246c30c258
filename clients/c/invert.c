/* Finds media for albedos. The parts of a reply are put together as they arrive. */

#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/message.h"

/* ---- parts --------------------------------------------------------------------------------- */

static bool merge_part(const libdipole_pending *pending, const void *part, void *whole) {
  const wire_invert_reply *fixed = part;
  wire_invert_reply *all = whole;
  if (all != NULL) {
    all->missing_count += fixed->missing_count;
  }
  return fixed->missing_count <= fixed->count && fixed->errors == 2 &&
         fixed->given == pending->wanted &&
         (all == NULL ||
          (fixed->model == all->model && fixed->moments == all->moments &&
           memcmp(&fixed->albedo_least, &all->albedo_least, 2 * sizeof(double)) == 0));
}

static const libdipole_kind kind = {
    .repeatable = true, .reply = &schema_invert_reply, .merge = merge_part};

/* ---- requests ------------------------------------------------------------------------------ */

bool dipole_invert(dipole_client *client, const dipole_invert_query *query,
                   dipole_inversion **inversion, dipole_error *error) {
  const dipole_field fields[] = {
      {"model", .number = query->model},
      {"moments", .number = query->moments},
      {"given", .number = query->given},
      {"light", .number = query->light},
      {"specular", .number = query->specular},
      {"g", .number = query->g},
      {"eta", .number = query->eta},
      {"albedo", .elements = query->albedos, .count = query->medium_count},
      {"length", .elements = query->lengths_mm, .count = query->medium_count}};
  const wire_invert_reply most = {.count = query->medium_count, .errors = 2};
  const libdipole_shape shape = {&schema_invert_reply, &most, true};
  libdipole_pending pending = {.kind = &kind,
                               .type = WIRE_TYPE_INVERT,
                               .deadline_ms = query->deadline_ms,
                               .wanted = query->given,
                               .radius_count = query->medium_count};
  libdipole_made made;
  libdipole_frame *frame = NULL;
  error = error != NULL ? error : &(dipole_error){0};
  if (!libdipole_make(&made, &schema_invert_request, fields, LIBDIPOLE_COUNT(fields), error) ||
      (frame = libdipole_ask(client, &pending, made.payload, made.start, made.parts, &shape,
                             error)) == NULL) {
    return false;
  }
  const wire_invert_reply *fixed = (const void *)frame->payload;
  const double *arrays = (const void *)(frame->payload + WIRE_BYTES_invert_reply);
  frame->inversion = (dipole_inversion){.medium_count = fixed->count,
                                        .missing_count = fixed->missing_count,
                                        .sigma_a_per_mm = arrays,
                                        .sigma_s_per_mm = arrays + fixed->count,
                                        .albedos = arrays + 2 * fixed->count,
                                        .albedo_least = fixed->albedo_least,
                                        .albedo_most = fixed->albedo_most,
                                        .sigma_a_errors_per_mm = arrays + 3 * fixed->count,
                                        .sigma_s_errors_per_mm = arrays + 4 * fixed->count,
                                        .model_errors = arrays + 5 * fixed->count};
  *inversion = &frame->inversion;
  return true;
}
