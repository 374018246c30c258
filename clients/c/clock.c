#include "clients/c/clock.h"

#include <errno.h>
#include <limits.h>
#include <poll.h>
#include <time.h>

int64_t libdipole_now_ms(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

void libdipole_sleep_ms(int64_t ms) {
  struct timespec left = {.tv_sec = (time_t)(ms / 1000), .tv_nsec = (long)(ms % 1000) * 1000000};
  while (nanosleep(&left, &left) != 0 && errno == EINTR) {
  }
}

bool libdipole_wait(int fd, short events, unsigned timeout_ms, short *ready) {
  struct pollfd wait = {.fd = fd, .events = events};
  const int64_t deadline_ms = libdipole_now_ms() + timeout_ms;
  for (;;) {
    int64_t left_ms = timeout_ms == 0 ? -1 : deadline_ms - libdipole_now_ms();
    left_ms = timeout_ms != 0 && left_ms < 0 ? 0 : left_ms;
    const int count = poll(&wait, 1, left_ms > INT_MAX ? INT_MAX : (int)left_ms);
    if (count > 0) {
      *ready = wait.revents;
      return true;
    }
    if (count == 0) {
      errno = ETIMEDOUT;
      return false;
    }
    if (errno != EINTR) {
      return false;
    }
  }
}

/* Returns the upper 32 of the 64 bits of xorshift64* (Vigna 2016), which are the better ones. */
uint32_t libdipole_random(uint64_t *state) {
  uint64_t x = *state;
  if (x == 0) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    x = ((uint64_t)now.tv_nsec << 32 ^ (uint64_t)(uintptr_t)state) | 1;
  }
  x ^= x >> 12;
  x ^= x << 25;
  x ^= x >> 27;
  *state = x;
  return (uint32_t)(x * UINT64_C(0x2545f4914f6cdd1d) >> 32);
}

unsigned libdipole_jitter(uint64_t *state, unsigned pause_ms) {
  return pause_ms - libdipole_random(state) % (pause_ms / 2 + 1);
}

unsigned libdipole_pause(uint64_t *state, unsigned *pause_ms, uint32_t retry_after_ms,
                         int64_t until_ms) {
  const int64_t left_ms = until_ms - libdipole_now_ms();
  if (left_ms < LIBDIPOLE_PAUSE_FIRST_MS || left_ms <= (int64_t)retry_after_ms) {
    return 0;
  }
  const unsigned usual_ms = libdipole_jitter(state, *pause_ms);
  const unsigned short_ms = usual_ms < left_ms / 2 ? usual_ms : (unsigned)(left_ms / 2);
  *pause_ms = 2 * *pause_ms < LIBDIPOLE_PAUSE_MOST_MS ? 2 * *pause_ms : LIBDIPOLE_PAUSE_MOST_MS;
  return short_ms > retry_after_ms ? short_ms : retry_after_ms;
}
