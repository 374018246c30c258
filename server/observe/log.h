/* log: one line per event on standard error, `ts=... level=... event=... key=value ...`. */
#ifndef DIPOLED_LOG_H
#define DIPOLED_LOG_H

#include <stdbool.h>

enum log_level { LOG_LEVEL_ERROR, LOG_LEVEL_INFO };

/* Lines above this level are dropped. Call before threads exist. */
void log_set_level(enum log_level level);

/* "error" or "info"; false: neither. */
bool log_level_by_name(const char *name, enum log_level *level);

/* One line: format gives the event and its keys, `event=NAME key=value`. Anything that a peer had a
 * hand in is passed as an argument: bytes that could break the line are escaped as \xNN. */
void log_line(enum log_level level, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* The same for lines that a peer can cause: at most LOG_PEER_LINES_PER_SECOND are printed, the next
 * one after that says how many were not (key suppressed). */
void log_peer_line(enum log_level level, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

enum { LOG_PEER_LINES_PER_SECOND = 20 };

#endif
