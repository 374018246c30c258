/* progress: a bar on standard error for work that takes long, when somebody can see it. */
#ifndef DIPOLE_CLI_PROGRESS_H
#define DIPOLE_CLI_PROGRESS_H

#include <stdbool.h>
#include <stdint.h>

typedef struct cli_progress {
  bool watched; /* standard error is a terminal */
  bool shown;
  int64_t start_ms, last_ms;
} cli_progress;

void cli_progress_start(cli_progress *progress);

/* done of total (0: unknown) units of work; rows: what has been finished. */
void cli_progress_show(cli_progress *progress, uint64_t done, uint64_t total, uint64_t rows);

/* The same with the rate and the time left: done of total (above 0) of what `unit` names. */
void cli_progress_show_rate(cli_progress *progress, double done, double total, const char *unit);

/* "0:07", "1:02:03"; seconds that nobody can wait for are not counted. */
void cli_progress_write_time(double seconds);

/* Wipes the bar, so that what is written next stands alone. */
void cli_progress_wipe(cli_progress *progress);

#endif
