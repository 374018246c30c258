/* Counts allocations in build/dipoled-counting, which is made of dipoled's objects. The linker's
 * --wrap sends each of their calls of malloc, calloc and realloc through this file, and libuv is
 * told to call the same functions. A test reads the number of calls from the first 8 bytes of the
 * file that ALLOCATIONS_FILE names. */
#include <fcntl.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>
#include <uv.h>

static _Atomic uint64_t *calls;

void *__real_malloc(size_t bytes);
void *__real_calloc(size_t count, size_t bytes);
void *__real_realloc(void *pointer, size_t bytes);
void *__wrap_malloc(size_t bytes);
void *__wrap_calloc(size_t count, size_t bytes);
void *__wrap_realloc(void *pointer, size_t bytes);

void *__wrap_malloc(size_t bytes) {
  atomic_fetch_add(calls, 1);
  return __real_malloc(bytes);
}

void *__wrap_calloc(size_t count, size_t bytes) {
  atomic_fetch_add(calls, 1);
  return __real_calloc(count, bytes);
}

void *__wrap_realloc(void *pointer, size_t bytes) {
  atomic_fetch_add(calls, 1);
  return __real_realloc(pointer, bytes);
}

/* Starts to count before main() uses libuv. */
__attribute__((constructor)) static void begin(void) {
  const char *path = getenv("ALLOCATIONS_FILE");
  const int fd = path != NULL ? open(path, O_RDWR | O_CREAT, 0600) : -1;
  void *mapped = MAP_FAILED;
  if (fd >= 0 && ftruncate(fd, sizeof *calls) == 0) {
    mapped = mmap(NULL, sizeof *calls, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  }
  if (mapped == MAP_FAILED) {
    perror("ALLOCATIONS_FILE");
    _exit(EXIT_FAILURE);
  }
  close(fd);
  calls = mapped;
  uv_replace_allocator(__wrap_malloc, __wrap_realloc, __wrap_calloc, free);
}
