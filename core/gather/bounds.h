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

/* Spread i holds relative differences of distance up to (i + 1) / GATHER_SPREADS_PER_ONE. */
enum { GATHER_BANDS = 16 * 26, GATHER_SPREADS = 12, GATHER_SPREADS_PER_ONE = 16 };

/* Rounded up, so that blocks can be read. */
enum { GATHER_EDGES = GATHER_BANDS + 1 + 8 };

/* About a distance r, R is a cubic polynomial of the squared distance s, plus g (s - r^2)^4, at all
 * distances that differ from r by up to the spread. */
typedef struct gather_near {
  double range[GATHER_EDGES]; /* the largest g r^4 less the smallest, 1/mm^6 */
  double same[GATHER_EDGES];  /* the smallest |g| r^4, or 0 if the sign of g varies */
  double cubic[GATHER_EDGES]; /* |coefficient of s^3| r, 1/mm^7 */
} gather_near;

typedef struct gather_bounds {
  int64_t first;   /* the top 16 bits of the first edge, a double */
  double least_mm; /* the first edge, and the last one */
  double most_mm;
  double zero;                      /* the largest R at any distance */
  double R[GATHER_BANDS + 1];       /* at each edge */
  double top[GATHER_BANDS + 1];     /* the largest R from each edge on */
  gather_near near[GATHER_SPREADS]; /* at each edge; 0 after the last one */
} gather_bounds;

/* Fills in the bounds of a profile. */
void gather_bounds_prepare(gather_bounds *bounds, const core_profile *profile);

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
