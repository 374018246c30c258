/* progress: a bar on standard error for work that takes long, when somebody can see it. */
#ifndef DIPOLE_CLI_PROGRESS_H
#define DIPOLE_CLI_PROGRESS_H

#include <stdbool.h>
#include <stdint.h>

typedef struct cli_progress {
  bool watched; /* standard error is a terminal */
  bool shown;
  const char *unit; /* what is counted */
  int64_t start_ms, last_ms;
} cli_progress;

/* unit: "rows" */
void cli_progress_start(cli_progress *progress, const char *unit);

/* done of total (0: unknown) of the work; count: what has been finished. */
void cli_progress_show(cli_progress *progress, uint64_t done, uint64_t total, uint64_t count);

/* Wipes the bar, so that what is written next stands alone. */
void cli_progress_wipe(cli_progress *progress);

#endif
