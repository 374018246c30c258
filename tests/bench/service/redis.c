#include "tests/bench/service/redis.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "tests/bench/bench.h"
#include "tests/bench/service/child.h"

enum { KEYS = 64, VALUE_BYTES = 64, READY_MS = 10000, TEXT_BYTES = 256 };

static bool in_path(const char *program) {
  char file[4096];
  const char *at = getenv("PATH");
  while (at != NULL && *at != '\0') {
    const size_t length = strcspn(at, ":");
    snprintf(file, sizeof file, "%.*s/%s", (int)length, at, program);
    if (access(file, X_OK) == 0) {
      return true;
    }
    at += length + (at[length] == ':');
  }
  return false;
}

static void wait_until_it_listens(pid_t child, const char *path) {
  const struct timespec nap = {.tv_nsec = 1000000};
  for (int ms = 0; access(path, F_OK) != 0; ms++) {
    child_must_run(child, "redis-server");
    if (ms == READY_MS) {
      bench_fail("redis-server does not get ready");
    }
    nanosleep(&nap, NULL);
  }
}

/* ---- its protocol: RESP ------------------------------------------------------------------- */

static void make_value(unsigned key, char value[VALUE_BYTES + 1]) {
  for (unsigned i = 0; i < VALUE_BYTES; i++) {
    value[i] = (char)('0' + (key * 7 + i) % 64);
  }
  value[VALUE_BYTES] = '\0';
}

static int print_get(char *text, unsigned key) {
  return snprintf(text, TEXT_BYTES, "*2\r\n$3\r\nGET\r\n$8\r\nkey:%04u\r\n", key);
}

static int print_value(char *text, unsigned key) {
  char value[VALUE_BYTES + 1];
  make_value(key, value);
  return snprintf(text, TEXT_BYTES, "$%d\r\n%s\r\n", VALUE_BYTES, value);
}

static void set(int fd, unsigned key) {
  static const char ok[] = "+OK\r\n";
  char text[TEXT_BYTES], value[VALUE_BYTES + 1], reply[sizeof ok] = "";
  make_value(key, value);
  const int length =
      snprintf(text, sizeof text, "*3\r\n$3\r\nSET\r\n$8\r\nkey:%04u\r\n$%d\r\n%s\r\n", key,
               VALUE_BYTES, value);
  if (write(fd, text, (size_t)length) != length ||
      recv(fd, reply, sizeof ok - 1, MSG_WAITALL) != (ssize_t)sizeof ok - 1 ||
      strcmp(reply, ok) != 0) {
    bench_fail("redis-server does not take a value");
  }
}

static void make_target(struct target *target, const char *path, pid_t server) {
  char text[TEXT_BYTES];
  *target = (struct target){
      .name = "redis",
      .server = server,
      .address = target_unix(path),
      .variants = KEYS,
      .request_bytes = (size_t)print_get(text, 0),
      .reply_bytes = (size_t)print_value(text, 0),
      .check_every = 1,
  };
  target->requests = calloc(KEYS, target->request_bytes);
  target->replies = calloc(KEYS, target->reply_bytes);
  if (target->requests == NULL || target->replies == NULL) {
    bench_fail("out of memory");
  }
  for (unsigned key = 0; key < KEYS; key++) {
    print_get(text, key);
    memcpy(target->requests + key * target->request_bytes, text, target->request_bytes);
    print_value(text, key);
    memcpy(target->replies + key * target->reply_bytes, text, target->reply_bytes);
  }
}

/* ---- public ------------------------------------------------------------------------------- */

bool redis_start(struct target *target) {
  if (!in_path("redis-server")) {
    fprintf(stderr, "bench: no redis-server in PATH: the comparison with it is left out\n");
    return false;
  }
  const char *path = child_path("redis.sock");
  char *arguments[] = {"redis-server", "--port",      "0",  "--unixsocket",
                       (char *)path,   "--save",      "",   "--appendonly",
                       "no",           "--daemonize", "no", NULL};
  const pid_t child = child_run(CHILD_SERVER, arguments, child_path("redis.log"));
  wait_until_it_listens(child, path);
  make_target(target, path, child);
  const int fd = target_connect(&target->address);
  for (unsigned key = 0; key < KEYS; key++) {
    set(fd, key);
  }
  close(fd);
  return true;
}
