#include "server/modbus/connection.h"

#include <errno.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include "server/net/tcp.h"
#include "server/net/worker.h"
#include "server/observe/log.h"

enum {
  HEADER_BYTES = 7, /* transaction, protocol, length, unit */
  LENGTH_MIN = 2,   /* least value of the field length: it counts the unit and the function */
  LENGTH_MAX = 254,
  /* The kernel's buffer in each direction. Without a limit, it grows to megabytes for a master that
   * does not read. With a limit far below the size of a segment, the kernel drops segments. */
  SOCKET_BUFFER_BYTES = 65536,
  LINGER_MS = 1000, /* how long the peer may take to close after the last answer */
};

static void on_poll(uv_poll_t *poll, int status, int events);

static struct modbus_connection *connection_of(struct client *client) {
  return (struct modbus_connection *)(void *)client;
}

static uint64_t now_ms(const struct modbus_connection *c) {
  return uv_now(worker_loop(c->client.worker));
}

static struct stats *stats_of(const struct modbus_connection *c) {
  return &c->units->server->stats;
}

static void log_closed(const struct modbus_connection *c, const char *reason) {
  char peer[TCP_TEXT_BYTES];
  tcp_peer(c->fd, peer);
  log_peer_line(LOG_LEVEL_INFO, "event=modbus-closed reason=%s%s%s", reason,
                LOG_FIELD(" peer=", peer));
}

static void log_refusal(const struct modbus_connection *c, const uint8_t *frame, size_t bytes) {
  const uint8_t *answer = c->unsent + HEADER_BYTES;
  if (answer[0] >= 0x80) { /* tcp_peer() takes a system call */
    char peer[TCP_TEXT_BYTES];
    tcp_peer(c->fd, peer);
    modbus_answer_log(frame + HEADER_BYTES, bytes - HEADER_BYTES, answer, frame[6], "peer", peer);
  }
}

/* ---- ending ---------------------------------------------------------------------------------- */

static void on_closed(uv_handle_t *handle) {
  struct modbus_connection *c = handle->data;
  stats_subtract(stats_of(c), STATS_MODBUS_CONNECTIONS_OPEN, 1);
  if (c->tls != NULL) {
    tls_session_free(c->tls);
  }
  free(c->may.rights);
  close(c->fd);
  worker_forget(&c->client);
  modbus_units_leave(c->units, &c->client);
  free(c);
}

static void abort_connection(struct modbus_connection *c) {
  if (!c->closing) {
    c->closing = true;
    if (c->waits_for != NULL) {
      modbus_unit_forget(c->waits_for, &c->client);
      c->waits_for = NULL;
    }
    uv_close((uv_handle_t *)&c->poll, on_closed);
  }
}

/* Sets the events that the poll waits for. A change takes a system call. */
static void set_events(struct modbus_connection *c, int events) {
  if (c->closing || c->events == events) {
    return;
  }
  c->events = events;
  if (events == 0) {
    uv_poll_stop(&c->poll);
  } else if (uv_poll_start(&c->poll, events, on_poll) != 0) {
    abort_connection(c);
  }
}

/* Ends the connection so that the peer can read the last answer. Closing a socket with unread bytes
 * would reset the connection, and the peer might lose that answer. So the connection reads and
 * drops bytes until the peer closes. */
static void linger(struct modbus_connection *c) {
  if (c->tls != NULL) {
    tls_session_end(c->tls);
  }
  if (shutdown(c->fd, SHUT_WR) != 0) {
    abort_connection(c);
    return;
  }
  c->lingering = true;
  c->active_ms = now_ms(c);
  set_events(c, UV_READABLE);
}

/* ---- the socket: results are those of send() and recv(), and errors negative ------------------ */

static ssize_t send_some(const struct modbus_connection *c, const uint8_t *from, size_t bytes) {
  if (c->tls != NULL) {
    return tls_session_write(c->tls, from, bytes);
  }
  const ssize_t sent = send(c->fd, from, bytes, MSG_NOSIGNAL);
  return sent < 0 ? uv_translate_sys_error(errno) : sent;
}

static ssize_t receive_some(struct modbus_connection *c, uint8_t *to, size_t bytes) {
  if (c->tls == NULL) {
    const ssize_t got = recv(c->fd, to, bytes, 0);
    return got < 0 ? uv_translate_sys_error(errno) : got;
  }
  const ssize_t got = tls_session_read(c->tls, to, bytes);
  c->has_more = got >= 0;
  return got == UV_EOF ? 0 : got == 0 ? UV_EAGAIN : got;
}

/* ---- writing --------------------------------------------------------------------------------- */

static bool has_unsent(const struct modbus_connection *c) {
  return c->unsent_begin < c->unsent_end;
}

/* Writes as much of the answer as the socket takes. */
static void write_unsent(struct modbus_connection *c) {
  while (has_unsent(c)) {
    const ssize_t sent =
        send_some(c, c->unsent + c->unsent_begin, c->unsent_end - c->unsent_begin);
    if (sent > 0) {
      c->unsent_begin += (unsigned)sent;
      c->active_ms = now_ms(c);
      stats_add(stats_of(c), STATS_SENT_BYTES, (uint64_t)sent);
    } else if (sent == UV_EAGAIN) {
      return;
    } else if (sent < 0 && sent != UV_EINTR) {
      abort_connection(c);
      return;
    }
  }
}

/* ---- answering ------------------------------------------------------------------------------- */

/* Returns the unit of a number in a frame, or 0 if there is no such unit. Masters that know no
 * units send 0 or 255, which mean unit 1. */
static unsigned unit_of(uint8_t number) {
  return number == 0 || number == 255 ? 1 : number <= MODBUS_UNITS ? number : 0;
}

static unsigned frame_bytes(const uint8_t *frame) {
  return 6 + ((unsigned)frame[4] << 8 | frame[5]);
}

/* Sends the answer, whose PDU is already in c->unsent, and goes on to the next frame. */
static void send_answer(struct modbus_connection *c, size_t pdu_bytes) {
  const uint8_t *frame = c->input + c->begin;
  const size_t length = 1 + pdu_bytes;
  memcpy(c->unsent, frame, HEADER_BYTES);
  c->unsent[4] = (uint8_t)(length >> 8);
  c->unsent[5] = (uint8_t)length;
  c->unsent_begin = 0;
  c->unsent_end = (unsigned)(HEADER_BYTES + pdu_bytes);
  c->begin += frame_bytes(frame);
  c->frame_started_ms = 0;
  if (c->begin == c->end) {
    c->begin = c->end = 0;
  }
  write_unsent(c);
}

static void answer_frame(struct modbus_connection *c, const uint8_t *frame, size_t bytes) {
  struct modbus_unit *unit = NULL;
  const size_t answered =
      modbus_answer(c->units, &c->client, &c->may, unit_of(frame[6]), frame + HEADER_BYTES,
                    bytes - HEADER_BYTES, c->unsent + HEADER_BYTES, &unit);
  if (answered > 0) {
    log_refusal(c, frame, bytes);
    send_answer(c, answered);
  } else {
    c->waits_for = unit;
  }
}

/* Answers the frame whose commit has been evaluated. */
static void answer_late(struct modbus_connection *c) {
  const uint8_t *frame = c->input + c->begin;
  const size_t answered =
      modbus_answer_late(c->waits_for, frame + HEADER_BYTES, frame_bytes(frame) - HEADER_BYTES,
                         c->unsent + HEADER_BYTES);
  c->waits_for = NULL;
  send_answer(c, answered);
}

/* Ends the connection after bytes that are no frame: where the next frame begins is unknown. */
static void lose_framing(struct modbus_connection *c) {
  log_closed(c, "bad-frame");
  stats_add(stats_of(c), STATS_MODBUS_BAD_FRAMES, 1);
  c->begin = c->end = 0;
  c->frame_started_ms = 0;
  c->ending = true;
}

/* Returns whether these bytes can be the start of a frame. */
static bool is_frame(const uint8_t *frame, unsigned bytes) {
  if (bytes >= 4 && (frame[2] != 0 || frame[3] != 0)) {
    return false;
  }
  const unsigned length = bytes >= 6 ? frame_bytes(frame) - 6 : LENGTH_MIN;
  return length >= LENGTH_MIN && length <= LENGTH_MAX &&
         (bytes <= HEADER_BYTES || frame[HEADER_BYTES] < 0x80);
}

/* Answers the next frame. Returns false if it has not arrived completely. */
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

/* One turn: answers the frames that have arrived, up to the first whose job goes into the batch. */
static void run(struct client *client) {
  struct modbus_connection *c = connection_of(client);
  while (!c->closing && !c->ending && c->waits_for == NULL && !has_unsent(c) && c->begin < c->end &&
         take_frame(c)) {
  }
}

/* Notes when an incomplete frame began to arrive. Its time counts only while the connection reads,
 * so that the peer could send the rest. */
static void note_partial_frame(struct modbus_connection *c) {
  if (c->begin == c->end) {
    c->frame_started_ms = 0;
  } else if (c->frame_started_ms == 0) {
    c->frame_started_ms = now_ms(c);
  }
}

/* ---- reading --------------------------------------------------------------------------------- */

static void discard(struct modbus_connection *c) {
  const ssize_t got = recv(c->fd, c->input, sizeof c->input, 0);
  if (got == 0 || (got < 0 && errno != EAGAIN && errno != EINTR)) {
    abort_connection(c);
  }
}

/* Reads as many bytes as the input has room for. It has room for the rest of any frame, because all
 * complete frames have been answered and removed. */
static void read_more(struct modbus_connection *c) {
  if (c->begin > 0) {
    memmove(c->input, c->input + c->begin, c->end - c->begin);
    c->end -= c->begin;
    c->begin = 0;
  }
  const size_t room = sizeof c->input - c->end;
  const size_t wanted = c->unread > 0 && c->unread < room ? c->unread : room;
  const ssize_t got = receive_some(c, c->input + c->end, wanted);
  c->unread -= got > 0 && (size_t)got < c->unread ? (unsigned)got : c->unread;
  if (got > 0) {
    c->end += (unsigned)got;
    c->active_ms = now_ms(c);
    stats_add(stats_of(c), STATS_RECEIVED_BYTES, (uint64_t)got);
  } else if (got == 0) {
    c->stopping = true;
  } else if (got != UV_EAGAIN && got != UV_EINTR) {
    abort_connection(c);
  }
}

/* Sets the events that the poll waits for, after a turn has answered all frames that it can. */
static void await_events(struct modbus_connection *c) {
  if (has_unsent(c)) {
    set_events(c, UV_WRITABLE);
  } else if ((c->unread > 0 || c->has_more) && !c->ending) {
    read_more(c);
    worker_run_later(&c->client);
  } else if (c->ending || c->stopping) {
    linger(c);
  } else {
    note_partial_frame(c);
    set_events(c, c->tls != NULL && tls_session_is_blocked(c->tls) ? UV_WRITABLE : UV_READABLE);
  }
}

/* Called after a turn, and when the unit for which the first frame waits has its results. Both may
 * happen in the same round. */
static void finish(struct client *client) {
  struct modbus_connection *c = connection_of(client);
  if (c->waits_for != NULL) {
    if (c->waits_for->evaluating) {
      return;
    }
    answer_late(c);
    if (!c->closing && c->begin < c->end) {
      worker_run_later(client);
    }
  }
  if (!c->closing && !c->lingering && client->run_queue == NULL) {
    await_events(c);
  }
}

static void on_poll(uv_poll_t *poll, int status, int events) {
  struct modbus_connection *c = poll->data;
  if (status < 0) {
    abort_connection(c);
  } else if (c->lingering) {
    discard(c);
  } else if (c->client.run_queue == NULL) {
    if (events & UV_WRITABLE) {
      c->has_more = c->tls != NULL; /* Reading may have had to answer an update of keys first. */
      write_unsent(c);
    }
    if (!c->closing && (events & UV_READABLE)) {
      read_more(c);
    }
    if (!c->closing) {
      worker_run_later(&c->client);
    }
  }
}

/* ---- starting, stopping, time ---------------------------------------------------------------- */

static void start(struct client *client) {
  struct modbus_connection *c = connection_of(client);
  const int on = 1;
  const int bytes = SOCKET_BUFFER_BYTES;
  setsockopt(c->fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  setsockopt(c->fd, SOL_SOCKET, SO_RCVBUF, &bytes, sizeof bytes);
  setsockopt(c->fd, SOL_SOCKET, SO_SNDBUF, &bytes, sizeof bytes);
  modbus_units_join(c->units);
  const int polled = uv_poll_init(worker_loop(client->worker), &c->poll, c->fd);
  c->poll.data = c;
  c->active_ms = now_ms(c);
  if (polled != 0) {
    log_line(LOG_LEVEL_ERROR, "event=modbus-connection-failed reason=%s", uv_strerror(polled));
    c->closing = true;
    on_closed((uv_handle_t *)&c->poll);
    return;
  }
  set_events(c, UV_READABLE);
  if (c->tls != NULL) { /* The handshake may have read the first request. */
    c->has_more = true;
    worker_run_later(client);
  }
}

static void stop(struct client *client) {
  struct modbus_connection *c = connection_of(client);
  int unread = 0;
  if (c->tls != NULL) {
    c->has_more = true;
  } else if (!c->lingering && ioctl(c->fd, FIONREAD, &unread) == 0) {
    c->unread = (unsigned)unread;
  }
  c->stopping = true;
  if (!c->closing) {
    worker_run_later(client);
  }
}

static void abort_client(struct client *client) {
  abort_connection(connection_of(client));
}

static unsigned count_requests(const struct client *client) {
  const struct modbus_connection *c = (const struct modbus_connection *)(const void *)client;
  return !c->closing && (c->waits_for != NULL || has_unsent(c)) ? 1 : 0;
}

static void tick(struct client *client, uint64_t time_ms) {
  struct modbus_connection *c = connection_of(client);
  const struct options *options = &c->units->server->options;
  if (c->closing) {
    return;
  }
  const bool late =
      c->frame_started_ms != 0 && time_ms - c->frame_started_ms > options->modbus_frame_timeout_ms;
  const uint64_t silence_ms = c->lingering ? LINGER_MS : options->modbus_idle_timeout_ms;
  if (late || time_ms - c->active_ms > silence_ms) {
    if (!c->lingering) {
      log_closed(c, late ? "frame-timeout" : "idle");
    }
    abort_connection(c);
  }
}

struct modbus_connection *modbus_connection_new(struct modbus_units *units, int fd,
                                                struct tls_session *session,
                                                const struct modbus_permissions *may) {
  static const struct client_kind kind = {
      .start = start,
      .run = run,
      .finish = finish,
      .tick = tick,
      .stop = stop,
      .abort = abort_client,
      .count = count_requests,
  };
  struct modbus_connection *c = calloc(1, sizeof *c);
  if (c != NULL) {
    c->client.kind = &kind;
    c->units = units;
    c->fd = fd;
    c->tls = session;
    c->may = *may;
  }
  return c;
}
