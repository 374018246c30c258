/* repeat: short requests that are like earlier ones but for their radii, as farms send them by the
 * million: they are answered from what is known of those, with the same bytes as otherwise.
 *
 * What counts as the same is the payload before the radii, byte for byte.
 */
#ifndef DIPOLED_REPEAT_H
#define DIPOLED_REPEAT_H

#include "server/jobs/batch.h"

struct job;

enum {
  REPEAT_SETS = 64,           /* a request is kept in one of them, found by hash, */
  REPEAT_WAYS = 4,            /* in any of its places */
  REPEAT_REQUEST_BYTES = 256, /* before the radii, at most */
  REPEAT_REPLY_BYTES = 72,    /* before the arrays, of a reply with one channel */
};

/* A request that has been answered. */
struct repeat_entry {
  uint64_t hash;
  size_t request_bytes; /* before the radii; 0: the entry is empty */
  size_t payload_bytes; /* and with them */
  size_t reply_bytes;
  size_t array_bytes;
  size_t value_bytes;
  size_t count; /* of radii */
  unsigned wanted;
  core_grid grid; /* where the radii are not listed */
  uint8_t request[REPEAT_REQUEST_BYTES];
  uint8_t reply[REPEAT_REPLY_BYTES];
  struct profiles_order order; /* ready, with a reference of its own */
};

/* Of one worker, on its thread; starts all 0. */
struct repeat {
  struct repeat_set {
    unsigned next; /* place to be used next */
    struct repeat_entry entries[REPEAT_WAYS];
  } sets[REPEAT_SETS];
};

/* Keeps a job in mind whose reply is complete and whose profile it still has, if it is one that may
 * be repeated. */
void repeat_learn(struct repeat *repeat, const struct job *job);

/* What a request repeats, if there is nothing wrong with its radii; NULL: nothing is known, or it is
 * to be looked at closely. */
const struct repeat_entry *repeat_find(struct repeat *repeat, const uint8_t *payload,
                                       size_t payload_bytes);

/* Fills in the reply, reply_bytes; the values are there after batch_finish(). `radii` has room for
 * BATCH_SHORT_RADII numbers. */
void repeat_answer(const struct repeat_entry *entry, struct batch *batch, struct stats *stats,
                   const uint8_t *payload, double *radii, uint8_t *reply);

/* From time to time: forgets what the cache does not keep any more. */
void repeat_sweep(struct repeat *repeat);

/* Forgets all. */
void repeat_end(struct repeat *repeat);

#endif
