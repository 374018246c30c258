#include "tests/bench/service/modbus.h"

#include <errno.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "core/core.h"
#include "proto/registers.h"
#include "tests/bench/bench.h"
#include "tests/bench/service/child.h"

enum {
  MBAP_BYTES = 7,
  READ_WRITE = 23,
  WRITTEN = 20,
  READ = 20,
  REQUEST_BYTES = MBAP_BYTES + 10 + 2 * WRITTEN,
  REPLY_BYTES = MBAP_BYTES + 2 + 2 * READ,
  COUNT = 4,
  R_BYTES = COUNT * 4,
  WRITE_FROM = 100, /* the registers commit and status, see proto/REGISTERS.md */
  READ_FROM = 300,
  BLOCKED_MS = 20,
};
#define START_MM 0.5f
#define STOP_MM 2.0f

/* ---- jobs --------------------------------------------------------------------------------- */

static uint8_t *put_word(uint8_t *at, unsigned word) {
  at[0] = (uint8_t)(word >> 8);
  at[1] = (uint8_t)word;
  return at + 2;
}

static uint8_t *put_float(uint8_t *at, float value) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  return put_word(put_word(at, bits >> 16), bits & 0xffff);
}

/* Returns the medium of a unit. Every unit has its own. */
static core_medium medium_of(size_t unit) {
  return (core_medium){.sigma_a_per_mm = (float)(0.01 * (double)unit),
                       .sigma_s_per_mm = 1,
                       .g = 0,
                       .eta = (double)1.3f};
}

static void put_request(uint8_t *at, size_t unit) {
  const core_medium medium = medium_of(unit);
  at = put_word(at, 1); /* transaction */
  at = put_word(at, 0); /* protocol */
  at = put_word(at, REQUEST_BYTES - MBAP_BYTES + 1);
  *at++ = (uint8_t)unit;
  *at++ = READ_WRITE;
  at = put_word(put_word(at, READ_FROM), READ);
  at = put_word(put_word(at, WRITE_FROM), WRITTEN);
  *at++ = 2 * WRITTEN;
  at = put_word(at, 1); /* the value of commit */
  at = put_word(at, CORE_MODEL_BETTER);
  at = put_word(at, CORE_EVALUATOR_F32);
  at = put_word(at, CORE_MOMENTS_EXACT);
  at = put_float(at, 0); /* tolerance: none */
  at = put_float(at, (float)medium.sigma_a_per_mm);
  at = put_float(at, (float)medium.sigma_s_per_mm);
  at = put_float(at, (float)medium.g);
  at = put_float(at, (float)medium.eta);
  at = put_word(at, CORE_SPACING_LINEAR);
  at = put_word(at, COUNT);
  put_float(put_float(at, START_MM), STOP_MM);
}

/* Writes the expected values R, the last bytes of a reply, with which replies are compared. */
static void put_values(uint8_t *at, size_t unit) {
  const core_grid grid = {CORE_SPACING_LINEAR, COUNT, (double)START_MM, (double)STOP_MM};
  const core_medium medium = medium_of(unit);
  core_profile profile;
  float r[COUNT], R[COUNT];
  if (core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_BETTER, CORE_MOMENTS_EXACT,
                           CORE_EVALUATOR_F32, &medium, NULL)
          .field != NULL) {
    bench_fail("a medium was refused");
  }
  core_grid_radii_f32(&grid, 0, COUNT, r);
  core_eval_f32(&profile, CORE_QUANTITY_R, COUNT, r, R);
  core_profile_free(&profile);
  for (size_t i = 0; i < COUNT; i++) {
    at = put_float(at, R[i]);
  }
}

void modbus_make_jobs(struct target *target) {
  *target = (struct target){
      .name = "dipoled",
      .framed = false,
      .variants = MODBUS_UNITS,
      .request_bytes = REQUEST_BYTES,
      .reply_bytes = REPLY_BYTES,
      .values_from = REPLY_BYTES - R_BYTES,
      .check_every = 1,
      .requests = calloc(MODBUS_UNITS, REQUEST_BYTES),
      .replies = calloc(MODBUS_UNITS, REPLY_BYTES),
  };
  if (target->requests == NULL || target->replies == NULL) {
    bench_fail("out of memory");
  }
  for (size_t i = 0; i < MODBUS_UNITS; i++) {
    put_request(target->requests + i * REQUEST_BYTES, i + 1);
    put_values(target->replies + i * REPLY_BYTES + target->values_from, i + 1);
  }
}

/* ---- masters that behave badly ------------------------------------------------------------- */

static void nap(long ns) {
  const struct timespec time = {.tv_nsec = ns};
  nanosleep(&time, NULL);
}

/* Sends requests one byte at a time. When the deadline of a frame ends the connection, opens the
 * next one. */
static _Noreturn void trickle(const struct target_address *address, int ready) {
  if (write(ready, "", 1) != 1) {
    _exit(EXIT_FAILURE);
  }
  uint8_t request[REQUEST_BYTES];
  put_request(request, MODBUS_UNITS + 1);
  for (;;) {
    const int fd = target_connect(address);
    for (size_t i = 0; i < sizeof request && send(fd, request + i, 1, MSG_NOSIGNAL) == 1; i++) {
      nap(400000000);
    }
    close(fd);
  }
}

/* Sends requests and never reads. Writes to `ready` when the daemon takes no more bytes, which
 * happens soon because the buffers are small. */
static _Noreturn void never_read(const struct target_address *address, int ready) {
  const int small = 4096;
  uint8_t request[REQUEST_BYTES];
  put_request(request, MODBUS_UNITS + 2);
  const int fd = target_connect(address);
  struct pollfd room = {.fd = fd, .events = POLLOUT};
  setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &small, sizeof small);
  setsockopt(fd, SOL_SOCKET, SO_SNDBUF, &small, sizeof small);
  while (poll(&room, 1, BLOCKED_MS) == 1) {
    if (send(fd, request, sizeof request, MSG_NOSIGNAL | MSG_DONTWAIT) < 0 && errno != EAGAIN) {
      _exit(EXIT_FAILURE);
    }
  }
  while (write(ready, "", 1) == 1) {
    pause();
  }
  _exit(EXIT_FAILURE);
}

static _Noreturn void ask_the_unknown(const struct target_address *address, int ready) {
  static const uint8_t request[] = {0, 1, 0, 0, 0, 2, MODBUS_UNITS + 3, 99};
  uint8_t reply[MBAP_BYTES + 2];
  const int fd = target_connect(address);
  if (write(ready, "", 1) != 1) {
    _exit(EXIT_FAILURE);
  }
  while (send(fd, request, sizeof request, MSG_NOSIGNAL) == sizeof request &&
         recv(fd, reply, sizeof reply, MSG_WAITALL) == sizeof reply) {
    nap(10000000);
  }
  _exit(EXIT_FAILURE);
}

void modbus_start_rude(const struct target_address *address, pid_t rude[MODBUS_RUDE]) {
  void (*const run[MODBUS_RUDE])(const struct target_address *, int) = {trickle, never_read,
                                                                        ask_the_unknown};
  int ready[2];
  if (pipe(ready) != 0) {
    bench_fail("no pipe");
  }
  for (size_t i = 0; i < MODBUS_RUDE; i++) {
    rude[i] = child_fork(CHILD_CLIENT);
    if (rude[i] == 0) {
      close(ready[0]); /* Only the parent process reads from this pipe. */
      run[i](address, ready[1]);
      _exit(EXIT_FAILURE);
    }
  }
  close(ready[1]);
  for (size_t i = 0; i < MODBUS_RUDE; i++) {
    char byte;
    if (read(ready[0], &byte, 1) != 1) {
      bench_fail("the rude masters have ended");
    }
  }
  close(ready[0]);
}
