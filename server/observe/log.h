/* log: one line per event on standard error, `ts=... level=... event=... key=value ...`. No caller
 * waits for standard error: lines wait in a queue, and those that find it full are dropped. The key
 * `dropped` of the next line says how many. */
#ifndef DIPOLED_LOG_H
#define DIPOLED_LOG_H

#include <stdbool.h>
#include <stdint.h>

enum log_level { LOG_LEVEL_ERROR, LOG_LEVEL_INFO };

/* Sets the level above which lines are dropped. Call this before the first thread is started. */
void log_set_level(enum log_level level);

/* Starts the thread that writes the lines. Returns 0 or an errno. */
int log_start(void);

/* Waits until all lines are written, for a second at most. */
void log_finish(void);

/* Returns how many lines could not wait or be written so far. */
uint64_t log_dropped_lines(void);

/* Finds the level that is called "error" or "info". Returns false for any other name. */
bool log_level_by_name(const char *name, enum log_level *level);

/* Prints one line. `format` gives the event and its keys: `event=NAME key=value`. Bytes that are
 * not printable are escaped as \xNN, so that text from a peer may be an argument. */
void log_line(enum log_level level, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Prints a line that a peer can cause, or drops it: at most LOG_PEER_LINES_PER_SECOND such lines
 * are printed. The key `suppressed` of the next printed line says how many were dropped. */
void log_peer_line(enum log_level level, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

enum { LOG_PEER_LINES_PER_SECOND = 20 };

/* Two arguments for "%s%s": " KEY=" and a value, or nothing if the value is empty. */
#define LOG_FIELD(key, value) (value)[0] != '\0' ? (key) : "", (value)

#endif
