/* batch: many short requests for one profile, evaluated in one pass of the kernel.
 *
 * In a round of its loop a worker gathers what is short, whichever connection it came from, and
 * evaluates it at the round's end, before anything is written. The radii are copied together and the
 * values apart; what is evaluated does not depend on what it is gathered with.
 */
#ifndef DIPOLED_BATCH_H
#define DIPOLED_BATCH_H

#include "server/store/profiles.h"
#include "server/observe/stats.h"

enum {
  BATCH_SHORT_RADII = 128, /* longer ones fill the kernels' vectors by themselves */
  BATCH_RADII = 4096,      /* in one pass */
  BATCH_PIECES = 512,      /* requests in one pass */
  BATCH_GROUPS = 4,        /* profiles and quantities that are gathered for at a time */
};

/* One request's share of a pass. */
struct batch_piece {
  void *to;
  uint32_t count;
};

/* A pass that is being gathered. */
struct batch_group {
  struct cache_key key;
  enum core_quantity quantity;
  core_profile profile;
  struct cache_entry *entry; /* whose copy the profile is, and a reference; NULL: it owns nothing */
  size_t radius_count;
  size_t piece_count;
  struct batch_piece pieces[BATCH_PIECES];
  double radii[BATCH_RADII]; /* or as many floats */
};

/* Of one worker, on its thread; starts all 0. */
struct batch {
  struct batch_group groups[BATCH_GROUPS];
  unsigned next; /* group to be evaluated when there is need of one */
};

/* Takes n radii (1 to BATCH_SHORT_RADII) of an order that is ready, in its evaluator's precision;
 * the values of the quantity are at `to` after batch_finish(). False: such a profile or quantity is
 * not gathered. */
bool batch_take(struct batch *batch, struct stats *stats, const struct profiles_order *order,
                enum core_quantity quantity, size_t n, const void *r, void *to);

/* Evaluates all that has been taken. */
void batch_finish(struct batch *batch, struct stats *stats);

#endif
