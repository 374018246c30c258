/* Counts allocations in build/dipoled-counting, which is made of dipoled's objects, and lets one of
 * them fail. The linker's --wrap sends each of their calls of malloc, calloc and realloc through this
 * file, and libuv is told to call functions of this file, which never fail. The first 8 bytes of the
 * file that ALLOCATIONS_FILE names are the number of calls; a test writes into the second 8 bytes
 * which of the daemon's own calls fails: the next one is 1; 0 when it has failed. */
#include <fcntl.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>
#include <uv.h>

static struct { _Atomic uint64_t calls, until_failure; } * shared;

void *__real_malloc(size_t bytes);
void *__real_calloc(size_t count, size_t bytes);
void *__real_realloc(void *pointer, size_t bytes);
void *__wrap_malloc(size_t bytes);
void *__wrap_calloc(size_t count, size_t bytes);
void *__wrap_realloc(void *pointer, size_t bytes);

/* Counts a call of the daemon. Returns whether it has to fail. */
static bool fails(void) {
  uint64_t left = atomic_load(&shared->until_failure);
  while (left > 0 && !atomic_compare_exchange_weak(&shared->until_failure, &left, left - 1)) {
  }
  atomic_fetch_add(&shared->calls, 1);
  return left == 1;
}

void *__wrap_malloc(size_t bytes) {
  return fails() ? NULL : __real_malloc(bytes);
}

void *__wrap_calloc(size_t count, size_t bytes) {
  return fails() ? NULL : __real_calloc(count, bytes);
}

void *__wrap_realloc(void *pointer, size_t bytes) {
  return fails() ? NULL : __real_realloc(pointer, bytes);
}

static void *malloc_of_loop(size_t bytes) {
  atomic_fetch_add(&shared->calls, 1);
  return __real_malloc(bytes);
}

static void *calloc_of_loop(size_t count, size_t bytes) {
  atomic_fetch_add(&shared->calls, 1);
  return __real_calloc(count, bytes);
}

static void *realloc_of_loop(void *pointer, size_t bytes) {
  atomic_fetch_add(&shared->calls, 1);
  return __real_realloc(pointer, bytes);
}

/* Starts to count before main() uses libuv. */
__attribute__((constructor)) static void begin(void) {
  const char *path = getenv("ALLOCATIONS_FILE");
  const int fd = path != NULL ? open(path, O_RDWR | O_CREAT, 0600) : -1;
  void *mapped = MAP_FAILED;
  if (fd >= 0 && ftruncate(fd, sizeof *shared) == 0) {
    mapped = mmap(NULL, sizeof *shared, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  }
  if (mapped == MAP_FAILED) {
    perror("ALLOCATIONS_FILE");
    _exit(EXIT_FAILURE);
  }
  close(fd);
  shared = mapped;
  uv_replace_allocator(malloc_of_loop, realloc_of_loop, calloc_of_loop, free);
}
