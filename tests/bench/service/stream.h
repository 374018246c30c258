/* stream: clients that request the largest possible answers one after another, and read and count
 * all their bytes. They are the background load beside which small requests are measured.
 *
 * Each is a process on the clients' core with the policy SCHED_IDLE, so that it takes time from the
 * daemon but none from the client that is measured.
 */
#ifndef DIPOLED_BENCH_SERVICE_STREAM_H
#define DIPOLED_BENCH_SERVICE_STREAM_H

#include "tests/bench/service/target.h"

/* Number of radii in the grid of a streamed request; its answer comes in parts. */
enum { STREAM_RADII = 64000000 };

struct streamer {
  int control; /* the benchmark's end of a socket pair with the process */
  struct stream_shared *shared;
};

/* Starts the process, which connects and stays silent. */
void stream_start(struct streamer *streamer, const struct target_address *address);

/* Returns when the first bytes of an answer have arrived. */
void stream_begin(struct streamer *streamer);

/* Returns the number of bytes of answers that have arrived since stream_start(). */
uint64_t stream_bytes(const struct streamer *streamer);

/* Returns when the current answer has been read to its end. There is no time limit as long as bytes
 * arrive. */
void stream_pause(struct streamer *streamer);

#endif
