#include "server/net/connection.h"

#include <poll.h>
#include <stdlib.h>

#include "server/jobs/requests.h"
#include "server/net/tcp.h"
#include "server/net/transport.h"
#include "server/net/worker.h"
#include "server/observe/log.h"

enum {
  TURN_RADII = JOB_SLICE_RADII, /* work of one turn, in radii of a dipole */
  WRITE_BUFFERS = 16,
  /* most bytes written in one turn, in about 60 microseconds: 65,536 floats with their head */
  WRITE_BYTES = 263168,
  REST_MS = 1000,    /* the silence after which the connection releases its buffers */
  HANG_UP_MS = 1000, /* how long preparations go on for a peer that has ended its side */
  REPORT_MS = 5000,  /* the silence after which a waiting client is told of the work */
};

struct connection {
  struct transport transport; /* first member: see transport.h */
  enum connection_purpose purpose;
  struct input input;
  struct output output;
  struct requests requests;

  bool more_to_do;    /* whether frames or their work were left at the end of the last turn */
  bool went_on;       /* whether they were at its beginning */
  bool detached_more; /* whether detached requests have work left */

  uint64_t frame_started_ms; /* when the incomplete frame began to arrive; 0 if there is none */
};

static const struct client_kind kind;
static const struct transport_calls calls;

static void write_more(struct connection *c);

static struct connection *connection_of(struct client *client) {
  return (struct connection *)(void *)client;
}

/* ---- beginning and end ----------------------------------------------------------------------- */

static void on_wake(void *owner) {
  struct connection *c = owner;
  worker_run_later(&c->transport.client);
}

/* Returns whether the connection gets an error and is closed, and does not count as open. */
static bool is_refused(const struct connection *c) {
  return c->purpose == CONNECTION_REFUSE || c->purpose == CONNECTION_FORBID;
}

static void log_end(void *owner, const wire_error *error) {
  const struct connection *c = owner;
  char peer[TCP_TEXT_BYTES];
  tcp_peer(c->transport.fd, peer);
  log_peer_line(LOG_LEVEL_INFO, "event=%s status=%s%s%s%s%s%s%s",
                is_refused(c) ? "connection-refused" : "connection-ended",
                wire_status_of(error->status)->name, LOG_FIELD(" field=", error->field),
                LOG_FIELD(" peer=", peer), LOG_FIELD(" allowed=", error->allowed));
}

wire_error connection_refusal(enum connection_purpose purpose) {
  return purpose == CONNECTION_FORBID
             ? wire_error_make(WIRE_STATUS_NOT_ALLOWED, "allow",
                               "addresses in the networks of the daemon's --allow")
             : wire_error_busy("max_connections", "fewer open connections", 1000);
}

struct client *connection_new(struct server *server, int fd, struct tls_session *tls,
                              enum connection_purpose purpose) {
  struct connection *c = calloc(1, sizeof *c);
  if (c == NULL) {
    return NULL;
  }
  transport_init(&c->transport, &kind, &calls, server, fd, tls);
  c->purpose = purpose;
  input_init(&c->input, server);
  output_init(&c->output, server);
  requests_init(&c->requests, &c->input, &c->output, on_wake, c);
  c->requests.tell_end = log_end;
  c->requests.roles = tls != NULL ? tls_session_roles(tls) : ROLE_ALL;
  return &c->transport.client;
}

static void free_connection(struct transport *t) {
  struct connection *c = (struct connection *)(void *)t;
  struct server *server = t->server;
  const enum connection_purpose purpose = c->purpose;
  const bool was_open = !is_refused(c);
  input_free(&c->input);
  output_free(&c->output);
  free(c);
  if (was_open) {
    stats_subtract(&server->stats, STATS_CONNECTIONS_OPEN, 1);
  }
  if (purpose == CONNECTION_INHERITED) {
    uv_async_send(&server->inherited_closed);
  }
}

/* No job may call the connection from here on. */
static void drop_requests(struct transport *t) {
  requests_drop(&((struct connection *)(void *)t)->requests);
}

/* Ends the connection so that the peer can read all replies. */
static void linger(struct connection *c) {
  if (c->transport.peer_done) {
    transport_abort(&c->transport);
  } else {
    transport_linger(&c->transport);
  }
}

/* ---- reading --------------------------------------------------------------------------------- */

static size_t find_room(struct transport *t, uint8_t **room) {
  struct connection *c = (struct connection *)(void *)t;
  return requests_hold_input(&c->requests) ? input_room_behind(&c->input, room)
                                           : input_room(&c->input, room);
}

/* Refuses and skips an incomplete frame because there is no memory for the rest of it. */
static void refuse_for_memory(struct connection *c) {
  wire_header header;
  const wire_error error =
      wire_error_busy("payload_bytes", "less data at a time: max_total_bytes are in use", 1000);
  if (!input_refuse(&c->input, &header)) {
    transport_abort(&c->transport);
  } else if (!requests_refuse(&c->requests, header.request_id, &error)) {
    transport_abort(&c->transport);
  }
}

/* Reads while a job uses its request in place: only into the free memory behind that request. So the
 * arrival times of the next requests are known, and their deadlines count from then. */
static void read_behind(struct connection *c) {
  uint8_t *room = NULL;
  transport_set_reading(&c->transport,
                        !c->transport.peer_done && input_room_behind(&c->input, &room) > 0);
}

static bool is_ready(const struct connection *c, short events, short ready) {
  struct pollfd peer = {.fd = c->transport.fd, .events = events};
  return poll(&peer, 1, 0) > 0 && (peer.revents & ready) != 0;
}

/* Returns whether the peer of a Unix socket has closed both of its sides: nobody reads the replies.
 * TCP does not tell that from the end of the sending side. */
static bool has_hung_up(const struct connection *c) {
  return is_ready(c, 0, POLLHUP | POLLERR);
}

/* Returns whether preparations for a peer that has ended its side end. */
static bool is_gone(const struct connection *c, uint64_t now_ms) {
  int domain = AF_UNIX;
  socklen_t bytes = sizeof domain;
  getsockopt(c->transport.fd, SOL_SOCKET, SO_DOMAIN, &domain, &bytes);
  return domain == AF_UNIX ? has_hung_up(c) : now_ms - c->transport.active_ms > HANG_UP_MS;
}

/* Takes the bytes that have been read; the connection serves their requests in the same round of
 * the loop. It stops reading only if work is left after that, so that a client that waits for each
 * reply costs no calls to stop and start reading. */
static void on_received(struct transport *t, ssize_t bytes) {
  struct connection *c = (struct connection *)(void *)t;
  if (bytes > 0) {
    input_arrived(&c->input, (size_t)bytes, worker_round_ns(c->transport.client.worker));
    if (requests_hold_input(&c->requests)) {
      read_behind(c);
      return; /* The job will wake the connection. */
    }
  } else {
    if (bytes == UV_ENOBUFS && requests_hold_input(&c->requests)) {
      return; /* The next turn of the job reads on. */
    }
    if (bytes == UV_ENOBUFS) {
      refuse_for_memory(c);
    } else if (!has_hung_up(c)) {
      t->active_ms = transport_now_ms(&c->transport);
    } else {
      transport_abort(&c->transport);
    }
  }
  if (!c->transport.closing) {
    worker_run_later(&c->transport.client);
  }
}

/* ---- writing --------------------------------------------------------------------------------- */

static void on_sent(struct transport *t, uint64_t bytes) {
  struct connection *c = (struct connection *)(void *)t;
  output_consume(&c->output, bytes);
  worker_run_later(&t->client); /* the next turn writes more */
}

/* Cuts the buffers off after this many bytes. Returns how many buffers are left. */
static unsigned cut_off(uv_buf_t *buffers, unsigned count, size_t bytes) {
  unsigned i = 0;
  for (; i < count && bytes > 0; i++) {
    buffers[i].len = buffers[i].len < bytes ? buffers[i].len : bytes;
    bytes -= buffers[i].len;
  }
  return i;
}

/* Writes as much as the socket takes at once, up to WRITE_BYTES: a reader on another core may empty
 * the socket as fast as it is filled, and the other clients wait meanwhile. If the socket takes
 * nothing, the transport tells when it does. */
static void write_more(struct connection *c) {
  size_t left = WRITE_BYTES;
  while (!c->transport.closing && !c->transport.writing && c->output.ready_bytes > 0 && left > 0) {
    uv_buf_t buffers[WRITE_BUFFERS];
    const unsigned count =
        cut_off(buffers, (unsigned)output_buffers(&c->output, buffers, WRITE_BUFFERS), left);
    const uint64_t written = transport_write(&c->transport, buffers, count);
    output_consume(&c->output, written);
    left -= written;
  }
}

/* ---- turns ----------------------------------------------------------------------------------- */

/* Notes when an incomplete frame began to arrive. Its time counts only while the connection reads.
 */
static void note_partial_frame(struct connection *c) {
  if (!input_partial(&c->input) || output_is_full(&c->output)) {
    c->frame_started_ms = 0;
  } else if (c->frame_started_ms == 0) {
    c->frame_started_ms = transport_now_ms(&c->transport);
  }
}

/* If the peer is done or the daemon stops, makes Monte Carlo end with its results so far: nobody can
 * cancel it any more. Returns whether last replies of detached requests are still to come. */
static bool awaits_detached(struct connection *c) {
  return (c->transport.peer_done || c->transport.stopping) &&
         requests_stop_detached(&c->requests,
                                c->transport.peer_done ? JOB_CANCELLED : JOB_DAEMON_STOPS);
}

static wire_error stopping_error(void) {
  return wire_error_make(WIRE_STATUS_SHUTTING_DOWN, "daemon",
                         "another one, or this one when it has been started again");
}

/* Called when all complete frames have been served. If the peer is done or the daemon stops,
 * sends the last error, if any, and takes no more frames. */
static void end_if_done(struct connection *c) {
  if (c->requests.ended || output_is_full(&c->output) || awaits_detached(c)) {
    return;
  }
  if (c->transport.peer_done && input_partial(&c->input)) {
    requests_end(&c->requests, input_partial_id(&c->input),
                 wire_error_make(WIRE_STATUS_TRUNCATED, "payload_bytes",
                                 "as many bytes as the header announces"));
  } else if (c->transport.stopping && !c->transport.peer_done) {
    requests_end(&c->requests, 0, stopping_error());
  }
  c->requests.ended |= c->transport.peer_done;
  write_more(c);
}

/* Called when a turn has done all work that it could: reads on, or ends the connection. */
static void read_on_or_end(struct connection *c) {
  if (c->requests.run.state != RUN_IDLE) { /* The job waits for a profile, or for the reader. */
    read_behind(c);
    return;
  }
  end_if_done(c);
  if (c->transport.closing || c->transport.lingering) {
    return;
  }
  if (c->requests.ended) {
    transport_set_reading(&c->transport, false);
    if (c->output.ready_bytes == 0) {
      linger(c);
    }
    return;
  }
  if (c->requests.blocked) {
    read_behind(c);
    return;
  }
  note_partial_frame(c);
  transport_set_reading(
      &c->transport,
      !output_is_full(&c->output) &&
          !c->transport.peer_done); /* Without this it would read the end of the stream again. */
}

/* Makes the worker wake the connection at the deadline of a request that waits. */
static void watch_deadline(struct connection *c) {
  const uint64_t deadline_ms = requests_deadline_ms(&c->requests);
  if (deadline_ms != 0) {
    worker_wake_at(c->transport.client.worker, deadline_ms);
  }
}

/* Returns whether the worker wants to hand the connection over, which is between two requests. */
static bool may_move(const struct connection *c) {
  const struct requests *r = &c->requests;
  const struct transport *t = &c->transport;
  return t->client.worker->relief != NULL && c->went_on && r->run.state == RUN_IDLE &&
         r->detached_count == 0 && r->points == NULL && !r->ended && !t->writing && !t->peer_done &&
         !t->stopping;
}

static void run_turn(struct client *client) {
  struct connection *c = connection_of(client);
  struct requests *r = &c->requests;
  const uint64_t share = r->detached_count > 0 ? TURN_RADII / 2 : 0;
  uint64_t budget = TURN_RADII - share;
  /* A turn takes at most max_in_flight requests, the current one among them. */
  const uint64_t before = r->taken;
  const uint64_t most =
      before + c->transport.server->options.max_in_flight - (r->run.state != RUN_IDLE);
  bool more = true;
  c->went_on = c->more_to_do;
  while (more && budget > 0 && !c->transport.closing && !may_move(c) &&
         (r->run.state != RUN_IDLE || r->taken < most)) {
    more = requests_step(r, &budget);
  }
  if (r->taken > before) {
    c->frame_started_ms = 0;
  }
  budget += share;
  c->detached_more = requests_step_detached(r, &budget);
  if (r->no_room) {
    transport_abort(&c->transport);
  }
  if (!c->transport.closing) {
    watch_deadline(c);
  }
  c->more_to_do = more && (r->run.state != RUN_IDLE || input_partial(&c->input));
}

static void finish_turn(struct client *client) {
  struct connection *c = connection_of(client);
  /* Frames wait while the output is full. If writing makes room, the connection continues. */
  const bool was_blocked = output_is_full(&c->output);
  if (!c->transport.closing) {
    write_more(c);
  }
  if (c->transport.closing) {
    return;
  }
  if (may_move(c) && transport_move(&c->transport, client->worker->relief)) {
    client->worker->relief = NULL;
    return;
  }
  if (c->more_to_do || (was_blocked && !output_is_full(&c->output))) {
    if (requests_hold_input(&c->requests)) {
      read_behind(c);
    } else {
      transport_set_reading(&c->transport, false);
    }
    worker_run_later(&c->transport.client);
  } else {
    read_on_or_end(c);
  }
  /* WRITE_BYTES may have been written, and there is more. */
  const bool writes_more = !c->transport.writing && c->output.ready_bytes > 0;
  if (!c->transport.closing && (c->detached_more || writes_more)) {
    worker_run_later(&c->transport.client);
  }
}

/* ---- starting, stopping, time ---------------------------------------------------------------- */

static void start_client(struct client *client) {
  struct connection *c = connection_of(client);
  c->requests.context = &client->worker->context;
  c->requests.profiles = &client->profiles;
  if (transport_open(&c->transport)) {
    if (is_refused(c)) {
      requests_end(&c->requests, 0, connection_refusal(c->purpose));
    }
    worker_run_later(client);
  }
}

static void stop_client(struct client *client) {
  struct connection *c = connection_of(client);
  c->transport.stopping = true;
  if (!c->transport.closing) {
    worker_run_later(client);
  }
}

/* Tells a client whose request takes long that the daemon is at work (F3e): by an empty reply to a
 * ping with the request's id, before the part that is open in the output. */
static void report_work(struct connection *c) {
  const wire_header *waiting = requests_under_way(&c->requests);
  if (waiting == NULL || c->output.ready_bytes > 0 || c->transport.writing ||
      !is_ready(c, POLLOUT, POLLOUT)) {
    return;
  }
  const wire_header header = {.magic = WIRE_MAGIC,
                              .version = WIRE_VERSION,
                              .type = WIRE_TYPE_PING | WIRE_REPLY,
                              .request_id = waiting->request_id};
  uint8_t frame[WIRE_BYTES_header];
  wire_put_header(frame, &header);
  uv_buf_t buffer = uv_buf_init((char *)frame, sizeof frame);
  if (transport_write(&c->transport, &buffer, 1) != sizeof frame) {
    transport_abort(&c->transport); /* the rest has no place in the output */
  }
}

static void check_time(struct client *client, uint64_t now_ms) {
  struct connection *c = connection_of(client);
  const struct options *options = &c->transport.server->options;
  if (transport_is_over(&c->transport, now_ms)) {
    return;
  }
  requests_trim(&c->requests, now_ms);
  const wire_error gone =
      wire_error_make(WIRE_STATUS_CANCELLED, "connection", "one whose client may still send");
  if (c->transport.peer_done && is_gone(c, now_ms) &&
      requests_give_up(&c->requests, &gone, false)) {
    worker_run_later(&c->transport.client);
  }
  if (!requests_hold_input(&c->requests)) {
    input_trim(&c->input);
  }
  if (c->requests.ended || c->output.ready_bytes > 0) {
    if (now_ms - c->transport.active_ms > options->idle_timeout_ms) {
      transport_abort(&c->transport);
    }
    return;
  }
  if (now_ms - c->transport.active_ms > REPORT_MS) {
    report_work(c);
  }
  if (c->transport.closing || requests_hold_input(&c->requests) ||
      c->transport.client.run_queue != NULL) {
    return;
  }
  if (c->frame_started_ms != 0 && now_ms - c->frame_started_ms > options->frame_timeout_ms) {
    requests_end(&c->requests, 0,
                 wire_error_make(WIRE_STATUS_TIMEOUT, "payload_bytes",
                                 "a whole frame within frame_timeout_ms"));
    worker_run_later(&c->transport.client);
  } else if (c->requests.detached_count > 0) { /* a reply may have room now */
    worker_run_later(&c->transport.client);
  } else if (now_ms - c->transport.active_ms > options->idle_timeout_ms) {
    requests_end(
        &c->requests, 0,
        wire_error_make(WIRE_STATUS_TIMEOUT, "idle_timeout_ms", "no longer silence than this"));
    worker_run_later(&c->transport.client);
  } else if (now_ms - c->transport.active_ms > REST_MS) {
    input_release(&c->input);
    output_release(&c->output);
  }
}

static void check_deadlines(struct client *client) {
  struct connection *c = connection_of(client);
  if (c->transport.closing) {
    return;
  }
  if (requests_expire(&c->requests)) {
    worker_run_later(client);
  } else {
    watch_deadline(c);
  }
}

/* Refuses what is still under way, as far as the peer reads, so that it requests that elsewhere. */
static void abort_client(struct client *client) {
  struct connection *c = connection_of(client);
  if (!c->transport.closing) {
    const wire_error error = stopping_error();
    uint64_t budget = 0;
    requests_give_up(&c->requests, &error, true);
    requests_step_detached(&c->requests, &budget); /* writes the refusals */
    end_if_done(c);
  }
  transport_abort(&c->transport);
}

static bool is_busy(const struct client *client) {
  const struct connection *c = (const struct connection *)(const void *)client;
  return !c->transport.closing && (c->output.ready_bytes > 0 || requests_wait(&c->requests));
}

static const struct transport_calls calls = {.name = "",
                                             .room = find_room,
                                             .received = on_received,
                                             .sent = on_sent,
                                             .dropped = drop_requests,
                                             .closed = free_connection};

static const struct client_kind kind = {
    .start = start_client,
    .run = run_turn,
    .finish = finish_turn,
    .tick = check_time,
    .deadline = check_deadlines,
    .stop = stop_client,
    .abort = abort_client,
    .busy = is_busy,
    .counts = true,
};
