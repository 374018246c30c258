/* The daemon is linked with --wrap for these functions: each of its calls, wherever it stands, comes
 * through here. */
#include "server/memory.h"

#include <stdatomic.h>
#include <stddef.h>
#include <stdlib.h>
#include <uv.h>

static _Atomic uint64_t allocations;

void *__real_malloc(size_t bytes);
void *__real_calloc(size_t count, size_t bytes);
void *__real_realloc(void *pointer, size_t bytes);
void *__wrap_malloc(size_t bytes);
void *__wrap_calloc(size_t count, size_t bytes);
void *__wrap_realloc(void *pointer, size_t bytes);

static void count_one(void) {
  atomic_fetch_add_explicit(&allocations, 1, memory_order_relaxed);
}

void *__wrap_malloc(size_t bytes) {
  count_one();
  return __real_malloc(bytes);
}

void *__wrap_calloc(size_t count, size_t bytes) {
  count_one();
  return __real_calloc(count, bytes);
}

void *__wrap_realloc(void *pointer, size_t bytes) {
  count_one();
  return __real_realloc(pointer, bytes);
}

void memory_count(void) {
  uv_replace_allocator(__wrap_malloc, __wrap_realloc, __wrap_calloc, free);
}

uint64_t memory_allocations(void) {
  return atomic_load_explicit(&allocations, memory_order_relaxed);
}
