/* The scheme with a thread in front, which reads and writes, and workers behind. */
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "tests/bench/service/seat.h"

enum {
  EVENTS = 64,
  QUEUE_ROOM = 4096,     /* more than all clients of the benchmark have in flight */
  LARGE_BYTES = 1 << 14, /* a reply of so much is sent before the next is worked out */
};

struct task {
  struct seat *seat;
  size_t place;
};

/* From one thread to another; without a lock. */
struct queue {
  struct task tasks[QUEUE_ROOM];
  _Alignas(64) _Atomic uint64_t pushed;
  _Alignas(64) _Atomic uint64_t popped;
};

/* Who may sleep until somebody has something for it. */
struct sleeper {
  _Alignas(64) _Atomic bool asleep;
  int eventfd;
};

struct worker {
  pthread_t thread;
  struct front *front;
  struct queue to_do;
  struct queue done;
  struct sleeper sleeper;
  uint64_t given; /* for the front's use: tasks under way */
};

struct front {
  const struct target *target;
  int listener;
  int epoll;
  struct sleeper sleeper;
  struct worker workers[SCHEME_WORKERS];
};

/* ---- queues ------------------------------------------------------------------------------- */

static void push(struct queue *queue, struct task task) {
  const uint64_t at = atomic_load_explicit(&queue->pushed, memory_order_relaxed);
  if (at - atomic_load_explicit(&queue->popped, memory_order_acquire) == QUEUE_ROOM) {
    _exit(EXIT_FAILURE);
  }
  queue->tasks[at % QUEUE_ROOM] = task;
  atomic_store(&queue->pushed, at + 1);
}

static bool empty(struct queue *queue) {
  return atomic_load(&queue->pushed) == atomic_load_explicit(&queue->popped, memory_order_relaxed);
}

static bool pop(struct queue *queue, struct task *task) {
  if (empty(queue)) {
    return false;
  }
  const uint64_t at = atomic_load_explicit(&queue->popped, memory_order_relaxed);
  *task = queue->tasks[at % QUEUE_ROOM];
  atomic_store_explicit(&queue->popped, at + 1, memory_order_release);
  return true;
}

/* ---- sleeping ----------------------------------------------------------------------------- */

/* Says that it will sleep, then looks once more for what has come meanwhile; who pushes does it the
 * other way round, so that one of them sees the other. */
static void wake(struct sleeper *sleeper) {
  const uint64_t one = 1;
  if (atomic_exchange(&sleeper->asleep, false) &&
      write(sleeper->eventfd, &one, sizeof one) != sizeof one) {
    _exit(EXIT_FAILURE);
  }
}

static void make_sleeper(struct sleeper *sleeper, int flags) {
  sleeper->eventfd = eventfd(0, EFD_CLOEXEC | flags);
  if (sleeper->eventfd < 0) {
    _exit(EXIT_FAILURE);
  }
}

/* ---- a worker ----------------------------------------------------------------------------- */

static void sleep_unless_given(struct worker *worker) {
  uint64_t count;
  atomic_store(&worker->sleeper.asleep, true);
  if (!empty(&worker->to_do) && atomic_exchange(&worker->sleeper.asleep, false)) {
    return;
  }
  if (read(worker->sleeper.eventfd, &count, sizeof count) != sizeof count) {
    _exit(EXIT_FAILURE);
  }
}

static void *run_worker(void *argument) {
  struct worker *worker = argument;
  const bool large = worker->front->target->reply_bytes >= LARGE_BYTES;
  for (;;) {
    struct task task;
    while (pop(&worker->to_do, &task)) {
      seat_work(task.seat, task.place);
      push(&worker->done, task);
      if (large) {
        wake(&worker->front->sleeper);
      }
    }
    wake(&worker->front->sleeper);
    sleep_unless_given(worker);
  }
  return NULL;
}

/* ---- the front ---------------------------------------------------------------------------- */

static void set_events(struct front *front, int operation, struct seat *seat) {
  struct epoll_event event = {.events = seat->blocked ? EPOLLIN | EPOLLOUT : EPOLLIN,
                              .data.ptr = seat};
  if (epoll_ctl(front->epoll, operation, seat->fd, &event) != 0) {
    _exit(EXIT_FAILURE);
  }
}

/* A client of the benchmark closes with nothing in flight, so no worker has a task of the seat. */
static void send_replies(struct front *front, struct seat *seat) {
  const bool was_blocked = seat->blocked;
  if (!seat_send(seat)) {
    seat_free(seat);
  } else if (seat->blocked != was_blocked) {
    set_events(front, EPOLL_CTL_MOD, seat);
  }
}

static struct worker *least_busy(struct front *front) {
  struct worker *best = &front->workers[0];
  for (size_t i = 1; i < SCHEME_WORKERS; i++) {
    if (front->workers[i].given < best->given) {
      best = &front->workers[i];
    }
  }
  return best;
}

static void serve(struct front *front, struct seat *seat, uint32_t events) {
  struct task task = {.seat = seat};
  if ((events & ~(uint32_t)EPOLLOUT) != 0 && !seat_receive(seat)) {
    seat_free(seat);
    return;
  }
  while (seat_take(seat, &task.place)) {
    struct worker *worker = least_busy(front);
    worker->given++;
    push(&worker->to_do, task);
  }
  if (events & EPOLLOUT) {
    send_replies(front, seat);
  }
}

/* Takes what the workers have done; each connection is written to once. */
static void collect(struct front *front) {
  struct seat *touched[QUEUE_ROOM];
  struct task task;
  size_t count = 0;
  for (size_t i = 0; i < SCHEME_WORKERS; i++) {
    struct worker *worker = &front->workers[i];
    while (count < QUEUE_ROOM && pop(&worker->done, &task)) {
      worker->given--;
      seat_finish(task.seat, task.place);
      if (!task.seat->touched) {
        task.seat->touched = true;
        touched[count++] = task.seat;
      }
    }
  }
  for (size_t i = 0; i < count; i++) {
    touched[i]->touched = false;
    send_replies(front, touched[i]);
  }
}

static bool anything_done(struct front *front) {
  bool any = false;
  for (size_t i = 0; i < SCHEME_WORKERS; i++) {
    any = any || !empty(&front->workers[i].done);
  }
  return any;
}

static void admit(struct front *front) {
  const int fd = accept4(front->listener, NULL, NULL, SOCK_NONBLOCK | SOCK_CLOEXEC);
  if (fd < 0) {
    _exit(EXIT_FAILURE);
  }
  set_events(front, EPOLL_CTL_ADD, seat_new(front->target, fd));
}

static void on_event(struct front *front, const struct epoll_event *event) {
  uint64_t count;
  if (event->data.ptr == NULL) {
    admit(front);
  } else if (event->data.ptr == front) {
    const ssize_t got = read(front->sleeper.eventfd, &count, sizeof count);
    (void)got; /* nothing is there when it was read before */
  } else {
    serve(front, event->data.ptr, event->events);
  }
}

static _Noreturn void run_front(struct front *front) {
  struct epoll_event events[EVENTS];
  for (;;) {
    atomic_store(&front->sleeper.asleep, true);
    const int count = epoll_wait(front->epoll, events, EVENTS, anything_done(front) ? 0 : -1);
    atomic_store(&front->sleeper.asleep, false);
    for (int i = 0; i < count; i++) {
      on_event(front, &events[i]);
    }
    for (size_t i = 0; i < SCHEME_WORKERS; i++) {
      if (!empty(&front->workers[i].to_do)) {
        wake(&front->workers[i].sleeper);
      }
    }
    collect(front);
  }
}

_Noreturn void scheme_run_front(const struct target *target, int listener) {
  static struct front front;
  front.target = target;
  front.listener = listener;
  front.epoll = epoll_create1(EPOLL_CLOEXEC);
  make_sleeper(&front.sleeper, EFD_NONBLOCK);
  struct epoll_event event = {.events = EPOLLIN, .data.ptr = NULL};
  int failed = epoll_ctl(front.epoll, EPOLL_CTL_ADD, listener, &event);
  event.data.ptr = &front;
  failed |= epoll_ctl(front.epoll, EPOLL_CTL_ADD, front.sleeper.eventfd, &event);
  for (size_t i = 0; i < SCHEME_WORKERS; i++) {
    front.workers[i].front = &front;
    make_sleeper(&front.workers[i].sleeper, 0);
    failed |= pthread_create(&front.workers[i].thread, NULL, run_worker, &front.workers[i]);
  }
  if (failed != 0) {
    _exit(EXIT_FAILURE);
  }
  run_front(&front);
}
