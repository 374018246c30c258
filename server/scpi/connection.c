#include "server/scpi/connection.h"

#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>

#include "server/net/tcp.h"
#include "server/net/worker.h"
#include "server/observe/log.h"

enum {
  READ_BYTES = 4096,   /* room for a read, at least */
  AHEAD_BYTES = 65536, /* the most bytes that are read behind a message that is being carried out */
  TURN_UNITS = 64,     /* the most units in one turn */
  LINGER_MS = 1000,    /* how long the peer may take to close after the last answer */
};

static struct scpi_connection *connection_of(struct client *client) {
  return (struct scpi_connection *)(void *)client;
}

static uint64_t now_ms(const struct scpi_connection *c) {
  return uv_now(worker_loop(c->client.worker));
}

/* ---- ending ---------------------------------------------------------------------------------- */

static void on_closed(void *owner) {
  struct scpi_connection *c = owner;
  stats_subtract(&c->server->stats, STATS_SCPI_CONNECTIONS_OPEN, 1);
  worker_forget(&c->client);
  text_free(&c->input);
  scpi_session_free(&c->session);
  free(c);
}

static void abort_connection(struct scpi_connection *c) {
  if (!c->closing) {
    c->closing = true;
    for (int i = 0; i < SCPI_TASKS; i++) {
      scpi_task_drop(&c->session.tasks[i]);
    }
    transport_close(&c->transport);
  }
}

static void on_failed(void *owner) {
  abort_connection(owner);
}

static void log_closed(const struct scpi_connection *c, const char *reason) {
  char peer[TCP_TEXT_BYTES];
  tcp_peer(c->fd, peer);
  log_peer_line(LOG_LEVEL_INFO, "event=scpi-closed reason=%s%s%s", reason,
                LOG_FIELD(" peer=", peer));
}

/* ---- writing --------------------------------------------------------------------------------- */

static void wrote(struct scpi_connection *c, uint64_t bytes) {
  c->sent_bytes += (size_t)bytes;
  c->active_ms = now_ms(c);
  stats_add(&c->server->stats, STATS_SENT_BYTES, bytes);
  if (c->sent_bytes == c->session.answers.count) {
    c->answered = false;
    c->sent_bytes = 0;
    text_reset(&c->session.answers);
  }
}

/* Writes as much of the answers as the socket takes. */
static void write_answers(struct scpi_connection *c) {
  while (c->answered && !c->transport.writing && !c->closing) {
    const struct text *answers = &c->session.answers;
    const uv_buf_t rest =
        uv_buf_init(answers->bytes + c->sent_bytes, (unsigned)(answers->count - c->sent_bytes));
    wrote(c, transport_write(&c->transport, &rest, 1));
  }
}

static void on_sent(void *owner, uint64_t bytes) {
  struct scpi_connection *c = owner;
  wrote(c, bytes);
  write_answers(c);
  worker_run_later(&c->client);
}

/* ---- messages -------------------------------------------------------------------------------- */

/* Forgets the first message, of which nothing is left to be carried out, and sends its answers. */
static void end_message(struct scpi_connection *c) {
  stats_add(&c->server->stats, STATS_SCPI_MESSAGES, 1);
  c->begin += c->message_bytes;
  c->message_bytes = c->at = 0;
  c->scan = (struct scpi_scan){0};
  if (c->begin == c->input.count) {
    c->begin = 0;
    text_reset(&c->input);
  }
  scpi_session_end_message(&c->session);
  c->answered = c->session.answers.count > 0;
  write_answers(c);
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
  if (c->message_bytes == 0 && (c->skipping || count >= c->server->options.max_part_bytes)) {
    drop_message(c, SCPI_OVERRUN, "up to max_part_bytes");
    c->skipping = true;
  } else if (c->message_bytes > c->server->options.max_part_bytes && c->at == 0) {
    scpi_status_fail(&c->session.status, SCPI_OVERRUN, "message", "up to max_part_bytes");
    c->at = c->message_bytes;
  }
  return c->message_bytes > 0;
}

/* Returns whether there is a unit that can be carried out. */
static bool can_go_on(struct scpi_connection *c) {
  return !c->closing && !c->transport.lingering && !c->answered && c->session.waits_for == NULL &&
         !c->session.held && find_message(c);
}

/* One turn: lets jobs go on, and carries out units up to the first that waits. */
static void run_turn(struct client *client) {
  struct scpi_connection *c = connection_of(client);
  uint64_t budget = JOB_SLICE_RADII;
  if (c->closing) {
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

static size_t find_room(void *owner, uint8_t **room) {
  struct scpi_connection *c = owner;
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

static void on_received(void *owner, ssize_t bytes) {
  struct scpi_connection *c = owner;
  if (bytes > 0) {
    c->input.count += (size_t)bytes;
    c->unread -= (unsigned)bytes < c->unread ? (unsigned)bytes : c->unread;
    c->active_ms = now_ms(c);
    stats_add(&c->server->stats, STATS_RECEIVED_BYTES, (uint64_t)bytes);
  } else if (bytes < 0) {
    transport_set_reading(&c->transport, false);
    c->left |= bytes == UV_EOF;
    c->unread = 0;
  }
  worker_run_later(&c->client);
}

/* Reads on, or ends the connection, after a turn has carried out all units that it can. */
static void read_on_or_end(struct scpi_connection *c) {
  if (c->left && c->session.held) {
    scpi_session_stop(&c->session, true); /* Nobody is there who waits for the jobs. */
    worker_run_later(&c->client);
    return;
  }
  const bool waits = c->answered || c->message_bytes > 0;
  if (!waits && (c->left || (c->stopping && c->unread == 0))) {
    scpi_session_stop(&c->session, true);
    c->active_ms = now_ms(c);
    transport_linger(&c->transport);
    return;
  }
  const bool ahead = c->input.count - c->begin - c->message_bytes >= AHEAD_BYTES;
  transport_set_reading(&c->transport, !c->left && !c->answered && !(waits && ahead));
}

/* Called after a turn, and when the batch has been evaluated. */
static void finish_turn(struct client *client) {
  struct scpi_connection *c = connection_of(client);
  if (c->closing) {
    return;
  }
  const bool ran = c->session.waits_for != NULL || c->session.held;
  if (!scpi_session_finish(&c->session)) {
    c->at = c->message_bytes;
  }
  if (ran && c->session.waits_for == NULL && !c->session.held) {
    c->active_ms = now_ms(c);
    worker_run_later(client);
  }
  if (!c->transport.lingering && client->run_queue == NULL) {
    read_on_or_end(c);
  }
}

/* ---- starting, stopping, time ---------------------------------------------------------------- */

static void start_client(struct client *client) {
  struct scpi_connection *c = connection_of(client);
  static const struct transport_calls calls = {.room = find_room,
                                               .received = on_received,
                                               .sent = on_sent,
                                               .failed = on_failed,
                                               .closed = on_closed};
  c->active_ms = now_ms(c);
  if (transport_open(&c->transport, worker_loop(client->worker), c->fd, NULL, &calls, c) != 0) {
    abort_connection(c);
    return;
  }
  transport_set_reading(&c->transport, true);
}

/* Bytes that have arrived by now are still read. */
static void stop_client(struct client *client) {
  struct scpi_connection *c = connection_of(client);
  int unread = 0;
  if (c->closing) {
    return;
  }
  const bool reads = !c->transport.lingering && !c->left;
  c->unread = reads && ioctl(c->fd, FIONREAD, &unread) == 0 ? (unsigned)unread : 0;
  c->stopping = true;
  scpi_session_stop(&c->session, false);
  worker_run_later(client);
}

static void abort_client(struct client *client) {
  abort_connection(connection_of(client));
}

static bool is_busy(const struct client *client) {
  const struct scpi_connection *c = (const struct scpi_connection *)(const void *)client;
  return !c->closing && (c->answered || c->message_bytes > 0);
}

static void check_time(struct client *client, uint64_t time_ms) {
  struct scpi_connection *c = connection_of(client);
  const struct options *options = &c->server->options;
  const uint64_t silence_ms = time_ms - c->active_ms;
  if (c->closing) {
    return;
  }
  if (c->message_bytes == 0 && (c->input.count > c->begin || c->skipping) &&
      silence_ms > options->frame_timeout_ms) {
    drop_message(c, SCPI_TIME_OUT, "one that ends with a newline");
    c->skipping = false;
    c->scan = (struct scpi_scan){0};
  }
  const bool works =
      !c->answered && (c->session.waits_for != NULL || scpi_session_measures(&c->session));
  if (c->transport.lingering ? silence_ms > LINGER_MS
                             : !works && silence_ms > options->idle_timeout_ms) {
    if (!c->transport.lingering) {
      log_closed(c, "idle");
    }
    abort_connection(c);
  }
}

struct scpi_connection *scpi_connection_new(struct server *server, int fd) {
  static const struct client_kind kind = {
      .start = start_client,
      .run = run_turn,
      .finish = finish_turn,
      .tick = check_time,
      .stop = stop_client,
      .abort = abort_client,
      .busy = is_busy,
      .counts = true,
  };
  struct scpi_connection *c = calloc(1, sizeof *c);
  if (c != NULL) {
    c->client.kind = &kind;
    c->server = server;
    c->fd = fd;
    text_init(&c->input, &server->buffers);
    scpi_session_init(&c->session, &c->client, server);
  }
  return c;
}
