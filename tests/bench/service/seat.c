#include "tests/bench/service/seat.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "tests/bench/bench.h"

/* ---- what is done for a request ----------------------------------------------------------- */

/* Stands for looking up a profile: a chain of some 100 ns. */
static float prepare(float seed) {
  enum { STEPS = 40 };
  for (int i = 0; i < STEPS; i++) {
    seed = seed * 0.5f + 1.0f;
  }
  return seed;
}

/* Stands for a kernel: half a nanosecond or so for each value. */
static void work(const struct target *target, const uint8_t *request, uint8_t *reply) {
  const size_t n = (target->reply_bytes - target->values_from) / sizeof(float);
  const float *x = (const float *)(request + target->request_bytes - n * sizeof *x);
  float *y = (float *)(reply + target->values_from);
  const float a = prepare(x[0]);
  for (size_t i = 0; i < n; i++) {
    y[i] = (a * x[i] + 0.25f) * x[i] + 0.125f;
  }
}

void seat_work(struct seat *seat, size_t place) {
  const struct target *target = seat->target;
  const uint8_t *request = seat->requests + place * target->request_bytes;
  uint8_t *reply = seat->replies + place * target->reply_bytes;
  target_set_id(reply, target_id(request));
  work(target, request, reply);
}

void seat_expect(struct target *target) {
  for (size_t variant = 0; variant < target->variants; variant++) {
    work(target, target->requests + variant * target->request_bytes,
         target->replies + variant * target->reply_bytes);
  }
}

/* ---- rings -------------------------------------------------------------------------------- */

struct seat *seat_new(const struct target *target, int fd) {
  struct seat *seat = calloc(1, sizeof *seat);
  uint8_t *requests = calloc(SEAT_PLACES, target->request_bytes);
  uint8_t *replies = calloc(SEAT_PLACES, target->reply_bytes);
  if (seat == NULL || requests == NULL || replies == NULL) {
    _exit(EXIT_FAILURE);
  }
  *seat = (struct seat){.target = target, .fd = fd, .requests = requests, .replies = replies};
  for (size_t place = 0; place < SEAT_PLACES; place++) {
    memcpy(replies + place * target->reply_bytes, target->replies, target->reply_bytes);
  }
  return seat;
}

void seat_free(struct seat *seat) {
  close(seat->fd);
  free(seat->requests);
  free(seat->replies);
  free(seat);
}

/* How many bytes from a position of a ring on lie in one piece, at most wanted. */
static size_t piece(uint64_t position, size_t ring_bytes, uint64_t wanted) {
  const size_t left = ring_bytes - position % ring_bytes;
  return wanted < left ? (size_t)wanted : left;
}

bool seat_receive(struct seat *seat) {
  const struct target *target = seat->target;
  const size_t ring_bytes = SEAT_PLACES * target->request_bytes;
  const uint64_t kept_bytes =
      seat->received_bytes - seat->sent_bytes / target->reply_bytes * target->request_bytes;
  const size_t room = piece(seat->received_bytes, ring_bytes, ring_bytes - kept_bytes);
  if (room == 0) {
    return true;
  }
  const ssize_t got = read(seat->fd, seat->requests + seat->received_bytes % ring_bytes, room);
  seat->received_bytes += got > 0 ? (uint64_t)got : 0;
  return got > 0 || (got < 0 && errno == EAGAIN);
}

bool seat_take(struct seat *seat, size_t *place) {
  if ((seat->taken + 1) * seat->target->request_bytes > seat->received_bytes) {
    return false;
  }
  *place = seat->taken++ % SEAT_PLACES;
  return true;
}

void seat_finish(struct seat *seat, size_t place) {
  seat->done[place] = true;
  while (seat->done[seat->complete % SEAT_PLACES]) {
    seat->done[seat->complete++ % SEAT_PLACES] = false;
  }
}

bool seat_send(struct seat *seat) {
  const size_t ring_bytes = SEAT_PLACES * seat->target->reply_bytes;
  const uint64_t end = seat->complete * seat->target->reply_bytes;
  while (seat->sent_bytes < end) {
    const ssize_t sent = write(seat->fd, seat->replies + seat->sent_bytes % ring_bytes,
                               piece(seat->sent_bytes, ring_bytes, end - seat->sent_bytes));
    if (sent < 0) {
      seat->blocked = true;
      return errno == EAGAIN;
    }
    seat->sent_bytes += (uint64_t)sent;
  }
  seat->blocked = false;
  return true;
}
