#include "core/draw.h"

#include <float.h>

#include "core/splitmix.h"

core_fault core_draw_check(const core_draw *draw) {
  const bool by_rule = draw->rule != CORE_DRAW_LIST;
  const bool seeded = draw->rule == CORE_DRAW_STRATIFIED || draw->rule == CORE_DRAW_RANDOM;
  if (by_rule && (draw->count < 1 || draw->count > CORE_DRAW_COUNT_MAX)) {
    return (core_fault){"sample_count", "1 to 2^52", 0};
  }
  if (draw->first > (draw->rule == CORE_DRAW_RANDOM ? CORE_DRAW_COUNT_MAX : 0)) {
    return draw->rule == CORE_DRAW_RANDOM
               ? (core_fault){"sample_first", "0 to 2^52", 0}
               : (core_fault){"sample_first", "0 unless the draw is random", 0};
  }
  if (draw->seed != 0 && !seeded) {
    return (core_fault){"seed", "0 unless the draw is random or stratified", 0};
  }
  return (core_fault){0};
}

/* ---- by rule --------------------------------------------------------------------------------- */

static uint64_t random_bits(uint64_t seed, uint64_t i) {
  uint64_t state = seed + i * UINT64_C(0x9e3779b97f4a7c15);
  return core_splitmix(&state);
}

static double random_f64(uint64_t seed, uint64_t i) {
  return ((double)(random_bits(seed, i) >> 12) + 0.5) * 0x1p-52;
}

static float random_f32(uint64_t seed, uint64_t i) {
  return ((float)(random_bits(seed, i) >> 41) + 0.5f) * 0x1p-23f;
}

/* Returns number i of the rules REGULAR and STRATIFIED. It may round to 1, which the caller
 * corrects. */
static double in_stratum(const core_draw *draw, uint64_t i) {
  const double within = draw->rule == CORE_DRAW_REGULAR ? 0.5 : random_f64(draw->seed, i);
  return ((double)i + within) / (double)draw->count;
}

void core_draw_f64(const core_draw *draw, uint64_t begin, size_t n, double *u) {
  const double most = 1 - DBL_EPSILON / 2;
  for (size_t k = 0; k < n; k++) {
    const uint64_t i = begin + k;
    const double number = draw->rule == CORE_DRAW_RANDOM ? random_f64(draw->seed, draw->first + i)
                                                         : in_stratum(draw, i);
    u[k] = number < most ? number : most;
  }
}

void core_draw_f32(const core_draw *draw, uint64_t begin, size_t n, float *u) {
  const float most = 1 - FLT_EPSILON / 2;
  for (size_t k = 0; k < n; k++) {
    const uint64_t i = begin + k;
    const float number = draw->rule == CORE_DRAW_RANDOM ? random_f32(draw->seed, draw->first + i)
                                                        : (float)in_stratum(draw, i);
    u[k] = number < most ? number : most;
  }
}

/* ---- by list --------------------------------------------------------------------------------- */

core_fault core_numbers_check(size_t n, bool single, const void *u) {
  for (size_t i = 0; i < n; i++) {
    const double number = single ? (double)((const float *)u)[i] : ((const double *)u)[i];
    if (!(number >= 0 && number <= 1)) {
      return (core_fault){"u", "0 to 1, both included", i};
    }
  }
  return (core_fault){0};
}

/* ---- cost ------------------------------------------------------------------------------------ */

/* The cost was measured for all models. A table needs one further look-up. Other evaluators invert
 * the cdf in about eight steps of at most two evaluations each; 280 is the cost of the steps
 * besides the evaluations. */
double core_draw_cost(const core_profile *profile) {
  return profile->evaluator == CORE_EVALUATOR_LUT ? 3 : 280 + 16 * profile->cost;
}
