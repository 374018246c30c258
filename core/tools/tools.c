#include "core/tools/tools.h"

#include <errno.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { PATH_BYTES = 4096 };

void tools_fail(const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  fprintf(stderr, "%s: ", program_invocation_short_name);
  vfprintf(stderr, format, arguments);
  fputc('\n', stderr);
  va_end(arguments);
  exit(EXIT_FAILURE);
}

void tools_check(core_fault fault, const char *what) {
  if (fault.field != NULL) {
    tools_fail("%s refused %s: %s", what, fault.field, fault.allowed);
  }
}

void *tools_allocate(size_t count, size_t size) {
  void *memory = calloc(count, size);
  if (memory == NULL) {
    tools_fail("out of memory");
  }
  return memory;
}

/* ---- files ----------------------------------------------------------------------------------- */

void tools_make_folder(const char *path) {
  if (mkdir(path, 0777) != 0 && errno != EEXIST) {
    tools_fail("cannot make the folder %s: %s", path, strerror(errno));
  }
}

static void temporary_name(char name[PATH_BYTES], const char *path) {
  if (snprintf(name, PATH_BYTES, "%s.part", path) >= PATH_BYTES) {
    tools_fail("%s: the name is too long", path);
  }
}

FILE *tools_open(const char *path) {
  char name[PATH_BYTES];
  temporary_name(name, path);
  FILE *file = fopen(name, "we");
  if (file == NULL) {
    tools_fail("cannot write %s: %s", name, strerror(errno));
  }
  return file;
}

void tools_close(FILE *file, const char *path) {
  char name[PATH_BYTES];
  temporary_name(name, path);
  const bool good = ferror(file) == 0;
  if (fclose(file) != 0 || !good || rename(name, path) != 0) {
    tools_fail("cannot write %s: %s", path, strerror(errno));
  }
}

/* The name of a file is the FNV-1a checksum of its key, which is its first line. */
static void kept_name(char name[PATH_BYTES], const char *folder, const char *key) {
  uint64_t hash = UINT64_C(0xcbf29ce484222325);
  for (const char *at = key; *at != '\0'; at++) {
    hash = (hash ^ (unsigned char)*at) * UINT64_C(0x100000001b3);
  }
  if (snprintf(name, PATH_BYTES, "%s/%016llx", folder, (unsigned long long)hash) >= PATH_BYTES) {
    tools_fail("%s: the name is too long", folder);
  }
}

bool tools_kept(const char *folder, const char *key, void *result, size_t bytes) {
  char name[PATH_BYTES], *line = NULL;
  size_t room = 0;
  kept_name(name, folder, key);
  FILE *file = fopen(name, "rbe");
  if (file == NULL) {
    return false;
  }
  const ssize_t length = getline(&line, &room, file);
  const bool good = length == (ssize_t)strlen(key) + 1 && strncmp(line, key, strlen(key)) == 0 &&
                    fread(result, bytes, 1, file) == 1;
  free(line);
  fclose(file);
  return good;
}

void tools_keep(const char *folder, const char *key, const void *result, size_t bytes) {
  char name[PATH_BYTES];
  kept_name(name, folder, key);
  FILE *file = tools_open(name);
  fprintf(file, "%s\n", key);
  fwrite(result, bytes, 1, file);
  tools_close(file, name);
}

/* ---- threads --------------------------------------------------------------------------------- */

size_t tools_processors(void) {
  const long processors = sysconf(_SC_NPROCESSORS_ONLN);
  return processors < 1                   ? 1
         : processors > TOOLS_THREADS_MAX ? TOOLS_THREADS_MAX
                                          : (size_t)processors;
}

struct items {
  void (*item)(void *context, size_t i);
  void *context;
  size_t count;
  atomic_size_t next;
};

static void *take_items(void *argument) {
  struct items *all = argument;
  for (size_t i; (i = atomic_fetch_add(&all->next, 1)) < all->count;) {
    all->item(all->context, i);
  }
  return NULL;
}

void tools_each(size_t threads, size_t count, void (*item)(void *context, size_t i),
                void *context) {
  pthread_t ids[TOOLS_THREADS_MAX];
  struct items all = {.item = item, .context = context, .count = count};
  for (size_t i = 0; i < threads; i++) {
    if (pthread_create(&ids[i], NULL, take_items, &all) != 0) {
      tools_fail("cannot start a thread");
    }
  }
  for (size_t i = 0; i < threads; i++) {
    pthread_join(ids[i], NULL);
  }
}

void tools_progress_start(tools_progress *progress, double total_us) {
  *progress = (tools_progress){.total_us = total_us};
  pthread_mutex_init(&progress->lock, NULL);
  cli_progress_start(&progress->bar, NULL);
}

void tools_progress_add(tools_progress *progress, double us) {
  pthread_mutex_lock(&progress->lock);
  progress->done_us += us;
  cli_progress_show(&progress->bar, progress->done_us / progress->total_us, 0);
  pthread_mutex_unlock(&progress->lock);
}

void tools_progress_end(tools_progress *progress) {
  cli_progress_wipe(&progress->bar);
  pthread_mutex_destroy(&progress->lock);
}
