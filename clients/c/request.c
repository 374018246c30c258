/* Asking and waiting. */
#include <stdlib.h>
#include <string.h>

#include "clients/c/client.h"

/* Unsent bytes up to which a request is left to be sent later. */
#define BACKLOG_MAX_BYTES ((size_t)1 << 20)

/* Requests are held back up to so many bytes, and up to one in so many of those that are
 * outstanding: a call of the system for each would cost more than the rest of it. */
#define HELD_MAX_BYTES ((size_t)16 << 10)
enum { HELD_SHARE = 4 };

/* ---- waiting ------------------------------------------------------------------------------- */

void libdipole_call_begin(dipole_client *client, uint16_t type) {
  const bool endless = type == WIRE_TYPE_MC || type == WIRE_TYPE_CANCEL;
  client->until_ms = endless || client->call_timeout_ms == 0
                         ? 0
                         : libdipole_now_ms() + (int64_t)client->call_timeout_ms;
}

bool libdipole_call_left(const dipole_client *client, unsigned *limit_ms, dipole_error *error) {
  if (client->until_ms == 0) {
    return true;
  }
  const int64_t left_ms = client->until_ms - libdipole_now_ms();
  if (left_ms <= 0) {
    return libdipole_fail(error, DIPOLE_ERROR_TIMEOUT, "the call took longer than %u ms",
                          client->call_timeout_ms);
  }
  if (*limit_ms == 0 || left_ms < (int64_t)*limit_ms) {
    *limit_ms = (unsigned)left_ms;
  }
  return true;
}

/* Waits for the connection to move until the daemon has been silent for too long, or the call's
 * time is over: then what has been waited counts on in the next call. */
static bool wait_and_move(dipole_client *client, dipole_error *error) {
  libdipole_stream *stream = &client->stream;
  const unsigned timeout_ms = client->timeout_ms;
  const unsigned silence_ms = timeout_ms == 0                  ? 0
                              : timeout_ms > client->waited_ms ? timeout_ms - client->waited_ms
                                                               : 1;
  unsigned limit_ms = silence_ms;
  if (!libdipole_call_left(client, &limit_ms, error)) {
    return false;
  }
  if (libdipole_stream_step(stream, limit_ms, error)) {
    client->waited_ms = 0;
    return true;
  }
  if (stream->silent && limit_ms != silence_ms) {
    stream->silent = false;
    client->waited_ms += timeout_ms != 0 ? limit_ms : 0;
    libdipole_fail(error, DIPOLE_ERROR_TIMEOUT, "the call took longer than %u ms",
                   client->call_timeout_ms);
  } else if (stream->silent) {
    libdipole_fail(error, DIPOLE_ERROR_CONNECTION, "the daemon was silent for %u ms: gave up",
                   timeout_ms);
  }
  return false;
}

static bool advance(dipole_client *client, dipole_error *error) {
  bool moves = true;
  if (client->retry.later_count > 0 && !libdipole_retry_wait(client, &moves, error)) {
    return false;
  }
  return !moves || (wait_and_move(client, error) && libdipole_receive(client, error));
}

/* Waits for bytes to come or go and deals with what came. After a failure that another connection
 * cannot make good, every call fails in the same way. */
static bool step(dipole_client *client, dipole_error *error) {
  if (client->broken.kind != DIPOLE_ERROR_NONE) {
    *error = client->broken;
    return false;
  }
  if (client->lost.kind == DIPOLE_ERROR_NONE) {
    if (advance(client, error)) {
      return true;
    }
    if (error->kind == DIPOLE_ERROR_TIMEOUT) {
      return false;
    }
    client->lost = *error;
  }
  *error = client->lost;
  if (libdipole_restore(client, error)) {
    client->lost.kind = DIPOLE_ERROR_NONE;
    return true;
  }
  if (error->kind != DIPOLE_ERROR_TIMEOUT) {
    client->broken = *error;
  }
  return false;
}

/* ---- asking -------------------------------------------------------------------------------- */

bool libdipole_request_begin(dipole_client *client, libdipole_pending *pending,
                             uint64_t payload_bytes, uint8_t **payload, dipole_error *error) {
  libdipole_call_begin(client, pending->type);
  if (client->broken.kind != DIPOLE_ERROR_NONE) {
    *error = client->broken;
    return false;
  }
  while (client->lost.kind != DIPOLE_ERROR_NONE || client->dropped_count >= DIPOLE_IN_FLIGHT_MAX) {
    if (!step(client, error)) {
      return false;
    }
  }
  if (payload_bytes > UINT32_MAX - WIRE_BYTES_header) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "the request takes %llu bytes, more than a frame holds: ask for fewer "
                          "radii or media at a time",
                          (unsigned long long)payload_bytes);
  }
  const size_t bytes = WIRE_BYTES_header + (size_t)payload_bytes;
  if (!libdipole_pending_reserve(client, error) ||
      !libdipole_stream_reserve(&client->stream, bytes, error)) {
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

void dipole_flush(dipole_client *client) {
  libdipole_stream_send(&client->stream);
  client->held_count = 0;
}

bool libdipole_request_send(dipole_client *client, dipole_error *error) {
  const libdipole_stream *stream = &client->stream;
  const uint64_t id = client->last_id;
  libdipole_retry_keep(client);
  client->held_count++;
  if (client->held_count * HELD_SHARE >= dipole_outstanding(client) ||
      stream->out_end - stream->out_begin >= HELD_MAX_BYTES) {
    dipole_flush(client);
  }
  while (stream->out_end - stream->out_begin > BACKLOG_MAX_BYTES) {
    if (!step(client, error)) {
      libdipole_pending_drop(client, id);
      return false;
    }
  }
  return true;
}

bool libdipole_request_wait(dipole_client *client, uint64_t id, libdipole_pending *pending,
                            dipole_error *error) {
  for (;;) {
    libdipole_pending *entry =
        id != 0 ? libdipole_pending_find(client, id) : libdipole_pending_arrived(client);
    if (entry != NULL && entry->frame != NULL) {
      libdipole_pending_take(client, entry, pending);
      return true;
    }
    const bool none = id != 0 ? entry == NULL || entry->dropped : dipole_outstanding(client) == 0;
    if (none) {
      return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                            id != 0 ? "no query with this id is outstanding"
                                    : "no query is outstanding");
    }
    if (!step(client, error)) {
      return false;
    }
  }
}

bool libdipole_request_read(dipole_client *client, uint64_t id, const libdipole_reader *reader,
                            libdipole_pending *pending, dipole_error *error) {
  for (;;) {
    libdipole_pending *entry = libdipole_pending_find(client, id);
    if (entry != NULL && entry->frame != NULL) {
      libdipole_pending_take(client, entry, pending);
      return true;
    }
    if (reader->stopped) { /* in the middle; the rest may have come already, and be gone */
      pending->frame = NULL;
      return true;
    }
    if (!step(client, error)) {
      libdipole_pending_drop(client, id);
      return false;
    }
  }
}

libdipole_frame *libdipole_reply(dipole_client *client, libdipole_pending *pending,
                                 dipole_error *error) {
  const uint64_t id = pending->id;
  if (!libdipole_request_wait(client, id, pending, error)) {
    libdipole_pending_drop(client, id);
    return NULL;
  }
  if (pending->frame->header.type == WIRE_TYPE_ERROR) {
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
