#include "server/modbus/connection.h"

#include <errno.h>
#include <linux/sockios.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include "server/observe/log.h"
#include "server/modbus/service.h"
#include "server/net/worker.h"

enum {
  HEADER_BYTES = 7, /* transaction, protocol, length, unit */
  LENGTH_MIN = 2,   /* unit and function */
  LENGTH_MAX = 254,
  /* What an empty socket takes for sure, whatever the overhead of small segments. */
  SURELY_TAKEN_BYTES = 4096,
  /* What the kernel keeps in each direction for a master that does not read; without a bound it
   * grows to megabytes, and much less than a segment of the loopback makes it drop those. */
  SOCKET_BUFFER_BYTES = 65536,
  LINGER_MS = 1000, /* for a peer that does not close after the last answer */
};

static void on_poll(uv_poll_t *poll, int status, int events);
static void on_evaluated(struct modbus_client *client);
static void settle(struct modbus_connection *c);

static uv_loop_t *loop_of(const struct modbus_connection *c) {
  return worker_loop(c->service->worker);
}

static struct stats *stats_of(const struct modbus_connection *c) {
  return &c->service->server->stats;
}

/* ---- beginning and end ------------------------------------------------------------------------
 */

struct modbus_connection *modbus_connection_new(struct modbus_service *service, int fd) {
  struct modbus_connection *c = calloc(1, sizeof *c);
  if (c != NULL) {
    c->service = service;
    c->fd = fd;
    c->client.answer = on_evaluated;
  }
  return c;
}

static void on_closed(uv_handle_t *handle) {
  struct modbus_connection *c = handle->data;
  stats_subtract(stats_of(c), STATS_MODBUS_CONNECTIONS_OPEN, 1);
  close(c->fd);
  modbus_service_forget(c->service, c);
  free(c);
}

void modbus_connection_abort(struct modbus_connection *c) {
  if (!c->closing) {
    c->closing = true;
    if (c->waiting) {
      modbus_bank_forget(c->bank, &c->client);
    }
    uv_close((uv_handle_t *)&c->poll, on_closed);
  }
}

/* Changing what is waited for takes a system call, not changing it none. */
static void set_events(struct modbus_connection *c, int events) {
  if (c->closing || c->events == events) {
    return;
  }
  c->events = events;
  if (events == 0) {
    uv_poll_stop(&c->poll);
  } else if (uv_poll_start(&c->poll, events, on_poll) != 0) {
    modbus_connection_abort(c);
  }
}

/* A socket that is closed with unread bytes resets the connection, and the peer may lose answers
 * that it has not read: so what still comes is read and dropped, until the peer closes. */
static void linger(struct modbus_connection *c) {
  if (shutdown(c->fd, SHUT_WR) != 0) {
    modbus_connection_abort(c);
    return;
  }
  c->lingering = true;
  c->active_ms = uv_now(loop_of(c));
  set_events(c, UV_READABLE);
}

/* ---- writing ----------------------------------------------------------------------------------
 */

static void wrote(struct modbus_connection *c, size_t bytes) {
  c->unconfirmed += (unsigned)bytes;
  c->active_ms = uv_now(loop_of(c));
  stats_add(stats_of(c), STATS_SENT_BYTES, bytes);
}

/* Writes what the socket takes of the answer that is kept. */
static void write_unsent(struct modbus_connection *c) {
  while (c->unsent_begin < c->unsent_end) {
    const ssize_t sent =
        send(c->fd, c->unsent + c->unsent_begin, c->unsent_end - c->unsent_begin, MSG_NOSIGNAL);
    if (sent < 0 && errno != EAGAIN && errno != EINTR) {
      modbus_connection_abort(c);
      return;
    }
    if (sent < 0 && errno == EAGAIN) {
      return;
    }
    if (sent > 0) {
      c->unsent_begin += (unsigned)sent;
      wrote(c, (size_t)sent);
    }
  }
  c->unsent_begin = c->unsent_end = 0;
}

static void keep_and_write(struct modbus_connection *c, int bytes) {
  if (bytes <= 0) {
    modbus_connection_abort(c);
    return;
  }
  c->unsent_begin = 0;
  c->unsent_end = (unsigned)bytes;
  write_unsent(c);
}

/* Whether the socket has room for any answer. libmodbus does not say how much of one was taken, so
 * that it may write to the socket itself only where all of it will be. The kernel is asked when as
 * much has been written as an empty socket takes, which is once in some fifty answers. */
static bool takes_an_answer(struct modbus_connection *c) {
  if (c->unconfirmed + MODBUS_FRAME_MAX > SURELY_TAKEN_BYTES) {
    int queued = 0;
    c->unconfirmed = ioctl(c->fd, SIOCOUTQ, &queued) == 0 ? (unsigned)queued : SURELY_TAKEN_BYTES;
  }
  return c->unconfirmed + MODBUS_FRAME_MAX <= SURELY_TAKEN_BYTES;
}

static void answer_by_codec(struct modbus_connection *c, const uint8_t *frame, size_t bytes,
                            struct modbus_bank *bank, unsigned exception) {
  struct modbus_codec *codec = &c->service->codec;
  modbus_mapping_t *mapping = bank != NULL ? &bank->mapping : NULL;
  if (takes_an_answer(c)) {
    const int sent = modbus_codec_send(codec, c->fd, frame, bytes, mapping, exception);
    if (sent > 0) {
      wrote(c, (size_t)sent);
      return;
    }
    if (errno != EAGAIN) { /* a part of an answer among them, of unknown length */
      modbus_connection_abort(c);
      return;
    }
  }
  keep_and_write(c, modbus_codec_encode(codec, frame, bytes, mapping, exception, c->unsent));
}

static void answer_by_hand(struct modbus_connection *c, const uint8_t *frame,
                           const struct modbus_answer *answer) {
  const size_t length = 1 + answer->bytes;
  memcpy(c->unsent, frame, HEADER_BYTES);
  c->unsent[4] = (uint8_t)(length >> 8);
  c->unsent[5] = (uint8_t)length;
  memcpy(c->unsent + HEADER_BYTES, answer->pdu, answer->bytes);
  keep_and_write(c, (int)(HEADER_BYTES + answer->bytes));
}

/* ---- answering --------------------------------------------------------------------------------
 */

/* 0 and 255 are what masters say that think of no unit. */
static unsigned unit_of(uint8_t number) {
  return number == 0 || number == 255 ? 1 : number <= MODBUS_UNITS ? number : 0;
}

static unsigned frame_bytes(const uint8_t *frame) {
  return 6 + ((unsigned)frame[4] << 8 | frame[5]);
}

static void next_frame(struct modbus_connection *c) {
  c->begin += frame_bytes(c->input + c->begin);
  c->frame_started_ms = 0;
  if (c->begin == c->end) {
    c->begin = c->end = 0;
  }
}

/* Its commit has been evaluated. */
static void on_evaluated(struct modbus_client *client) {
  struct modbus_connection *c = (struct modbus_connection *)(void *)client;
  const uint8_t *frame = c->input + c->begin;
  c->waiting = false;
  answer_by_codec(c, frame, frame_bytes(frame), c->bank, 0);
  if (c->closing) {
    return;
  }
  next_frame(c);
  if (c->begin < c->end) {
    modbus_service_run_later(c->service, c);
  } else { /* as a rule: the loop then waits for the next, and need not look once more before it */
    settle(c);
  }
}

static void answer_frame(struct modbus_connection *c, const uint8_t *frame, size_t bytes) {
  struct modbus_answer answer;
  modbus_answer(c->service, &c->client, unit_of(frame[6]), frame + HEADER_BYTES,
                bytes - HEADER_BYTES, &answer);
  if (answer.later) {
    c->waiting = true;
    c->bank = answer.bank;
    return;
  }
  if (answer.bytes > 0) {
    answer_by_hand(c, frame, &answer);
  } else {
    answer_by_codec(c, frame, bytes, answer.bank, answer.exception);
  }
  if (!c->closing) {
    next_frame(c);
  }
}

/* What follows cannot be told apart any more. */
static void lose_framing(struct modbus_connection *c) {
  log_peer_line(LOG_LEVEL_INFO, "event=modbus-closed reason=bad-frame");
  stats_add(stats_of(c), STATS_MODBUS_BAD_FRAMES, 1);
  c->begin = c->end = 0;
  c->frame_started_ms = 0;
  c->ending = true;
}

/* Whether the bytes that have arrived can be the beginning of a frame. */
static bool is_frame(const uint8_t *frame, unsigned bytes) {
  if (bytes >= 4 && (frame[2] != 0 || frame[3] != 0)) {
    return false;
  }
  const unsigned length = bytes >= 6 ? frame_bytes(frame) - 6 : LENGTH_MIN;
  return length >= LENGTH_MIN && length <= LENGTH_MAX &&
         (bytes <= HEADER_BYTES || frame[HEADER_BYTES] < 0x80);
}

/* Takes up the next frame, if it is there; false: it is not. */
static bool take_frame(struct modbus_connection *c) {
  const uint8_t *frame = c->input + c->begin;
  const unsigned bytes = c->end - c->begin;
  if (!is_frame(frame, bytes)) {
    lose_framing(c);
    return false;
  }
  if (bytes < 6 || bytes < frame_bytes(frame)) {
    return false;
  }
  answer_frame(c, frame, frame_bytes(frame));
  return true;
}

static bool is_blocked(const struct modbus_connection *c) {
  return c->waiting || c->unsent_begin < c->unsent_end;
}

/* Answers what is there, as far as it can; one commit at a time. */
static void take_frames(struct modbus_connection *c) {
  while (!c->closing && !c->ending && !is_blocked(c) && c->begin < c->end && take_frame(c)) {
  }
}

/* The clock of an unfinished frame runs while the peer could finish it. */
static void note_partial_frame(struct modbus_connection *c) {
  if (c->begin == c->end) {
    c->frame_started_ms = 0;
  } else if (c->frame_started_ms == 0) {
    c->frame_started_ms = uv_now(loop_of(c));
  }
}

/* ---- reading ----------------------------------------------------------------------------------
 */

static void discard(struct modbus_connection *c) {
  const ssize_t got = recv(c->fd, c->input, sizeof c->input, 0);
  if (got == 0 || (got < 0 && errno != EAGAIN && errno != EINTR)) {
    modbus_connection_abort(c);
  }
}

/* Reads what there is room for: always for the rest of a frame, as whole ones have been answered.
 */
static void read_more(struct modbus_connection *c) {
  if (c->begin > 0) {
    memmove(c->input, c->input + c->begin, c->end - c->begin);
    c->end -= c->begin;
    c->begin = 0;
  }
  const size_t room = sizeof c->input - c->end;
  const size_t wanted = c->unread > 0 && c->unread < room ? c->unread : room;
  const ssize_t got = recv(c->fd, c->input + c->end, wanted, 0);
  c->unread -= got > 0 && (size_t)got < c->unread ? (unsigned)got : c->unread;
  if (got > 0) {
    c->end += (unsigned)got;
    c->active_ms = uv_now(loop_of(c));
    stats_add(stats_of(c), STATS_RECEIVED_BYTES, (uint64_t)got);
  } else if (got == 0) {
    c->stopping = true;
  } else if (errno != EAGAIN && errno != EINTR) {
    modbus_connection_abort(c);
  }
}

/* What has arrived is answered as far as it can be: what is waited for now. */
static void settle(struct modbus_connection *c) {
  if (c->closing || c->lingering || c->waiting) {
    return; /* that comes to an end in this round, before anything is read */
  }
  if (c->unsent_begin < c->unsent_end) {
    set_events(c, UV_WRITABLE);
    return;
  }
  if (c->unread > 0 && !c->ending) {
    read_more(c);
    modbus_service_run_later(c->service, c);
    return;
  }
  if (c->ending || c->stopping) {
    linger(c);
    return;
  }
  note_partial_frame(c);
  set_events(c, UV_READABLE);
}

void modbus_connection_run(struct modbus_connection *c) {
  take_frames(c);
  settle(c);
}

static void on_poll(uv_poll_t *poll, int status, int events) {
  struct modbus_connection *c = poll->data;
  if (status < 0) {
    modbus_connection_abort(c);
  } else if (c->lingering) {
    discard(c);
  } else if (!c->waiting && !c->to_run) {
    if (events & UV_WRITABLE) {
      write_unsent(c);
    }
    if (!c->closing && (events & UV_READABLE)) {
      read_more(c);
    }
    modbus_connection_run(c);
  }
}

/* ---- starting, stopping, time ------------------------------------------------------------------
 */

void modbus_connection_start(struct modbus_connection *c) {
  const int on = 1;
  const int bytes = SOCKET_BUFFER_BYTES;
  setsockopt(c->fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  setsockopt(c->fd, SOL_SOCKET, SO_RCVBUF, &bytes, sizeof bytes);
  setsockopt(c->fd, SOL_SOCKET, SO_SNDBUF, &bytes, sizeof bytes);
  modbus_service_remember(c->service, c);
  const int polled = uv_poll_init(loop_of(c), &c->poll, c->fd);
  c->poll.data = c;
  c->active_ms = uv_now(loop_of(c));
  if (polled != 0) {
    log_line(LOG_LEVEL_ERROR, "event=modbus-connection-failed reason=%s", uv_strerror(polled));
    c->closing = true;
    on_closed((uv_handle_t *)&c->poll);
    return;
  }
  set_events(c, UV_READABLE);
}

void modbus_connection_stop(struct modbus_connection *c) {
  int unread = 0;
  if (!c->lingering && ioctl(c->fd, FIONREAD, &unread) == 0) {
    c->unread = (unsigned)unread;
  }
  c->stopping = true;
  modbus_connection_run(c);
}

void modbus_connection_tick(struct modbus_connection *c, uint64_t now_ms) {
  const struct options *options = &c->service->server->options;
  if (c->closing) {
    return;
  }
  const bool late =
      c->frame_started_ms != 0 && now_ms - c->frame_started_ms > options->modbus_frame_timeout_ms;
  const uint64_t silence_ms = c->lingering ? LINGER_MS : options->modbus_idle_timeout_ms;
  if (late || now_ms - c->active_ms > silence_ms) {
    if (!c->lingering) {
      log_peer_line(LOG_LEVEL_INFO, "event=modbus-closed reason=%s",
                    late ? "frame-timeout" : "idle");
    }
    modbus_connection_abort(c);
  }
}
