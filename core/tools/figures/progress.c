#include "core/tools/figures/progress.h"

#include <stdio.h>
#include <time.h>
#include <unistd.h>

#define SHOW_EVERY_MS 200

enum { BAR_WIDTH = 40 };

static int64_t now_ms(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return time.tv_sec * INT64_C(1000) + time.tv_nsec / 1000000;
}

void progress_start(progress_bar *progress, double total_us) {
  pthread_mutex_init(&progress->lock, NULL);
  progress->watched = isatty(STDERR_FILENO) == 1;
  progress->total_us = total_us;
  progress->done_us = 0;
  progress->start_ms = progress->shown_ms = now_ms();
  progress->stage[0] = '\0';
}

/* Time left: as fast as so far. */
static void show(progress_bar *progress) {
  static const char full[] = "########################################";
  const int64_t now = now_ms();
  if (!progress->watched || now - progress->shown_ms < SHOW_EVERY_MS) {
    return;
  }
  progress->shown_ms = now;
  const double share = progress->total_us > 0 && progress->done_us < progress->total_us
                           ? progress->done_us / progress->total_us
                           : 1;
  fprintf(stderr, "\r[%-*.*s] %3.0f %%", BAR_WIDTH, (int)(share * BAR_WIDTH), full, share * 100);
  if (share > 0) {
    const double left_s = (double)(now - progress->start_ms) * 1e-3 * (1 - share) / share;
    const int seconds = (int)left_s;
    fprintf(stderr, "  %d:%02d left", seconds / 60, seconds % 60);
  }
  fprintf(stderr, "  %s\033[K", progress->stage);
}

void progress_stage(progress_bar *progress, const char *stage) {
  pthread_mutex_lock(&progress->lock);
  snprintf(progress->stage, sizeof progress->stage, "%s", stage);
  pthread_mutex_unlock(&progress->lock);
}

void progress_add(progress_bar *progress, double us) {
  pthread_mutex_lock(&progress->lock);
  progress->done_us += us;
  show(progress);
  pthread_mutex_unlock(&progress->lock);
}

void progress_end(progress_bar *progress) {
  if (progress->watched) {
    fputs("\r\033[K", stderr);
  }
  pthread_mutex_destroy(&progress->lock);
}
