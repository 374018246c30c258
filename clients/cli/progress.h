/* progress: a bar on standard error for work that takes long, and Ctrl-C, which ends such work. It
 * depends on no other file of this folder, so that core's tools show the bar, too. */
#ifndef DIPOLE_CLI_PROGRESS_H
#define DIPOLE_CLI_PROGRESS_H

#include <stdbool.h>
#include <stdint.h>

typedef struct cli_progress {
  bool watched;     /* whether standard error is a terminal */
  bool shown;       /* whether a bar is on the screen */
  const char *unit; /* what is counted, such as "rows"; NULL: nothing */
  char note[96];    /* stands behind the bar; the caller may change it at any time */
  int64_t start_ms, last_ms;
} cli_progress;

/* Starts the clock. Nothing is shown for the first two seconds. */
void cli_progress_start(cli_progress *progress, const char *unit);

/* Shows a bar, the count, its rate and the time left, at most ten times a second. share: how much
 * of the work is done, 0 to 1; NAN if that is unknown, which shows no bar and no time left. count:
 * how many units are done. Several threads must take turns. */
void cli_progress_show(cli_progress *progress, double share, double count);

/* Is called with true before a call that may wait, and with false after it. If it lasts two seconds
 * and no bar moves, the seconds are shown in place of one. Sets the handler of SIGALRM. */
void cli_progress_wait(bool waits);

/* Removes the bar, so that the next line starts in the first column. */
void cli_progress_wipe(cli_progress *progress);

/* Makes the first Ctrl-C set what cli_interrupted() returns, and a second one end the program. */
void cli_catch_interrupt(void);

/* Returns whether Ctrl-C was pressed since cli_catch_interrupt(): the work should end. */
bool cli_interrupted(void);

#endif
