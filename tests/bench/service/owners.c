/* The scheme in which workers own connections. */
#include <pthread.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <unistd.h>

#include "tests/bench/service/seat.h"

enum { EVENTS = 64 };

struct owner {
  pthread_t thread;
  int epoll;
};

static void set_events(int epoll, int operation, struct seat *seat) {
  struct epoll_event event = {.events = seat->blocked ? EPOLLIN | EPOLLOUT : EPOLLIN,
                              .data.ptr = seat};
  if (epoll_ctl(epoll, operation, seat->fd, &event) != 0) {
    _exit(EXIT_FAILURE);
  }
}

static bool serve(struct seat *seat, uint32_t events) {
  size_t place;
  if ((events & ~(uint32_t)EPOLLOUT) != 0 && !seat_receive(seat)) {
    return false;
  }
  while (seat_take(seat, &place)) {
    seat_work(seat, place);
    seat_finish(seat, place);
  }
  return seat_send(seat);
}

static void *run(void *argument) {
  const struct owner *owner = argument;
  struct epoll_event events[EVENTS];
  for (;;) {
    const int count = epoll_wait(owner->epoll, events, EVENTS, -1);
    for (int i = 0; i < count; i++) {
      struct seat *seat = events[i].data.ptr;
      const bool was_blocked = seat->blocked;
      if (!serve(seat, events[i].events)) {
        seat_free(seat);
      } else if (seat->blocked != was_blocked) {
        set_events(owner->epoll, EPOLL_CTL_MOD, seat);
      }
    }
  }
  return NULL;
}

_Noreturn void scheme_run_owners(const struct target *target, int listener) {
  struct owner owners[SCHEME_WORKERS];
  for (size_t i = 0; i < SCHEME_WORKERS; i++) {
    owners[i].epoll = epoll_create1(EPOLL_CLOEXEC);
    if (owners[i].epoll < 0 || pthread_create(&owners[i].thread, NULL, run, &owners[i]) != 0) {
      _exit(EXIT_FAILURE);
    }
  }
  for (size_t next = 0;; next = (next + 1) % SCHEME_WORKERS) {
    const int fd = accept4(listener, NULL, NULL, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (fd < 0) {
      _exit(EXIT_FAILURE);
    }
    set_events(owners[next].epoll, EPOLL_CTL_ADD, seat_new(target, fd));
  }
}
