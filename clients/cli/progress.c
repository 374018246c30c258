#include "clients/cli/progress.h"

#include <math.h>
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

static const char full[] = "########################################";

/* Somebody watches, it takes long, and what is shown is not of just now. */
static bool is_due(cli_progress *progress) {
  const int64_t now_ms = cli_now_ms();
  if (!progress->watched || now_ms - progress->start_ms < SHOW_AFTER_MS ||
      now_ms - progress->last_ms < SHOW_EVERY_MS) {
    return false;
  }
  progress->last_ms = now_ms;
  progress->shown = true;
  return true;
}

void cli_progress_write_time(double seconds) {
  if (!(seconds < 360000)) {
    fputs("days", stderr);
    return;
  }
  const long left = (long)ceil(seconds);
  if (left >= 3600) {
    fprintf(stderr, "%ld:%02ld:%02ld", left / 3600, left / 60 % 60, left % 60);
  } else {
    fprintf(stderr, "%ld:%02ld", left / 60, left % 60);
  }
}

void cli_progress_show(cli_progress *progress, double share, double count) {
  if (!is_due(progress)) {
    return;
  }
  const double seconds = (double)(progress->last_ms - progress->start_ms) / 1000;
  fputc('\r', stderr);
  if (share >= 0) {
    fprintf(stderr, "[%-*.*s] %3.0f %%  ", BAR_WIDTH, (int)(fmin(share, 1) * BAR_WIDTH), full,
            fmin(share, 1) * 100);
  }
  fprintf(stderr, "%.4g %s, %.3g/s", count, progress->unit, count / seconds);
  if (share > 0) {
    fputs("  ", stderr);
    cli_progress_write_time(seconds * (1 / fmin(share, 1) - 1));
    fputs(" left", stderr);
  }
  fputs("\033[K", stderr);
}

void cli_progress_wipe(cli_progress *progress) {
  if (progress->shown) {
    fputs("\r\033[K", stderr);
    progress->shown = false;
  }
}
