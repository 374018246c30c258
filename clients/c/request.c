#include "clients/c/request.h"

#include <assert.h>
#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "clients/c/clock.h"
#include "clients/c/error.h"

/* A call that sends waits until fewer bytes than this are unsent. */
#define BACKLOG_MAX_BYTES ((size_t)1 << 20)

/* To save system calls, which cost more than the rest of a short request, the client holds back
 * requests until they have HELD_MAX_BYTES or are one in HELD_SHARE of the outstanding ones. */
#define HELD_MAX_BYTES ((size_t)16 << 10)
enum { HELD_SHARE = 4 };

const libdipole_kind libdipole_plain = {.repeatable = true};

/* ---- pending requests ---------------------------------------------------------------------- */

static libdipole_pending *find_pending(dipole_client *client, uint64_t id) {
  libdipole_pending *first = client->pending + client->pending_begin;
  size_t i = 0; /* Replies come nearly in order, so this loop is short, as the next one is. */
  while (i < client->pending_count && first[i].id < id) {
    i++;
  }
  return i < client->pending_count && first[i].id == id ? &first[i] : NULL;
}

/* Returns the oldest request that has a reply, or NULL. */
static libdipole_pending *find_arrived(dipole_client *client) {
  libdipole_pending *first = client->pending + client->pending_begin;
  for (size_t i = 0; client->arrived_count > 0 && i < client->pending_count; i++) {
    if (first[i].frame != NULL) {
      return &first[i];
    }
  }
  return NULL;
}

/* Makes room for one more outstanding request. */
static bool reserve(dipole_client *client, dipole_error *error) {
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
    return libdipole_fail_memory(error);
  }
  client->pending = larger;
  client->pending_capacity = capacity;
  return true;
}

/* Frees the copy of a request that was kept to send it again. */
static void forget_copy(dipole_client *client, libdipole_pending *pending) {
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

static void remove_entry(dipole_client *client, libdipole_pending *entry) {
  forget_copy(client, entry);
  libdipole_pending *first = client->pending + client->pending_begin;
  const size_t before = (size_t)(entry - first);
  const size_t after = --client->pending_count - before;
  if (before < after) {
    memmove(first + 1, first, before * sizeof *first);
    client->pending_begin++;
  } else {
    memmove(entry, entry + 1, after * sizeof *entry);
  }
}

static bool is_progress(const libdipole_pending *pending) {
  return pending->kind->is_progress != NULL && pending->frame->header.type != WIRE_TYPE_ERROR &&
         pending->kind->is_progress(pending->frame);
}

/* Copies an entry that has a reply to *out and removes it from the list. If the reply is a
 * report of progress, the entry stays in the list. */
static void hand_out(dipole_client *client, libdipole_pending *entry, libdipole_pending *out) {
  *out = *entry;
  client->arrived_count--;
  if (is_progress(entry)) {
    entry->frame = NULL;
  } else {
    remove_entry(client, entry);
  }
}

/* Throws away a report of progress that no call has taken. */
static void drop_report(dipole_client *client, libdipole_pending *entry) {
  free(entry->frame);
  entry->frame = NULL;
  client->arrived_count--;
}

void libdipole_request_drop(dipole_client *client, uint64_t id) {
  libdipole_pending *entry = find_pending(client, id);
  if (entry == NULL || entry->dropped) {
    return;
  }
  if (entry->frame == NULL &&
      entry->again_ms == 0) { /* The request has been sent, and its reply is still to come. */
    entry->dropped = true;
    client->dropped_count++;
    return;
  }
  client->arrived_count -= entry->frame != NULL;
  free(entry->frame);
  free(entry->gathered);
  remove_entry(client, entry);
}

bool libdipole_cancel(dipole_client *client, uint64_t job_id, uint64_t *cancel_id,
                      dipole_error *error) {
  static const libdipole_kind cancel_kind = {.endless = true};
  const wire_cancel_request request = {.job_id = job_id};
  libdipole_pending pending = {.kind = &cancel_kind,
                               .type = WIRE_TYPE_CANCEL,
                               .reply_bytes_min = WIRE_BYTES_cancel_reply,
                               .reply_bytes_max = WIRE_BYTES_cancel_reply};
  libdipole_pending *job = find_pending(client, job_id);
  uint8_t *payload;
  if (job != NULL) {
    assert(job->again_ms == 0);
    forget_copy(client, job); /* so that it is never sent again */
  }
  if (!libdipole_request_begin(client, &pending, WIRE_BYTES_cancel_request, &payload, error)) {
    return false;
  }
  wire_put_cancel_request(payload, &request);
  *cancel_id = pending.id;
  return libdipole_request_send(client, error);
}

size_t dipole_outstanding(const dipole_client *client) {
  return client->pending_count - client->dropped_count;
}

void libdipole_requests_free(dipole_client *client) {
  for (size_t i = 0; i < client->pending_count; i++) {
    libdipole_pending *entry = &client->pending[client->pending_begin + i];
    free(entry->frame);
    free(entry->gathered);
    free(entry->kept);
  }
  free(client->pending);
  free(client->frame);
}

/* ---- replies ------------------------------------------------------------------------------- */

static bool refused(const dipole_client *client, const libdipole_pending *pending,
                    const libdipole_frame *frame, dipole_error *error) {
  static const dipole_info empty;
  return libdipole_fail_refused(error, client->info != NULL ? client->info : &empty,
                                pending != NULL ? pending->medium_count : 0,
                                pending != NULL ? pending->layer_count : 0,
                                pending != NULL ? pending->radius_count : 0, frame->payload);
}

bool libdipole_refusal_check(const dipole_client *client, const libdipole_pending *pending,
                             dipole_error *error) {
  return pending->frame->header.type != WIRE_TYPE_ERROR ||
         refused(client, pending, pending->frame, error);
}

bool libdipole_bad_reply(dipole_client *client, const char *what, dipole_error *error) {
  libdipole_fail_protocol(error, what);
  client->broken = *error;
  return false;
}

/* Returns whether the request waits for a frame. pending: NULL if no request has the frame's id. */
static bool is_awaited(const libdipole_pending *pending) {
  return pending != NULL && (pending->frame == NULL || is_progress(pending));
}

/* Returns whether the frame only says that the daemon is at work on a request (F3e). */
static bool reports_work(const wire_header *header, const libdipole_pending *pending) {
  return header->type == (WIRE_TYPE_PING | WIRE_REPLY) && header->payload_bytes == 0 &&
         pending->type != WIRE_TYPE_PING;
}

/* Returns whether the header is of an error or of a reply that this request can have. pending:
 * NULL if no request has the frame's id, as for an error that concerns the whole connection. */
static bool check_header(const wire_header *header, const libdipole_pending *pending,
                         dipole_error *error) {
  char what[160];
  const wire_error fault = wire_header_check(header, UINT32_MAX);
  if (fault.status != WIRE_STATUS_OK) {
    snprintf(what, sizeof what, "%s: %s: expected %s", wire_status_of(fault.status)->name,
             fault.field, fault.allowed);
    return libdipole_fail_protocol(error, what);
  }
  if (header->type == WIRE_TYPE_ERROR && header->payload_bytes == WIRE_BYTES_error) {
    return true;
  }
  if (!is_awaited(pending)) {
    return libdipole_fail_protocol(error, "it replied to a request that was not sent");
  }
  if (reports_work(header, pending)) {
    return true;
  }
  if (header->type != (pending->type | WIRE_REPLY) ||
      header->payload_bytes < pending->reply_bytes_min ||
      header->payload_bytes > pending->reply_bytes_max) {
    snprintf(what, sizeof what, "it replied to a request of type %s with type 0x%04x and %lu bytes",
             wire_type_name(pending->type), header->type, (unsigned long)header->payload_bytes);
    return libdipole_fail_protocol(error, what);
  }
  return true;
}

/* Starts to receive a frame whose complete header is in the buffer. */
static bool begin_frame(dipole_client *client, dipole_error *error) {
  libdipole_stream *stream = &client->stream;
  wire_header header;
  wire_get_header(stream->in + stream->in_begin, &header);
  stream->in_begin += WIRE_BYTES_header;
  const libdipole_pending *pending = find_pending(client, header.request_id);
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

/* Fails with an error that the daemon sent about the whole connection. Frees the frame. */
static bool fail_connection(dipole_client *client, libdipole_frame *frame, dipole_error *error) {
  refused(client, NULL, frame, error);
  free(frame);
  /* Before the reply to hello, opening fails with this error; later, the connection is lost. */
  error->kind = client->info != NULL ? DIPOLE_ERROR_CONNECTION : DIPOLE_ERROR_REFUSED;
  return false;
}

/* Ends a request whose reply is complete or is an error: frees its parts and its copy. */
static void end_reply(dipole_client *client, libdipole_pending *pending) {
  free(pending->gathered); /* the parts before the error */
  pending->gathered = NULL;
  if (pending->dropped) {
    free(pending->frame);
    client->dropped_count--;
    remove_entry(client, pending);
  } else {
    client->arrived_count++;
  }
}

/* Returns whether the request can be sent again: there is a copy, and no reader has got a part. */
static bool can_repeat(const libdipole_pending *pending) {
  return pending->kept != NULL && !pending->dropped &&
         (pending->reader == NULL || pending->next_part == 0);
}

/* Returns when the request first failed; if this is its first failure, that is now. The client
 * sends it again for retry.for_ms from then on. */
static int64_t failed_since_ms(libdipole_pending *pending, int64_t now_ms) {
  if (pending->failed_ms == 0) {
    pending->failed_ms = now_ms;
  }
  return pending->failed_ms;
}

/* Returns whether a frame ends its request for a reason that passes: a temporary refusal, or an
 * reply that a daemon cut off when it stopped. *least_ms: the pause that the daemon requests. */
static bool is_passing(const libdipole_pending *pending, const libdipole_frame *frame,
                       uint32_t *least_ms) {
  wire_error why;
  *least_ms = 0;
  if (frame->header.type != WIRE_TYPE_ERROR) {
    return pending->kind->is_cut_off != NULL && pending->kind->is_cut_off(frame);
  }
  wire_get_error(frame->payload, &why);
  *least_ms = why.retry_after_ms;
  return why.status == WIRE_STATUS_BUSY || why.status == WIRE_STATUS_SHUTTING_DOWN;
}

/* If the frame ends the request for a reason that passes, plans to send the request again, frees
 * the frame and returns true. */
static bool send_later(dipole_client *client, libdipole_pending *pending, libdipole_frame *frame) {
  uint32_t retry_after_ms;
  if (!can_repeat(pending) || !is_passing(pending, frame, &retry_after_ms)) {
    return false;
  }
  const int64_t now_ms = libdipole_now_ms();
  const unsigned least_ms =
      retry_after_ms > LIBDIPOLE_PAUSE_FIRST_MS ? retry_after_ms : LIBDIPOLE_PAUSE_FIRST_MS;
  const int64_t again_ms =
      now_ms + least_ms + libdipole_jitter(&client->retry.random, LIBDIPOLE_PAUSE_FIRST_MS);
  if (again_ms > failed_since_ms(pending, now_ms) + client->retry.for_ms) {
    return false;
  }
  free(frame);
  libdipole_parts_drop(pending);
  pending->again_ms = again_ms;
  client->retry.later_count++;
  return true;
}

/* Gives a complete frame to its request. A report of progress replaces the one before it. */
static bool end_frame(dipole_client *client, dipole_error *error) {
  libdipole_frame *frame = client->frame;
  libdipole_pending *pending = find_pending(client, frame->header.request_id);
  client->frame = NULL;
  if (!is_awaited(pending)) {
    return fail_connection(client, frame, error);
  }
  if (reports_work(&frame->header, pending)) {
    free(frame);
    return true;
  }
  if (pending->frame != NULL) {
    drop_report(client, pending);
  }
  if (send_later(client, pending, frame)) {
    return true;
  }
  if (frame->header.type == WIRE_TYPE_ERROR || pending->kind->reply == NULL) {
    pending->frame = frame;
  } else {
    const bool was_dropped = pending->dropped;
    client->frame = pending->reader != NULL ? frame : NULL; /* if a reader does not return */
    const bool good = libdipole_part_take(pending, frame, error);
    client->frame = NULL;
    if (!good) {
      return false;
    }
    client->dropped_count += pending->dropped && !was_dropped;
  }
  if (pending->frame != NULL && is_progress(pending)) {
    pending->failed_ms = 0; /* The request continues, so another failure is a new one. */
  }
  if (pending->frame != NULL) {
    end_reply(client, pending);
  }
  return true;
}

/* Makes frames of the received bytes. */
static bool receive(dipole_client *client, dipole_error *error) {
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

/* ---- waiting ------------------------------------------------------------------------------- */

void libdipole_call_begin(dipole_client *client, const libdipole_kind *kind) {
  client->until_ms = kind->endless || client->call_timeout_ms == 0
                         ? 0
                         : libdipole_now_ms() + (int64_t)client->call_timeout_ms;
}

static bool fail_late(const dipole_client *client, dipole_error *error) {
  return libdipole_fail(error, DIPOLE_ERROR_TIMEOUT, "the call took longer than %u ms",
                        client->call_timeout_ms);
}

/* Lowers *limit_ms to the time left; 0: no limit. Fails with kind TIMEOUT if none is left. */
static bool limit_to_call(const dipole_client *client, unsigned *limit_ms, dipole_error *error) {
  if (client->until_ms == 0) {
    return true;
  }
  const int64_t left_ms = client->until_ms - libdipole_now_ms();
  if (left_ms <= 0) {
    return fail_late(client, error);
  }
  if (*limit_ms == 0 || left_ms < (int64_t)*limit_ms) {
    *limit_ms = (unsigned)left_ms;
  }
  return true;
}

/* Waits until bytes are received or sent, the daemon has been silent for timeout_ms, or the time of
 * the call is over. Silence at the end of a call counts on in the next call. */
static bool wait_and_move(dipole_client *client, dipole_error *error) {
  libdipole_stream *stream = &client->stream;
  const unsigned timeout_ms = client->timeout_ms;
  const unsigned silence_ms = timeout_ms == 0                  ? 0
                              : timeout_ms > client->waited_ms ? timeout_ms - client->waited_ms
                                                               : 1;
  unsigned limit_ms = silence_ms;
  if (!limit_to_call(client, &limit_ms, error)) {
    return false;
  }
  if (libdipole_stream_step(stream, limit_ms, error)) {
    client->waited_ms = 0;
    return true;
  }
  if (stream->silent && limit_ms != silence_ms) {
    stream->silent = false;
    client->waited_ms += timeout_ms != 0 ? limit_ms : 0;
    return fail_late(client, error);
  }
  if (stream->silent) {
    libdipole_fail(error, DIPOLE_ERROR_CONNECTION, "the daemon was silent for %u ms: gave up",
                   timeout_ms);
  }
  return false;
}

/* ---- sending again ------------------------------------------------------------------------- */

/* Keeps a copy of the request that was begun last, if it may be sent again and
 * DIPOLE_RETRY_KEPT_BYTES has room. The end of stream.out is the frame of the request. */
static void keep_copy(dipole_client *client) {
  libdipole_pending *last = &client->pending[client->pending_begin + client->pending_count - 1];
  if (client->retry.for_ms == 0 || !last->kind->repeatable ||
      last->frame_bytes > DIPOLE_RETRY_KEPT_BYTES - client->retry.kept_bytes) {
    return;
  }
  last->kept = malloc(last->frame_bytes); /* If this fails, the request is sent only once. */
  if (last->kept != NULL) {
    const libdipole_stream *stream = &client->stream;
    memcpy(last->kept, stream->out + stream->out_end - last->frame_bytes, last->frame_bytes);
    client->retry.kept_bytes += last->frame_bytes;
    last->sent_ms = last->deadline_ms != 0 ? libdipole_now_ms() : 0;
  }
}

/* Gives a request the error that a daemon sends after the deadline. */
static bool reply_late(dipole_client *client, libdipole_pending *pending, dipole_error *error) {
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

/* Sends a request again with the rest of its deadline, which counts from the first sending. If
 * nothing is left, gives the request the error "deadline" instead. */
static bool send_again(dipole_client *client, libdipole_pending *pending, dipole_error *error) {
  libdipole_stream *stream = &client->stream;
  if (pending->deadline_ms != 0) {
    const int64_t left_ms = pending->sent_ms + pending->deadline_ms - libdipole_now_ms();
    if (left_ms <= 0) {
      return reply_late(client, pending, error);
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

/* Sends the requests that are due to be sent again. Then waits for the connection, at most until
 * the next request is due. *moves: whether the connection may have bytes to read or send. */
static bool send_due(dipole_client *client, bool *moves, dipole_error *error) {
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
      *moves = *moves && first[i].frame == NULL; /* send_again() may have ended it */
    } else if (first[i].again_ms != 0 && first[i].again_ms < next_ms) {
      next_ms = first[i].again_ms;
    }
  }
  if (next_ms != INT64_MAX && *moves) {
    const libdipole_stream *stream = &client->stream;
    const bool sending = stream->out_end > stream->out_begin && stream->send_errno == 0;
    const short events = (short)(POLLIN | (sending ? POLLOUT : 0));
    unsigned wait_ms = (unsigned)(next_ms - now_ms); /* ms to wait, from 1 to retry.for_ms */
    short ready;
    if (!limit_to_call(client, &wait_ms, error)) {
      return false;
    }
    *moves = libdipole_stream_wait(stream, events, wait_ms, &ready) || errno != ETIMEDOUT;
  }
  return true;
}

/* ---- connecting again ---------------------------------------------------------------------- */

bool libdipole_is_temporary(const dipole_error *error) {
  switch (error->kind) {
  case DIPOLE_ERROR_CONNECT:
    return error->status == WIRE_STATUS_OK;
  case DIPOLE_ERROR_CONNECTION:
  case DIPOLE_ERROR_REFUSED:
    return error->status == WIRE_STATUS_OK || error->status == WIRE_STATUS_SHUTTING_DOWN ||
           error->status == WIRE_STATUS_BUSY || error->status == WIRE_STATUS_TIMEOUT;
  default:
    return false;
  }
}

/* Returns whether every outstanding request can be sent again. Removes the requests that the caller
 * has dropped. *until_ms: the first moment at which a request may no longer be sent again. */
static bool can_restore(dipole_client *client, int64_t *until_ms) {
  const int64_t now_ms = libdipole_now_ms();
  *until_ms = now_ms + client->retry.for_ms;
  for (size_t i = 0; i < client->pending_count;) {
    libdipole_pending *entry = &client->pending[client->pending_begin + i];
    if (entry->dropped) {
      client->dropped_count--;
      libdipole_parts_drop(entry);
      remove_entry(client, entry); /* The next entry is at position i now. */
      continue;
    }
    const bool done = entry->frame != NULL && !is_progress(entry);
    if (!done) {
      if (!can_repeat(entry)) {
        return false;
      }
      const int64_t over_ms = failed_since_ms(entry, now_ms) + client->retry.for_ms;
      *until_ms = over_ms < *until_ms ? over_ms : *until_ms;
    }
    i++;
  }
  return true;
}

/* Gives this client the connection and the private daemon of a fresh client. Frees the fresh
 * client, and ends this client's former daemon with it. */
static void take_over(dipole_client *client, dipole_client *fresh) {
  const pid_t former = client->daemon;
  free(client->frame);
  client->frame = NULL;
  libdipole_stream_close(&client->stream, true);
  client->stream = fresh->stream;
  client->daemon = fresh->daemon;
  client->waited_ms = 0;
  libdipole_stream_init(&fresh->stream, -1);
  fresh->daemon = former;
  dipole_close(fresh);
}

static bool send_all_again(dipole_client *client, dipole_error *error) {
  libdipole_pending *first = client->pending + client->pending_begin;
  for (size_t i = 0; i < client->pending_count; i++) {
    if (first[i].frame != NULL && is_progress(&first[i])) {
      drop_report(client, &first[i]);
    }
    if (first[i].frame == NULL && first[i].again_ms == 0) {
      libdipole_parts_drop(&first[i]);
      if (!send_again(client, &first[i], error)) {
        return false;
      }
    }
  }
  return true;
}

/* Waits before the next round of attempts. Returns false if no time is left: *over is true if the
 * requests may no longer be sent again, else the call has no time left and *error says so. */
static bool wait_for_round(dipole_client *client, int64_t until_ms, uint32_t retry_after_ms,
                           bool *over, dipole_error *error) {
  unsigned call_ms =
      libdipole_pause(&client->retry.random, &client->retry.pause_ms, retry_after_ms, until_ms);
  *over = call_ms == 0;
  if (*over || !limit_to_call(client, &call_ms, error)) {
    return false;
  }
  libdipole_sleep_ms(call_ms);
  return limit_to_call(client, &call_ms, error);
}

/* Tries to connect again until until_ms or a lasting error: then returns NULL and sets *error. */
static dipole_client *connect_again(dipole_client *client, int64_t until_ms, dipole_error *error) {
  const dipole_error first = *error;
  dipole_error latest = first;
  bool may_pass = true, over;
  while (may_pass) {
    if (!wait_for_round(client, until_ms, latest.retry_after_ms, &over, error)) {
      if (over) {
        break;
      }
      return NULL;
    }
    const bool call_ends = client->until_ms != 0 && client->until_ms < until_ms;
    dipole_client *fresh =
        client->reopen(client, call_ends ? client->until_ms : until_ms, &may_pass, &latest);
    if (fresh != NULL) {
      return fresh;
    }
  }
  libdipole_fail(error, DIPOLE_ERROR_CONNECTION, "%.120s (and connecting again failed: %.100s)",
                 first.text, latest.text);
  error->status = first.status;
  return NULL;
}

/* Connects again after the loss that *error describes, and sends all outstanding requests again.
 * Fails with the reason for the loss. If the time of the call ends first, fails with kind TIMEOUT,
 * and the next call continues. */
static bool restore(dipole_client *client, dipole_error *error) {
  int64_t until_ms;
  /* If the daemon was silent, only the connection to another daemon may help. */
  if (client->retry.for_ms == 0 || client->reopen == NULL ||
      (client->stream.silent && client->addresses.count <= 1) ||
      error->kind != DIPOLE_ERROR_CONNECTION || !libdipole_is_temporary(error) ||
      !can_restore(client, &until_ms)) {
    return false;
  }
  if (client->retry.pause_ms == 0) { /* The connection has only just been lost. */
    client->retry.pause_ms = LIBDIPOLE_PAUSE_FIRST_MS;
    client->addresses.at = (client->addresses.at + 1) % client->addresses.count;
    /* Close at once, because a daemon that stops waits for its clients to close. */
    libdipole_stream_close(&client->stream, true);
  }
  dipole_client *fresh = connect_again(client, until_ms, error);
  if (fresh == NULL) {
    return false;
  }
  client->retry.pause_ms = 0;
  take_over(client, fresh);
  return send_all_again(client, error);
}

static bool advance(dipole_client *client, dipole_error *error) {
  bool moves = true;
  if (client->retry.later_count > 0 && !send_due(client, &moves, error)) {
    return false;
  }
  return !moves || (wait_and_move(client, error) && receive(client, error));
}

/* Returns false and sets *error if the client can only be closed. An exception or a jump may have
 * left an earlier call in the middle of a frame. */
static bool check_whole(dipole_client *client, dipole_error *error) {
  if (client->broken.kind == DIPOLE_ERROR_NONE && client->torn) {
    libdipole_fail(
        &client->broken, DIPOLE_ERROR_CONNECTION,
        "an exception or a jump left an earlier call of this client before its end, or a "
        "function that a call runs uses the client: open another one");
  }
  if (client->broken.kind != DIPOLE_ERROR_NONE) {
    *error = client->broken;
  }
  return client->broken.kind == DIPOLE_ERROR_NONE;
}

/* Does the same before bytes move. A forked process would take replies of the one that opened the
 * client, so its copy of the client is broken. */
static bool check_usable(dipole_client *client, dipole_error *error) {
  if (client->broken.kind == DIPOLE_ERROR_NONE && client->process != getpid()) {
    libdipole_fail(&client->broken, DIPOLE_ERROR_CONNECTION,
                   "process %ld opened this client: after fork(), open a client in each process",
                   (long)client->process);
  }
  return check_whole(client, error);
}

static bool advance_or_restore(dipole_client *client, dipole_error *error) {
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
  if (restore(client, error)) {
    client->lost.kind = DIPOLE_ERROR_NONE;
    return true;
  }
  if (error->kind != DIPOLE_ERROR_TIMEOUT) {
    client->broken = *error;
  }
  return false;
}

/* Waits until bytes are received or sent, and reads the received frames. After a failure that
 * another connection cannot repair, every later call fails in the same way. */
static bool move_bytes(dipole_client *client, dipole_error *error) {
  if (!check_usable(client, error)) {
    return false;
  }
  client->torn = true;
  const bool good = advance_or_restore(client, error);
  client->torn = false;
  return good;
}

/* ---- requests ------------------------------------------------------------------------------ */

bool libdipole_request_begin(dipole_client *client, libdipole_pending *pending,
                             uint64_t payload_bytes, uint8_t **payload, dipole_error *error) {
  libdipole_call_begin(client, pending->kind);
  if (!check_whole(client, error)) {
    return false;
  }
  while (client->lost.kind != DIPOLE_ERROR_NONE || client->dropped_count >= DIPOLE_IN_FLIGHT_MAX) {
    if (!move_bytes(client, error)) {
      return false;
    }
  }
  if (payload_bytes > UINT32_MAX - WIRE_BYTES_header) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "the request takes %llu bytes, more than a frame holds: request fewer "
                          "radii or media at a time",
                          (unsigned long long)payload_bytes);
  }
  const size_t bytes = WIRE_BYTES_header + (size_t)payload_bytes;
  if (!reserve(client, error) || !libdipole_stream_reserve(&client->stream, bytes, error)) {
    return false;
  }
  pending->id = ++client->last_id;
  pending->frame_bytes = bytes;
  const wire_header header = {.magic = WIRE_MAGIC,
                              .version = WIRE_VERSION,
                              .type = pending->type,
                              .request_id = pending->id,
                              .payload_bytes = (uint32_t)payload_bytes,
                              .deadline_ms = pending->deadline_ms};
  uint8_t *at = client->stream.out + client->stream.out_end;
  wire_put_header(at, &header);
  *payload = at + WIRE_BYTES_header;
  /* bytes of the request are missing until the caller has filled the payload */
  client->torn = true;
  client->stream.out_end += bytes;
  client->pending[client->pending_begin + client->pending_count++] = *pending;
  return true;
}

void dipole_flush(dipole_client *client) {
  if (check_usable(client, &(dipole_error){0})) {
    client->torn = true;
    libdipole_stream_send(&client->stream);
    client->held_count = 0;
    client->torn = false;
  }
}

bool libdipole_request_send(dipole_client *client, dipole_error *error) {
  const libdipole_stream *stream = &client->stream;
  const uint64_t id = client->last_id;
  keep_copy(client);
  client->torn = false;
  client->held_count++;
  if (client->held_count * HELD_SHARE >= dipole_outstanding(client) ||
      stream->out_end - stream->out_begin >= HELD_MAX_BYTES) {
    dipole_flush(client);
  }
  while (stream->out_end - stream->out_begin > BACKLOG_MAX_BYTES) {
    if (!move_bytes(client, error)) {
      libdipole_request_drop(client, id);
      return false;
    }
  }
  return true;
}

bool libdipole_request_wait(dipole_client *client, uint64_t id, const libdipole_reader *reader,
                            libdipole_pending *pending, dipole_error *error) {
  for (;;) {
    libdipole_pending *entry = id != 0 ? find_pending(client, id) : find_arrived(client);
    if (entry != NULL && entry->frame != NULL) {
      hand_out(client, entry, pending);
      return true;
    }
    if (reader != NULL && reader->stopped) {
      pending->frame = NULL;
      return true;
    }
    const bool none = id != 0 ? entry == NULL || entry->dropped : dipole_outstanding(client) == 0;
    if (none) {
      return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                            id != 0 ? "no query with this id is outstanding"
                                    : "no query is outstanding");
    }
    if (!move_bytes(client, error)) {
      return false;
    }
  }
}

libdipole_frame *libdipole_reply(dipole_client *client, libdipole_pending *pending,
                                 dipole_error *error) {
  const uint64_t id = pending->id;
  if (!libdipole_request_wait(client, id, NULL, pending, error)) {
    libdipole_request_drop(client, id);
    return NULL;
  }
  if (!libdipole_refusal_check(client, pending, error)) {
    free(pending->frame);
    return NULL;
  }
  return pending->frame;
}

libdipole_frame *libdipole_call(dipole_client *client, libdipole_pending *pending,
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
