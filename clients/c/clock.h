/* clock: time, waiting, and pauses of random length. */
#ifndef LIBDIPOLE_CLOCK_H
#define LIBDIPOLE_CLOCK_H

#include <stdbool.h>
#include <stdint.h>

/* The shortest and the longest pause between two attempts. */
enum { LIBDIPOLE_PAUSE_FIRST_MS = 10, LIBDIPOLE_PAUSE_MOST_MS = 1000 };

/* Returns the milliseconds since some moment in the past. This clock is never set back. */
int64_t libdipole_now_ms(void);

void libdipole_sleep_ms(int64_t ms);

/* Calls poll() for one descriptor, again after each signal. A timeout_ms of 0 sets no limit. On
 * success, stores the events in *ready. Otherwise returns false and sets errno, to ETIMEDOUT if the
 * time is over. */
bool libdipole_wait(int fd, short events, unsigned timeout_ms, short *ready);

/* Returns a random number. Set *state to 0 before the first call. */
uint32_t libdipole_random(uint64_t *state);

/* Returns a random length between half of a pause and all of it, so that clients that lost the same
 * daemon at the same moment do not all come back at the same moment. */
unsigned libdipole_jitter(uint64_t *state, unsigned pause_ms);

/* Returns the length of the pause that follows one of pause_ms: twice as long, up to the longest.
 */
unsigned libdipole_next_pause_ms(unsigned pause_ms);

#endif
