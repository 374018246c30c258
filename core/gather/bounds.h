/* bounds: numbers from which core/gather/loops.h computes the error of replacing points by a pair
 * of distances. Internal to core/gather.
 *
 * Distances are divided into bands. The edges of the bands are 2^k (1 + i / 16) mm, 16 for each
 * octave, so the top 16 bits of a double give its band. */
#ifndef DIPOLED_CORE_GATHER_BOUNDS_H
#define DIPOLED_CORE_GATHER_BOUNDS_H

#include <stdint.h>
#include <string.h>

#include "core/core.h"

/* A spread is a largest relative difference of distances: number i is (i + 1) /
 * GATHER_SPREADS_PER_ONE. */
enum { GATHER_BANDS = 16 * 26, GATHER_SPREADS = 12, GATHER_SPREADS_PER_ONE = 16 };

/* The number of edges, plus padding so that a block of 8 that begins at any edge can be read. */
enum { GATHER_EDGES = GATHER_BANDS + 1 + 8 };

/* Bounds near each edge r for one spread. Write R as a cubic polynomial in the squared distance s
 * plus g (s - r^2)^4; the bounds hold for all distances within the spread of r. */
typedef struct gather_near {
  double range[GATHER_EDGES]; /* upper bound of g r^4 minus lower bound, 1/mm^6 */
  double same[GATHER_EDGES];  /* the least |g| r^4, or 0 if g changes sign; 1/mm^6 */
  double cubic[GATHER_EDGES]; /* |coefficient of s^3| r, 1/mm^7 */
} gather_near;

typedef struct gather_bounds {
  int64_t first;   /* the top 16 bits of least_mm as a double */
  double least_mm; /* the first edge; most_mm is the last */
  double most_mm;
  double zero;                      /* the largest R at any distance, 1/mm^2 */
  double R[GATHER_BANDS + 1];       /* R at each edge */
  double top[GATHER_BANDS + 1];     /* the largest R at each edge and beyond */
  gather_near near[GATHER_SPREADS]; /* for each spread; 0 after the last edge */
} gather_bounds;

/* Computes the bounds of a profile from 928 samples of R. */
void gather_bounds_prepare(gather_bounds *bounds, const core_profile *profile);

/* Returns the index of the band that holds the distance r in mm, which is in [least_mm,
 * most_mm). */
static inline size_t gather_band(const gather_bounds *bounds, double r) {
  uint64_t bits;
  memcpy(&bits, &r, sizeof bits);
  return (size_t)((int64_t)(bits >> 48) - bounds->first);
}

/* Returns the largest R at distances of at least r. */
static inline double gather_top(const gather_bounds *bounds, double r) {
  return r < bounds->least_mm  ? bounds->zero
         : r < bounds->most_mm ? bounds->top[gather_band(bounds, r)]
                               : bounds->top[GATHER_BANDS];
}

/* Returns an estimate of R at r: its value at the lower edge of r's band. */
static inline double gather_about(const gather_bounds *bounds, double r) {
  return r < bounds->least_mm  ? bounds->R[0]
         : r < bounds->most_mm ? bounds->R[gather_band(bounds, r)]
                               : bounds->R[GATHER_BANDS];
}

#endif
