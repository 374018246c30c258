/* daemon: the daemon in this process. It has one worker, whose loop the fuzzing thread runs. */
#ifndef DIPOLED_TESTS_FUZZ_DAEMON_H
#define DIPOLED_TESTS_FUZZ_DAEMON_H

#include "server/net/worker.h"
#include "tests/fuzz/fuzz.h"

extern struct server fuzz_server;
extern struct worker fuzz_worker;

void fuzz_daemon_run(uv_run_mode mode);

/* Plays the peer of a client: sends all bytes, shuts down its side, and gathers the answers up to
 * the end. Bits of `manners`: 1 closes the socket after the last byte instead; 2 reads only at the
 * end, or when nothing more can be sent. Closes fd. */
void fuzz_daemon_talk(int fd, struct fuzz_delivery *delivery, unsigned manners,
                      struct fuzz_bytes *answers);

/* Checks that all memory has been returned. A Monte Carlo job that was dropped returns its own a
 * little later, when its thread has finished with it. */
void fuzz_daemon_check_freed(void);

#endif
