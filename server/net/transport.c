#include "server/net/transport.h"

#include <fcntl.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include "server/net/tcp.h"
#include "server/net/worker.h"
#include "server/observe/log.h"

enum {
  TLS_READ_BYTES = 524288, /* at most in one call of the poll: some 200 microseconds */
  TLS_RECORD_BYTES = 2048, /* what a read takes beside its bytes, as small as a record may be */
  DROPPED_BYTES = 4096,    /* at a time, of a peer that has the last reply */
  LINGER_MS = 1000,        /* how long the peer may take to close after the last reply */
};

/* ---- the end --------------------------------------------------------------------------------- */

static void close_and_tell(uv_handle_t *handle) {
  struct transport *t = handle->data;
  if (t->tls != NULL) {
    tls_session_free(t->tls);
    t->tls = NULL;
    close(t->fd); /* libuv closes the sockets of its own streams */
  }
  worker_forget(&t->client);
  t->calls->closed(t);
}

void transport_abort(struct transport *t) {
  if (!t->closing) {
    t->closing = true;
    t->calls->dropped(t);
    uv_close(&t->uv.handle, close_and_tell);
  }
}

void transport_abort_client(struct client *client) {
  transport_abort(transport_of(client));
}

static void close_and_move(uv_handle_t *handle) {
  struct transport *t = handle->data;
  t->closing = t->reading = t->blocked = false;
  t->has_more = t->tls != NULL; /* OpenSSL may hold bytes */
  t->events = 0;
  worker_move(&t->client, t->next);
}

/* libuv closes the sockets of its own streams, so that the next stream needs another descriptor. */
bool transport_move(struct transport *t, struct worker *to) {
  const int fd = t->tls != NULL ? t->fd : fcntl(t->fd, F_DUPFD_CLOEXEC, 0);
  if (fd < 0 || !worker_expect(to)) {
    if (fd != t->fd && fd >= 0) {
      close(fd);
    }
    return false;
  }
  t->fd = fd;
  t->next = to;
  t->closing = true;
  uv_close(&t->uv.handle, close_and_move);
  return true;
}

void transport_log_end(const struct transport *t, const char *reason) {
  char peer[TCP_TEXT_BYTES];
  tcp_peer(t->fd, peer);
  log_peer_line(LOG_LEVEL_INFO, "event=%sclosed reason=%s%s%s", t->calls->name, reason,
                LOG_FIELD(" peer=", peer));
}

/* ---- what the owner is told ------------------------------------------------------------------ */

static bool fail_transport(struct transport *t) {
  transport_abort(t);
  return false;
}

static inline void tell_received(struct transport *t, ssize_t bytes) {
  if (bytes < 0 && bytes != UV_ENOBUFS && (bytes != UV_EOF || t->lingering)) {
    fail_transport(t);
  }
  if (t->lingering || t->closing) {
    return;
  }
  if (bytes > 0) {
    stats_add(&t->server->stats, STATS_RECEIVED_BYTES, (uint64_t)bytes);
    t->active_ms = transport_now_ms(t);
    if (t->tls == NULL) {
      t->unread -= (size_t)bytes < t->unread ? (unsigned)bytes : t->unread;
    }
  } else if (bytes < 0) {
    transport_set_reading(t, false);
    t->peer_done |= bytes == UV_EOF;
  }
  t->unread = bytes == 0 || t->peer_done ? 0 : t->unread;
  t->calls->received(t, bytes);
}

static void note_sent(struct transport *t, uint64_t bytes) {
  stats_add(&t->server->stats, STATS_SENT_BYTES, bytes);
  t->active_ms = transport_now_ms(t);
}

/* Writes as much of what transport_send() was given as the socket takes. */
static void write_unsent(struct transport *t) {
  while (t->unsent.len > 0 && !t->writing && !t->closing) {
    const uint64_t written = transport_write(t, &t->unsent, 1);
    t->unsent.base += written;
    t->unsent.len -= written;
  }
}

static void tell_sent(struct transport *t, uint64_t bytes) {
  note_sent(t, bytes);
  if (t->unsent.len > 0) {
    t->unsent.base += bytes;
    t->unsent.len -= bytes;
    write_unsent(t);
    worker_run_later(&t->client);
  } else {
    t->calls->sent(t, bytes);
  }
}

static size_t find_room(struct transport *t, uint8_t **room) {
  static _Thread_local uint8_t dropped[DROPPED_BYTES];
  *room = dropped;
  return t->lingering ? sizeof dropped : t->calls->room(t, room);
}

/* ---- plain sockets --------------------------------------------------------------------------- */

static void on_room_wanted(uv_handle_t *handle, size_t suggested, uv_buf_t *buffer) {
  (void)suggested;
  struct transport *t = handle->data;
  uint8_t *room = NULL;
  const size_t bytes = find_room(t, &room);
  *buffer = uv_buf_init((char *)room, (unsigned)bytes);
}

static void on_read(uv_stream_t *stream, ssize_t bytes, const uv_buf_t *buffer) {
  (void)buffer;
  struct transport *t = stream->data;
  if (bytes != 0) {
    tell_received(t, bytes);
  }
}

/* Shuts down the sending side, when nothing is being written. */
static bool shut_down(struct transport *t) {
  return t->writing || shutdown(t->fd, SHUT_WR) == 0;
}

static void on_written(uv_write_t *request, int status) {
  struct transport *t = request->handle->data;
  const uint64_t bytes = t->writing_bytes;
  free(request);
  t->writing_bytes = 0;
  t->writing = false;
  if (status != 0 || (t->lingering && !t->closing && !shut_down(t))) {
    fail_transport(t);
  } else {
    tell_sent(t, bytes);
  }
}

static bool write_plain(struct transport *t, const uv_buf_t *buffers, unsigned count,
                        uint64_t *written) {
  const int sent = uv_try_write(&t->uv.stream, buffers, count);
  if (sent > 0) {
    *written = (uint64_t)sent;
    return true;
  }
  for (unsigned i = 0; i < count; i++) {
    t->writing_bytes += buffers[i].len;
  }
  uv_write_t *request = malloc(sizeof *request);
  t->writing = request != NULL && (sent == UV_EAGAIN || sent == 0) &&
               uv_write(request, &t->uv.stream, buffers, count, on_written) == 0;
  if (!t->writing) {
    free(request);
  }
  return t->writing;
}

static int open_plain(struct transport *t, uv_loop_t *loop) {
  struct sockaddr_storage address = {.ss_family = AF_UNIX};
  socklen_t length = sizeof address;
  getsockname(t->fd, (struct sockaddr *)&address, &length);
  if (address.ss_family == AF_UNIX) {
    uv_pipe_init(loop, &t->uv.pipe, 0);
    return uv_pipe_open(&t->uv.pipe, t->fd);
  }
  uv_tcp_init(loop, &t->uv.tcp);
  const int opened = uv_tcp_open(&t->uv.tcp, t->fd);
  if (opened == 0) {
    uv_tcp_nodelay(&t->uv.tcp, 1); /* no delay: small replies are already written together */
  }
  return opened;
}

/* ---- TLS ------------------------------------------------------------------------------------- */

static void on_poll(uv_poll_t *poll, int status, int events);

static bool poll_for(struct transport *t, int events) {
  if (events == t->events || t->closing) {
    return true;
  }
  t->events = events;
  return events == 0 ? uv_poll_stop(&t->uv.poll) == 0
                     : uv_poll_start(&t->uv.poll, events, on_poll) == 0;
}

/* Returns the events that the poll has to wait for. Bytes that OpenSSL holds wake no poll: the
 * socket can be written to as a rule, which calls on_poll() in the next round of the loop. */
static int events_wanted(const struct transport *t) {
  return (t->reading && !t->blocked ? UV_READABLE : 0) |
         (t->writing || t->blocked || (t->reading && t->has_more) ? UV_WRITABLE : 0);
}

/* Sets the events that the poll waits for. A change takes two system calls, and connections often
 * cease to read for a moment: so the poll continues to wait until bytes arrive that nobody
 * wants. */
static bool set_events(struct transport *t) {
  return poll_for(t, events_wanted(t) | (t->events & UV_READABLE));
}

/* Reads what has arrived, while the owner has room and wants it, up to the first record without
 * content. The poll tells of bytes that the socket still has. */
static void read_tls(struct transport *t) {
  size_t left = TLS_READ_BYTES;
  t->has_more = true;
  while (t->has_more && t->reading && left > TLS_RECORD_BYTES && !t->closing) {
    left -= TLS_RECORD_BYTES;
    uint8_t *room = NULL;
    const size_t bytes = find_room(t, &room);
    const ssize_t got =
        bytes > 0 ? tls_session_read(t->tls, room, bytes < left ? bytes : left) : UV_ENOBUFS;
    if (got == 0 || got == UV_EAGAIN) {
      t->has_more = got == 0;
      t->blocked = tls_session_is_blocked(t->tls);
      if (!t->has_more && t->tells_empty) {
        t->tells_empty = false;
        tell_received(t, 0);
      }
      return;
    }
    left -= got > 0 ? (size_t)got : 0;
    t->has_more = got < 0 || t->tells_empty || tls_session_holds(t->tls);
    tell_received(t, got);
  }
}

static void on_poll(uv_poll_t *poll, int status, int events) {
  struct transport *t = poll->data;
  if (status < 0) {
    fail_transport(t);
    return;
  }
  if ((events & UV_WRITABLE) != 0) {
    t->has_more |= t->blocked;
    t->blocked = false;
  }
  if (t->writing && (events & UV_WRITABLE) != 0) {
    t->writing = false;
    tell_sent(t, 0);
  }
  if ((events & UV_READABLE) != 0 || t->has_more) {
    read_tls(t);
  }
  if ((events & UV_READABLE) != 0 && (!t->reading || t->blocked)) {
    poll_for(t, events_wanted(t));
  } else {
    set_events(t);
  }
}

static bool write_tls(struct transport *t, const uv_buf_t *buffers, unsigned count,
                      uint64_t *written) {
  ssize_t sent = 0;
  for (unsigned i = 0; i < count && sent >= 0; i++) {
    for (size_t at = 0; at < buffers[i].len && sent >= 0; at += sent > 0 ? (size_t)sent : 0) {
      sent = tls_session_write(t->tls, buffers[i].base + at, buffers[i].len - at);
      *written += sent > 0 ? (uint64_t)sent : 0;
    }
  }
  t->writing = sent == UV_EAGAIN && *written == 0;
  return (sent >= 0 || sent == UV_EAGAIN) && set_events(t);
}

/* ---- TCP or TLS ------------------------------------------------------------------------------ */

void transport_init(struct transport *t, const struct client_kind *kind,
                    const struct transport_calls *calls, struct server *server, int fd,
                    struct tls_session *session) {
  t->client.kind = kind;
  t->calls = calls;
  t->server = server;
  t->fd = fd;
  t->tls = session;
  t->has_more = session != NULL; /* The handshake may have received the first request. */
}

bool transport_open(struct transport *t) {
  uv_loop_t *loop = &t->client.worker->loop;
  const int opened = t->tls != NULL ? uv_poll_init(loop, &t->uv.poll, t->fd) : open_plain(t, loop);
  if (opened != 0 && t->tls != NULL) {
    uv_tcp_init(loop, &t->uv.tcp); /* makes a handle that can be closed */
  } else if (opened != 0) {
    close(t->fd);
  }
  t->uv.handle.data = t;
  t->active_ms = transport_now_ms(t);
  if (opened != 0) {
    log_line(LOG_LEVEL_ERROR, "event=%sconnection-failed reason=%s", t->calls->name,
             uv_strerror(opened));
    transport_abort(t);
  }
  return opened == 0;
}

void transport_set_reading(struct transport *t, bool wanted) {
  if (t->reading == wanted || t->closing) {
    return;
  }
  t->reading = wanted;
  if (t->tls == NULL && !wanted) {
    uv_read_stop(&t->uv.stream);
  } else if (t->tls != NULL ? !set_events(t)
                            : uv_read_start(&t->uv.stream, on_room_wanted, on_read) != 0) {
    t->reading = false;
    fail_transport(t);
  }
}

uint64_t transport_write(struct transport *t, const uv_buf_t *buffers, unsigned count) {
  uint64_t written = 0;
  const bool good = t->tls != NULL ? write_tls(t, buffers, count, &written)
                                   : write_plain(t, buffers, count, &written);
  if (!good) {
    fail_transport(t);
    return 0;
  }
  if (written > 0) {
    note_sent(t, written);
  }
  return written;
}

void transport_send(struct transport *t, void *bytes, size_t count) {
  t->unsent = (uv_buf_t){.base = bytes, .len = count};
  write_unsent(t);
}

void transport_drain(struct client *client) {
  struct transport *t = transport_of(client);
  int unread = 1; /* with TLS it stays 1 until read_tls() finds that nothing is unread */
  if (t->closing) {
    return;
  }
  if (!t->lingering && !t->peer_done && (t->tls != NULL || ioctl(t->fd, FIONREAD, &unread) == 0)) {
    t->unread = (unsigned)unread;
  }
  t->stopping = true;
  worker_run_later(client);
  if (t->unread > 0 && t->tls != NULL) {
    t->has_more = t->tells_empty = true;
    if (!set_events(t)) {
      fail_transport(t);
    }
  }
}

void transport_linger(struct transport *t) {
  t->active_ms = transport_now_ms(t);
  if (t->tls != NULL) {
    tls_session_end(t->tls);
  }
  t->lingering = true;
  if (t->tls != NULL ? shutdown(t->fd, SHUT_WR) == 0 : shut_down(t)) {
    transport_set_reading(t, true);
  } else {
    fail_transport(t);
  }
}

bool transport_is_over(struct transport *t, uint64_t now_ms) {
  if (t->lingering && now_ms - t->active_ms > LINGER_MS) {
    transport_abort(t);
  }
  return t->lingering || t->closing;
}
