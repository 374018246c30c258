/* Connecting again and asking again. A request is kept as it was sent until its answer is here. All
 * that is kept is idempotent: it has one right answer, whoever gives it and however often it is
 * asked for. Answers of the lost connection cannot come any more, and of an answer that had come in
 * part nothing is used; so none is wrong and none comes twice. */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "clients/c/client.h"

enum { PAUSE_FIRST_MS = 10, PAUSE_MOST_MS = 1000 };

/* ---- what is kept -------------------------------------------------------------------------- */

/* Of a Monte Carlo job the photons walked so far would be lost, and others' jobs delayed. */
static bool is_idempotent(uint16_t type) {
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
  if (client->retry.for_ms == 0 || !is_idempotent(last->type) ||
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

/* What has been handed on to a reader is not handed on again. */
static bool can_be_asked_again(const libdipole_pending *pending) {
  return pending->kept != NULL && !pending->dropped &&
         (pending->reader == NULL || pending->next_part == 0);
}

static void drop_parts(libdipole_pending *pending) {
  free(pending->gathered);
  pending->gathered = NULL;
  pending->next_part = 0;
  pending->next_radius = 0;
}

/* ---- when ---------------------------------------------------------------------------------- */

/* Between half and all of a pause (xorshift64, Marsaglia 2003), so that clients that lost the same
 * daemon at the same moment do not all come back at the same moment. */
static unsigned with_jitter(dipole_client *client, unsigned pause_ms) {
  uint64_t x = client->retry.random;
  if (x == 0) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    x = ((uint64_t)now.tv_nsec << 32 ^ (uint64_t)(uintptr_t)client) | 1;
  }
  x ^= x << 13;
  x ^= x >> 7;
  x ^= x << 17;
  client->retry.random = x;
  return pause_ms - (unsigned)(x % (pause_ms / 2 + 1));
}

/* The first time that a request could not be answered: from then on its time runs. */
static int64_t trouble_ms(libdipole_pending *pending, int64_t now_ms) {
  if (pending->trouble_ms == 0) {
    pending->trouble_ms = now_ms;
  }
  return pending->trouble_ms;
}

bool libdipole_retry_later(dipole_client *client, libdipole_pending *pending,
                           libdipole_frame *frame) {
  wire_error why;
  if (frame->header.type != WIRE_TYPE_ERROR || !can_be_asked_again(pending)) {
    return false;
  }
  wire_get_error(frame->payload, &why);
  if (why.status != WIRE_STATUS_BUSY && why.status != WIRE_STATUS_SHUTTING_DOWN) {
    return false;
  }
  const int64_t now_ms = libdipole_now_ms();
  const unsigned least_ms =
      why.retry_after_ms > PAUSE_FIRST_MS ? why.retry_after_ms : PAUSE_FIRST_MS;
  const int64_t again_ms = now_ms + least_ms + with_jitter(client, PAUSE_FIRST_MS);
  if (again_ms > trouble_ms(pending, now_ms) + client->retry.for_ms) {
    return false;
  }
  free(frame);
  drop_parts(pending);
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
  pending->frame = libdipole_frame_new(&header, WIRE_BYTES_error, 0, error);
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
static bool send_again(dipole_client *client, libdipole_pending *pending, dipole_error *error) {
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
      if (!send_again(client, &first[i], error)) {
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
    const int64_t wait_ms = next_ms - now_ms; /* at most retry.for_ms, at least 1 */
    short ready;
    *moves = libdipole_wait(stream->fd, events, (unsigned)wait_ms, &ready) || errno != ETIMEDOUT;
  }
  return true;
}

/* ---- connecting again ---------------------------------------------------------------------- */

/* Whether what ended a connection, or kept one from being made, may be over soon. */
static bool may_pass(const dipole_error *error) {
  switch (error->kind) {
  case DIPOLE_ERROR_CONNECT:
    return true;
  case DIPOLE_ERROR_CONNECTION:
  case DIPOLE_ERROR_REFUSED:
    return error->status == WIRE_STATUS_OK || error->status == WIRE_STATUS_SHUTTING_DOWN ||
           error->status == WIRE_STATUS_BUSY || error->status == WIRE_STATUS_TIMEOUT;
  default:
    return false;
  }
}

/* Whether all that is outstanding can be asked again. What nobody wants any more is taken out.
 * *until_ms: when the time of one of them is over. */
static bool can_restore(dipole_client *client, int64_t *until_ms) {
  const int64_t now_ms = libdipole_now_ms();
  *until_ms = now_ms + client->retry.for_ms;
  for (size_t i = 0; i < client->pending_count;) {
    libdipole_pending *entry = &client->pending[client->pending_begin + i];
    if (entry->dropped) {
      client->dropped_count--;
      drop_parts(entry);
      libdipole_pending_remove(client, entry); /* the next one has its place now */
      continue;
    }
    const bool answered = entry->frame != NULL && is_idempotent(entry->type);
    if (!answered) {
      if (!can_be_asked_again(entry)) {
        return false;
      }
      const int64_t over_ms = trouble_ms(entry, now_ms) + client->retry.for_ms;
      *until_ms = over_ms < *until_ms ? over_ms : *until_ms;
    }
    i++;
  }
  return true;
}

/* What the numbers in the requests mean must be what it was: then any daemon's answer is right. */
static bool has_lists_of(const dipole_client *fresh, const dipole_client *client) {
  for (size_t i = 0; i < client->info.choice_count; i++) {
    const dipole_choice *choice = &client->info.choices[i];
    if (choice->name[0] != '\0' && choice->kind != DIPOLE_STATUS &&
        dipole_id(fresh, choice->kind, choice->name) != choice->id) {
      return false;
    }
  }
  return true;
}

/* The fresh one's connection becomes the client's own; the fresh one is freed. */
static void take_over(dipole_client *client, dipole_client *fresh) {
  free(client->frame);
  client->frame = NULL;
  client->stream = fresh->stream;
  libdipole_stream_init(&fresh->stream, -1);
  dipole_close(fresh);
}

static bool send_all_again(dipole_client *client, dipole_error *error) {
  libdipole_pending *first = client->pending + client->pending_begin;
  for (size_t i = 0; i < client->pending_count; i++) {
    if (first[i].frame == NULL && first[i].again_ms == 0) {
      drop_parts(&first[i]);
      if (!send_again(client, &first[i], error)) {
        return false;
      }
    }
  }
  return true;
}

static void sleep_ms(int64_t ms) {
  struct timespec left = {.tv_sec = (time_t)(ms / 1000), .tv_nsec = (long)(ms % 1000) * 1000000};
  while (nanosleep(&left, &left) != 0 && errno == EINTR) {
  }
}

/* Tries until the time is over or there is no hope. NULL: *error says why. */
static dipole_client *connect_again(dipole_client *client, int64_t until_ms, dipole_error *error) {
  unsigned pause_ms = PAUSE_FIRST_MS;
  dipole_error latest = *error;
  for (;;) {
    int64_t left_ms = until_ms - libdipole_now_ms();
    int64_t wait_ms = with_jitter(client, pause_ms);
    wait_ms = latest.retry_after_ms > wait_ms ? latest.retry_after_ms : wait_ms;
    if (left_ms <= wait_ms) {
      break;
    }
    sleep_ms(wait_ms);
    pause_ms = 2 * pause_ms < PAUSE_MOST_MS ? 2 * pause_ms : PAUSE_MOST_MS;
    left_ms -= wait_ms;
    const unsigned limit_ms = client->timeout_ms != 0 && client->timeout_ms < left_ms
                                  ? client->timeout_ms
                                  : (unsigned)left_ms;
    dipole_client *fresh;
    if (dipole_open_within(client->address, limit_ms, &fresh, &latest)) {
      return fresh;
    }
    if (!may_pass(&latest)) {
      break;
    }
  }
  const dipole_error first = *error;
  libdipole_fail(error, DIPOLE_ERROR_CONNECTION, "%.120s (and connecting again failed: %.80s)",
                 first.text, latest.text);
  error->status = first.status;
  return NULL;
}

bool libdipole_retry_restore(dipole_client *client, dipole_error *error) {
  int64_t until_ms;
  if (client->retry.for_ms == 0 || client->info.software == NULL || client->stream.silent ||
      error->kind != DIPOLE_ERROR_CONNECTION || !may_pass(error) ||
      !can_restore(client, &until_ms)) {
    return false;
  }
  /* At once: a daemon that stops waits a while for its clients to close. */
  libdipole_stream_close(&client->stream);
  dipole_client *fresh = connect_again(client, until_ms, error);
  if (fresh == NULL) {
    return false;
  }
  if (!has_lists_of(fresh, client)) {
    dipole_close(fresh);
    return libdipole_fail(error, DIPOLE_ERROR_CONNECTION,
                          "the connection was lost, and the daemon that is there now has other "
                          "lists: open a new client");
  }
  take_over(client, fresh);
  return send_all_again(client, error);
}

void dipole_set_retry_ms(dipole_client *client, unsigned retry_ms) {
  client->retry.for_ms = retry_ms;
}
