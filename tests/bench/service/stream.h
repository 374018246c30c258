/* stream: clients that ask for the largest answers there are, one after another, and read and count
 * all of them: what small requests have to live with.
 *
 * Each is a process on the clients' core that yields to anyone else there (SCHED_IDLE), as it would
 * be on another machine: it should take the daemon's time, not that of the client that is measured.
 */
#ifndef DIPOLED_BENCH_SERVICE_STREAM_H
#define DIPOLED_BENCH_SERVICE_STREAM_H

#include "tests/bench/service/target.h"

/* Radii of a streamed request, a grid, whose answer comes in parts. */
enum { STREAM_RADII = 64000000 };

struct streamer {
  int control; /* of a socket pair, to the process */
  struct stream_shared *shared;
};

/* Starts the process, which connects and stays silent. */
void stream_start(struct streamer *streamer, const struct target_address *address);

/* Returns when the first bytes of an answer have arrived. */
void stream_begin(struct streamer *streamer);

/* Bytes of answers that have arrived ever. */
uint64_t stream_bytes(const struct streamer *streamer);

/* Returns when the answer that is under way has been read to its end; as long as bytes arrive, that
 * may take any time. */
void stream_pause(struct streamer *streamer);

#endif
