#include <stdlib.h>
#include <string.h>

#include "clients/c/client.h"
#include "proto/mc.h"

/* Unsent bytes up to which a request is left to be sent later. */
#define BACKLOG_MAX_BYTES ((size_t)1 << 20)

/* ---- what has been asked ------------------------------------------------------------------- */

static libdipole_pending *pending_find(dipole_client *client, uint64_t id) {
  libdipole_pending *first = client->pending + client->pending_begin;
  for (size_t i = 0; i < client->pending_count && first[i].id <= id; i++) {
    if (first[i].id == id) { /* answers come nearly in order, so this is a short walk */
      return &first[i];
    }
  }
  return NULL;
}

static libdipole_pending *pending_first_arrived(dipole_client *client) {
  libdipole_pending *first = client->pending + client->pending_begin;
  for (size_t i = 0; i < client->pending_count; i++) {
    if (first[i].frame != NULL) {
      return &first[i];
    }
  }
  return NULL;
}

static bool pending_reserve(dipole_client *client, dipole_error *error) {
  if (client->pending_begin + client->pending_count < client->pending_capacity) {
    return true;
  }
  if (client->pending_begin > client->pending_capacity / 2) {
    memmove(client->pending, client->pending + client->pending_begin,
            client->pending_count * sizeof *client->pending);
    client->pending_begin = 0;
    return true;
  }
  const size_t capacity = client->pending_capacity == 0 ? 16 : 2 * client->pending_capacity;
  libdipole_pending *larger = reallocarray(client->pending, capacity, sizeof *larger);
  if (larger == NULL) {
    return libdipole_fail(error, DIPOLE_ERROR_MEMORY, "out of memory");
  }
  client->pending = larger;
  client->pending_capacity = capacity;
  return true;
}

/* Whether this is progress of a job: more frames of its answer follow. */
static bool is_progress(const libdipole_frame *frame) {
  wire_mc_reply reply;
  if (frame->header.type != (WIRE_TYPE_MC | WIRE_REPLY)) {
    return false;
  }
  wire_get_mc_reply(frame->payload, &reply); /* no shorter: see check_header() */
  return reply.state == MC_UNDER_WAY;
}

/* Those before it, usually none, move up. */
void libdipole_pending_remove(dipole_client *client, libdipole_pending *entry) {
  libdipole_retry_forget(client, entry);
  libdipole_pending *first = client->pending + client->pending_begin;
  memmove(first + 1, first, (size_t)(entry - first) * sizeof *first);
  client->pending_begin++;
  client->pending_count--;
}

/* Hands an entry out that has an answer. After progress of a job it stays. */
static void pending_take(dipole_client *client, libdipole_pending *entry, libdipole_pending *out) {
  *out = *entry;
  client->arrived_count--;
  if (is_progress(entry->frame)) {
    entry->frame = NULL;
  } else {
    libdipole_pending_remove(client, entry);
  }
}

void libdipole_pending_free(dipole_client *client) {
  for (size_t i = 0; i < client->pending_count; i++) {
    libdipole_pending *entry = &client->pending[client->pending_begin + i];
    free(entry->frame);
    free(entry->gathered);
    free(entry->kept);
  }
  free(client->pending);
  free(client->frame);
  client->pending = NULL;
  client->frame = NULL;
  client->pending_count = 0;
}

/* ---- what arrives -------------------------------------------------------------------------- */

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
  if (pending == NULL || (pending->frame != NULL && !is_progress(pending->frame))) {
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
                                     uint32_t channel_count, dipole_error *error) {
  const uint64_t beside =
      sizeof(libdipole_frame) + channel_count * (uint64_t)sizeof(dipole_channel);
  libdipole_frame *frame =
      payload_bytes <= SIZE_MAX - beside ? malloc((size_t)(payload_bytes + beside)) : NULL;
  if (frame == NULL) {
    libdipole_fail(error, DIPOLE_ERROR_MEMORY, "out of memory: %llu bytes for an answer",
                   (unsigned long long)payload_bytes);
    return NULL;
  }
  frame->header = *header;
  frame->payload_bytes = payload_bytes;
  return frame;
}

/* Starts a frame when a whole header is in the buffer. */
static bool begin_frame(dipole_client *client, dipole_error *error) {
  libdipole_stream *stream = &client->stream;
  wire_header header;
  wire_get_header(stream->in + stream->in_begin, &header);
  stream->in_begin += WIRE_BYTES_header;
  const libdipole_pending *pending = pending_find(client, header.request_id);
  if (!check_header(&header, pending, error)) {
    return false;
  }
  client->frame = libdipole_frame_new(&header, header.payload_bytes,
                                      pending != NULL ? pending->medium_count : 0, error);
  if (client->frame == NULL) {
    return false;
  }
  stream->target = client->frame->payload;
  stream->target_bytes = header.payload_bytes;
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
  libdipole_pending *pending = pending_find(client, frame->header.request_id);
  client->frame = NULL;
  if (pending == NULL || (pending->frame != NULL && !is_progress(pending->frame))) {
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

/* Makes frames of the bytes in the buffer. */
static bool take_frames(dipole_client *client, dipole_error *error) {
  libdipole_stream *stream = &client->stream;
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
    if (!end_frame(client, error)) {
      return false;
    }
  }
}

static bool advance(dipole_client *client, dipole_error *error) {
  bool moves = true;
  if (client->retry.later_count > 0 && !libdipole_retry_wait(client, &moves, error)) {
    return false;
  }
  return !moves || (libdipole_stream_step(&client->stream, client->timeout_ms, error) &&
                    take_frames(client, error));
}

/* Waits for bytes to come or go and deals with what came. After a failure that another connection
 * cannot make good, every call fails in the same way. */
static bool step(dipole_client *client, dipole_error *error) {
  if (client->broken.kind == DIPOLE_ERROR_NONE) {
    if (advance(client, error) || libdipole_retry_restore(client, error)) {
      return true;
    }
    client->broken = *error;
  }
  *error = client->broken;
  return false;
}

/* ---- asking -------------------------------------------------------------------------------- */

bool libdipole_request_begin(dipole_client *client, libdipole_pending *pending,
                             uint64_t payload_bytes, uint8_t **payload, dipole_error *error) {
  if (client->broken.kind != DIPOLE_ERROR_NONE) {
    *error = client->broken;
    return false;
  }
  if (payload_bytes > UINT32_MAX - WIRE_BYTES_header) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "the request takes %llu bytes, more than a frame holds: ask for fewer "
                          "radii or media at a time",
                          (unsigned long long)payload_bytes);
  }
  const size_t bytes = WIRE_BYTES_header + (size_t)payload_bytes;
  if (!pending_reserve(client, error) || !libdipole_stream_reserve(&client->stream, bytes, error)) {
    return false;
  }
  pending->id = ++client->last_id;
  pending->frame = NULL;
  pending->frame_bytes = bytes;
  pending->kept = NULL;
  pending->trouble_ms = pending->again_ms = 0;
  const wire_header header = {.magic = WIRE_MAGIC,
                              .version = WIRE_VERSION,
                              .type = pending->type,
                              .request_id = pending->id,
                              .payload_bytes = (uint32_t)payload_bytes,
                              .deadline_ms = pending->deadline_ms};
  uint8_t *at = client->stream.out + client->stream.out_end;
  wire_put_header(at, &header);
  *payload = at + WIRE_BYTES_header;
  client->stream.out_end += bytes;
  client->pending[client->pending_begin + client->pending_count++] = *pending;
  return true;
}

bool libdipole_request_send(dipole_client *client, dipole_error *error) {
  const libdipole_stream *stream = &client->stream;
  libdipole_retry_keep(client);
  libdipole_stream_send(&client->stream);
  while (stream->out_end - stream->out_begin > BACKLOG_MAX_BYTES) {
    if (!step(client, error)) {
      return false;
    }
  }
  return true;
}

bool libdipole_request_wait(dipole_client *client, uint64_t id, libdipole_pending *pending,
                            dipole_error *error) {
  for (;;) {
    libdipole_pending *entry = NULL;
    if (client->arrived_count > 0) {
      entry = id != 0 ? pending_find(client, id) : pending_first_arrived(client);
    }
    if (entry != NULL && entry->frame != NULL) {
      pending_take(client, entry, pending);
      return true;
    }
    if (client->pending_count == client->dropped_count) {
      return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "no query is outstanding");
    }
    if (!step(client, error)) {
      return false;
    }
  }
}

bool libdipole_request_read(dipole_client *client, uint64_t id, const libdipole_reader *reader,
                            libdipole_pending *pending, dipole_error *error) {
  for (;;) {
    libdipole_pending *entry = pending_find(client, id);
    if (entry != NULL && entry->frame != NULL) {
      pending_take(client, entry, pending);
      return true;
    }
    if (reader->stopped) { /* in the middle; the rest may have come already, and be gone */
      pending->frame = NULL;
      return true;
    }
    if (!step(client, error)) {
      return false;
    }
  }
}

libdipole_frame *libdipole_reply(dipole_client *client, libdipole_pending *pending,
                                 dipole_error *error) {
  if (!libdipole_request_wait(client, pending->id, pending, error)) {
    return NULL;
  }
  if (is_error(&pending->frame->header)) {
    libdipole_refused(client, pending, pending->frame, error);
    free(pending->frame);
    return NULL;
  }
  return pending->frame;
}

libdipole_frame *libdipole_ask(dipole_client *client, libdipole_pending *pending,
                               const uint8_t *payload, size_t payload_bytes, dipole_error *error) {
  uint8_t *at;
  if (!libdipole_request_begin(client, pending, payload_bytes, &at, error)) {
    return NULL;
  }
  if (payload_bytes > 0) {
    memcpy(at, payload, payload_bytes);
  }
  return libdipole_request_send(client, error) ? libdipole_reply(client, pending, error) : NULL;
}
