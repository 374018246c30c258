/* progress: a bar with the time left on standard error, when that is a terminal. */
#ifndef FIGURES_PROGRESS_H
#define FIGURES_PROGRESS_H

#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>

typedef struct progress_bar {
  pthread_mutex_t lock;
  bool watched;
  double total_us; /* of work, as estimated beforehand */
  double done_us;
  int64_t start_ms, shown_ms;
  char stage[64];
} progress_bar;

void progress_start(progress_bar *progress, double total_us);

/* What is being done from now on. */
void progress_stage(progress_bar *progress, const char *stage);

/* So much of the estimated work has been done; any thread may say so. */
void progress_add(progress_bar *progress, double us);

/* Wipes the bar. */
void progress_end(progress_bar *progress);

#endif
