#include "server/modbus/connection.h"

#include <stdlib.h>
#include <string.h>
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
};

static struct modbus_connection *connection_of(struct client *client) {
  return (struct modbus_connection *)(void *)client;
}

static void log_refusal(const struct modbus_connection *c, const uint8_t *frame, size_t bytes) {
  const uint8_t *reply = c->reply + HEADER_BYTES;
  if (reply[0] >= 0x80) { /* tcp_peer() needs a system call */
    char peer[TCP_TEXT_BYTES];
    tcp_peer(c->transport.fd, peer);
    modbus_log_refusal(frame + HEADER_BYTES, bytes - HEADER_BYTES, reply, frame[6], "peer", peer);
  }
}

/* ---- ending ---------------------------------------------------------------------------------- */

static void free_connection(struct transport *t) {
  struct modbus_connection *c = (struct modbus_connection *)(void *)t;
  stats_subtract(&t->server->stats, STATS_MODBUS_CONNECTIONS_OPEN, 1);
  modbus_units_leave(c->units, &t->client);
  free(c);
}

static void drop_frame(struct transport *t) {
  struct modbus_connection *c = (struct modbus_connection *)(void *)t;
  if (c->waits_for != NULL) {
    modbus_unit_forget(c->waits_for, &t->client);
    c->waits_for = NULL;
  }
}

static bool has_unsent(const struct modbus_connection *c) {
  return c->transport.unsent.len > 0;
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

/* Sends the reply, whose PDU is already in c->reply, and moves on to the next frame. */
static void send_reply(struct modbus_connection *c, size_t pdu_bytes) {
  const uint8_t *frame = c->input + c->begin;
  const size_t length = 1 + pdu_bytes;
  memcpy(c->reply, frame, HEADER_BYTES);
  c->reply[4] = (uint8_t)(length >> 8);
  c->reply[5] = (uint8_t)length;
  c->begin += frame_bytes(frame);
  c->frame_started_ms = 0;
  if (c->begin == c->end) {
    c->begin = c->end = 0;
  }
  transport_send(&c->transport, c->reply, HEADER_BYTES + pdu_bytes);
}

static void handle_frame(struct modbus_connection *c, const uint8_t *frame, size_t bytes) {
  struct modbus_unit *unit = NULL;
  const size_t replied_bytes =
      modbus_carry_out(c->units, &c->transport.client, c->roles, unit_of(frame[6]),
                       frame + HEADER_BYTES, bytes - HEADER_BYTES, c->reply + HEADER_BYTES, &unit);
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
                        c->reply + HEADER_BYTES);
  c->waits_for = NULL;
  send_reply(c, replied_bytes);
}

/* Ends the connection after bytes that are no frame: where the next frame begins is unknown. */
static void lose_framing(struct modbus_connection *c) {
  transport_log_end(&c->transport, "bad-frame");
  stats_add(&c->transport.server->stats, STATS_MODBUS_BAD_FRAMES, 1);
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
  while (!c->transport.closing && !c->ending && c->waits_for == NULL && !has_unsent(c) &&
         c->begin < c->end && take_frame(c)) {
  }
}

/* Notes when an incomplete frame began to arrive. Its time counts only while the connection reads,
 * so that the peer could send the rest. */
static void note_partial_frame(struct modbus_connection *c) {
  if (c->begin == c->end) {
    c->frame_started_ms = 0;
  } else if (c->frame_started_ms == 0) {
    c->frame_started_ms = transport_now_ms(&c->transport);
  }
}

/* ---- reading --------------------------------------------------------------------------------- */

/* The input has room for the rest of any frame when all complete frames have been served. */
static size_t find_room(struct transport *t, uint8_t **room) {
  struct modbus_connection *c = (struct modbus_connection *)(void *)t;
  if (c->begin > 0) {
    memmove(c->input, c->input + c->begin, c->end - c->begin);
    c->end -= c->begin;
    c->begin = 0;
  }
  *room = c->input + c->end;
  return sizeof c->input - c->end;
}

static void on_received(struct transport *t, ssize_t bytes) {
  struct modbus_connection *c = (struct modbus_connection *)(void *)t;
  c->end += bytes > 0 ? (unsigned)bytes : 0;
  worker_run_later(&t->client);
}

/* Reads on, or ends the connection, after a turn has served all frames that it can. */
static void read_on_or_end(struct modbus_connection *c) {
  struct transport *t = &c->transport;
  if (has_unsent(c)) {
    transport_set_reading(t, false);
  } else if (c->ending || t->peer_done || (t->stopping && t->unread == 0)) {
    transport_linger(t);
  } else {
    note_partial_frame(c);
    transport_set_reading(t, true);
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
    if (!c->transport.closing && c->begin < c->end) {
      worker_run_later(client);
    }
  }
  if (!c->transport.closing && !c->transport.lingering && client->run_queue == NULL) {
    read_on_or_end(c);
  }
}

/* ---- starting, stopping, time ---------------------------------------------------------------- */

static void start_client(struct client *client) {
  struct modbus_connection *c = connection_of(client);
  const int bytes = SOCKET_BUFFER_BYTES;
  setsockopt(c->transport.fd, SOL_SOCKET, SO_RCVBUF, &bytes, sizeof bytes);
  setsockopt(c->transport.fd, SOL_SOCKET, SO_SNDBUF, &bytes, sizeof bytes);
  c->units->users++;
  if (transport_open(&c->transport)) {
    transport_set_reading(&c->transport, true);
  }
}

static bool is_busy(const struct client *client) {
  const struct modbus_connection *c = (const struct modbus_connection *)(const void *)client;
  return !c->transport.closing && (c->waits_for != NULL || has_unsent(c));
}

static void check_time(struct client *client, uint64_t time_ms) {
  struct modbus_connection *c = connection_of(client);
  const struct options *options = &c->transport.server->options;
  if (transport_is_over(&c->transport, time_ms)) {
    return;
  }
  const bool late =
      c->frame_started_ms != 0 && time_ms - c->frame_started_ms > options->modbus_frame_timeout_ms;
  if (late || time_ms - c->transport.active_ms > options->modbus_idle_timeout_ms) {
    transport_log_end(&c->transport, late ? "frame-timeout" : "idle");
    transport_abort(&c->transport);
  }
}

struct modbus_connection *modbus_connection_new(struct modbus_units *units, int fd,
                                                struct tls_session *session, unsigned roles) {
  static const struct transport_calls calls = {.name = "modbus-",
                                               .room = find_room,
                                               .received = on_received,
                                               .dropped = drop_frame,
                                               .closed = free_connection};
  static const struct client_kind kind = {
      .start = start_client,
      .run = run_turn,
      .finish = finish_turn,
      .tick = check_time,
      .stop = transport_drain,
      .abort = transport_abort_client,
      .busy = is_busy,
  };
  struct modbus_connection *c = calloc(1, sizeof *c);
  if (c != NULL) {
    transport_init(&c->transport, &kind, &calls, units->server, fd, session);
    c->units = units;
    c->roles = roles;
  }
  return c;
}
