/* draw: makes by rule the numbers u, from 0 to 1, from which core_sample_f64() draws radii. The
 * same rule gives the same bits on every machine, and no number depends on the others.
 *
 *   REGULAR     u[i] = (i + 1/2) / count
 *   STRATIFIED  u[i] = (i + random(i)) / count
 *   RANDOM      u[i] = random(first + i)
 *
 * In double precision random(i) = (floor(z / 2^12) + 1/2) / 2^52, in single precision (floor(z /
 * 2^41) + 1/2) / 2^23. Both are exact and lie in (0, 1). z is output i, counted from 0, of
 * SplitMix64 with the seed (Steele, Lea, Flood 2014, "Fast splittable pseudorandom number
 * generators"), all modulo 2^64:
 *
 *   z = seed + (i + 1) * 0x9e3779b97f4a7c15
 *   z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9
 *   z = (z ^ z >> 27) * 0x94d049bb133111eb
 *   z = z ^ z >> 31
 *
 * REGULAR and STRATIFIED are evaluated in double precision, with one sum and one quotient. For
 * single precision the result is rounded once more. A number that rounds to 1 is replaced by the
 * largest one below 1.
 */
#ifndef DIPOLED_CORE_DRAW_H
#define DIPOLED_CORE_DRAW_H

#include "core/core.h"

typedef struct core_draw {
  enum core_draw_rule rule;
  uint64_t count;
  uint64_t first; /* RANDOM: up to CORE_DRAW_COUNT_MAX; other rules: 0 */
  uint64_t seed;  /* STRATIFIED and RANDOM: any; other rules: 0 */
} core_draw;

#define CORE_DRAW_COUNT_MAX ((uint64_t)1 << 52)

/* Returns the fault of a draw. It names the field of the wire: sample_count, sample_first or seed.
 * sample_count is from 1 to CORE_DRAW_COUNT_MAX, except for a LIST. */
core_fault core_draw_check(const core_draw *draw);

/* Writes the numbers begin, begin + 1, ..., begin + n - 1 to u[n]. The rule must not be LIST. */
void core_draw_f64(const core_draw *draw, uint64_t begin, size_t n, double *u);
void core_draw_f32(const core_draw *draw, uint64_t begin, size_t n, float *u);

/* Returns the fault, with the field `u`, of the first listed number that is not from 0 to 1. u: [n], of
 * type float if `single`, else double. */
core_fault core_numbers_check(size_t n, bool single, const void *u);

/* Returns the cost of drawing one radius, in the unit of core_profile.cost. */
double core_draw_cost(const core_profile *profile);

#endif
