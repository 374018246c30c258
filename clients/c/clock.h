/* clock: time, waiting, and pauses of random length. */
#ifndef LIBDIPOLE_CLOCK_H
#define LIBDIPOLE_CLOCK_H

#include <stdbool.h>
#include <stdint.h>

/* The shortest and the longest pause between two attempts. */
enum { LIBDIPOLE_PAUSE_FIRST_MS = 10, LIBDIPOLE_PAUSE_MOST_MS = 1000 };

/* Milliseconds since some moment in the past. This clock is never set back. */
int64_t libdipole_now_ms(void);

void libdipole_sleep_ms(int64_t ms);

/* Calls poll() for one descriptor, again after each signal. timeout_ms: 0 is no limit. Returns
 * false with errno set: to ETIMEDOUT if the time is over. *ready: the events, only if true. */
bool libdipole_wait(int fd, short events, unsigned timeout_ms, short *ready);

/* A random number. *state: 0 before the first call. */
uint32_t libdipole_random(uint64_t *state);

/* A random length between half of a pause and all of it, so that clients that lost the same daemon
 * at the same moment do not all come back at the same moment. */
unsigned libdipole_jitter(uint64_t *state, unsigned pause_ms);

/* The length of the pause after one of this length: twice as long, up to the longest. */
unsigned libdipole_next_pause_ms(unsigned pause_ms);

#endif
