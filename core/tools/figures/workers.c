#include "core/tools/figures/workers.h"

#include <pthread.h>
#include <stdatomic.h>

#include "core/tools/figures/fail.h"

typedef struct job {
  void (*work)(void *context);
  void *context;
} job;

static void *start(void *argument) {
  const job *j = argument;
  j->work(j->context);
  return NULL;
}

void workers_run(size_t threads, void (*work)(void *context), void *context) {
  pthread_t ids[WORKERS_MAX];
  job j = {work, context};
  for (size_t i = 0; i < threads; i++) {
    if (pthread_create(&ids[i], NULL, start, &j) != 0) {
      fail("cannot start a thread");
    }
  }
  for (size_t i = 0; i < threads; i++) {
    pthread_join(ids[i], NULL);
  }
}

typedef struct items {
  void (*item)(void *context, size_t i);
  void *context;
  size_t count;
  atomic_size_t next;
} items;

static void take_items(void *context) {
  items *all = context;
  for (size_t i; (i = atomic_fetch_add(&all->next, 1)) < all->count;) {
    all->item(all->context, i);
  }
}

void workers_each(size_t threads, size_t count, void (*item)(void *context, size_t i),
                  void *context) {
  items all = {.item = item, .context = context, .count = count};
  workers_run(threads < count || count == 0 ? threads : count, take_items, &all);
}
