/* tools: functions that the programs share which make shipped data and figures. Every function ends
 * the program with a message when something goes wrong. */
#ifndef DIPOLED_TOOLS_H
#define DIPOLED_TOOLS_H

#include <pthread.h>
#include <stddef.h>
#include <stdio.h>

#include "clients/cli/progress.h"
#include "core/core.h"

/* Prints the program's name and a message on standard error, and exits with EXIT_FAILURE. */
_Noreturn void tools_fail(const char *format, ...) __attribute__((format(printf, 1, 2)));

/* Calls tools_fail() if there is a fault. `what` names the function that refused the input. */
void tools_check(core_fault fault, const char *what);

/* Returns memory for `count` things of this size, all 0, which the caller frees. */
void *tools_allocate(size_t count, size_t size);

/* ---- files ----------------------------------------------------------------------------------- */

/* Makes a folder unless it exists. */
void tools_make_folder(const char *path);

/* Opens a file for writing. It has a temporary name until tools_close() has written all of it, so
 * that a program that is killed leaves no incomplete file. */
FILE *tools_open(const char *path);
void tools_close(FILE *file, const char *path);

/* Results that a folder keeps, so that a program which was interrupted continues where it was. key:
 * one line, without its end, that names all that the result depends on. tools_kept() returns
 * whether the folder has it, and then fills it in. */
bool tools_kept(const char *folder, const char *key, void *result, size_t bytes);
void tools_keep(const char *folder, const char *key, const void *result, size_t bytes);

/* ---- threads --------------------------------------------------------------------------------- */

enum { TOOLS_THREADS_MAX = 64 };

/* Returns the number of processors, at most TOOLS_THREADS_MAX. */
size_t tools_processors(void);

/* Calls item(context, i) once for each i below count; the threads share the items. */
void tools_each(size_t threads, size_t count, void (*item)(void *context, size_t i), void *context);

/* A progress bar with the time left, shown if standard error is a terminal. Any thread may call its
 * functions. */
typedef struct tools_progress {
  pthread_mutex_t lock;
  cli_progress bar;
  double total_us; /* estimated time of the whole work */
  double done_us;
} tools_progress;

void tools_progress_start(tools_progress *progress, double total_us);

/* Adds finished work, in the unit of total_us. */
void tools_progress_add(tools_progress *progress, double us);

/* Removes the bar. */
void tools_progress_end(tools_progress *progress);

#endif
