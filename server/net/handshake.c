#include "server/net/handshake.h"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include "server/net/tcp.h"
#include "server/net/worker.h"
#include "server/observe/log.h"

enum {
  LOW_PRIORITY = 10, /* nice value, as of threads that walk photons */
  MOST_BYTES = 65536 /* of a handshake, from the client */
};

TAILQ_HEAD(queue, handshake);

struct handshakes {
  struct server *server;
  struct queue
      silent; /* on the main thread: clients that have sent nothing, the oldest one first */
  unsigned silent_count;
  uv_timer_t timer; /* looks for those that are silent for too long */
  struct tls *tls;
  struct worker *worker;
  handshakes_done *done;
  struct queue queue;       /* the oldest one first */
  _Atomic unsigned waiting; /* those that the worker has not taken up */
  unsigned count;           /* of the queue */
  bool has_low_priority;
};

struct handshake {
  struct client client; /* first member: see client.h */
  struct handshakes *all;
  TAILQ_ENTRY(handshake) in_queue;
  int fd;
  struct tls_session *session;
  handshakes_done *done;
  uv_poll_t poll;
  uint64_t began_ms;
  bool closing;
  bool is_done; /* the socket and the session go on to the workers */
};

static struct handshake *of(struct client *client) {
  return (struct handshake *)(void *)client;
}

/* ---- ending ---------------------------------------------------------------------------------- */

static void on_closed(uv_handle_t *handle) {
  struct handshake *h = handle->data;
  struct server *server = h->all->server;
  worker_forget(&h->client);
  if (h->is_done && !atomic_load(&server->draining)) {
    h->done(server, h->fd, h->session);
  } else {
    tls_session_free(h->session);
    close(h->fd);
  }
  free(h);
}

static void end(struct handshake *h) {
  if (!h->closing) {
    h->closing = true;
    TAILQ_REMOVE(&h->all->queue, h, in_queue);
    h->all->count--;
    stats_subtract(&h->all->server->stats, STATS_TLS_HANDSHAKES_OPEN, 1);
    uv_close((uv_handle_t *)&h->poll, on_closed);
  }
}

static void log_refusal(int fd, const char *reason) {
  char peer[TCP_TEXT_BYTES];
  tcp_peer(fd, peer);
  log_peer_line(LOG_LEVEL_INFO, "event=tls-refused%s%s%s%s", LOG_FIELD(" peer=", peer),
                LOG_FIELD(" reason=", reason));
}

static void fail(struct handshake *h, const char *reason) {
  if (!h->closing) {
    log_refusal(h->fd, reason);
    stats_add(&h->all->server->stats, STATS_TLS_HANDSHAKES_FAILED, 1);
    end(h);
  }
}

/* ---- shaking hands --------------------------------------------------------------------------- */

static void on_poll(uv_poll_t *poll, int status, int events) {
  (void)events;
  struct handshake *h = poll->data;
  if (status < 0) { /* libuv says EBADF for a reset. */
    fail(h, "the peer has closed the connection");
  } else {
    worker_run_later(&h->client);
  }
}

static void await(struct handshake *h, int event) {
  if (uv_poll_start(&h->poll, event, on_poll) != 0) {
    fail(h, "the socket cannot be polled");
  }
}

/* One turn: what OpenSSL computes for one message of the client, at most a signature or two. */
static void run(struct client *client) {
  struct handshake *h = of(client);
  char why[TLS_WHY_BYTES];
  if (h->closing) {
    return;
  }
  const enum tls_progress progress = tls_session_shake_hands(h->session, why);
  if (progress == TLS_DONE) {
    stats_add(&h->all->server->stats, STATS_TLS_HANDSHAKES, 1);
    h->is_done = true;
    end(h);
  } else if (progress == TLS_FAILED) {
    fail(h, why);
  } else if (tls_session_received_bytes(h->session) > MOST_BYTES) {
    fail(h, "the handshake has too many bytes");
  } else {
    await(h, progress == TLS_WANTS_WRITE ? UV_WRITABLE : UV_READABLE);
  }
}

static void tick(struct client *client, uint64_t now_ms) {
  struct handshake *h = of(client);
  if (now_ms - h->began_ms > h->all->server->options.tls_handshake_timeout_ms) {
    fail(h, "the handshake takes too long");
  }
}

/* ---- beginning ------------------------------------------------------------------------------- */

static void start(struct client *client) {
  struct handshake *h = of(client);
  struct handshakes *all = h->all;
  atomic_fetch_sub(&all->waiting, 1);
  if (!all->has_low_priority) {
    all->has_low_priority = true;
    setpriority(PRIO_PROCESS, 0, LOW_PRIORITY); /* In Linux, 0 is this thread. */
  }
  while (all->count >= all->server->options.max_tls_handshakes) {
    fail(TAILQ_FIRST(&all->queue), "max_tls_handshakes newer ones have begun");
  }
  h->began_ms = uv_now(worker_loop(client->worker));
  if (uv_poll_init(worker_loop(client->worker), &h->poll, h->fd) != 0) {
    worker_forget(client);
    tls_session_free(h->session);
    close(h->fd);
    free(h);
    return;
  }
  TAILQ_INSERT_TAIL(&all->queue, h, in_queue);
  all->count++;
  stats_add(&all->server->stats, STATS_TLS_HANDSHAKES_OPEN, 1);
  await(h, UV_READABLE);
}

static void stop(struct client *client) {
  end(of(client));
}

static const struct client_kind kind = {
    .start = start,
    .run = run,
    .tick = tick,
    .stop = stop,
    .abort = stop,
};

static void refuse(struct server *server, int fd, const char *why, enum stats_index counter) {
  log_refusal(fd, why);
  stats_add(&server->stats, counter, 1);
  close(fd);
}

void handshakes_admit(struct server *server, int fd) {
  if (access_allows_peer(&server->allow, fd)) {
    handshakes_begin(server, fd, server->handshakes->done);
  } else {
    refuse(server, fd, "not-allowed", STATS_CONNECTIONS_REFUSED);
  }
}

/* Gives a client that has sent something, and is not in a queue, to the worker. */
static void pass_on(struct handshake *h) {
  struct handshakes *all = h->all;
  struct server *server = all->server;
  const bool full = atomic_load(&all->waiting) >= server->options.max_tls_handshakes;
  h->session = full ? NULL : tls_session_new(all->tls, h->fd);
  if (h->session == NULL) {
    refuse(server, h->fd, full ? "max_tls_handshakes have begun at once" : "out of memory",
           STATS_TLS_HANDSHAKES_FAILED);
    free(h);
    return;
  }
  atomic_fetch_add(&all->waiting, 1);
  worker_give(all->worker, &h->client);
}

static void on_left(uv_handle_t *handle) {
  struct handshake *h = handle->data;
  if (!h->closing && !atomic_load(&h->all->server->draining)) {
    pass_on(h);
  } else {
    close(h->fd);
    free(h);
  }
}

/* Takes a client out of those that are silent. why: NULL if it has sent something. */
static void leave(struct handshake *h, const char *why) {
  TAILQ_REMOVE(&h->all->silent, h, in_queue);
  h->all->silent_count--;
  if (why != NULL) {
    log_refusal(h->fd, why);
    stats_add(&h->all->server->stats, STATS_TLS_HANDSHAKES_FAILED, 1);
    h->closing = true;
  }
  uv_close((uv_handle_t *)&h->poll, on_left);
}

static bool has_sent(const struct handshake *h) {
  int bytes = 0;
  return ioctl(h->fd, FIONREAD, &bytes) == 0 && bytes > 0;
}

static void on_first_bytes(uv_poll_t *poll, int status, int events) {
  struct handshake *h = poll->data;
  (void)status, (void)events;
  leave(h, has_sent(h) ? NULL : "the peer has closed the connection");
}

static void on_timer(uv_timer_t *timer) {
  struct handshakes *all = timer->data;
  struct handshake *h;
  while ((h = TAILQ_FIRST(&all->silent)) != NULL &&
         uv_now(timer->loop) - h->began_ms > all->server->options.tls_handshake_timeout_ms) {
    leave(h, "the handshake takes too long");
  }
  if (h == NULL) {
    uv_timer_stop(timer);
  }
}

void handshakes_begin(struct server *server, int fd, handshakes_done *done) {
  struct handshakes *all = server->handshakes;
  struct handshake *h = calloc(1, sizeof *h);
  const int on = 1;
  if (h == NULL) {
    refuse(server, fd, "out of memory", STATS_TLS_HANDSHAKES_FAILED);
    return;
  }
  setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  h->client.kind = &kind;
  h->all = all;
  h->fd = fd;
  h->done = done;
  h->poll.data = h;
  if (has_sent(h)) {
    pass_on(h);
    return;
  }
  if (uv_poll_init(all->timer.loop, &h->poll, fd) != 0) {
    refuse(server, fd, "the socket cannot be polled", STATS_TLS_HANDSHAKES_FAILED);
    free(h);
    return;
  }
  while (all->silent_count >= server->options.max_tls_handshakes) {
    struct handshake *oldest = TAILQ_FIRST(&all->silent);
    leave(oldest, has_sent(oldest) ? NULL : "max_tls_handshakes newer ones have begun");
  }
  const uint64_t period_ms = server->options.tls_handshake_timeout_ms / 4 + 1;
  h->began_ms = uv_now(all->timer.loop);
  TAILQ_INSERT_TAIL(&all->silent, h, in_queue);
  all->silent_count++;
  uv_poll_start(&h->poll, UV_READABLE, on_first_bytes);
  if (!uv_is_active((uv_handle_t *)&all->timer)) {
    uv_timer_start(&all->timer, on_timer, period_ms, period_ms);
  }
}

void handshakes_stop(struct handshakes *all) {
  struct handshake *h;
  while (all != NULL && (h = TAILQ_FIRST(&all->silent)) != NULL) {
    leave(h, "the daemon stops");
  }
  if (all != NULL) {
    uv_close((uv_handle_t *)&all->timer, NULL);
  }
}

struct handshakes *handshakes_new(struct server *server, struct tls *tls, uv_loop_t *loop,
                                  struct worker *worker, handshakes_done *done) {
  struct handshakes *all = calloc(1, sizeof *all);
  if (all != NULL) {
    all->server = server;
    all->tls = tls;
    all->worker = worker;
    all->done = done;
    TAILQ_INIT(&all->queue);
    TAILQ_INIT(&all->silent);
    uv_timer_init(loop, &all->timer);
    all->timer.data = all;
  }
  return all;
}

void handshakes_free(struct handshakes *handshakes) {
  free(handshakes);
}
