/* batch: short eval requests. Many of them for one profile are evaluated in one pass of the kernel,
 * and those that repeat an earlier one are answered from what is known of it.
 *
 * Passes. In each round of its loop a worker gathers the short requests of all its clients. It
 * evaluates them at the end of the round, before anything is written. The radii of a pass are
 * copied together, and its values are copied to where each request wants them. The values do not
 * depend on which requests share a pass. Measured as in server/store/profiles.h: without passes a
 * request of 4 radii takes 2.0 times as much of the daemon's processor time with single scattering,
 * 1.5 times with quantized diffusion, and the same with a dipole.
 *
 * Repeated requests. Render farms send requests by the million that differ in their radii alone:
 * their payloads are equal byte by byte up to the radii. What is known of an earlier request takes
 * the place of checking the new one and of making its reply, and gives the same bytes. Measured as
 * in server/store/profiles.h: without this, a request of 16 radii (service.redis) takes 2.8 times
 * as much of the daemon's processor time, and ratio.service.redis is half as high.
 */
#ifndef DIPOLED_BATCH_H
#define DIPOLED_BATCH_H

#include "proto/eval.h"
#include "server/observe/stats.h"
#include "server/store/profiles.h"

/* ---- passes -----------------------------------------------------------------------------------
 */

enum {
  BATCH_SHORT_RADII = 128, /* more radii fill the kernels' vectors by themselves */
  BATCH_RADII = 4096,      /* at most in one pass */
  BATCH_PIECES = 512,      /* requests at most in one pass */
  BATCH_GROUPS = 4, /* passes that are gathered at a time, each of one profile and quantity */
};

/* The part of one request in a pass. */
struct batch_piece {
  void *to; /* where its values go */
  uint32_t count;
};

/* A pass that is being gathered. */
struct batch_group {
  struct profiles_slot *slot; /* pinned; NULL: the group is free */
  enum core_quantity quantity;
  size_t radius_count;
  size_t piece_count;
  struct batch_piece pieces[BATCH_PIECES];
  double radii[BATCH_RADII]; /* or as many floats */
};

/* Belongs to one worker and is used on its thread only. Starts with all members 0. */
struct batch {
  struct batch_group groups[BATCH_GROUPS];
  unsigned next; /* the group that is evaluated first when all are taken */
};

/* Takes n radii (1 to BATCH_SHORT_RADII), in the precision of the profile's evaluator. After
 * batch_finish() the values of the quantity are at `to`. False: the profile at this place is gone,
 * or the quantity is S, which depends on angles that the profile does not have; the caller
 * evaluates the radii itself. */
bool batch_take(struct batch *batch, struct stats *stats, struct profiles_place place,
                enum core_quantity quantity, size_t n, const void *r, void *to);

/* Evaluates all that has been taken. */
void batch_finish(struct batch *batch, struct stats *stats);

/* ---- repeated requests ------------------------------------------------------------------------
 */

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

/* The request that this one repeats. NULL: none is known, its profile is gone, or a radius is
 * out of range; the request is then answered like a new one. */
const struct repeat_entry *repeat_find(struct repeat *repeat, const uint8_t *payload,
                                       size_t payload_bytes);

/* Fills in a reply of entry->reply_bytes. The values are there after batch_finish(). `radii` is
 * working space for BATCH_SHORT_RADII numbers. No profile has been got since repeat_find(). */
void repeat_answer(const struct repeat_entry *entry, struct batch *batch, struct stats *stats,
                   const uint8_t *payload, double *radii, uint8_t *reply);

#endif
