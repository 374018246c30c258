/* workers: the same work done by several threads at a time. */
#ifndef FIGURES_WORKERS_H
#define FIGURES_WORKERS_H

#include <stddef.h>

enum { WORKERS_MAX = 64 };

/* Calls work(context) in so many threads (1 to WORKERS_MAX) and waits for all. */
void workers_run(size_t threads, void (*work)(void *context), void *context);

/* Calls item(context, i) once for each i below count, by so many threads. */
void workers_each(size_t threads, size_t count, void (*item)(void *context, size_t i),
                  void *context);

#endif
