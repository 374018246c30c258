/* draw: the numbers u, from 0 to 1, that radii are drawn with (core_sample_f64()), by rule. The
 * same rule gives the same bits everywhere, and each number is made by itself.
 *
 *   REGULAR     u[i] = (i + 1/2) / count
 *   STRATIFIED  u[i] = (i + random(i)) / count
 *   RANDOM      u[i] = random(first + i)
 *
 * random(i) = (floor(z / 2^12) + 1/2) / 2^52, in single precision (floor(z / 2^41) + 1/2) / 2^23:
 * in (0, 1), and exact. z is output i, from 0, of SplitMix64 with the seed (Steele, Lea, Flood
 * 2014, "Fast splittable pseudorandom number generators"), all modulo 2^64:
 *
 *   z = seed + (i + 1) * 0x9e3779b97f4a7c15
 *   z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9
 *   z = (z ^ z >> 27) * 0x94d049bb133111eb
 *   z = z ^ z >> 31
 *
 * The other two rules are evaluated in double precision (a sum, a quotient; in single precision
 * rounded after that), and what rounds to 1 is the largest number below it.
 */
#ifndef DIPOLED_CORE_DRAW_H
#define DIPOLED_CORE_DRAW_H

#include "core/core.h"

typedef struct core_draw {
  enum core_draw_rule rule;
  uint64_t count;
  uint64_t first; /* RANDOM: up to CORE_DRAW_COUNT_MAX; else 0 */
  uint64_t seed;  /* STRATIFIED, RANDOM; else 0 */
} core_draw;

#define CORE_DRAW_COUNT_MAX ((uint64_t)1 << 52)

/* The faults name the fields of the wire: sample_count (1 to CORE_DRAW_COUNT_MAX but for a LIST),
 * sample_first, seed. */
core_fault core_draw_check(const core_draw *draw);

/* Writes the numbers begin, begin + 1, ..., begin + n - 1 to u[n]. Not of a LIST. */
void core_draw_f64(const core_draw *draw, uint64_t begin, size_t n, double *u);
void core_draw_f32(const core_draw *draw, uint64_t begin, size_t n, float *u);

/* The first of listed numbers that is not from 0 to 1, under the field `u`. */
core_fault core_numbers_check_f64(size_t n, const double *u);
core_fault core_numbers_check_f32(size_t n, const float *u);

/* What drawing a radius costs, as core_profile.cost has it, evaluating nothing. */
double core_draw_cost(const core_profile *profile);

#endif
