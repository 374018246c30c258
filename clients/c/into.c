/* Answers into the caller's memory. The head of a frame, its fixed part and channels, is received
 * into a block of its own and checked; from then on it is known where each array belongs, and the
 * bytes go there from the socket. Nothing is ever written beyond what was asked for. Once nobody
 * wants the answer any more, the rest of its bytes is thrown away. */
#include "clients/c/client.h"

bool libdipole_into_check(const dipole_query *query, dipole_error *error) {
  bool arrays = false;
  if (query->into_values == NULL && query->into_radii == NULL) {
    return true;
  }
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    arrays = arrays || eval_is_array(query->wanted, quantity->id);
  }
  const bool radii = (query->wanted & DIPOLE_RADIUS) != 0;
  if ((arrays && query->into_values == NULL) || (radii && query->into_radii == NULL)) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "into_values and into_radii are needed for all that is wanted, or for "
                          "none of it");
  }
  return true;
}

bool libdipole_into_is(const libdipole_pending *pending, const wire_header *header) {
  return pending != NULL && (pending->into_values != NULL || pending->into_radii != NULL) &&
         header->type == (WIRE_TYPE_EVAL | WIRE_REPLY);
}

/* The head is here: what follows it is known. */
static bool begin(dipole_client *client, const libdipole_pending *pending, dipole_error *error) {
  libdipole_into *into = &client->into;
  eval_layout layout;
  if (!libdipole_answer_parse(pending, client->frame, &into->fixed, &layout, error)) {
    return false;
  }
  const bool radii = (into->fixed.wanted & CORE_QUANTITY_RADIUS) != 0;
  into->begun = true;
  into->array_bytes = layout.array_bytes;
  into->array_count = layout.array_bytes > 0
                          ? radii + (uint64_t)into->fixed.channel_count * layout.arrays_per_channel
                          : 0;
  into->array = 0;
  into->done_bytes = 0;
  return true;
}

/* Where this array of the whole answer begins. */
static uint8_t *array_start(const libdipole_into *into, const libdipole_pending *pending,
                            size_t value_bytes) {
  const bool radii = (into->fixed.wanted & CORE_QUANTITY_RADIUS) != 0;
  if (radii && into->array == 0) {
    return pending->into_radii;
  }
  return (uint8_t *)pending->into_values +
         (into->array - radii) * pending->radius_count * value_bytes;
}

/* Finds a place for what comes next. False: that was all. */
static bool place_next(dipole_client *client, const libdipole_pending *pending) {
  libdipole_into *into = &client->into;
  libdipole_stream *stream = &client->stream;
  if (into->array < into->array_count && into->done_bytes == into->array_bytes) {
    into->array++;
    into->done_bytes = 0;
  }
  if (into->array == into->array_count) {
    return false;
  }
  const size_t value_bytes = core_evaluator_bytes(into->fixed.evaluator);
  const uint64_t values_bytes = into->fixed.radius_count * value_bytes; /* the rest is padding */
  if (into->done_bytes < values_bytes && !pending->dropped) {
    stream->target = array_start(into, pending, value_bytes) +
                     into->fixed.radius_first * value_bytes + into->done_bytes;
    stream->target_bytes = (size_t)(values_bytes - into->done_bytes);
  } else {
    const uint64_t left = into->array_bytes - into->done_bytes;
    stream->target = into->discarded;
    stream->target_bytes = left < sizeof into->discarded ? (size_t)left : sizeof into->discarded;
  }
  into->done_bytes += stream->target_bytes;
  return true;
}

bool libdipole_into_next(dipole_client *client, bool *more, dipole_error *error) {
  const libdipole_frame *frame = client->frame;
  *more = false;
  if (frame->stored_bytes == frame->payload_bytes) {
    return true;
  }
  const libdipole_pending *pending = libdipole_pending_find(client, frame->header.request_id);
  if (!client->into.begun && !begin(client, pending, error)) {
    return false;
  }
  *more = place_next(client, pending);
  client->into.begun = *more;
  return true;
}

void libdipole_into_discard(dipole_client *client, uint64_t id) {
  libdipole_into *into = &client->into;
  if (into->begun && client->frame != NULL && client->frame->header.request_id == id) {
    into->done_bytes -= client->stream.target_bytes;
    place_next(client, libdipole_pending_find(client, id));
  }
}
