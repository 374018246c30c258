/* points: sets of points that clients send in parts (proto/gather.h).
 *
 * A connection sends at most one set at a time. Memory is taken as points arrive, from a budget that
 * all connections share (--points-bytes), and what has been sent is freed when the next part does
 * not come in time, or when the connection ends. A complete set becomes an entry of the cache
 * (server/store/cache.h), which builds its tree and then frees the points as they were sent.
 */
#ifndef DIPOLED_POINTS_H
#define DIPOLED_POINTS_H

#include "core/gather/gather.h"
#include "proto/gather.h"
#include "server/store/cache.h"

/* A set of points, complete or not. */
struct points;

/* Returns whether the client has taken too long to send the set. */
bool points_is_late(const struct points *points, uint64_t now_ms);

/* Releases a reference; with the last one, frees the set. points may be NULL. */
void points_release(struct points *points);

/* Looks the tree of a set up. points: what it is built from if the cache does not have it, of which a
 * new entry takes a reference; NULL: the set is then at fault. */
enum lookup_state points_get(struct lookups *lookups, struct lookup *lookup, const uint64_t set[2],
                             struct points *points);

/* Returns the tree that points_get() has found, until lookup_return(); NULL if there is none. */
static inline const core_gather_points *points_found(const struct lookup *lookup) {
  core_gather_points *const *found = lookup_thing(lookup);
  return found != NULL ? *found : NULL;
}

#endif
