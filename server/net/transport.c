#include "server/net/transport.h"

#include <errno.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <unistd.h>

enum {
  READ_BYTES = 524288,  /* at most in one call of the poll: with TLS some 200 microseconds */
  CALL_BYTES = 2048,    /* what a read costs beside its bytes, which may be few */
  DROPPED_BYTES = 4096, /* at a time, of a peer that has the last reply */
};

static void close_and_tell(uv_handle_t *handle) {
  struct transport *t = handle->data;
  tls_session_free(t->tls);
  close(t->fd);
  t->calls->closed(t->owner);
}

void transport_close(struct transport *t) {
  uv_close(&t->uv.handle, close_and_tell);
}

/* ---- what the owner is told ------------------------------------------------------------------ */

static bool fail_transport(struct transport *t) {
  if (!uv_is_closing(&t->uv.handle)) {
    t->calls->failed(t->owner);
  }
  return false;
}

static inline void tell_received(struct transport *t, ssize_t bytes) {
  if (bytes < 0 && bytes != UV_ENOBUFS && (bytes != UV_EOF || t->lingering)) {
    fail_transport(t);
  } else if (!t->lingering && !uv_is_closing(&t->uv.handle)) {
    t->calls->received(t->owner, bytes);
  }
}

static size_t find_room(struct transport *t, uint8_t **room) {
  static _Thread_local uint8_t dropped[DROPPED_BYTES];
  *room = dropped;
  return t->lingering ? sizeof dropped : t->calls->room(t->owner, room);
}

/* ---- the poll -------------------------------------------------------------------------------- */

static void on_poll(uv_poll_t *poll, int status, int events);

static bool poll_for(struct transport *t, int events) {
  if (events == t->events || uv_is_closing(&t->uv.handle)) {
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

/* ---- reading and writing --------------------------------------------------------------------- */

/* As tls_session_read(). */
static ssize_t read_bytes(struct transport *t, uint8_t *room, size_t bytes) {
  if (t->tls != NULL) {
    return tls_session_read(t->tls, room, bytes);
  }
  const ssize_t got = recv(t->fd, room, bytes, 0);
  return got > 0    ? got
         : got == 0 ? UV_EOF
                    : (errno == EAGAIN || errno == EINTR ? UV_EAGAIN : UV_ECONNRESET);
}

/* Reads what has arrived, while the owner has room and wants it; with TLS up to the first record
 * without content. */
static void read_more(struct transport *t) {
  size_t left = READ_BYTES;
  bool more = true;
  t->has_more = t->tls != NULL; /* the poll tells of bytes that a plain socket has */
  while (more && t->reading && left > CALL_BYTES && !uv_is_closing(&t->uv.handle)) {
    left -= CALL_BYTES;
    uint8_t *room = NULL;
    size_t bytes = find_room(t, &room);
    bytes = bytes < left ? bytes : left;
    const ssize_t got = bytes > 0 ? read_bytes(t, room, bytes) : UV_ENOBUFS;
    if (got == 0 || got == UV_EAGAIN) {
      t->has_more = got == 0;
      t->blocked = t->tls != NULL && tls_session_is_blocked(t->tls);
      if (!t->has_more && t->tells_empty) {
        t->tells_empty = false;
        tell_received(t, 0);
      }
      return;
    }
    left -= got > 0 ? (size_t)got : 0;
    more = t->tls != NULL || got == (ssize_t)bytes;
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
    t->calls->sent(t->owner);
  }
  if ((events & UV_READABLE) != 0 || t->has_more) {
    read_more(t);
  }
  if ((events & UV_READABLE) != 0 && (!t->reading || t->blocked)) {
    poll_for(t, events_wanted(t));
  } else {
    set_events(t);
  }
}

/* Returns UV_EAGAIN or another error if the socket does not take all bytes. */
static ssize_t write_tls(struct transport *t, const uv_buf_t *buffers, unsigned count,
                         uint64_t *written) {
  ssize_t sent = 0;
  for (unsigned i = 0; i < count && sent >= 0; i++) {
    for (size_t at = 0; at < buffers[i].len && sent >= 0; at += sent > 0 ? (size_t)sent : 0) {
      sent = tls_session_write(t->tls, buffers[i].base + at, buffers[i].len - at);
      *written += sent > 0 ? (uint64_t)sent : 0;
    }
  }
  return sent;
}

/* The same. uv_buf_t is a struct iovec. */
static ssize_t write_plain(struct transport *t, const uv_buf_t *buffers, unsigned count,
                           uint64_t *written) {
  const struct msghdr message = {.msg_iov = (struct iovec *)(uintptr_t)buffers,
                                 .msg_iovlen = count};
  const ssize_t sent = sendmsg(t->fd, &message, MSG_NOSIGNAL);
  *written = sent > 0 ? (uint64_t)sent : 0;
  return sent >= 0 ? sent : errno == EAGAIN || errno == EINTR ? UV_EAGAIN : UV_EPIPE;
}

/* ---- public ---------------------------------------------------------------------------------- */

int transport_open(struct transport *t, uv_loop_t *loop, int fd, struct tls_session *session,
                   const struct transport_calls *calls, void *owner) {
  t->calls = calls;
  t->owner = owner;
  t->fd = fd;
  t->tls = session;
  t->has_more = session != NULL; /* The handshake may have received the first request. */
  const int on = 1;
  setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on); /* small replies are written together */
  const int opened = uv_poll_init(loop, &t->uv.poll, fd);
  if (opened != 0) {
    uv_idle_init(loop, &t->uv.none); /* makes a handle that can be closed */
  }
  t->uv.handle.data = t;
  return opened;
}

void transport_set_reading(struct transport *t, bool wanted) {
  if (t->reading == wanted || uv_is_closing(&t->uv.handle)) {
    return;
  }
  t->reading = wanted;
  if (!set_events(t)) {
    t->reading = false;
    fail_transport(t);
  }
}

uint64_t transport_write(struct transport *t, const uv_buf_t *buffers, unsigned count) {
  uint64_t written = 0;
  const ssize_t sent = (t->tls != NULL ? write_tls : write_plain)(t, buffers, count, &written);
  t->writing = sent == UV_EAGAIN && written == 0;
  const bool good = (sent >= 0 || sent == UV_EAGAIN) && set_events(t);
  return good || fail_transport(t) ? written : 0;
}

void transport_tell_empty(struct transport *t) {
  t->has_more = t->tells_empty = t->tls != NULL;
  if (t->tls != NULL && !set_events(t)) {
    fail_transport(t);
  }
}

void transport_linger(struct transport *t) {
  if (t->tls != NULL) {
    tls_session_end(t->tls);
  }
  t->lingering = true;
  if (shutdown(t->fd, SHUT_WR) == 0) {
    transport_set_reading(t, true);
  } else {
    fail_transport(t);
  }
}
