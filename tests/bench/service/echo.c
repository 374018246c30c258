#include "tests/bench/service/echo.h"

#include <errno.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <unistd.h>

#include "tests/bench/service/child.h"

enum { BUFFER_BYTES = 65536, EVENTS = 64 };

struct peer {
  int fd;
  uint8_t *input; /* the incomplete request, and other bytes that have been read */
  size_t input_bytes;
  size_t have;
  uint8_t *output; /* complete replies, as many as fit; only their ids are still to be set */
  size_t output_replies;
  size_t to_write; /* number of bytes of output, from written on, that wait for the socket */
  size_t written;
};

static size_t at_least_one(size_t bytes) {
  return bytes > BUFFER_BYTES ? bytes : BUFFER_BYTES / bytes * bytes;
}

static struct peer *new_peer(const struct target *target, int fd) {
  struct peer *peer = calloc(1, sizeof *peer);
  if (peer == NULL) {
    _exit(EXIT_FAILURE);
  }
  peer->fd = fd;
  peer->input_bytes = at_least_one(target->request_bytes);
  peer->input = malloc(peer->input_bytes);
  peer->output_replies = at_least_one(target->reply_bytes) / target->reply_bytes;
  peer->output = malloc(peer->output_replies * target->reply_bytes);
  if (peer->input == NULL || peer->output == NULL) {
    _exit(EXIT_FAILURE);
  }
  for (size_t i = 0; i < peer->output_replies; i++) {
    memcpy(peer->output + i * target->reply_bytes, target->replies, target->reply_bytes);
  }
  return peer;
}

static void free_peer(struct peer *peer) {
  close(peer->fd);
  free(peer->input);
  free(peer->output);
  free(peer);
}

/* Writes output to the socket. Returns false if the peer is gone. */
static bool write_some(struct peer *peer) {
  while (peer->written < peer->to_write) {
    const ssize_t sent =
        write(peer->fd, peer->output + peer->written, peer->to_write - peer->written);
    if (sent < 0) {
      return errno == EAGAIN;
    }
    peer->written += (size_t)sent;
  }
  peer->written = peer->to_write = 0;
  return true;
}

/* Answers the complete requests, as long as output and socket have room. */
static bool answer(struct peer *peer, const struct target *target) {
  size_t at = 0;
  bool alive = true;
  while (alive && peer->to_write == 0 && peer->have - at >= target->request_bytes) {
    size_t replies = 0;
    for (; replies < peer->output_replies && peer->have - at >= target->request_bytes; replies++) {
      target_set_id(peer->output + replies * target->reply_bytes, target_id(peer->input + at));
      at += target->request_bytes;
    }
    peer->to_write = replies * target->reply_bytes;
    alive = write_some(peer);
  }
  if (at > 0) {
    memmove(peer->input, peer->input + at, peer->have - at);
    peer->have -= at;
  }
  return alive;
}

static bool serve(struct peer *peer, const struct target *target, uint32_t events) {
  bool alive = (events & EPOLLOUT) == 0 || write_some(peer);
  if (alive && peer->to_write == 0 && peer->have < peer->input_bytes) {
    const ssize_t got = read(peer->fd, peer->input + peer->have, peer->input_bytes - peer->have);
    alive = got > 0 || (got < 0 && errno == EAGAIN);
    peer->have += got > 0 ? (size_t)got : 0;
  }
  return alive && answer(peer, target);
}

static void set_events(int epoll, int operation, struct peer *peer, uint32_t events) {
  struct epoll_event event = {.events = events, .data.ptr = peer};
  if (epoll_ctl(epoll, operation, peer->fd, &event) != 0) {
    _exit(EXIT_FAILURE);
  }
}

static void on_event(int epoll, struct peer *peer, const struct target *target, uint32_t events) {
  const bool was_blocked = peer->to_write > 0;
  if (!serve(peer, target, events)) {
    free_peer(peer);
  } else if (was_blocked != (peer->to_write > 0)) {
    set_events(epoll, EPOLL_CTL_MOD, peer, was_blocked ? EPOLLIN : EPOLLOUT);
  }
}

static void admit(int epoll, int listener, const struct target *target) {
  const int on = 1;
  const int fd = accept4(listener, NULL, NULL, SOCK_NONBLOCK | SOCK_CLOEXEC);
  if (fd >= 0) {
    setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on,
               sizeof on); /* This call fails on a Unix socket, where it is not needed. */
    set_events(epoll, EPOLL_CTL_ADD, new_peer(target, fd), EPOLLIN);
  }
}

static _Noreturn void run(int listener, const struct target *target) {
  const int epoll = epoll_create1(EPOLL_CLOEXEC);
  struct epoll_event events[EVENTS] = {{.events = EPOLLIN, .data.ptr = NULL}};
  if (epoll < 0 || epoll_ctl(epoll, EPOLL_CTL_ADD, listener, events) != 0) {
    _exit(EXIT_FAILURE);
  }
  for (;;) {
    const int count = epoll_wait(epoll, events, EVENTS, -1);
    for (int i = 0; i < count; i++) {
      if (events[i].data.ptr == NULL) {
        admit(epoll, listener, target);
      } else {
        on_event(epoll, events[i].data.ptr, target, events[i].events);
      }
    }
  }
}

void echo_start(struct target *target) {
  const int listener = target_listen(&target->address);
  target->server = child_fork(CHILD_SERVER);
  if (target->server == 0) {
    run(listener, target);
  }
  close(listener);
}
