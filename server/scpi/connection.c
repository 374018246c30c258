#include "server/scpi/connection.h"

#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/net/listener.h"
#include "server/net/tcp.h"
#include "server/net/worker.h"
#include "server/observe/log.h"

enum {
  READ_BYTES = 4096,   /* room for a read, at least */
  AHEAD_BYTES = 65536, /* the most bytes that are read behind a message that is being carried out */
  TURN_UNITS = 64,     /* the most units in one turn */
};

static struct scpi_connection *connection_of(struct client *client) {
  return (struct scpi_connection *)(void *)client;
}

/* ---- the end, and answers -------------------------------------------------------------------- */

static void free_connection(struct transport *t) {
  struct scpi_connection *c = (struct scpi_connection *)(void *)t;
  stats_subtract(&t->server->stats, STATS_SCPI_CONNECTIONS_OPEN, 1);
  text_free(&c->input);
  scpi_session_free(&c->session);
  free(c);
}

static void drop_tasks(struct transport *t) {
  for (int i = 0; i < SCPI_TASKS; i++) {
    call_drop(&((struct scpi_connection *)(void *)t)->session.tasks[i]);
  }
}

/* Returns whether answers have still to be written. Forgets them when they are. */
static bool has_unsent(struct scpi_connection *c) {
  if (c->answered && c->transport.unsent.len == 0) {
    c->answered = false;
    text_reset(&c->session.answers);
  }
  return c->answered;
}

/* ---- messages -------------------------------------------------------------------------------- */

/* Forgets the first message, of which nothing is left to be carried out, and sends its answers. */
static void end_message(struct scpi_connection *c) {
  stats_add(&c->transport.server->stats, STATS_SCPI_MESSAGES, 1);
  c->begin += c->message_bytes;
  c->message_bytes = c->at = 0;
  c->scan = (struct scpi_scan){0};
  if (c->begin == c->input.count) {
    c->begin = 0;
    text_reset(&c->input);
  }
  scpi_session_end_message(&c->session);
  c->answered = true;
  transport_send(&c->transport, c->session.answers.bytes, c->session.answers.count);
}

/* Drops what has arrived of a message that will not be carried out. */
static void drop_message(struct scpi_connection *c, int error, const char *what) {
  if (!c->skipping) {
    scpi_status_fail(&c->session.status, error, "message", what);
  }
  c->begin = c->scan.at = 0;
  text_free(&c->input);
}

/* Looks for the end of the first message. Returns whether it has arrived completely. */
static bool find_message(struct scpi_connection *c) {
  if (c->begin == c->input.count) {
    return false;
  }
  const char *from = c->input.bytes + c->begin;
  const size_t count = c->input.count - c->begin;
  if (c->message_bytes == 0 && count > c->scan.at && scpi_scan(&c->scan, from, count, '\n')) {
    c->message_bytes = c->scan.at;
    if (c->skipping) { /* This is the end of a message that was dropped. */
      c->skipping = false;
      c->at = c->message_bytes;
    }
  }
  if (c->message_bytes == 0 &&
      (c->skipping || count >= c->transport.server->options.max_part_bytes)) {
    drop_message(c, SCPI_OVERRUN, "up to max_part_bytes");
    c->skipping = true;
  } else if (c->message_bytes > c->transport.server->options.max_part_bytes && c->at == 0) {
    scpi_status_fail(&c->session.status, SCPI_OVERRUN, "message", "up to max_part_bytes");
    c->at = c->message_bytes;
  }
  return c->message_bytes > 0;
}

/* Returns whether there is a unit that can be carried out. */
static bool can_go_on(struct scpi_connection *c) {
  return !c->transport.closing && !c->transport.lingering && !has_unsent(c) &&
         c->session.waits_for == NULL && !c->session.held && find_message(c);
}

/* One turn: lets jobs go on, and carries out units up to the first that waits. */
static void run_turn(struct client *client) {
  struct scpi_connection *c = connection_of(client);
  uint64_t budget = JOB_SLICE_RADII;
  if (c->transport.closing) {
    return;
  }
  scpi_session_run(&c->session, &budget);
  for (int i = 0; i < TURN_UNITS && can_go_on(c); i++) {
    if (c->at == c->message_bytes ||
        !scpi_session_step(&c->session, c->input.bytes + c->begin, c->message_bytes - 1, &c->at)) {
      end_message(c);
    }
  }
  if (can_go_on(c)) {
    worker_run_later(client);
  }
}

/* ---- reading --------------------------------------------------------------------------------- */

static size_t find_room(struct transport *t, uint8_t **room) {
  struct scpi_connection *c = (struct scpi_connection *)(void *)t;
  if (c->begin > 0) {
    memmove(c->input.bytes, c->input.bytes + c->begin, c->input.count - c->begin);
    c->input.count -= c->begin;
    c->begin = 0;
  }
  *room = (uint8_t *)text_room(&c->input, READ_BYTES);
  if (*room == NULL && c->message_bytes == 0) {
    drop_message(c, SCPI_NO_MEMORY, "later: the buffers of all connections are full");
    c->skipping = true;
    *room = (uint8_t *)text_room(&c->input, READ_BYTES);
  }
  return *room != NULL ? c->input.capacity - c->input.count : 0;
}

/* Where the peer's stream ends, so does its last message (END of IEEE 488.2). */
static void on_received(struct transport *t, ssize_t bytes) {
  struct scpi_connection *c = (struct scpi_connection *)(void *)t;
  c->input.count += bytes > 0 ? (size_t)bytes : 0;
  if (t->peer_done && c->input.count > c->begin && c->input.bytes[c->input.count - 1] != '\n') {
    text_add(&c->input, "\n", 1);
  }
  worker_run_later(&t->client);
}

/* Reads on, or ends the connection, after a turn has carried out all units that it can. */
static void read_on_or_end(struct scpi_connection *c) {
  struct transport *t = &c->transport;
  if (t->peer_done && c->session.held) {
    scpi_session_stop(&c->session, true); /* Nobody is there who waits for the jobs. */
    worker_run_later(&t->client);
    return;
  }
  const bool sends = has_unsent(c), waits = sends || c->message_bytes > 0;
  if (!waits && (t->peer_done || (t->stopping && t->unread == 0))) {
    scpi_session_stop(&c->session, true);
    transport_linger(t);
    return;
  }
  const bool ahead = c->input.count - c->begin - c->message_bytes >= AHEAD_BYTES;
  transport_set_reading(t, !t->peer_done && !sends && !(waits && ahead));
}

/* Called after a turn, and when the batch has been evaluated. */
static void finish_turn(struct client *client) {
  struct scpi_connection *c = connection_of(client);
  if (c->transport.closing) {
    return;
  }
  const bool ran = c->session.waits_for != NULL || c->session.held;
  if (!scpi_session_finish(&c->session)) {
    c->at = c->message_bytes;
  }
  if (ran && c->session.waits_for == NULL && !c->session.held) {
    c->transport.active_ms = transport_now_ms(&c->transport);
    worker_run_later(client);
  }
  if (!c->transport.lingering && client->run_queue == NULL) {
    read_on_or_end(c);
  }
}

/* ---- starting, stopping, time ---------------------------------------------------------------- */

static void start_client(struct client *client) {
  if (transport_open(transport_of(client))) {
    transport_set_reading(transport_of(client), true);
  }
}

static void stop_client(struct client *client) {
  struct scpi_connection *c = connection_of(client);
  if (!c->transport.closing) {
    scpi_session_stop(&c->session, false);
  }
  transport_drain(client);
}

static bool is_busy(const struct client *client) {
  const struct scpi_connection *c = (const struct scpi_connection *)(const void *)client;
  return !c->transport.closing && (c->transport.unsent.len > 0 || c->message_bytes > 0);
}

static void check_time(struct client *client, uint64_t time_ms) {
  struct scpi_connection *c = connection_of(client);
  const struct options *options = &c->transport.server->options;
  const uint64_t silence_ms = time_ms - c->transport.active_ms;
  if (transport_is_over(&c->transport, time_ms)) {
    return;
  }
  if (c->message_bytes == 0 && (c->input.count > c->begin || c->skipping) &&
      silence_ms > options->frame_timeout_ms) {
    drop_message(c, SCPI_TIME_OUT, "one that ends with a newline");
    c->skipping = false;
    c->scan = (struct scpi_scan){0};
  }
  const bool works =
      !has_unsent(c) && (c->session.waits_for != NULL || scpi_session_measures(&c->session));
  if (!works && silence_ms > options->idle_timeout_ms) {
    transport_log_end(&c->transport, "idle");
    transport_abort(&c->transport);
  }
}

struct scpi_connection *scpi_connection_new(struct server *server, int fd) {
  static const struct transport_calls calls = {.name = "scpi-",
                                               .room = find_room,
                                               .received = on_received,
                                               .dropped = drop_tasks,
                                               .closed = free_connection};
  static const struct client_kind kind = {
      .start = start_client,
      .run = run_turn,
      .finish = finish_turn,
      .tick = check_time,
      .stop = stop_client,
      .abort = transport_abort_client,
      .busy = is_busy,
      .counts = true,
  };
  struct scpi_connection *c = calloc(1, sizeof *c);
  if (c != NULL) {
    transport_init(&c->transport, &kind, &calls, server, fd, NULL);
    text_init(&c->input, &server->buffers);
    scpi_session_init(&c->session, &c->transport.client, server);
  }
  return c;
}

void scpi_connection_admit(struct server *server, int fd) {
  const uint64_t open = stats_get(&server->stats, STATS_SCPI_CONNECTIONS_OPEN);
  const char *why = !access_allows_peer(&server->scpi_allow, fd)   ? "not-allowed"
                    : open >= server->options.max_scpi_connections ? "max-scpi-connections"
                                                                   : NULL;
  struct scpi_connection *connection = why == NULL ? scpi_connection_new(server, fd) : NULL;
  if (connection == NULL) {
    char peer[TCP_TEXT_BYTES];
    tcp_peer(fd, peer);
    log_peer_line(LOG_LEVEL_INFO, "event=scpi-refused reason=%s%s%s",
                  why != NULL ? why : "out-of-memory", LOG_FIELD(" peer=", peer));
    stats_add(&server->stats, STATS_SCPI_CONNECTIONS_REFUSED, 1);
    close(fd);
    return;
  }
  stats_add(&server->stats, STATS_SCPI_CONNECTIONS_ACCEPTED, 1);
  stats_add(&server->stats, STATS_SCPI_CONNECTIONS_OPEN, 1);
  worker_give(worker_least_busy(server), &connection->transport.client);
}
