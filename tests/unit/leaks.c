/* What makes the leak sanitizer fast, linked or loaded before it. It looks for pointers in all that is
 * writable, in 5.6 MB of its own tables, too, which point to none of the program's memory: they are
 * left out. It maps each large block anew, so that solving takes twice as long: a few are kept for the
 * solver's next allocation, and given back before it looks for what is lost. */
#include <dlfcn.h>
#include <link.h>
#include <malloc.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* The sanitizer's own. */
void *__interceptor_aligned_alloc(size_t alignment, size_t bytes);
void __interceptor_free(void *block);

typedef int visitor(struct dl_phdr_info *, size_t, void *);
struct call {
  visitor *visit;
  void *data;
};

static int visit_others(struct dl_phdr_info *library, size_t bytes, void *data) {
  const struct call *of = data;
  const bool is_own = strstr(library->dlpi_name, "/liblsan.so") != NULL;
  return is_own ? 0 : of->visit(library, bytes, of->data);
}

int dl_iterate_phdr(visitor *visit, void *data) {
  int (*all)(visitor *, void *) = (int (*)(visitor *, void *))dlsym(RTLD_NEXT, "dl_iterate_phdr");
  return all(visit_others, &(struct call){visit, data});
}

enum { KEPT_MAX = 8, ALIGNMENT_BYTES = 64, LARGE_BYTES = 1 << 15, LARGEST_BYTES = 1 << 22 };
static void *_Atomic kept[KEPT_MAX];
static atomic_bool is_keeping; /* from the solver's first allocation on */

static void give_back(void) {
  is_keeping = false;
  for (int i = 0; i < KEPT_MAX; i++) {
    __interceptor_free(atomic_exchange(&kept[i], NULL));
  }
}

/* Takes a kept block that is at most a fourth too long. */
void *aligned_alloc(size_t alignment, size_t bytes) {
  static atomic_flag has_begun = ATOMIC_FLAG_INIT;
  if (!atomic_flag_test_and_set(&has_begun)) {
    is_keeping = atexit(give_back) == 0;
  }
  for (int i = 0; i < KEPT_MAX && bytes >= LARGE_BYTES; i++) {
    void *block = atomic_exchange(&kept[i], NULL);
    const size_t room = block == NULL ? 0 : malloc_usable_size(block);
    if (room >= bytes && room <= bytes + bytes / 4 && (uintptr_t)block % alignment == 0) {
      return block;
    }
    __interceptor_free(atomic_exchange(&kept[i], block));
  }
  return __interceptor_aligned_alloc(alignment, bytes);
}

void free(void *block) {
  static atomic_uint turn;
  const bool may_keep = is_keeping && block != NULL && (uintptr_t)block % ALIGNMENT_BYTES == 0;
  const size_t bytes = may_keep ? malloc_usable_size(block) : 0;
  if (bytes >= LARGE_BYTES && bytes <= LARGEST_BYTES) {
    block = atomic_exchange(&kept[turn++ % KEPT_MAX], block);
  }
  __interceptor_free(block);
}
