/* seat: one connection of the prototypes of threading schemes: rings of requests and of replies in
 * which all of them keep their places until they are sent. Replies go out in the requests' order,
 * as many with one system call as are complete. Requests are those of a target (target.h), and what
 * is done for them costs about as much as evaluating them: what differs is who does it. */
#ifndef DIPOLED_BENCH_SERVICE_SEAT_H
#define DIPOLED_BENCH_SERVICE_SEAT_H

#include "tests/bench/service/target.h"

enum { SEAT_PLACES = 16 }; /* requests that a client may have in flight */

struct seat {
  const struct target *target;
  int fd;
  uint8_t *requests; /* [SEAT_PLACES][request_bytes] */
  uint8_t *replies;  /* [SEAT_PLACES][reply_bytes] */
  bool done[SEAT_PLACES];
  uint64_t received_bytes; /* these four count from the beginning */
  uint64_t sent_bytes;
  uint64_t taken;    /* requests */
  uint64_t complete; /* replies, without a gap */
  bool blocked;      /* the socket takes no more for now */
  bool touched;      /* for the owner's use */
};

/* For a connected socket, which it owns from now on. The process ends if there is no memory. */
struct seat *seat_new(const struct target *target, int fd);
void seat_free(struct seat *seat);

/* Reads once; false: the peer is gone. */
bool seat_receive(struct seat *seat);

/* The next request that has arrived; false: there is none. */
bool seat_take(struct seat *seat, size_t *place);

/* Works out the reply; any thread, one at a time for each place. */
void seat_work(struct seat *seat, size_t place);

/* The reply is there. */
void seat_finish(struct seat *seat, size_t place);

/* Sends what is there, as far as the socket takes it; false: the peer is gone. */
bool seat_send(struct seat *seat);

/* Makes the target's expected replies those of seat_work(). */
void seat_expect(struct target *target);

/* ---- the schemes ---------------------------------------------------------------------------- */

enum { SCHEME_WORKERS = 2 };

/* Both serve target on listener for ever.
 *
 * owners: workers own connections; each waits for its own, and works where it reads.
 * front: one thread reads and writes for all connections; it hands requests to workers through
 * queues and gets them back likewise, an eventfd waking who sleeps. */
_Noreturn void scheme_run_owners(const struct target *target, int listener);
_Noreturn void scheme_run_front(const struct target *target, int listener);

#endif
