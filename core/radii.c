/* Checks listed radii and expands grids. */
#include <assert.h>
#include <math.h>

#include "core/core.h"

#define CORE_REAL 64
#include "core/kernel.h"

/* ---- lists ----------------------------------------------------------------------------------- */

#define RADIUS_ALLOWED "0 to infinity, in mm"

static core_fault radius_fault(size_t index) {
  return (core_fault){"r", RADIUS_ALLOWED, index};
}

/* If a list contains 0, the least radius of its range is the smallest positive one below this, if
 * there is any: errors at such radii may be larger (core_profile_errors()). */
#define NEAREST_MM (CORE_RADIUS_SMALL_MFP / CORE_SIGMA_T_PRIME_MIN_PER_MM)

#define LESS(a, b) ((a) < (b) ? (a) : (b))
#define MORE(a, b) ((a) > (b) ? (a) : (b))

/* One pass finds the range, and whether there is a NaN. A second pass, for the first bad radius or
 * the largest finite one, is needed only if there is a NaN, a negative or an infinite radius.
 *
 * `omp simd` lets the compiler reorder the reductions, so that the loop vectorizes. Each turn takes
 * a radius from each quarter of the list: if all radii went into one minimum, each would wait for
 * the one before. */
#define REDUCE _Pragma("omp simd reduction(min:least) reduction(max:most) reduction(|:has_nan)")
#define DEFINE_CHECK(name, type)                                                                   \
  core_fault name(size_t n, const type *r, core_radii_range *range) {                              \
    type least = (type)INFINITY;                                                                   \
    type most = 0, tiny = (type)NEAREST_MM;                                                        \
    int has_nan = 0;                                                                               \
    const size_t quarter = n / 4;                                                                  \
    REDUCE                                                                                         \
    for (size_t i = 0; i < quarter; i++) {                                                         \
      const type a = r[i], b = r[quarter + i], c = r[2 * quarter + i], d = r[3 * quarter + i];     \
      const type least_of_two = LESS(a, b), most_of_two = MORE(a, b);                              \
      const type least_of_others = LESS(c, d), most_of_others = MORE(c, d);                        \
      const type least_of_four = LESS(least_of_two, least_of_others);                              \
      const type most_of_four = MORE(most_of_two, most_of_others);                                 \
      least = LESS(least_of_four, least);                                                          \
      most = MORE(most_of_four, most);                                                             \
      has_nan |= isunordered(a, b) | isunordered(c, d);                                            \
    }                                                                                              \
    for (size_t i = 4 * quarter; i < n; i++) {                                                     \
      least = LESS(r[i], least);                                                                   \
      most = MORE(r[i], most);                                                                     \
      has_nan |= isnan(r[i]);                                                                      \
    }                                                                                              \
    if (has_nan || least < 0) {                                                                    \
      size_t first = 0;                                                                            \
      while (r[first] >= 0) {                                                                      \
        first++;                                                                                   \
      }                                                                                            \
      return radius_fault(first);                                                                  \
    }                                                                                              \
    if (most == (type)INFINITY) {                                                                  \
      most = 0;                                                                                    \
      for (size_t i = 0; i < n; i++) {                                                             \
        most = r[i] > most && r[i] < (type)INFINITY ? r[i] : most;                                 \
      }                                                                                            \
    }                                                                                              \
    for (size_t i = 0; !(least > 0) && i < n;                                                      \
         i++) { /* the least positive radius, if it is tiny */                                     \
      tiny = r[i] > 0 && r[i] < tiny ? r[i] : tiny;                                                \
    }                                                                                              \
    least = !(least > 0) && tiny < (type)NEAREST_MM ? tiny : least;                                \
    *range = (core_radii_range){(double)least + 0, (double)most}; /* -0.0 becomes 0 */             \
    return (core_fault){0};                                                                        \
  }

DEFINE_CHECK(core_radii_check_f64, double)
DEFINE_CHECK(core_radii_check_f32, float)

core_fault core_radii_range_check(const core_radii_range *range, size_t n, bool single,
                                  const void *r) {
  const bool all = range->least_mm <= 0 && range->most_mm >= (double)INFINITY;
  for (size_t i = 0; !all && i < n; i++) {
    const double r_mm = single ? (double)((const float *)r)[i] : ((const double *)r)[i];
    if (r_mm < range->least_mm || r_mm > range->most_mm) {
      return (core_fault){"r", "the radii that the fit covers: fit_from to fit_to", i};
    }
  }
  return (core_fault){0};
}

/* ---- grids ----------------------------------------------------------------------------------- */

core_fault core_grid_check(const core_grid *grid) {
  const bool logarithmic = grid->spacing == CORE_SPACING_LOGARITHMIC;
  if (grid->count < 1 || grid->count > CORE_GRID_COUNT_MAX) {
    return (core_fault){"radius_count", "1 to 2^53 for a grid", 0};
  }
  if (!(grid->start_mm >= (logarithmic ? CORE_GRID_LOG_MIN_MM : 0) && isfinite(grid->start_mm))) {
    return logarithmic ? (core_fault){"radius_start", "at least 1e-300 mm, finite (logarithmic)", 0}
                       : (core_fault){"radius_start", "at least 0 mm, finite", 0};
  }
  if (!(grid->stop_mm >= grid->start_mm && isfinite(grid->stop_mm))) {
    return (core_fault){"radius_stop", "at least radius_start, finite", 0};
  }
  return (core_fault){0};
}

/* Returns start e^x for x >= 0; the result must not overflow. The power of two is applied in two
 * factors, because it may overflow by itself. */
static double times_exp(double start, double x) {
  const real_exp_parts parts = real_exp_split(x);
  const double half = floor(0.5 * parts.k);
  return fma(start, parts.m, start) * real_power_of_two(half) * real_power_of_two(parts.k - half);
}

/* A grid and its step. The step of a linear grid is computed from halves, so that a range up to the
 * largest double does not overflow. */
struct rule {
  const core_grid *grid;
  double step;
};

static struct rule make_rule(const core_grid *grid) {
  struct rule rule = {grid, 0};
  if (grid->count > 1) {
    const double steps = (double)(grid->count - 1);
    rule.step = grid->spacing == CORE_SPACING_LINEAR
                    ? 2 * ((0.5 * grid->stop_mm - 0.5 * grid->start_mm) / steps)
                    : (real_log(grid->stop_mm, 0) - real_log(grid->start_mm, 0)) / steps;
  }
  return rule;
}

/* Returns radius `index` of a grid. Both ends are exact, and no other radius exceeds the last one
 * by rounding. */
static double radius_of_rule(const struct rule *rule, uint64_t index) {
  const core_grid *grid = rule->grid;
  if (index == 0) {
    return grid->start_mm;
  }
  if (index == grid->count - 1) {
    return grid->stop_mm;
  }
  const double radius = grid->spacing == CORE_SPACING_LINEAR
                            ? fma((double)index, rule->step, grid->start_mm)
                            : times_exp(grid->start_mm, (double)index * rule->step);
  return real_min(radius, grid->stop_mm);
}

void core_grid_radii(const core_grid *grid, uint64_t first, size_t n, bool single, void *r) {
  assert(core_grid_check(grid).field == NULL && n <= grid->count && first <= grid->count - n);
  const struct rule rule = make_rule(grid);
  for (size_t i = 0; i < n; i++) {
    const double radius = radius_of_rule(&rule, first + i);
    if (single) {
      ((float *)r)[i] = (float)radius;
    } else {
      ((double *)r)[i] = radius;
    }
  }
}
