/* Finds media for albedos. The parts of an answer are put together as they arrive. */
#include "proto/invert.h"

#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/query.h"
#include "clients/c/request.h"

/* The inversion that the caller gets, and the frame that holds its arrays. */
struct inversion {
  dipole_inversion public;
  libdipole_frame *frame;
};

/* ---- parts --------------------------------------------------------------------------------- */

/* Returns whether two parts may belong together: they have the same model, moments and range of
 * albedos. */
static bool is_like(const wire_invert_reply *a, const wire_invert_reply *b) {
  return a->model == b->model && a->moments == b->moments && a->given == b->given &&
         !(a->albedo_least < b->albedo_least) && !(a->albedo_least > b->albedo_least) &&
         !(a->albedo_most < b->albedo_most) && !(a->albedo_most > b->albedo_most);
}

static void copy_arrays(const libdipole_pending *pending, const libdipole_frame *part,
                        const wire_invert_reply *fixed) {
  for (enum invert_array i = INVERT_SIGMA_A; i < INVERT_ARRAYS; i++) {
    uint8_t *to = pending->gathered->payload + invert_array_offset(i, pending->radius_count);
    memcpy(to + fixed->first * sizeof(double), part->payload + invert_array_offset(i, fixed->count),
           (size_t)fixed->count * sizeof(double));
  }
}

static bool take_part(libdipole_pending *pending, const libdipole_frame *frame,
                      dipole_error *error) {
  wire_invert_reply fixed = {0}, before;
  bool good =
      invert_reply_parse(frame->payload, (size_t)frame->payload_bytes, &fixed) && fixed.count > 0;
  wire_invert_reply whole = fixed;
  if (good && pending->gathered != NULL) {
    wire_get_invert_reply(pending->gathered->payload, &before);
    whole.missing_count += before.missing_count;
    good = is_like(&fixed, &before);
  }
  if (!good) {
    return libdipole_fail_protocol(error, "it answered an invert request with another shape than "
                                          "was asked for");
  }
  if (!libdipole_gather(pending, frame, invert_reply_bytes(pending->radius_count), error)) {
    return false;
  }
  copy_arrays(pending, frame, &fixed);
  wire_put_invert_reply(pending->gathered->payload, &whole);
  libdipole_part_end(pending, frame);
  return true;
}

static const libdipole_kind kind = {.repeatable = true, .part = take_part};

/* ---- asking -------------------------------------------------------------------------------- */

static bool check(const dipole_invert_query *query, dipole_error *error) {
  if (!libdipole_model_check(query->model, error) ||
      !libdipole_check_u16(query->model | query->moments | query->given, "model, moments and given",
                           error)) {
    return false;
  }
  if ((query->albedos == NULL || query->lengths_mm == NULL) && query->medium_count > 0) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "albedos or lengths_mm is NULL, medium_count is not 0");
  }
  if (query->medium_count > UINT32_MAX / (2 * sizeof(double))) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "%llu media are more than a frame holds: ask for fewer at a time",
                          (unsigned long long)query->medium_count);
  }
  return true;
}

static bool send(dipole_client *client, const dipole_invert_query *query,
                 libdipole_pending *pending, dipole_error *error) {
  uint8_t *at;
  const wire_invert_request fixed = {.model = (uint16_t)query->model,
                                     .moments = (uint16_t)query->moments,
                                     .given = (uint16_t)query->given,
                                     .medium_count = query->medium_count,
                                     .g = query->g,
                                     .eta = query->eta};
  if (!check(query, error) ||
      !libdipole_request_begin(client, pending, schema_bytes(&schema_invert_request, &fixed), &at,
                               error)) {
    return false;
  }
  wire_put_invert_request(at, &fixed);
  const size_t bytes = (size_t)query->medium_count * sizeof(double);
  if (bytes > 0) {
    memcpy(at + WIRE_BYTES_invert_request, query->albedos, bytes);
    memcpy(at + WIRE_BYTES_invert_request + bytes, query->lengths_mm, bytes);
  }
  return libdipole_request_send(client, error);
}

/* Makes an inversion of a frame, which the inversion then owns. */
static bool take(libdipole_frame *frame, uint64_t count, dipole_inversion **inversion,
                 dipole_error *error) {
  struct inversion *made = calloc(1, sizeof *made);
  wire_invert_reply fixed;
  if (made == NULL) {
    free(frame);
    return libdipole_fail_memory(error);
  }
  wire_get_invert_reply(frame->payload, &fixed);
  const double *arrays[INVERT_ARRAYS];
  for (enum invert_array i = INVERT_SIGMA_A; i < INVERT_ARRAYS; i++) {
    arrays[i] = (const double *)(const void *)(frame->payload + invert_array_offset(i, count));
  }
  made->frame = frame;
  made->public = (dipole_inversion){.medium_count = count,
                                    .missing_count = fixed.missing_count,
                                    .sigma_a_per_mm = arrays[INVERT_SIGMA_A],
                                    .sigma_s_per_mm = arrays[INVERT_SIGMA_S],
                                    .albedos = arrays[INVERT_ALBEDO],
                                    .albedo_least = fixed.albedo_least,
                                    .albedo_most = fixed.albedo_most};
  *inversion = &made->public;
  return true;
}

bool dipole_invert(dipole_client *client, const dipole_invert_query *query,
                   dipole_inversion **inversion, dipole_error *error) {
  libdipole_pending pending = {.kind = &kind,
                               .type = WIRE_TYPE_INVERT,
                               .deadline_ms = query->deadline_ms,
                               .reply_bytes_min = WIRE_BYTES_invert_reply,
                               .reply_bytes_max = invert_reply_bytes(query->medium_count),
                               .radius_count = query->medium_count};
  error = error != NULL ? error : &(dipole_error){0};
  if (!send(client, query, &pending, error)) {
    return false;
  }
  libdipole_frame *frame = libdipole_reply(client, &pending, error);
  return frame != NULL && take(frame, query->medium_count, inversion, error);
}

void dipole_inversion_free(dipole_inversion *inversion) {
  struct inversion *made = (struct inversion *)(void *)inversion;
  if (made != NULL) {
    free(made->frame);
    free(made);
  }
}
