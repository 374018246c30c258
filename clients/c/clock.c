#include <errno.h>
#include <poll.h>
#include <time.h>

#include "clients/c/client.h"

int64_t libdipole_now_ms(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
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
