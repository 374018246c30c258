#include "clients/cli/progress.h"

#include <errno.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#include "clients/cli/cli.h"

#define SHOW_AFTER_MS 2000
#define SHOW_EVERY_MS 100

enum { BAR_WIDTH = 40 };

void cli_progress_start(cli_progress *progress, const char *unit) {
  *progress =
      (cli_progress){.watched = isatty(STDERR_FILENO) == 1, .unit = unit, .start_ms = cli_now_ms()};
}

/* "0:07", "1:02:03", or "days" */
static void write_time(double seconds) {
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

/* ---- calls without a bar --------------------------------------------------------------------- */

/* A bar was shown since the last second; seconds that are shown. A signal handler sets both. */
static volatile sig_atomic_t bar_moves, shown_s;

static void on_second(int signal_number) {
  (void)signal_number;
  const int kept = errno;
  char text[] = "\rwaiting for the daemon:       s\033[K";
  if (bar_moves == 0) {
    shown_s = shown_s == 0 ? SHOW_AFTER_MS / 1000 : shown_s + 1;
    char *digit = strrchr(text, 's') - 2;
    for (int left = shown_s; left > 0 && *digit == ' '; left /= 10) {
      *digit-- = (char)('0' + left % 10);
    }
    if (write(STDERR_FILENO, text, sizeof text - 1) < 0) {
      shown_s = 0;
    }
  }
  bar_moves = 0;
  errno = kept;
}

void cli_progress_wait(bool waits) {
  struct sigaction action = {.sa_handler = on_second, .sa_flags = SA_RESTART};
  if (isatty(STDERR_FILENO) != 1) {
    return;
  }
  const struct itimerval timer = {{waits, 0}, {waits ? SHOW_AFTER_MS / 1000 : 0, 0}};
  sigemptyset(&action.sa_mask);
  sigaction(SIGALRM, &action, NULL);
  setitimer(ITIMER_REAL, &timer, NULL);
  if (!waits && shown_s > 0) {
    fputs("\r\033[K", stderr);
  }
  shown_s = 0;
}

/* ---- the bar --------------------------------------------------------------------------------- */

void cli_progress_show(cli_progress *progress, double share, double count) {
  static const char full[] = "########################################";
  const int64_t now = cli_now_ms();
  if (!progress->watched || now - progress->start_ms < SHOW_AFTER_MS ||
      now - progress->last_ms < SHOW_EVERY_MS) {
    return;
  }
  progress->last_ms = now;
  bar_moves = 1;
  progress->shown = true;
  const double seconds = (double)(now - progress->start_ms) / 1000;
  fputc('\r', stderr);
  if (share >= 0) {
    fprintf(stderr, "[%-*.*s] %3.0f %%  ", BAR_WIDTH, (int)(fmin(share, 1) * BAR_WIDTH), full,
            fmin(share, 1) * 100);
  }
  if (progress->unit != NULL) {
    fprintf(stderr, "%.4g %s, %.3g/s  ", count, progress->unit, count / seconds);
  }
  if (share > 0) {
    write_time(seconds * (1 / fmin(share, 1) - 1));
    fputs(" left", stderr);
  }
  fprintf(stderr, "%s%s\033[K", progress->note[0] != '\0' ? "  " : "", progress->note);
}

void cli_progress_wipe(cli_progress *progress) {
  if (progress->shown) {
    fputs("\r\033[K", stderr);
    progress->shown = false;
  }
}

/* ---- Ctrl-C ---------------------------------------------------------------------------------- */

static volatile sig_atomic_t interrupted;

static void on_interrupt(int signal_number) {
  (void)signal_number;
  interrupted = 1;
}

void cli_catch_interrupt(void) {
  struct sigaction action = {.sa_handler = on_interrupt, .sa_flags = SA_RESETHAND | SA_RESTART};
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, NULL);
}

bool cli_interrupted(void) {
  return interrupted != 0;
}
