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
 * Stores the events in *ready, or returns false and sets errno, to ETIMEDOUT after timeout_ms. */
bool libdipole_wait(int fd, short events, unsigned timeout_ms, short *ready);

/* Returns a random number. Set *state to 0 before the first call. */
uint32_t libdipole_random(uint64_t *state);

/* Returns a random number from pause_ms / 2 to pause_ms, so that clients that lost the same daemon
 * do not all come back at the same moment. */
unsigned libdipole_jitter(uint64_t *state, unsigned pause_ms);

/* Returns how long to wait before the next attempt to connect, or 0 if no attempt is left before
 * until_ms. *pause_ms: the usual pause; set it to LIBDIPOLE_PAUSE_FIRST_MS before the first call,
 * and each call doubles it up to LIBDIPOLE_PAUSE_MOST_MS. A pause takes at most half of the time
 * that is left, so that the last attempts come close to until_ms; but it takes at least
 * retry_after_ms, which the daemon has requested. */
unsigned libdipole_pause(uint64_t *state, unsigned *pause_ms, uint32_t retry_after_ms,
                         int64_t until_ms);

#endif
