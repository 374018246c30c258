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

/* Returns whether a reply is the next part of the answer. All parts must have the same model,
 * moments and range of albedos. */
static bool is_next(const libdipole_pending *pending, const wire_invert_reply *fixed) {
  const uint64_t left = pending->radius_count - pending->next_radius;
  const bool is_last = fixed->part + 1 == fixed->part_count;
  wire_invert_reply before;
  if (fixed->part != pending->next_part || fixed->medium_first != pending->next_radius ||
      fixed->medium_count == 0 || fixed->medium_count > left ||
      is_last != (fixed->medium_count == left)) {
    return false;
  }
  if (pending->gathered == NULL) {
    return true;
  }
  wire_get_invert_reply(pending->gathered->payload, &before);
  return fixed->model == before.model && fixed->moments == before.moments &&
         fixed->given == before.given && fixed->part_count == before.part_count &&
         !(fixed->albedo_least < before.albedo_least) &&
         !(fixed->albedo_least > before.albedo_least) &&
         !(fixed->albedo_most < before.albedo_most) && !(fixed->albedo_most > before.albedo_most);
}

static void copy_arrays(const libdipole_pending *pending, const libdipole_frame *part,
                        const wire_invert_reply *fixed) {
  for (enum invert_array i = INVERT_SIGMA_A; i < INVERT_ARRAYS; i++) {
    uint8_t *to = pending->gathered->payload + invert_array_offset(i, pending->radius_count);
    memcpy(to + fixed->medium_first * sizeof(double),
           part->payload + invert_array_offset(i, fixed->medium_count),
           (size_t)fixed->medium_count * sizeof(double));
  }
}

static bool take_part(libdipole_pending *pending, libdipole_frame *frame, dipole_error *error) {
  wire_invert_reply fixed;
  if (!invert_reply_parse(frame->payload, (size_t)frame->payload_bytes, &fixed) ||
      !is_next(pending, &fixed)) {
    return libdipole_fail_protocol(error, "it answered an invert request with another shape than "
                                          "was asked for");
  }
  wire_invert_reply whole = fixed;
  if (pending->gathered == NULL) {
    const uint64_t bytes = invert_reply_bytes(pending->radius_count);
    pending->gathered = libdipole_frame_new(&frame->header, bytes, bytes, 0, error);
    if (pending->gathered == NULL) {
      return false;
    }
  } else {
    wire_invert_reply before;
    wire_get_invert_reply(pending->gathered->payload, &before);
    whole.missing_count += before.missing_count;
  }
  copy_arrays(pending, frame, &fixed);
  wire_put_invert_reply(pending->gathered->payload, &whole);
  libdipole_part_end(pending, fixed.medium_count, fixed.part + 1 == fixed.part_count);
  return true;
}

static bool take_frame(libdipole_pending *pending, libdipole_frame *frame, dipole_error *error) {
  const bool good = take_part(pending, frame, error);
  free(frame);
  return good;
}

static const libdipole_kind kind = {.repeatable = true, .take = take_frame};

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
      !libdipole_request_begin(client, pending, invert_request_bytes(query->medium_count), &at,
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
