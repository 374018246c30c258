/* repeat: answers short eval requests that differ from earlier ones in their radii alone, as render
 * farms send them by the million. What is known of the earlier request takes the place of checking
 * the new one and of making its reply, and gives the same bytes.
 *
 * Two requests count as the same if their payloads are equal byte by byte up to the radii.
 *
 * Measured as in server/store/profiles.h: without it, a request of 16 radii (service.redis) takes
 * 2.8 times as much of the daemon's processor time, and ratio.service.redis is half as high.
 */
#ifndef DIPOLED_REPEAT_H
#define DIPOLED_REPEAT_H

#include "proto/eval.h"
#include "server/jobs/batch.h"

/* A request is found by its hash: in one of REPEAT_SETS sets, in any of its REPEAT_WAYS entries. */
enum {
  REPEAT_SETS = 64,
  REPEAT_WAYS = 4,
  REPEAT_REQUEST_BYTES = 256, /* at most, up to the radii */
  REPEAT_REPLY_BYTES = 72,    /* of a reply with one channel, up to the arrays */
};

/* A request that has been answered. */
struct repeat_entry {
  uint64_t hash;
  size_t request_bytes; /* up to the radii; 0 if the entry is empty */
  size_t payload_bytes; /* with the radii */
  size_t reply_bytes;
  size_t array_bytes;
  size_t value_bytes;
  size_t count; /* of radii */
  unsigned model;
  unsigned wanted;
  core_grid grid; /* of radii that are not listed */
  struct profiles_place place;
  uint8_t request[REPEAT_REQUEST_BYTES];
  uint8_t reply[REPEAT_REPLY_BYTES];
};

/* Belongs to one worker and is used on its thread only. Starts with all members 0. */
struct repeat {
  struct repeat_set {
    unsigned next; /* the entry that is replaced next */
    struct repeat_entry entries[REPEAT_WAYS];
  } sets[REPEAT_SETS];
};

/* Remembers a request whose reply is one complete part, if it is short and of a kind that can be
 * repeated. `place` is its profile's. Everything but the radii has been found right for any radii:
 * the model was named and covers all of them. */
void repeat_learn(struct repeat *repeat, const eval_request *request, const core_grid *grid,
                  const eval_layout *layout, const uint8_t *reply, struct profiles_place place);

/* The request that this one repeats. NULL: none is known, its profile is gone, or the radii are not
 * right; the request then takes the usual way. */
const struct repeat_entry *repeat_find(struct repeat *repeat, const uint8_t *payload,
                                       size_t payload_bytes);

/* Fills in a reply of entry->reply_bytes. The values are there after batch_finish(). `radii` is
 * working space for BATCH_SHORT_RADII numbers. No profile has been got since repeat_find(). */
void repeat_answer(const struct repeat_entry *entry, struct batch *batch, struct stats *stats,
                   const uint8_t *payload, double *radii, uint8_t *reply);

#endif
