/* Frames out of bytes, each to the request that it answers. */
#include <stdlib.h>
#include <string.h>

#include "clients/c/client.h"

static bool is_error(const wire_header *header) {
  return header->type == WIRE_TYPE_ERROR;
}

/* What a header announces must be an answer that this request can have. An error may also be about
 * the connection as a whole: then there is no request with its id. */
static bool check_header(const wire_header *header, const libdipole_pending *pending,
                         dipole_error *error) {
  const wire_error fault = wire_header_check(header, UINT32_MAX);
  if (fault.status != WIRE_STATUS_OK) {
    return libdipole_fail(error, DIPOLE_ERROR_PROTOCOL,
                          "the peer does not speak this protocol: %s: %s: expected %s",
                          wire_status_name(fault.status), fault.field, fault.allowed);
  }
  if (is_error(header) && header->payload_bytes == WIRE_BYTES_error) {
    return true;
  }
  if (pending == NULL || (pending->frame != NULL && !libdipole_is_progress(pending->frame))) {
    return libdipole_fail(error, DIPOLE_ERROR_PROTOCOL,
                          "the peer does not speak this protocol: it answered a request that was "
                          "not sent");
  }
  if (header->type != (pending->type | WIRE_REPLY) ||
      header->payload_bytes < pending->reply_bytes_min ||
      header->payload_bytes > pending->reply_bytes_max) {
    return libdipole_fail(error, DIPOLE_ERROR_PROTOCOL,
                          "the peer does not speak this protocol: it answered a request of type "
                          "%s with type 0x%04x and %lu bytes",
                          wire_type_name(pending->type), header->type,
                          (unsigned long)header->payload_bytes);
  }
  return true;
}

libdipole_frame *libdipole_frame_new(const wire_header *header, uint64_t payload_bytes,
                                     uint64_t stored_bytes, uint32_t channel_count,
                                     dipole_error *error) {
  const uint64_t beside =
      sizeof(libdipole_frame) + channel_count * (uint64_t)sizeof(dipole_channel);
  libdipole_frame *frame =
      stored_bytes <= SIZE_MAX - beside ? malloc((size_t)(stored_bytes + beside)) : NULL;
  if (frame == NULL) {
    libdipole_fail(error, DIPOLE_ERROR_MEMORY, "out of memory: %llu bytes for an answer",
                   (unsigned long long)stored_bytes);
    return NULL;
  }
  frame->header = *header;
  frame->payload_bytes = payload_bytes;
  frame->stored_bytes = stored_bytes;
  frame->into_values = frame->into_radii = NULL;
  return frame;
}

/* Starts a frame when a whole header is in the buffer. */
static bool begin_frame(dipole_client *client, dipole_error *error) {
  libdipole_stream *stream = &client->stream;
  wire_header header;
  wire_get_header(stream->in + stream->in_begin, &header);
  stream->in_begin += WIRE_BYTES_header;
  const libdipole_pending *pending = libdipole_pending_find(client, header.request_id);
  if (!check_header(&header, pending, error)) {
    return false;
  }
  const uint64_t stored_bytes =
      libdipole_into_is(pending, &header) ? pending->reply_bytes_min : header.payload_bytes;
  client->frame = libdipole_frame_new(&header, header.payload_bytes, stored_bytes,
                                      pending != NULL ? pending->medium_count : 0, error);
  if (client->frame == NULL) {
    return false;
  }
  stream->target = client->frame->payload;
  stream->target_bytes = (size_t)stored_bytes;
  client->into.begun = false;
  return true;
}

/* What the daemon says of the connection as a whole. */
static bool take_last_words(dipole_client *client, libdipole_frame *frame, dipole_error *error) {
  libdipole_refused(client, NULL, frame, error);
  free(frame);
  /* Before the lists are here, the client has nothing to lose: what the daemon says is the reason
   * why it cannot be opened. Later, it is why the connection is lost. */
  error->kind = client->info.software != NULL ? DIPOLE_ERROR_CONNECTION : DIPOLE_ERROR_REFUSED;
  return false;
}

/* The answer is whole, or an error has ended it. */
static void end_answer(dipole_client *client, libdipole_pending *pending) {
  free(pending->gathered); /* what came before the error */
  pending->gathered = NULL;
  if (pending->dropped) {
    free(pending->frame);
    client->dropped_count--;
    libdipole_pending_remove(client, pending);
  } else {
    client->arrived_count++;
  }
}

static bool take_part(dipole_client *client, libdipole_pending *pending, libdipole_frame *frame,
                      dipole_error *error) {
  const bool was_dropped = pending->dropped;
  if (!libdipole_part_take(pending, frame, error)) {
    return false;
  }
  client->dropped_count += pending->dropped && !was_dropped;
  if (pending->frame != NULL) {
    end_answer(client, pending);
  }
  return true;
}

/* Gives a complete frame to its request. Of a job's progress the latest is kept. */
static bool end_frame(dipole_client *client, dipole_error *error) {
  libdipole_frame *frame = client->frame;
  libdipole_pending *pending = libdipole_pending_find(client, frame->header.request_id);
  client->frame = NULL;
  if (pending == NULL || (pending->frame != NULL && !libdipole_is_progress(pending->frame))) {
    return take_last_words(client, frame, error);
  }
  if (pending->frame != NULL) {
    free(pending->frame);
    pending->frame = frame;
    return true;
  }
  if (libdipole_retry_later(client, pending, frame)) {
    return true;
  }
  if (libdipole_part_is(pending, frame)) {
    return take_part(client, pending, frame, error);
  }
  pending->frame = frame;
  end_answer(client, pending);
  return true;
}

bool libdipole_receive(dipole_client *client, dipole_error *error) {
  libdipole_stream *stream = &client->stream;
  bool more;
  for (;;) {
    if (client->frame == NULL) {
      if (stream->in_end - stream->in_begin < WIRE_BYTES_header) {
        return true;
      }
      if (!begin_frame(client, error)) {
        return false;
      }
    }
    const size_t unread = stream->in_end - stream->in_begin;
    const size_t bytes = unread < stream->target_bytes ? unread : stream->target_bytes;
    memcpy(stream->target, stream->in + stream->in_begin, bytes);
    stream->in_begin += bytes;
    stream->target += bytes;
    stream->target_bytes -= bytes;
    if (stream->target_bytes > 0) {
      return true;
    }
    if (!libdipole_into_next(client, &more, error) || (!more && !end_frame(client, error))) {
      return false;
    }
  }
}
