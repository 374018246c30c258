#include "server/net/handshake.h"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdlib.h>
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
  if (status < 0) {
    fail(h, uv_strerror(status));
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
  h->poll.data = h;
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

void handshakes_begin(struct server *server, int fd, handshakes_done *done) {
  struct handshakes *all = server->handshakes;
  const bool full = atomic_load(&all->waiting) >= server->options.max_tls_handshakes;
  struct handshake *h = full ? NULL : calloc(1, sizeof *h);
  struct tls_session *session = h != NULL ? tls_session_new(all->tls, fd) : NULL;
  if (session == NULL) {
    free(h);
    refuse(server, fd, full ? "max_tls_handshakes have begun at once" : "out of memory",
           STATS_TLS_HANDSHAKES_FAILED);
    return;
  }
  const int on = 1;
  setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  h->client.kind = &kind;
  h->all = all;
  h->fd = fd;
  h->session = session;
  h->done = done;
  atomic_fetch_add(&all->waiting, 1);
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
    TAILQ_INIT(&all->queue);
  }
  return all;
}

void handshakes_free(struct handshakes *handshakes) {
  free(handshakes);
}
