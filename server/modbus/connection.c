#include "server/modbus/connection.h"

#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>

#include "server/net/tcp.h"
#include "server/net/worker.h"
#include "server/observe/log.h"

enum {
  HEADER_BYTES = 7, /* transaction, protocol, length and unit */
  LENGTH_MIN = 2,   /* least value of the field length: it counts the unit and the function */
  LENGTH_MAX = 254,
  /* The kernel's buffer in each direction. Without a limit, it grows to megabytes for a master that
   * does not read. With a limit far below the size of a segment, the kernel drops segments. */
  SOCKET_BUFFER_BYTES = 65536,
  LINGER_MS = 1000, /* how long the peer may take to close after the last reply */
};

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
  const uint8_t *reply = c->unsent + HEADER_BYTES;
  if (reply[0] >= 0x80) { /* tcp_peer() needs a system call */
    char peer[TCP_TEXT_BYTES];
    tcp_peer(c->fd, peer);
    modbus_log_refusal(frame + HEADER_BYTES, bytes - HEADER_BYTES, reply, frame[6], "peer", peer);
  }
}

/* ---- ending ---------------------------------------------------------------------------------- */

static void on_closed(void *owner) {
  struct modbus_connection *c = owner;
  stats_subtract(stats_of(c), STATS_MODBUS_CONNECTIONS_OPEN, 1);
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
    transport_close(&c->transport);
  }
}

static void on_failed(void *owner) {
  abort_connection(owner);
}

/* Ends the connection so that the peer can read the last reply. */
static void linger(struct modbus_connection *c) {
  c->active_ms = now_ms(c);
  transport_linger(&c->transport);
}

/* ---- writing --------------------------------------------------------------------------------- */

static bool has_unsent(const struct modbus_connection *c) {
  return c->unsent_begin < c->unsent_end;
}

static void wrote(struct modbus_connection *c, uint64_t bytes) {
  c->unsent_begin += (unsigned)bytes;
  c->active_ms = now_ms(c);
  stats_add(stats_of(c), STATS_SENT_BYTES, bytes);
}

/* Writes as much of the reply as the socket takes. */
static void write_unsent(struct modbus_connection *c) {
  while (has_unsent(c) && !c->transport.writing && !c->closing) {
    const uv_buf_t rest =
        uv_buf_init((char *)c->unsent + c->unsent_begin, c->unsent_end - c->unsent_begin);
    wrote(c, transport_write(&c->transport, &rest, 1));
  }
}

static void on_sent(void *owner, uint64_t bytes) {
  struct modbus_connection *c = owner;
  wrote(c, bytes);
  write_unsent(c);
  worker_run_later(&c->client);
}

/* ---- serving ------------------------------------------------------------------------------- */

/* Returns the unit of a number in a frame, or 0 if there is no such unit. Masters that know no
 * units send 0 or 255, which mean unit 1. */
static unsigned unit_of(uint8_t number) {
  return number == 0 || number == 255 ? 1 : number <= MODBUS_UNITS ? number : 0;
}

static unsigned frame_bytes(const uint8_t *frame) {
  return 6 + ((unsigned)frame[4] << 8 | frame[5]);
}

/* Sends the reply, whose PDU is already in c->unsent, and moves on to the next frame. */
static void send_reply(struct modbus_connection *c, size_t pdu_bytes) {
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

static void handle_frame(struct modbus_connection *c, const uint8_t *frame, size_t bytes) {
  struct modbus_unit *unit = NULL;
  const size_t replied_bytes =
      modbus_carry_out(c->units, &c->client, c->roles, unit_of(frame[6]), frame + HEADER_BYTES,
                       bytes - HEADER_BYTES, c->unsent + HEADER_BYTES, &unit);
  if (replied_bytes > 0) {
    log_refusal(c, frame, bytes);
    send_reply(c, replied_bytes);
  } else {
    c->waits_for = unit;
  }
}

/* Serves the frame whose commit has been evaluated. */
static void reply_late(struct modbus_connection *c) {
  const uint8_t *frame = c->input + c->begin;
  const size_t replied_bytes =
      modbus_late_reply(c->waits_for, frame + HEADER_BYTES, frame_bytes(frame) - HEADER_BYTES,
                        c->unsent + HEADER_BYTES);
  c->waits_for = NULL;
  send_reply(c, replied_bytes);
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

/* Serves the next frame. Returns false if it has not arrived completely. */
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
  handle_frame(c, frame, frame_bytes(frame));
  return true;
}

/* One turn: serves the frames that have arrived, up to the first whose job goes into the batch. */
static void run_turn(struct client *client) {
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

/* The input has room for the rest of any frame when all complete frames have been served. */
static size_t find_room(void *owner, uint8_t **room) {
  struct modbus_connection *c = owner;
  if (c->begin > 0) {
    memmove(c->input, c->input + c->begin, c->end - c->begin);
    c->end -= c->begin;
    c->begin = 0;
  }
  *room = c->input + c->end;
  return sizeof c->input - c->end;
}

static void on_received(void *owner, ssize_t bytes) {
  struct modbus_connection *c = owner;
  if (bytes == 0) {
    c->unread = 0;
  } else if (bytes > 0) {
    c->end += (unsigned)bytes;
    if (c->tls == NULL) {
      c->unread -= (unsigned)bytes < c->unread ? (unsigned)bytes : c->unread;
    }
    c->active_ms = now_ms(c);
    stats_add(stats_of(c), STATS_RECEIVED_BYTES, (uint64_t)bytes);
  } else {
    transport_set_reading(&c->transport, false);
    c->stopping |= bytes == UV_EOF;
    c->unread = bytes == UV_EOF ? 0 : c->unread;
  }
  worker_run_later(&c->client);
}

/* Reads on, or ends the connection, after a turn has served all frames that it can. */
static void read_on_or_end(struct modbus_connection *c) {
  if (has_unsent(c)) {
    transport_set_reading(&c->transport, false);
  } else if (c->ending || (c->stopping && c->unread == 0)) {
    linger(c);
  } else {
    note_partial_frame(c);
    transport_set_reading(&c->transport, true);
  }
}

/* Called after a turn, and when the unit for which the first frame waits has its results. Both may
 * happen in the same round. */
static void finish_turn(struct client *client) {
  struct modbus_connection *c = connection_of(client);
  if (c->waits_for != NULL) {
    if (c->waits_for->awaited != NULL) {
      return;
    }
    reply_late(c);
    if (!c->closing && c->begin < c->end) {
      worker_run_later(client);
    }
  }
  if (!c->closing && !c->transport.lingering && client->run_queue == NULL) {
    read_on_or_end(c);
  }
}

/* ---- starting, stopping, time ---------------------------------------------------------------- */

static void start_client(struct client *client) {
  struct modbus_connection *c = connection_of(client);
  static const struct transport_calls calls = {.room = find_room,
                                               .received = on_received,
                                               .sent = on_sent,
                                               .failed = on_failed,
                                               .closed = on_closed};
  const int bytes = SOCKET_BUFFER_BYTES;
  setsockopt(c->fd, SOL_SOCKET, SO_RCVBUF, &bytes, sizeof bytes);
  setsockopt(c->fd, SOL_SOCKET, SO_SNDBUF, &bytes, sizeof bytes);
  modbus_units_join(c->units);
  c->active_ms = now_ms(c);
  const int opened =
      transport_open(&c->transport, worker_loop(client->worker), c->fd, c->tls, &calls, c);
  if (opened != 0) {
    log_line(LOG_LEVEL_ERROR, "event=modbus-connection-failed reason=%s", uv_strerror(opened));
    abort_connection(c);
    return;
  }
  transport_set_reading(&c->transport, true);
}

/* Bytes that have arrived by now are still read. */
static void stop_client(struct client *client) {
  struct modbus_connection *c = connection_of(client);
  int unread = 1; /* with TLS it stays 1 until the transport tells that nothing is unread */
  if (c->closing) {
    return;
  }
  if (!c->transport.lingering && !c->stopping &&
      (c->tls != NULL || ioctl(c->fd, FIONREAD, &unread) == 0)) {
    c->unread = (unsigned)unread;
  }
  c->stopping = true;
  worker_run_later(client);
  if (c->unread > 0) {
    transport_tell_empty(&c->transport);
  }
}

static void abort_client(struct client *client) {
  abort_connection(connection_of(client));
}

static bool is_busy(const struct client *client) {
  const struct modbus_connection *c = (const struct modbus_connection *)(const void *)client;
  return !c->closing && (c->waits_for != NULL || has_unsent(c));
}

static void check_time(struct client *client, uint64_t time_ms) {
  struct modbus_connection *c = connection_of(client);
  const struct options *options = &c->units->server->options;
  if (c->closing) {
    return;
  }
  const bool late =
      c->frame_started_ms != 0 && time_ms - c->frame_started_ms > options->modbus_frame_timeout_ms;
  const uint64_t silence_ms = c->transport.lingering ? LINGER_MS : options->modbus_idle_timeout_ms;
  if (late || time_ms - c->active_ms > silence_ms) {
    if (!c->transport.lingering) {
      log_closed(c, late ? "frame-timeout" : "idle");
    }
    abort_connection(c);
  }
}

struct modbus_connection *modbus_connection_new(struct modbus_units *units, int fd,
                                                struct tls_session *session, unsigned roles) {
  static const struct client_kind kind = {
      .start = start_client,
      .run = run_turn,
      .finish = finish_turn,
      .tick = check_time,
      .stop = stop_client,
      .abort = abort_client,
      .busy = is_busy,
  };
  struct modbus_connection *c = calloc(1, sizeof *c);
  if (c != NULL) {
    c->client.kind = &kind;
    c->units = units;
    c->fd = fd;
    c->tls = session;
    c->roles = roles;
  }
  return c;
}
