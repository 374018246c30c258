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

/* The share of the work that is done, 0 to 1 (NAN: nobody knows), how much has been finished so far,
 * the rate, and the time left. */
void cli_progress_show(cli_progress *progress, double share, double count);

/* "0:07", "1:02:03"; seconds that nobody can wait for are not counted. */
void cli_progress_write_time(double seconds);

/* Wipes the bar, so that what is written next stands alone. */
void cli_progress_wipe(cli_progress *progress);

#endif
