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

/* Wipes the bar, so that what is written next stands alone. */
void cli_progress_wipe(cli_progress *progress);

#endif
