#include "clients/cli/progress.h"

#include <stdio.h>
#include <unistd.h>

#include "clients/cli/cli.h"

#define SHOW_AFTER_MS 2000
#define SHOW_EVERY_MS 100

enum { BAR_WIDTH = 40 };

void cli_progress_start(cli_progress *progress, const char *unit) {
  *progress =
      (cli_progress){.watched = isatty(STDERR_FILENO) == 1, .unit = unit, .start_ms = cli_now_ms()};
}

void cli_progress_show(cli_progress *progress, uint64_t done, uint64_t total, uint64_t count) {
  static const char full[] = "########################################";
  if (!progress->watched) {
    return;
  }
  const int64_t now_ms = cli_now_ms();
  if (now_ms - progress->start_ms < SHOW_AFTER_MS || now_ms - progress->last_ms < SHOW_EVERY_MS) {
    return;
  }
  progress->last_ms = now_ms;
  progress->shown = true;
  if (total > 0 && done <= total) {
    const double share = (double)done / (double)total;
    fprintf(stderr, "\r[%-*.*s] %3.0f %%  %llu %s\033[K", BAR_WIDTH, (int)(share * BAR_WIDTH), full,
            share * 100, (unsigned long long)count, progress->unit);
  } else {
    fprintf(stderr, "\r%llu %s\033[K", (unsigned long long)count, progress->unit);
  }
}

void cli_progress_wipe(cli_progress *progress) {
  if (progress->shown) {
    fputs("\r\033[K", stderr);
    progress->shown = false;
  }
}
