/* batch: many short requests for one profile, evaluated in one pass of the kernel.
 *
 * In each round of its loop a worker gathers the short requests of all its clients. It evaluates
 * them at the end of the round, before anything is written. The radii of a pass are copied
 * together, and its values are copied to where each request wants them. The values do not depend on
 * which requests share a pass.
 *
 * Measured as in server/store/profiles.h: without batches a request of 4 radii takes 2.0 times as
 * much of the daemon's processor time with single scattering, 1.5 times with quantized diffusion,
 * and the same with a dipole.
 */
#ifndef DIPOLED_BATCH_H
#define DIPOLED_BATCH_H

#include "server/observe/stats.h"
#include "server/store/profiles.h"

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

#endif
