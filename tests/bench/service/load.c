#include "tests/bench/service/load.h"

#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/uio.h>
#include <unistd.h>

#include "proto/wire.h"
#include "tests/bench/bench.h"

enum { IN_FLIGHT_MAX = 4096, INPUT_BYTES = 65536, EVENTS = 64, PIECES = 64 };
#define SILENCE_NS (TARGET_SILENCE_S * UINT64_C(1000000000))

/* A queue of numbers of slots, first in, first out. */
struct queue {
  uint16_t *at;
  size_t room; /* one place for each slot */
  size_t first;
  size_t count;
};

/* A request, which may be in flight. Its bytes are made once; only the id changes. */
struct slot {
  uint64_t id;
  uint64_t due_ns;
  size_t variant;
  bool under_way;
};

struct connection {
  int fd;
  struct slot *slots;
  uint8_t *requests; /* [in_flight][request_bytes] */
  struct queue free;
  struct queue to_send; /* slots that wait to be sent; sent_bytes of the first have been sent */
  size_t sent_bytes;
  uint64_t sequence;
  uint8_t *input;
  size_t input_bytes;
  size_t have;
  bool blocked; /* whether the socket takes no more for now */
};

struct load {
  const struct target *target;
  struct connection *connections;
  size_t count;
  size_t in_flight;
  int epoll;
  struct samples *samples;
  uint64_t under_way;
  uint64_t answered;       /* number of answers so far */
  uint64_t heard_ns;       /* when the last answer arrived, or the run began */
  uint64_t issue_until_ns; /* later answers are not followed by a request */
};

/* ---- queues ------------------------------------------------------------------------------- */

static void *allocate(size_t count, size_t bytes) {
  void *memory = calloc(count, bytes);
  if (memory == NULL) {
    bench_fail("out of memory");
  }
  return memory;
}

static void push(struct queue *queue, size_t slot) {
  assert(queue->count < queue->room);
  const size_t end = queue->first + queue->count;
  queue->at[end < queue->room ? end : end - queue->room] = (uint16_t)slot;
  queue->count++;
}

static size_t pop(struct queue *queue) {
  assert(queue->count > 0);
  const size_t slot = queue->at[queue->first];
  queue->first = queue->first + 1 < queue->room ? queue->first + 1 : 0;
  queue->count--;
  return slot;
}

static size_t peek(const struct queue *queue, size_t index) {
  const size_t at = queue->first + index;
  return queue->at[at < queue->room ? at : at - queue->room];
}

/* ---- connections -------------------------------------------------------------------------- */

static void open_connection(struct load *load, size_t index) {
  const struct target *target = load->target;
  struct connection *c = &load->connections[index];
  const size_t n = load->in_flight;
  c->fd = target_connect(&target->address);
  c->slots = allocate(n, sizeof *c->slots);
  c->requests = allocate(n, target->request_bytes);
  struct queue *queues[] = {&c->free, &c->to_send};
  for (size_t i = 0; i < sizeof queues / sizeof queues[0]; i++) {
    *queues[i] = (struct queue){.at = allocate(n, sizeof(uint16_t)), .room = n};
  }
  for (size_t slot = 0; slot < n; slot++) {
    c->slots[slot].variant = (index * n + slot) % target->variants;
    memcpy(c->requests + slot * target->request_bytes,
           target->requests + c->slots[slot].variant * target->request_bytes,
           target->request_bytes);
    push(&c->free, slot);
  }
  const size_t least = target->reply_bytes + WIRE_BYTES_header + WIRE_BYTES_error;
  c->input_bytes = least > INPUT_BYTES ? least : INPUT_BYTES;
  c->input = allocate(1, c->input_bytes);
  struct epoll_event event = {.events = EPOLLIN, .data.ptr = c};
  if (fcntl(c->fd, F_SETFL, O_NONBLOCK) != 0 ||
      epoll_ctl(load->epoll, EPOLL_CTL_ADD, c->fd, &event) != 0) {
    bench_fail("cannot wait for a socket");
  }
}

struct load *load_new(const struct target *target, size_t connections, size_t in_flight) {
  assert(in_flight <= IN_FLIGHT_MAX);
  struct load *load = allocate(1, sizeof *load);
  load->target = target;
  load->count = connections;
  load->in_flight = in_flight;
  load->epoll = epoll_create1(EPOLL_CLOEXEC);
  load->connections = allocate(connections, sizeof *load->connections);
  for (size_t i = 0; i < connections; i++) {
    open_connection(load, i);
  }
  return load;
}

void load_free(struct load *load) {
  for (size_t i = 0; i < load->count; i++) {
    struct connection *c = &load->connections[i];
    close(c->fd);
    free(c->slots);
    free(c->requests);
    free(c->free.at);
    free(c->to_send.at);
    free(c->input);
  }
  close(load->epoll);
  free(load->connections);
  free(load);
}

/* ---- sending ------------------------------------------------------------------------------ */

/* Puts a request into a free slot and into the queue for sending. Its id names the slot and its
 * turn, so that an answer that comes late or twice is noticed. */
static void issue(struct load *load, struct connection *c, uint64_t due_ns) {
  const size_t number = pop(&c->free);
  struct slot *slot = &c->slots[number];
  slot->id = (++c->sequence * IN_FLIGHT_MAX) + number;
  slot->due_ns = due_ns;
  slot->under_way = true;
  target_set_id(c->requests + number * load->target->request_bytes, slot->id);
  push(&c->to_send, number);
  load->under_way++;
}

/* Joins requests that lie one behind the other in memory into one piece. Returns the number of
 * pieces. */
static int gather(const struct load *load, const struct connection *c, struct iovec *pieces) {
  const size_t bytes = load->target->request_bytes;
  int count = 0;
  for (size_t i = 0; i < c->to_send.count; i++) {
    uint8_t *request = c->requests + peek(&c->to_send, i) * bytes;
    if (count > 0 && (uint8_t *)pieces[count - 1].iov_base + pieces[count - 1].iov_len == request) {
      pieces[count - 1].iov_len += bytes;
    } else if (count < PIECES) {
      pieces[count++] = (struct iovec){request, bytes};
    } else {
      break;
    }
    if (i == 0) {
      pieces[0].iov_base = request + c->sent_bytes;
      pieces[0].iov_len -= c->sent_bytes;
    }
  }
  return count;
}

static void set_blocked(struct load *load, struct connection *c, bool blocked) {
  struct epoll_event event = {.events = blocked ? EPOLLIN | EPOLLOUT : EPOLLIN, .data.ptr = c};
  if (blocked != c->blocked && epoll_ctl(load->epoll, EPOLL_CTL_MOD, c->fd, &event) != 0) {
    bench_fail("cannot wait for a socket");
  }
  c->blocked = blocked;
}

static void send_more(struct load *load, struct connection *c) {
  while (c->to_send.count > 0) {
    struct iovec pieces[PIECES];
    const ssize_t sent = writev(c->fd, pieces, gather(load, c, pieces));
    if (sent < 0 && errno != EAGAIN) {
      bench_fail("a server does not take requests");
    }
    if (sent < 0) {
      set_blocked(load, c, true);
      return;
    }
    c->sent_bytes += (size_t)sent;
    while (c->sent_bytes >= load->target->request_bytes) {
      c->sent_bytes -= load->target->request_bytes;
      pop(&c->to_send);
    }
  }
  set_blocked(load, c, false);
}

/* ---- receiving ---------------------------------------------------------------------------- */

/* Returns the slot of the request that a reply, whose header has arrived, answers. */
static size_t slot_of(const struct load *load, const struct connection *c, const uint8_t *reply) {
  const size_t number = target_id(reply) % IN_FLIGHT_MAX;
  if (number >= load->in_flight || !c->slots[number].under_way) {
    bench_fail("an answer to a question that was not asked, or answered before");
  }
  return number;
}

static void take_answer(struct load *load, struct connection *c, size_t number, uint64_t now_ns) {
  struct slot *slot = &c->slots[number];
  samples_add(load->samples, now_ns - slot->due_ns);
  slot->under_way = false;
  push(&c->free, number);
  load->under_way--;
  load->answered++;
  if (now_ns < load->issue_until_ns) {
    issue(load, c, now_ns);
  }
}

static void take_answers(struct load *load, struct connection *c, uint64_t now_ns) {
  const struct target *target = load->target;
  size_t at = 0;
  while (c->have - at >= WIRE_BYTES_header) {
    const uint8_t *reply = c->input + at;
    const size_t number = slot_of(load, c, reply);
    const struct slot *slot = &c->slots[number];
    const bool whole = c->have - at >= target->reply_bytes;
    target_check(target, slot->variant, slot->id, reply,
                 whole && load->answered % target->check_every == 0);
    if (!whole) {
      break;
    }
    take_answer(load, c, number, now_ns);
    at += target->reply_bytes;
  }
  memmove(c->input, c->input + at, c->have - at);
  c->have -= at;
}

static void receive(struct load *load, struct connection *c) {
  const ssize_t got = read(c->fd, c->input + c->have, c->input_bytes - c->have);
  if (got == 0 || (got < 0 && errno != EAGAIN)) {
    bench_fail("a server has closed a connection");
  }
  if (got > 0) {
    c->have += (size_t)got;
    load->heard_ns = bench_now_ns();
    take_answers(load, c, load->heard_ns);
  }
}

/* Receives and sends on all sockets that are ready. Waits for one up to timeout_ms. */
static void pump(struct load *load, int timeout_ms) {
  struct epoll_event events[EVENTS];
  const int count = epoll_wait(load->epoll, events, EVENTS, timeout_ms);
  for (int i = 0; i < count; i++) {
    struct connection *c = events[i].data.ptr;
    if (events[i].events & ~(uint32_t)EPOLLOUT) {
      receive(load, c);
    }
    send_more(load, c);
  }
  if (count <= 0 && load->under_way > 0 && bench_now_ns() - load->heard_ns > SILENCE_NS) {
    bench_fail("a server does not answer");
  }
}

/* ---- public ------------------------------------------------------------------------------- */

static void begin(struct load *load, struct samples *samples, uint64_t now_ns) {
  samples_clear(samples);
  load->samples = samples;
  load->heard_ns = now_ns;
}

double load_closed(struct load *load, uint64_t duration_ns, struct samples *samples) {
  const uint64_t start_ns = bench_now_ns();
  begin(load, samples, start_ns);
  load->issue_until_ns = start_ns + duration_ns;
  for (size_t i = 0; i < load->count; i++) {
    struct connection *c = &load->connections[i];
    while (c->free.count > 0) {
      issue(load, c, bench_now_ns());
    }
    send_more(load, c);
  }
  while (bench_now_ns() < load->issue_until_ns) {
    pump(load, 1);
  }
  const double taken_s = (double)(bench_now_ns() - start_ns) * 1e-9;
  const double per_s = (double)samples->count / taken_s;
  load->issue_until_ns = 0;
  while (load->under_way > 0) {
    pump(load, 1);
  }
  samples_sort(samples);
  return per_s;
}
