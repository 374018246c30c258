/* fuzz: the functions that libFuzzer calls. FUZZ_TARGETS (fuzz.h) lists the targets. The variable
 * FUZZ_TARGET names the one that this process runs; without it, the process prints the names and
 * exits with 2:
 *
 *   FUZZ_TARGET=modbus build-fuzz/fuzz build-fuzz/corpus/modbus     searches
 *   FUZZ_TARGET=modbus build-fuzz/fuzz FILE                         runs one input again
 *
 * tests/fuzz/fuzz.py runs all targets. */
#include "tests/fuzz/fuzz.h"

#include <dirent.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

_Noreturn void fuzz_fail(const char *text) {
  (void)!write(STDERR_FILENO, text, strlen(text));
  abort();
}

/* ---- inputs --------------------------------------------------------------------------------- */

uint8_t *fuzz_copy(const uint8_t *data, size_t size) {
  uint8_t *copy = malloc(size > 0 ? size : 1);
  CHECK(copy != NULL);
  memcpy(copy, data, size);
  return copy;
}

struct fuzz_delivery fuzz_delivery_begin(const uint8_t *data, size_t size) {
  return (struct fuzz_delivery){
      .piece = data[0], .random = data[0], .at = data + 1, .left = size - 1};
}

size_t fuzz_delivery_next(struct fuzz_delivery *delivery, const uint8_t **piece) {
  size_t bytes = delivery->left;
  if (delivery->piece > 0) {
    delivery->random = delivery->random * 1664525 + 1013904223;
    const size_t wanted = 1 + (delivery->random >> 16) % delivery->piece;
    bytes = wanted < bytes ? wanted : bytes;
  }
  *piece = delivery->at;
  delivery->at += bytes;
  delivery->left -= bytes;
  return bytes;
}

uint8_t *fuzz_gather(struct fuzz_bytes *gathered, size_t bytes) {
  if (gathered->room - gathered->count < bytes) {
    gathered->room = 2 * gathered->room + bytes;
    gathered->bytes = realloc(gathered->bytes, gathered->room);
    CHECK(gathered->bytes != NULL);
  }
  return gathered->bytes + gathered->count;
}

/* ---- hangs -------------------------------------------------------------------------------------- */

enum { TICK_S = 5, HANG_S = 60 };

static pthread_t fuzzing_thread;
static atomic_ullong inputs_begun;

/* Returns for how long the threads of this process have waited for a processor, in seconds. */
static double queued_s(void) {
  DIR *tasks = opendir("/proc/self/task");
  CHECK(tasks != NULL);
  double sum_s = 0;
  for (const struct dirent *task; (task = readdir(tasks)) != NULL;) {
    char path[300];
    unsigned long long ran_ns, queued_ns;
    snprintf(path, sizeof path, "/proc/self/task/%s/schedstat", task->d_name);
    FILE *stat = fopen(path, "r"); /* a thread may have ended, and . has no such file */
    if (stat != NULL) {
      sum_s += fscanf(stat, "%llu %llu", &ran_ns, &queued_ns) == 2 ? 1e-9 * (double)queued_ns : 0;
      fclose(stat);
    }
  }
  closedir(tasks);
  return sum_s;
}

static double clock_s(clockid_t clock) {
  struct timespec now;
  clock_gettime(clock, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Ends the process by an abort of the fuzzing thread once an input takes HANG_S seconds of
 * processor time, or as long in which no thread runs or waits for a processor. A machine that is
 * busy with other work is not taken for a hang. */
static void *watch(void *unused) {
  unsigned long long input = 0;
  double begin_s = 0, ran_begin_s = 0, queued_begin_s = 0;
  for (;;) {
    const unsigned long long input_now = atomic_load(&inputs_begun);
    const double now_s = clock_s(CLOCK_MONOTONIC), ran_now_s = clock_s(CLOCK_PROCESS_CPUTIME_ID);
    const double queued_now_s = queued_s();
    if (input_now != input || input_now == 0) {
      input = input_now;
      begin_s = now_s, ran_begin_s = ran_now_s, queued_begin_s = queued_now_s;
    }
    const double took_s = now_s - begin_s, ran_s = ran_now_s - ran_begin_s;
    const double slept_s = took_s - ran_s - (queued_now_s - queued_begin_s);
    if (ran_s >= HANG_S || slept_s >= HANG_S) {
      dprintf(STDERR_FILENO,
              "hang: one input for %.0f s, %.0f s of processor time, %.0f s asleep\n", took_s,
              ran_s, slept_s);
      pthread_kill(fuzzing_thread, SIGABRT);
      return unused;
    }
    sleep(TICK_S);
  }
}

void fuzz_start_nothing(void) {}

/* ---- the list ----------------------------------------------------------------------------------- */

static const struct target {
  const char *name;
  void (*start)(void);
  void (*run)(const uint8_t *data, size_t size);
} targets[] = {
#define FUZZ_TARGET(name, start) {#name, start, fuzz_##name},
    FUZZ_TARGETS(FUZZ_TARGET)};

static const struct target *target;

int LLVMFuzzerInitialize(int *argc, char ***argv) {
  (void)argc;
  (void)argv;
  const char *name = getenv("FUZZ_TARGET");
  for (size_t i = 0; name != NULL && i < sizeof targets / sizeof *targets; i++) {
    target = strcmp(targets[i].name, name) == 0 ? &targets[i] : target;
  }
  if (target == NULL) {
    for (size_t i = 0; i < sizeof targets / sizeof *targets; i++) {
      puts(targets[i].name);
    }
    exit(2);
  }
  target->start();
  fuzzing_thread = pthread_self();
  pthread_t watcher;
  CHECK(pthread_create(&watcher, NULL, watch, NULL) == 0);
  CHECK(pthread_detach(watcher) == 0);
  return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  atomic_fetch_add(&inputs_begun, 1);
  target->run(data, size);
  return 0;
}
