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

/* For each part of a set that is this large, its client has frame_timeout_ms. */
#define POINTS_TIMED_BYTES ((uint64_t)16 << 20)

/* A set of points, complete or not. One thread adds points; references are counted, so that the
 * cache and a job can each hold one. */
struct points {
  struct server *server;
  _Atomic unsigned references;
  uint64_t set[2]; /* name of the set: the hash of its content */
  uint32_t channel_count;
  uint64_t count;    /* number of points of the whole set */
  uint64_t next;     /* number of points added so far */
  uint64_t capacity; /* number of points that fit into the arrays */
  double *xyz;       /* [next][GATHER_AXES] */
  float *power;      /* [next][channel_count] */
  gather_name name;  /* hash of the points added so far */
  uint64_t begun_ms; /* arrival of the first part, on the loop's clock, in ms */
};

/* Makes a set without points, with one reference, for a request that has been parsed. Returns NULL
 * if there is no memory. */
struct points *points_new(struct server *server, const wire_points_request *request,
                          uint64_t now_ms);

/* Returns whether the request names this set, with the same counts. */
bool points_is(const struct points *points, const wire_points_request *request);

/* Takes memory for n more points. Returns an error if there is none. */
wire_error points_reserve(struct points *points, uint64_t n);

/* Checks n points, for which there is memory, and adds them. */
wire_error points_add(struct points *points, uint64_t n, const double *xyz, const float *power);

/* Returns whether the set, to which all points have been added, has the hash that it is named by. */
bool points_has_its_name(struct points *points);

/* Returns the memory that a point of a set with this many channels takes as it is sent. */
static inline uint64_t points_row_bytes(uint32_t channel_count) {
  return GATHER_AXES * sizeof(double) + channel_count * sizeof(float);
}

/* Returns whether the client has taken too long to send the set. */
bool points_is_late(const struct points *points, uint64_t now_ms);

void points_hold(struct points *points);

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
