/* tools: what the programs that make shipped data and figures have in common. Every function ends
 * the program with a message when something goes wrong. */
#ifndef DIPOLED_TOOLS_H
#define DIPOLED_TOOLS_H

#include <pthread.h>
#include <stddef.h>
#include <stdio.h>

#include "clients/cli/gnuplot.h"
#include "clients/cli/progress.h"
#include "core/core.h"

/* Prints the program's name and a message on standard error, and exits with EXIT_FAILURE. */
_Noreturn void tools_fail(const char *format, ...) __attribute__((format(printf, 1, 2)));

/* Fails if there is a fault. what: who refused the input. */
void tools_check(core_fault fault, const char *what);

/* ---- files ------------------------------------------------------------------------------------
 */

/* Makes a folder; one that exists already is right as well. */
void tools_make_folder(const char *path);

/* A file that is being written. It has a temporary name until tools_close() has written all of it,
 * so that a program that is killed leaves no half of a file. */
FILE *tools_open(const char *path);
void tools_close(FILE *file, const char *path);

/* Fails if gnuplot does not run here: for a program that works for long before it draws. */
void tools_require_gnuplot(void);

/* Draws a picture, .svg or .png, width by height pixels. */
void tools_draw(const char *path, size_t width, size_t height, cli_gnuplot_script *write,
                const void *context);

/* ---- threads ----------------------------------------------------------------------------------
 */

enum { TOOLS_THREADS_MAX = 64 };

/* How many processors there are, up to TOOLS_THREADS_MAX. */
size_t tools_processors(void);

/* Calls work(context) in so many threads (1 to TOOLS_THREADS_MAX) and waits for all of them. */
void tools_in_threads(size_t threads, void (*work)(void *context), void *context);

/* Calls item(context, i) once for each i below count, in so many threads. */
void tools_each(size_t threads, size_t count, void (*item)(void *context, size_t i), void *context);

/* A bar with the time left on standard error, if that is a terminal. Any thread may call these. */
typedef struct tools_progress {
  pthread_mutex_t lock;
  cli_progress bar;
  double total_us; /* work, as estimated beforehand */
  double done_us;
} tools_progress;

void tools_progress_start(tools_progress *progress, double total_us);

/* Says what is being done from now on. */
void tools_progress_stage(tools_progress *progress, const char *stage);

/* Says that so much of the estimated work has been done. */
void tools_progress_add(tools_progress *progress, double us);

/* Removes the bar. */
void tools_progress_end(tools_progress *progress);

/* ---- numbers ----------------------------------------------------------------------------------
 */

/* The median of n numbers, at least one; sorts them. */
double tools_median(double *values, size_t n);

#endif
