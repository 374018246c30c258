/* bounds: how far a pair of distances may be from the points that it stands for. Internal to
 * core/gather.
 *
 * Bands of distance are sixteenths of octaves, whose edges are 2^k (1 + i / 16), so that the first
 * bits of a distance are its band.
 */
#ifndef DIPOLED_CORE_GATHER_BOUNDS_H
#define DIPOLED_CORE_GATHER_BOUNDS_H

#include <stdint.h>
#include <string.h>

#include "core/core.h"

/* Spread i holds ratios of a node's radius to its distance from i / 8 to (i + 1) / 8. */
enum { GATHER_BANDS = 16 * 26, GATHER_SPREADS = 6 };

/* The largest ratio of a node's radius to its distance for which `near` holds. */
#define GATHER_SPREAD_MAX 0.75

typedef struct gather_bound {
  double quartic; /* of R, divided by the ratio of radius and distance, to the fourth power */
  double cubic;   /* for each unit of a third moment of squared distances, 1/mm^8 */
} gather_bound;

typedef struct gather_bounds {
  int64_t first;   /* the first bits of the first edge */
  double least_mm; /* the first edge, and the last one */
  double most_mm;
  double zero;                  /* the largest R at any distance */
  double R[GATHER_BANDS + 1];   /* at each edge */
  double top[GATHER_BANDS + 1]; /* the largest R from each edge on */
  gather_bound near[GATHER_BANDS][GATHER_SPREADS];
} gather_bounds;

/* Fills in the bounds of a profile. Returns false if it tells nothing about derivatives. */
bool gather_bounds_prepare(gather_bounds *bounds, const core_profile *profile);

/* Returns the band of a distance from least_mm to below most_mm. */
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

/* Returns about R at r. */
static inline double gather_about(const gather_bounds *bounds, double r) {
  return r < bounds->least_mm  ? bounds->R[0]
         : r < bounds->most_mm ? bounds->R[gather_band(bounds, r)]
                               : bounds->R[GATHER_BANDS];
}

#endif
