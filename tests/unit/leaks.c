/* Finds memory that nothing can free any more. It is linked into a program or loaded before it, keeps
 * a table of the blocks that malloc() and its relatives have given, and looks at the end of the
 * process for pointers to them: in all that is writable but the heap and stacks of threads that have
 * ended, and in the blocks that these lead to. What is not found is lost: it is listed, and the exit
 * status is 23. GCC's leak sanitizer does the same for 110 ms a daemon; this takes 6. For the stack
 * of calls that took a block, build with SANITIZE=-fsanitize=leak. */
#include <dirent.h>
#include <errno.h>
#include <execinfo.h>
#include <fcntl.h>
#include <malloc.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

enum { FIRST_ROOM = 4096, THREADS_MAX = 256, SHOWN_MAX = 10, STATUS = 23 };
enum { PAGE_BYTES = 4096, PAGES_AT_ONCE = 512, STACK_BYTES = 8 << 20, VARIABLES_BYTES = 1 << 16 };

/* glibc's own. */
void *__libc_malloc(size_t bytes);
void *__libc_calloc(size_t count, size_t bytes);
void *__libc_realloc(void *block, size_t bytes);
void *__libc_memalign(size_t alignment, size_t bytes);
void __libc_free(void *block);

/* ---- the table of blocks ----------------------------------------------------------------------- */

/* A hash table: an entry stands at its block's place or behind it without a gap. */
struct entry {
  uintptr_t at; /* 0 in an empty place */
  const void *caller;
};
static struct entry first_entries[FIRST_ROOM] __attribute__((aligned(PAGE_BYTES)));
static struct entry *entries = first_entries;
static size_t entry_count, mask = FIRST_ROOM - 1;
static atomic_flag is_locked = ATOMIC_FLAG_INIT;

static void lock(void) {
  while (atomic_flag_test_and_set_explicit(&is_locked, memory_order_acquire)) {
    sched_yield();
  }
}

static void unlock(void) {
  atomic_flag_clear_explicit(&is_locked, memory_order_release);
}

static size_t place_of(uintptr_t at) {
  return (at >> 4) * 0x9e3779b97f4a7c15u >> 24 & mask;
}

/* The entry of a block, or the empty one where it would stand. */
static size_t entry_of(uintptr_t at) {
  size_t i = place_of(at);
  while (entries[i].at != at && entries[i].at != 0) {
    i = (i + 1) & mask;
  }
  return i;
}

static void *mapped(size_t bytes) {
  void *memory = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  return memory == MAP_FAILED ? (abort(), NULL) : memory;
}

static void grow(void) {
  const struct entry *old = entries;
  const size_t room = mask + 1;
  mask = 4 * room - 1;
  entries = mapped(4 * room * sizeof *entries); /* the old one stays, and is a fourth as long */
  for (size_t i = 0; i < room; i++) {
    if (old[i].at != 0) {
      entries[entry_of(old[i].at)] = old[i];
    }
  }
  memset((void *)old, 0, room * sizeof *old);
}

static void *noted(void *block, const void *caller) {
  if (block != NULL) {
    lock();
    if (++entry_count > mask / 2) {
      grow();
    }
    entries[entry_of((uintptr_t)block)] = (struct entry){(uintptr_t)block, caller};
    unlock();
  }
  return block;
}

/* Returns who took the block, NULL if that is not known. */
static const void *forget(void *block) {
  lock();
  size_t gap = entry_of((uintptr_t)block);
  const void *caller = entries[gap].caller;
  if (entries[gap].at != 0) {
    entry_count--;
    for (size_t i = (gap + 1) & mask; entries[i].at != 0; i = (i + 1) & mask) {
      if (((i - place_of(entries[i].at)) & mask) >=
          ((i - gap) & mask)) { /* it may stand in the gap */
        entries[gap] = entries[i];
        gap = i;
      }
    }
    entries[gap] = (struct entry){0};
  }
  unlock();
  return caller;
}

/* ---- in place of glibc's ----------------------------------------------------------------------- */

#define CALLER __builtin_return_address(0)

void *malloc(size_t bytes) {
  return noted(__libc_malloc(bytes), CALLER);
}

void *calloc(size_t count, size_t bytes) {
  return noted(__libc_calloc(count, bytes), CALLER);
}

void *aligned_alloc(size_t alignment, size_t bytes) {
  return noted(__libc_memalign(alignment, bytes), CALLER);
}

int posix_memalign(void **block, size_t alignment, size_t bytes) {
  void *taken = noted(__libc_memalign(alignment, bytes), CALLER);
  *block = taken == NULL ? *block : taken;
  return taken == NULL ? ENOMEM : 0;
}

void free(void *block) {
  if (block != NULL) {
    forget(block); /* before somebody else can get it */
    __libc_free(block);
  }
}

void *realloc(void *block, size_t bytes) {
  const void *before = block == NULL ? NULL : forget(block);
  void *moved = __libc_realloc(block, bytes);
  if (moved == NULL && bytes != 0 && before != NULL) {
    noted(block, before);
  }
  return noted(moved, CALLER);
}

/* ---- what is found ----------------------------------------------------------------------------- */

static struct range {
  uintptr_t from, to;
  const void *caller; /* NULL: the finder's own, which nobody looks into */
  bool is_found;
} * ranges; /* by address */
static size_t range_count;
static size_t *to_visit; /* ranges that were found and not yet looked into */
static size_t visit_count;

static void find(struct range *one) {
  if (!one->is_found) {
    one->is_found = true;
    to_visit[visit_count++] = (size_t)(one - ranges);
  }
}

/* The first range that ends behind an address. */
static size_t first_behind(uintptr_t at) {
  size_t low = 0, high = range_count;
  while (low < high) {
    const size_t middle = (low + high) / 2;
    if (ranges[middle].to > at) {
      high = middle;
    } else {
      low = middle + 1;
    }
  }
  return low;
}

__attribute__((no_sanitize("address"))) static void look(uintptr_t from, uintptr_t to) {
  const uintptr_t least = ranges[0].from, most = ranges[range_count - 1].to;
  enum { WORD_BYTES = sizeof(uintptr_t) };
  for (from = (from + WORD_BYTES - 1) / WORD_BYTES * WORD_BYTES; from + WORD_BYTES <= to;
       from += WORD_BYTES) {
    const uintptr_t value = *(const uintptr_t *)from;
    if (value >= least && value < most) {
      struct range *one = &ranges[first_behind(value)];
      /* The last word of a block is where glibc's lists point to if the chunk behind is free. */
      if (one->from <= value && value < one->to - WORD_BYTES) {
        find(one);
      }
    }
  }
}

/* Looks at the pages that are there: of a block at all, of a mapping at what lies between blocks. */
static void look_at_pages(uintptr_t from, uintptr_t to, bool is_block) {
  static uint64_t pages[PAGES_AT_ONCE];
  const int pagemap = open("/proc/self/pagemap", O_RDONLY | O_CLOEXEC);
  size_t next = first_behind(from);
  for (uintptr_t page = from / PAGE_BYTES * PAGE_BYTES; page < to; page += PAGE_BYTES) {
    const size_t i = page / PAGE_BYTES % PAGES_AT_ONCE;
    if (i == 0 || page <= from) {
      const size_t wanted = (PAGES_AT_ONCE - i) * sizeof *pages;
      if (pread(pagemap, &pages[i], wanted, (off_t)(page / PAGE_BYTES * sizeof *pages)) <= 0) {
        memset(&pages[i], 0xff, wanted);
      }
    }
    const uintptr_t end = page + PAGE_BYTES < to ? page + PAGE_BYTES : to;
    const bool is_there = pages[i] >> 62 != 0; /* or swapped out */
    for (uintptr_t at = page < from ? from : page; is_there && at < end;) {
      while (!is_block && next < range_count && ranges[next].to <= at) {
        next++;
      }
      const bool has_block = !is_block && next < range_count && ranges[next].from < end;
      look(at, has_block ? ranges[next].from : end);
      at = has_block ? ranges[next].to : end;
    }
  }
  close(pagemap);
}

static char text[1 << 18];

static size_t read_text(const char *path) {
  const int fd = open(path, O_RDONLY | O_CLOEXEC);
  size_t length = 0;
  for (ssize_t n; fd >= 0 && length < sizeof text - 1; length += (size_t)n) {
    if ((n = read(fd, text + length, sizeof text - 1 - length)) <= 0) {
      break;
    }
  }
  close(fd);
  text[length] = '\0';
  return length;
}

/* Where the stacks end of the threads that still live. Returns how many, 0 if that is not known. */
static size_t find_stacks(uintptr_t tops[THREADS_MAX]) {
  size_t count = 0;
  tops[count++] = (uintptr_t)__builtin_frame_address(0);
  DIR *folder = opendir("/proc/self/task");
  for (struct dirent *one; folder != NULL && (one = readdir(folder)) != NULL && count != 0;) {
    char path[64];
    snprintf(path, sizeof path, "/proc/self/task/%.20s/syscall", one->d_name);
    if (one->d_name[0] != '.' && atoi(one->d_name) != gettid()) {
      /* "... STACK PROGRAM", or "running" */
      char *last = read_text(path) == 0 ? NULL : strrchr(text, ' ');
      if (last != NULL) {
        *last = '\0';
        last = strrchr(text, ' ');
      }
      tops[count] = last == NULL ? 0 : strtoul(last, NULL, 16);
      count = last == NULL || count == THREADS_MAX - 1 ? 0 : count + 1;
    }
  }
  if (folder != NULL) {
    closedir(folder);
  }
  return count;
}

static int by_address(const void *a, const void *b) {
  const uintptr_t x = ((const struct range *)a)->from, y = ((const struct range *)b)->from;
  return (x > y) - (x < y);
}

static void add_range(uintptr_t from, size_t bytes, const void *caller) {
  ranges[range_count++] = (struct range){from, from + bytes, caller, caller == NULL};
}

static void collect(void) {
  const size_t room = entry_count + 4;
  ranges = mapped(room * sizeof *ranges);
  to_visit = mapped(room * sizeof *to_visit);
  add_range((uintptr_t)ranges, room * sizeof *ranges, NULL);
  add_range((uintptr_t)to_visit, room * sizeof *to_visit, NULL);
  add_range((uintptr_t)first_entries, sizeof first_entries, NULL);
  if (entries != first_entries) {
    add_range((uintptr_t)entries, (mask + 1) * sizeof *entries, NULL);
  }
  for (size_t i = 0; i <= mask && range_count < room; i++) {
    if (entries[i].at != 0) {
      add_range(entries[i].at, malloc_usable_size((void *)entries[i].at), entries[i].caller);
    }
  }
  qsort(ranges, range_count, sizeof *ranges, by_address);
}

/* Finds what all that is writable points to. */
static void look_at_mappings(const uintptr_t *tops, size_t top_count) {
  uintptr_t guard_end = 0, linker_from = UINTPTR_MAX, linker_to = 0;
  read_text("/proc/self/maps");
  for (char *line = text, *end; (end = strchr(line, '\n')) != NULL; line = end + 1) {
    *end = '\0';
    char *rest;
    const uintptr_t from = strtoul(line, &rest, 16);
    const uintptr_t to = strtoul(rest + 1, &rest, 16);
    const char *name = strpbrk(line, "/[");
    if (name != NULL && strstr(name, "/ld-linux") != NULL) {
      linker_from = from < linker_from ? from : linker_from;
      linker_to = to;
    }
    if (rest[2] == 'w' && (name == NULL || strcmp(name, "[heap]") != 0)) {
      const bool is_stack =
          top_count > 0 && (name == NULL ? from == guard_end : strcmp(name, "[stack]") == 0);
      /* Variables of this thread lie before it. */
      const uintptr_t own = (uintptr_t)__builtin_thread_pointer();
      uintptr_t least = !is_stack ? from : own - from < STACK_BYTES ? own - VARIABLES_BYTES : to;
      for (size_t i = 0; i < top_count && is_stack; i++) {
        least = tops[i] >= from && tops[i] < least ? tops[i] : least;
      }
      /* Of a thread that has ended, behind its stack alone. */
      look_at_pages(least < to ? least : from + STACK_BYTES, to, false);
    }
    guard_end = name == NULL && rest[1] == '-' && rest[2] == '-' ? to : 0;
  }
  /* The linker's own, as those of threads that have ended. */
  for (size_t i = 0; i < range_count; i++) {
    if ((uintptr_t)ranges[i].caller >= linker_from && (uintptr_t)ranges[i].caller < linker_to) {
      find(&ranges[i]);
    }
  }
}

__attribute__((constructor)) static void keep_to_one_heap(void) {
  mallopt(M_ARENA_MAX, 1);
}

__attribute__((destructor)) static void report_lost(void) {
  uintptr_t tops[THREADS_MAX];
  size_t lost = 0, lost_bytes = 0;
  __builtin_unwind_init();
  fflush(NULL);
  const size_t top_count = find_stacks(tops);
  collect();
  look_at_mappings(tops, top_count);
  while (visit_count > 0) {
    const struct range *one = &ranges[to_visit[--visit_count]];
    if (one->to - one->from < 16 * PAGE_BYTES) {
      look(one->from, one->to);
    } else {
      look_at_pages(one->from, one->to, true);
    }
  }
  for (size_t i = 0; i < range_count; i++) {
    if (!ranges[i].is_found) {
      if (lost++ < SHOWN_MAX) {
        fprintf(stderr, "lost: %zu bytes that were taken here:\n", ranges[i].to - ranges[i].from);
        backtrace_symbols_fd((void *const *)&ranges[i].caller, 1, STDERR_FILENO);
      }
      lost_bytes += ranges[i].to - ranges[i].from;
    }
  }
  if (lost > 0) {
    fprintf(stderr, "LeakSanitizer: %zu blocks with %zu bytes are lost\n", lost, lost_bytes);
    _exit(STATUS);
  }
}
