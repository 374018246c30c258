#include "tests/bench/service/ping.h"

#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "proto/wire.h"
#include "tests/bench/bench.h"

void ping_open(struct ping *ping, const struct target *target) {
  const size_t bytes = target->variants * target->request_bytes;
  *ping = (struct ping){.target = target, .fd = target_connect(&target->address)};
  ping->requests = malloc(bytes);
  ping->reply = malloc(target->reply_bytes + WIRE_BYTES_header + WIRE_BYTES_error);
  if (ping->requests == NULL || ping->reply == NULL) {
    bench_fail("out of memory");
  }
  memcpy(ping->requests, target->requests, bytes);
}

void ping_close(struct ping *ping) {
  close(ping->fd);
  free(ping->requests);
  free(ping->reply);
}

static void send_all(int fd, const uint8_t *bytes, size_t count) {
  while (count > 0) {
    const ssize_t sent = write(fd, bytes, count);
    if (sent <= 0) {
      bench_fail("a server does not take a request");
    }
    bytes += sent;
    count -= (size_t)sent;
  }
}

/* Waits for a reply. Checks the header before it waits for the rest. */
static void receive(const struct ping *ping, size_t variant) {
  const struct target *target = ping->target;
  size_t have = 0;
  bool looked_at = false;
  while (have < target->reply_bytes) {
    const ssize_t got = read(ping->fd, ping->reply + have, target->reply_bytes - have);
    if (got <= 0) {
      bench_fail("a server does not answer");
    }
    have += (size_t)got;
    if (!looked_at && have >= WIRE_BYTES_header && have < target->reply_bytes) {
      looked_at = true;
      target_check(target, variant, ping->count, ping->reply, false);
    }
  }
}

static uint64_t ask(struct ping *ping) {
  const struct target *target = ping->target;
  const size_t variant = ping->count % target->variants;
  uint8_t *request = ping->requests + variant * target->request_bytes;
  ping->count++;
  target_set_id(request, ping->count);
  const uint64_t start_ns = bench_now_ns();
  send_all(ping->fd, request, target->request_bytes);
  receive(ping, variant);
  const uint64_t end_ns = bench_now_ns();
  target_check(target, variant, ping->count, ping->reply, ping->count % target->check_every == 0);
  return end_ns - start_ns;
}

void ping_run(struct ping *ping, uint64_t duration_ns, struct samples *samples) {
  const uint64_t end_ns = bench_now_ns() + duration_ns;
  samples_clear(samples);
  do {
    samples_add(samples, ask(ping));
  } while (bench_now_ns() < end_ns);
  samples_sort(samples);
}
