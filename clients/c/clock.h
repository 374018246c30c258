/* clock: time, waiting, and pauses of random length. */
#ifndef LIBDIPOLE_CLOCK_H
#define LIBDIPOLE_CLOCK_H

#include <stdbool.h>
#include <stdint.h>

/* The shortest and the longest pause between two attempts to connect. */
enum { LIBDIPOLE_PAUSE_FIRST_MS = 10, LIBDIPOLE_PAUSE_MOST_MS = 1000 };

/* Returns the milliseconds since some moment in the past. This clock is never set back. */
int64_t libdipole_now_ms(void);

void libdipole_sleep_ms(int64_t ms);

/* Waits for events of one descriptor with poll(), also across signals. timeout_ms: 0 is no limit.
 * On success, stores the events in *ready. Otherwise returns false and sets errno, to ETIMEDOUT
 * after timeout_ms. */
bool libdipole_wait(int fd, short events, unsigned timeout_ms, short *ready);

/* Returns a random number. Set *state to 0 before the first call. */
uint32_t libdipole_random(uint64_t *state);

/* Returns a random number from pause_ms / 2 to pause_ms, so that clients that lost the same daemon
 * do not all come back at the same moment. */
unsigned libdipole_jitter(uint64_t *state, unsigned pause_ms);

/* Returns the pause after one of pause_ms: twice as long, but at most LIBDIPOLE_PAUSE_MOST_MS. */
unsigned libdipole_next_pause_ms(unsigned pause_ms);

#endif
