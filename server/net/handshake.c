#include "server/net/handshake.h"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include "server/net/tcp.h"
#include "server/net/worker.h"
#include "server/observe/log.h"

TAILQ_HEAD(queue, handshake);

struct handshakes {
  struct server *server;
  struct tls *tls;
  struct worker *worker;
  handshakes_done *done;
  /* Clients that have sent nothing, and handshakes under way; the oldest one comes first. */
  struct queue queues[2];
  unsigned counts[2];
};

struct handshake {
  struct client client; /* first member: see client.h */
  struct handshakes *all;
  TAILQ_ENTRY(handshake) in_queue;
  int fd;
  struct tls_session *session; /* NULL: the client has sent nothing */
  handshakes_done *done;
  uv_poll_t poll;
  uint64_t began_ms;
  bool closing;
  bool is_done; /* whether the socket and the session belong to a worker now */
};

static struct handshake *handshake_of(struct client *client) {
  return (struct handshake *)(void *)client;
}

/* ---- ending ---------------------------------------------------------------------------------- */

static void leave_queue(struct handshake *h) {
  const bool begun = h->session != NULL;
  TAILQ_REMOVE(&h->all->queues[begun], h, in_queue);
  h->all->counts[begun]--;
  stats_subtract(&h->all->server->stats, STATS_TLS_HANDSHAKES_OPEN, begun);
}

static void on_closed(uv_handle_t *handle) {
  struct handshake *h = handle->data;
  struct server *server = h->all->server;
  worker_forget(&h->client);
  if (h->is_done && !atomic_load(&server->draining)) {
    h->done(server, h->fd, h->session);
  } else {
    tls_session_free(h->session); /* session may be NULL */
    close(h->fd);
  }
  free(h);
}

static void end_handshake(struct handshake *h) {
  if (!h->closing) {
    h->closing = true;
    leave_queue(h);
    uv_close((uv_handle_t *)&h->poll, on_closed);
  }
}

static void log_refusal(int fd, const char *reason) {
  char peer[TCP_TEXT_BYTES];
  tcp_peer(fd, peer);
  log_peer_line(LOG_LEVEL_INFO, "event=tls-refused%s%s%s%s", LOG_FIELD(" peer=", peer),
                LOG_FIELD(" reason=", reason));
}

static void fail_handshake(struct handshake *h, const char *reason) {
  if (!h->closing) {
    log_refusal(h->fd, reason);
    stats_add(&h->all->server->stats, STATS_TLS_HANDSHAKES_FAILED, 1);
    end_handshake(h);
  }
}

/* ---- shaking hands --------------------------------------------------------------------------- */

static void on_poll(uv_poll_t *poll, int status, int events) {
  (void)events;
  struct handshake *h = poll->data;
  if (status < 0) { /* libuv reports a reset as EBADF. */
    fail_handshake(h, "the peer has closed the connection");
  } else {
    worker_run_later(&h->client);
  }
}

static void await_event(struct handshake *h, int event) {
  if (uv_poll_start(&h->poll, event, on_poll) != 0) {
    fail_handshake(h, "the socket cannot be polled");
  }
}

static bool has_sent(const struct handshake *h) {
  int bytes = 0;
  return ioctl(h->fd, FIONREAD, &bytes) == 0 && bytes > 0;
}

static void begin_handshake(struct handshake *h);

/* Joins a queue, in which one more than may be there ends the oldest of them. */
static void join_queue(struct handshake *h) {
  struct handshakes *all = h->all;
  const bool begun = h->session != NULL;
  while (all->counts[begun] >= all->server->options.max_tls_handshakes) {
    struct handshake *oldest = TAILQ_FIRST(&all->queues[begun]);
    if (!begun && has_sent(oldest)) {
      begin_handshake(oldest);
    } else {
      fail_handshake(oldest, "max_tls_handshakes newer ones have begun");
    }
  }
  TAILQ_INSERT_TAIL(&all->queues[begun], h, in_queue);
  all->counts[begun]++;
  stats_add(&all->server->stats, STATS_TLS_HANDSHAKES_OPEN, begun);
  h->began_ms = uv_now(&all->worker->loop);
}

/* Begins the handshake of a client that has sent something. */
static void begin_handshake(struct handshake *h) {
  struct tls_session *session = tls_session_new(h->all->tls, h->fd);
  if (session == NULL) {
    fail_handshake(h, "out of memory");
    return;
  }
  leave_queue(h);
  h->session = session;
  join_queue(h);
  worker_run_later(&h->client);
}

/* One turn: what OpenSSL computes for one message of the client, at most a signature or two. */
static void run_turn(struct client *client) {
  struct handshake *h = handshake_of(client);
  char why[TLS_WHY_BYTES];
  if (h->closing) {
    return;
  }
  if (h->session == NULL) {
    if (has_sent(h)) {
      begin_handshake(h);
    } else {
      fail_handshake(h, "the peer has closed the connection");
    }
    return;
  }
  const enum tls_progress progress = tls_session_shake_hands(h->session, why);
  if (progress == TLS_DONE) {
    stats_add(&h->all->server->stats, STATS_TLS_HANDSHAKES, 1);
    h->is_done = true;
    end_handshake(h);
  } else if (progress == TLS_FAILED) {
    fail_handshake(h, why);
  } else {
    await_event(h, progress == TLS_WANTS_WRITE ? UV_WRITABLE : UV_READABLE);
  }
}

static void check_time(struct client *client, uint64_t now_ms) {
  struct handshake *h = handshake_of(client);
  if (now_ms - h->began_ms > h->all->server->options.tls_handshake_timeout_ms) {
    fail_handshake(h, "the handshake takes too long");
  }
}

/* ---- beginning ------------------------------------------------------------------------------- */

static void start_client(struct client *client) {
  struct handshake *h = handshake_of(client);
  cache_lower_priority(10);
  if (uv_poll_init(&client->worker->loop, &h->poll, h->fd) != 0) {
    worker_forget(client);
    close(h->fd);
    free(h);
    return;
  }
  h->poll.data = h;
  join_queue(h);
  await_event(h, UV_READABLE);
}

static void stop_client(struct client *client) {
  end_handshake(handshake_of(client));
}

static const struct client_kind kind = {
    .start = start_client,
    .run = run_turn,
    .tick = check_time,
    .stop = stop_client,
    .abort = stop_client,
};

static void refuse_socket(struct server *server, int fd, const char *why,
                          enum stats_index counter) {
  log_refusal(fd, why);
  stats_add(&server->stats, counter, 1);
  close(fd);
}

void handshakes_admit(struct server *server, int fd) {
  if (access_allows_peer(&server->allow, fd)) {
    handshakes_begin(server, fd, server->handshakes->done);
  } else {
    refuse_socket(server, fd, "not-allowed", STATS_CONNECTIONS_REFUSED);
  }
}

void handshakes_begin(struct server *server, int fd, handshakes_done *done) {
  struct handshakes *all = server->handshakes;
  struct handshake *h = calloc(1, sizeof *h);
  const int on = 1;
  if (h == NULL) {
    refuse_socket(server, fd, "out of memory", STATS_TLS_HANDSHAKES_FAILED);
    return;
  }
  setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  h->client.kind = &kind;
  h->all = all;
  h->fd = fd;
  h->done = done;
  worker_give(all->worker, &h->client);
}

struct handshakes *handshakes_new(struct server *server, struct tls *tls, struct worker *worker,
                                  handshakes_done *done) {
  struct handshakes *all = calloc(1, sizeof *all);
  if (all != NULL) {
    all->server = server;
    all->tls = tls;
    all->worker = worker;
    all->done = done;
    TAILQ_INIT(&all->queues[false]);
    TAILQ_INIT(&all->queues[true]);
  }
  return all;
}

void handshakes_free(struct handshakes *handshakes) {
  free(handshakes);
}
