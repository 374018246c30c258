/* What makes the leak sanitizer fast, linked or loaded before it. It looks for pointers in all that is
 * writable, in 5.6 MB of its own tables, too, which point to none of the program's memory: they are
 * left out. It maps each large block anew, so that solving takes four times as long: a few are kept
 * for the next allocation, and given back before it looks for what is lost. */
#include <dlfcn.h>
#include <link.h>
#include <malloc.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* The sanitizer's own. */
void *__interceptor_malloc(size_t bytes);
void *__interceptor_calloc(size_t count, size_t bytes);
void *__interceptor_aligned_alloc(size_t alignment, size_t bytes);
void __interceptor_free(void *block);

typedef int visitor(struct dl_phdr_info *, size_t, void *);
typedef struct {
  visitor *visit;
  void *data;
} call;

static int visit_others(struct dl_phdr_info *library, size_t bytes, void *data) {
  const call *of = data;
  return strstr(library->dlpi_name, "/liblsan.so") != NULL ? 0
                                                           : of->visit(library, bytes, of->data);
}

int dl_iterate_phdr(visitor *visit, void *data) {
  int (*all)(visitor *, void *) = (int (*)(visitor *, void *))dlsym(RTLD_NEXT, "dl_iterate_phdr");
  return all(visit_others, &(call){visit, data});
}

enum { KEPT_MAX = 8, LARGE_BYTES = 1 << 16, LARGEST_BYTES = 1 << 22 };
static struct {
  void *block;
  size_t bytes;
} kept[KEPT_MAX];
static atomic_flag kept_in_use = ATOMIC_FLAG_INIT; /* who comes meanwhile keeps and takes none */
static bool is_keeping; /* since the first large block, when the sanitizer has long begun */

static void give_back(void) {
  is_keeping = false;
  for (int i = 0; i < KEPT_MAX; i++) {
    free(kept[i].block);
    kept[i].block = NULL;
  }
}

/* Takes a kept block that is at most a fourth too long. Returns NULL if there is none. */
static void *take_kept(size_t alignment, size_t bytes) {
  void *found = NULL;
  if (bytes >= LARGE_BYTES && bytes <= LARGEST_BYTES && !atomic_flag_test_and_set(&kept_in_use)) {
    static bool has_begun;
    if (!has_begun) {
      has_begun = true;
      is_keeping = atexit(give_back) == 0;
    }
    for (int i = 0; i < KEPT_MAX && found == NULL; i++) {
      if (kept[i].block != NULL && (uintptr_t)kept[i].block % alignment == 0 &&
          kept[i].bytes >= bytes && kept[i].bytes <= bytes + bytes / 4) {
        found = kept[i].block;
        kept[i].block = NULL;
      }
    }
    atomic_flag_clear(&kept_in_use);
  }
  return found;
}

static bool keep(void *block) {
  const size_t bytes = block == NULL || !is_keeping ? 0 : malloc_usable_size(block);
  bool is_kept = false;
  if (bytes >= LARGE_BYTES && bytes <= LARGEST_BYTES && !atomic_flag_test_and_set(&kept_in_use)) {
    for (int i = 0; i < KEPT_MAX && !is_kept; i++) {
      if (kept[i].block == NULL) {
        kept[i].block = block;
        kept[i].bytes = bytes;
        is_kept = true;
      }
    }
    atomic_flag_clear(&kept_in_use);
  }
  return is_kept;
}

void *malloc(size_t bytes) {
  void *block = take_kept(1, bytes);
  return block != NULL ? block : __interceptor_malloc(bytes);
}

void *calloc(size_t count, size_t bytes) {
  size_t all;
  void *block = __builtin_mul_overflow(count, bytes, &all) ? NULL : take_kept(1, all);
  return block != NULL ? memset(block, 0, all) : __interceptor_calloc(count, bytes);
}

void *aligned_alloc(size_t alignment, size_t bytes) {
  void *block = take_kept(alignment, bytes);
  return block != NULL ? block : __interceptor_aligned_alloc(alignment, bytes);
}

void free(void *block) {
  if (!keep(block)) {
    __interceptor_free(block);
  }
}
