/* Asking again. A request is kept as it was sent until its answer is here. All that is kept is
 * idempotent: it has one right answer, whoever gives it and however often it is asked for. Answers
 * of a lost connection cannot come any more, and of an answer that had come in part nothing is used;
 * so none is wrong and none comes twice. */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/client.h"

/* ---- what is kept -------------------------------------------------------------------------- */

/* Of a Monte Carlo job the photons walked so far would be lost, and others' jobs delayed. */
bool libdipole_retry_is_safe(uint16_t type) {
  switch (type) {
  case WIRE_TYPE_EVAL:
  case WIRE_TYPE_SAMPLE:
  case WIRE_TYPE_INVERT:
  case WIRE_TYPE_OFFERS:
  case WIRE_TYPE_TABLE:
  case WIRE_TYPE_MEDIA:
  case WIRE_TYPE_STATS:
  case WIRE_TYPE_PING:
    return true;
  default:
    return false;
  }
}

void libdipole_retry_keep(dipole_client *client) {
  libdipole_pending *last = &client->pending[client->pending_begin + client->pending_count - 1];
  if (client->retry.for_ms == 0 || !libdipole_retry_is_safe(last->type) ||
      last->frame_bytes > DIPOLE_RETRY_KEPT_BYTES - client->retry.kept_bytes) {
    return;
  }
  last->kept = malloc(last->frame_bytes); /* NULL: it cannot be sent again */
  if (last->kept != NULL) {
    const libdipole_stream *stream = &client->stream;
    memcpy(last->kept, stream->out + stream->out_end - last->frame_bytes, last->frame_bytes);
    client->retry.kept_bytes += last->frame_bytes;
    last->sent_ms = last->deadline_ms != 0 ? libdipole_now_ms() : 0;
  }
}

void libdipole_retry_forget(dipole_client *client, libdipole_pending *pending) {
  if (pending->kept != NULL) {
    client->retry.kept_bytes -= pending->frame_bytes;
    free(pending->kept);
    pending->kept = NULL;
  }
  if (pending->again_ms != 0) {
    client->retry.later_count--;
    pending->again_ms = 0;
  }
}

bool libdipole_retry_can(const libdipole_pending *pending) {
  return pending->kept != NULL && !pending->dropped &&
         (pending->reader == NULL || pending->next_part == 0);
}

void libdipole_retry_drop_parts(libdipole_pending *pending) {
  free(pending->gathered);
  pending->gathered = NULL;
  pending->next_part = 0;
  pending->next_radius = 0;
}

/* ---- when ---------------------------------------------------------------------------------- */

int64_t libdipole_retry_trouble_ms(libdipole_pending *pending, int64_t now_ms) {
  if (pending->trouble_ms == 0) {
    pending->trouble_ms = now_ms;
  }
  return pending->trouble_ms;
}

bool libdipole_retry_later(dipole_client *client, libdipole_pending *pending,
                           libdipole_frame *frame) {
  wire_error why;
  if (frame->header.type != WIRE_TYPE_ERROR || !libdipole_retry_can(pending)) {
    return false;
  }
  wire_get_error(frame->payload, &why);
  if (why.status != WIRE_STATUS_BUSY && why.status != WIRE_STATUS_SHUTTING_DOWN) {
    return false;
  }
  const int64_t now_ms = libdipole_now_ms();
  const unsigned least_ms =
      why.retry_after_ms > LIBDIPOLE_PAUSE_FIRST_MS ? why.retry_after_ms : LIBDIPOLE_PAUSE_FIRST_MS;
  const int64_t again_ms =
      now_ms + least_ms + libdipole_jitter(&client->retry.random, LIBDIPOLE_PAUSE_FIRST_MS);
  if (again_ms > libdipole_retry_trouble_ms(pending, now_ms) + client->retry.for_ms) {
    return false;
  }
  free(frame);
  libdipole_retry_drop_parts(pending);
  pending->again_ms = again_ms;
  client->retry.later_count++;
  return true;
}

/* ---- sending again ------------------------------------------------------------------------- */

/* The error that the daemon would send if there were one. */
static bool answer_late(dipole_client *client, libdipole_pending *pending, dipole_error *error) {
  const wire_header header = {.magic = WIRE_MAGIC,
                              .version = WIRE_VERSION,
                              .type = WIRE_TYPE_ERROR,
                              .request_id = pending->id,
                              .payload_bytes = WIRE_BYTES_error};
  wire_error late = {.status = WIRE_STATUS_DEADLINE};
  pending->frame = libdipole_frame_new(&header, WIRE_BYTES_error, WIRE_BYTES_error, 0, error);
  if (pending->frame == NULL) {
    return false;
  }
  WIRE_SET_TEXT(late.field, "deadline_ms");
  WIRE_SET_TEXT(late.allowed, "more: the connection was lost meanwhile");
  wire_put_error(pending->frame->payload, &late);
  client->arrived_count++;
  return true;
}

/* A deadline goes on from when the request was first sent. */
bool libdipole_retry_send(dipole_client *client, libdipole_pending *pending, dipole_error *error) {
  libdipole_stream *stream = &client->stream;
  if (pending->deadline_ms != 0) {
    const int64_t left_ms = pending->sent_ms + pending->deadline_ms - libdipole_now_ms();
    if (left_ms <= 0) {
      return answer_late(client, pending, error);
    }
    wire_header header;
    wire_get_header(pending->kept, &header);
    header.deadline_ms = (uint32_t)left_ms;
    wire_put_header(pending->kept, &header);
  }
  if (!libdipole_stream_reserve(stream, pending->frame_bytes, error)) {
    return false;
  }
  memcpy(stream->out + stream->out_end, pending->kept, pending->frame_bytes);
  stream->out_end += pending->frame_bytes;
  return true;
}

bool libdipole_retry_wait(dipole_client *client, bool *moves, dipole_error *error) {
  libdipole_pending *first = client->pending + client->pending_begin;
  const int64_t now_ms = libdipole_now_ms();
  int64_t next_ms = INT64_MAX;
  *moves = true;
  for (size_t i = 0; i < client->pending_count; i++) {
    if (first[i].again_ms != 0 && first[i].again_ms <= now_ms) {
      first[i].again_ms = 0;
      client->retry.later_count--;
      if (!libdipole_retry_send(client, &first[i], error)) {
        return false;
      }
      *moves = *moves && first[i].frame == NULL; /* else it was too late, and has ended here */
    } else if (first[i].again_ms != 0 && first[i].again_ms < next_ms) {
      next_ms = first[i].again_ms;
    }
  }
  if (next_ms != INT64_MAX && *moves) {
    const libdipole_stream *stream = &client->stream;
    const bool sending = stream->out_end > stream->out_begin && stream->send_errno == 0;
    const short events = (short)(POLLIN | (sending ? POLLOUT : 0));
    unsigned wait_ms = (unsigned)(next_ms - now_ms); /* at most retry.for_ms, at least 1 */
    short ready;
    if (!libdipole_call_left(client, &wait_ms, error)) {
      return false;
    }
    *moves = libdipole_wait(stream->fd, events, wait_ms, &ready) || errno != ETIMEDOUT;
  }
  return true;
}
