#include "tests/bench/service/stream.h"

#include <sched.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "core/core.h"
#include "proto/eval.h"
#include "tests/bench/bench.h"
#include "tests/bench/service/child.h"

/* The size of one read. It keeps the core for some ten microseconds. */
enum { READ_BYTES = 65536 };
#define SILENCE_NS (TARGET_SILENCE_S * UINT64_C(1000000000))

struct stream_shared {
  _Atomic uint64_t bytes;
  _Atomic bool wanted;
};

enum { BEGIN = 'b', PAUSED = 'p' };

/* ---- the process -------------------------------------------------------------------------- */

static size_t make_request(uint8_t *at) {
  const core_medium *medium = &core_measured_medium_by_name("skin1")->channel[0];
  const size_t payload_bytes = WIRE_BYTES_eval_request + WIRE_BYTES_medium;
  const wire_header header = {
      .magic = WIRE_MAGIC,
      .version = WIRE_VERSION,
      .type = WIRE_TYPE_EVAL,
      .request_id = 1,
      .payload_bytes = (uint32_t)payload_bytes,
  };
  const wire_eval_request fixed = {
      .model = CORE_MODEL_BETTER,
      .evaluator = CORE_EVALUATOR_F32,
      .moments = CORE_MOMENTS_EXACT,
      .wanted = CORE_QUANTITY_R,
      .medium_count = 1,
      .spacing = CORE_SPACING_LINEAR,
      .radius_count = STREAM_RADII,
      .radius_start = 0.01,
      .radius_stop = 10,
  };
  const wire_medium channel = {medium->sigma_a_per_mm, medium->sigma_s_per_mm, medium->g,
                               medium->eta};
  wire_put_header(at, &header);
  wire_put_eval_request(at + WIRE_BYTES_header, &fixed);
  wire_put_medium(at + WIRE_BYTES_header + WIRE_BYTES_eval_request, &channel);
  return WIRE_BYTES_header + payload_bytes;
}

static void receive_some(int fd, uint8_t *bytes, size_t count, struct stream_shared *shared) {
  for (size_t have = 0; have < count;) {
    const ssize_t got = read(fd, bytes + have, count - have);
    if (got <= 0) {
      bench_fail("a streamed answer breaks off");
    }
    have += (size_t)got;
    atomic_fetch_add_explicit(&shared->bytes, (uint64_t)got, memory_order_relaxed);
  }
}

/* Reads a frame. Returns how many bytes of values it has. */
static uint64_t receive_frame(int fd, uint8_t *buffer, struct stream_shared *shared) {
  wire_header header;
  const uint64_t besides = eval_albedo_offset(1) + 2 * WIRE_BYTES_quantity_error;
  receive_some(fd, buffer, WIRE_BYTES_header, shared);
  wire_get_header(buffer, &header);
  if (header.magic != WIRE_MAGIC || header.type != (WIRE_TYPE_EVAL | WIRE_REPLY) ||
      header.payload_bytes < besides) {
    bench_fail("a streamed request was refused");
  }
  for (uint64_t left = header.payload_bytes; left > 0;) {
    const size_t count = left < READ_BYTES ? (size_t)left : READ_BYTES;
    receive_some(fd, buffer, count, shared);
    left -= count;
  }
  return header.payload_bytes - besides;
}

static void tell(int control, char what) {
  if (write(control, &what, 1) != 1) {
    _exit(EXIT_FAILURE);
  }
}

/* Sends one request and reads its answer. */
static void stream_once(int fd, struct stream_shared *shared) {
  static uint8_t buffer[READ_BYTES];
  const size_t bytes = make_request(buffer);
  if (write(fd, buffer, bytes) != (ssize_t)bytes) {
    bench_fail("a streamed request is not taken");
  }
  uint64_t values = 0;
  while (values < STREAM_RADII * sizeof(float)) {
    values += receive_frame(fd, buffer, shared);
  }
  if (values != STREAM_RADII * sizeof(float)) {
    bench_fail("a streamed answer has more values than were asked for");
  }
}

static _Noreturn void run(int fd, int control, struct stream_shared *shared) {
  const struct sched_param none = {0};
  char what;
  if (sched_setscheduler(0, SCHED_IDLE, &none) != 0) {
    _exit(EXIT_FAILURE);
  }
  while (read(control, &what, 1) == 1) {
    do {
      stream_once(fd, shared);
    } while (atomic_load(&shared->wanted));
    tell(control, PAUSED);
  }
  _exit(EXIT_SUCCESS);
}

/* ---- public ------------------------------------------------------------------------------- */

void stream_start(struct streamer *streamer, const struct target_address *address) {
  int pair[2];
  streamer->shared = mmap(NULL, sizeof *streamer->shared, PROT_READ | PROT_WRITE,
                          MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (streamer->shared == MAP_FAILED ||
      socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0) {
    bench_fail("cannot start a streaming client");
  }
  if (child_fork(CHILD_CLIENT) == 0) {
    close(pair[0]);
    run(target_connect(address), pair[1], streamer->shared);
  }
  close(pair[1]);
  streamer->control = pair[0];
}

void stream_begin(struct streamer *streamer) {
  const struct timespec nap = {.tv_nsec = 100000};
  const uint64_t before = stream_bytes(streamer);
  const uint64_t end_ns = bench_now_ns() + SILENCE_NS;
  atomic_store(&streamer->shared->wanted, true);
  tell(streamer->control, BEGIN);
  while (stream_bytes(streamer) == before) {
    if (bench_now_ns() > end_ns) {
      bench_fail("a streaming client gets no answer");
    }
    nanosleep(&nap, NULL);
  }
}

uint64_t stream_bytes(const struct streamer *streamer) {
  return atomic_load(&streamer->shared->bytes);
}

void stream_pause(struct streamer *streamer) {
  atomic_store(&streamer->shared->wanted, false);
  char told;
  if (read(streamer->control, &told, 1) != 1 || told != PAUSED) {
    bench_fail("a streaming client has stopped");
  }
}
