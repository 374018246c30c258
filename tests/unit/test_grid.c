/* Radii: checks of lists, and expansion of grids. tests/e2e/wrong.txt lists which radii and grids are
 * refused. */
#include <float.h>
#include <math.h>

#include "tests/unit/unit.h"

enum { COUNT_MAX = 4096 };

/* ---- lists -------------------------------------------------------------------------------- */

/* The first bad radius is found at every position of lists of every length, also if another bad one
 * follows. */
UNIT_TEST(lists_name_the_first_bad_radius) {
  enum { LENGTHS = 68 };
  static const double bad[] = {-1, -5e-324, -INFINITY, NAN, -1e-44};
  for (size_t n = 1; n < LENGTHS; n++) {
    for (size_t at = 0; at < n; at++) {
      double wide[LENGTHS];
      float narrow[LENGTHS];
      core_radii_range range;
      for (size_t i = 0; i < n; i++) {
        wide[i] = (double)i;
        narrow[i] = (float)i;
      }
      const double value = bad[(n + at) % (sizeof bad / sizeof bad[0])];
      wide[at] = value;
      wide[n - 1] = at == n - 1 ? value : -2;
      unit_assert_fault(core_radii_check_f64(n, wide, &range), "r", at);
      narrow[at] = (float)value == 0 ? -1.0f : (float)value;
      narrow[n - 1] = at == n - 1 ? narrow[at] : -2;
      unit_assert_fault(core_radii_check_f32(n, narrow, &range), "r", at);
    }
  }
}

static void assert_range(core_radii_range range, double least_mm, double most_mm) {
  assert_true(range.least_mm == least_mm && range.most_mm == most_mm);
  assert_false(signbit(range.least_mm));
}

/* The least and the largest radius at every position of lists of every length. An infinite radius
 * beside them does not count. */
UNIT_TEST(lists_tell_their_range) {
  enum { LENGTHS = 68 };
  for (size_t n = 2; n < LENGTHS; n++) {
    for (size_t at = 0; at < n; at++) {
      double wide[LENGTHS];
      float narrow[LENGTHS];
      core_radii_range range;
      for (size_t i = 0; i < n; i++) {
        wide[i] = i == at ? 0.125 : i == (at + 1) % n ? 64.5 : 2;
        wide[i] = i == (at + 2) % n && n > 2 ? (double)INFINITY : wide[i];
        narrow[i] = (float)wide[i];
      }
      unit_accept(core_radii_check_f64(n, wide, &range));
      assert_range(range, 0.125, 64.5);
      unit_accept(core_radii_check_f32(n, narrow, &range));
      assert_range(range, 0.125, 64.5);
    }
  }
  static const double zeros[] = {-0.0, -0.0}, infinite[] = {INFINITY, INFINITY};
  core_radii_range range;
  unit_accept(core_radii_check_f64(2, zeros, &range));
  assert_range(range, 0, 0);
  unit_accept(core_radii_check_f64(2, infinite, &range));
  assert_range(range, INFINITY, 0);
  unit_accept(core_radii_check_f64(0, NULL, &range));
  assert_range(range, INFINITY, 0);
}

/* ---- what its radii are ------------------------------------------------------------------- */

static long double expected_radius(const core_grid *grid, uint64_t index) {
  const long double part =
      grid->count == 1 ? 0 : (long double)index / (long double)(grid->count - 1);
  const long double start = grid->start_mm;
  const long double stop = grid->stop_mm;
  return grid->spacing == CORE_SPACING_LINEAR ? start + part * (stop - start)
                                              : start * powl(stop / start, part);
}

/* Checks radii against the rule of their grid, and that they never decrease. The error of a linear
 * radius is the rounding error of its step times its position, which is large only for a subnormal
 * step. */
static void assert_radii(const core_grid *grid, uint64_t first, size_t n, const double *r) {
  const long double relative = grid->spacing == CORE_SPACING_LINEAR ? 2 * DBL_EPSILON : 1e-12L;
  for (size_t i = 0; i < n; i++) {
    const uint64_t index = first + i;
    const long double expected = expected_radius(grid, index);
    if (index == 0) {
      assert_true(r[i] == grid->start_mm);
    } else if (index == grid->count - 1) {
      assert_true(r[i] == grid->stop_mm);
    } else if (!(fabsl(r[i] - expected) <=
                 relative * expected + (long double)index * DBL_TRUE_MIN)) {
      fail_msg("radius %llu of %llu from %.17g to %.17g: %.17g, expected %.17Lg",
               (unsigned long long)index, (unsigned long long)grid->count, grid->start_mm,
               grid->stop_mm, r[i], expected);
    }
    assert_true(i == 0 || r[i] >= r[i - 1]);
  }
}

static const core_grid grids[] = {
    {CORE_SPACING_LINEAR, 1, 3, 5},
    {CORE_SPACING_LINEAR, 2, 0, 5},
    {CORE_SPACING_LINEAR, 67, 0, 10},
    {CORE_SPACING_LINEAR, COUNT_MAX, 0.1, 0.7},
    {CORE_SPACING_LINEAR, 1000, 2, 2},
    {CORE_SPACING_LINEAR, 1000, 0, DBL_MAX},
    {CORE_SPACING_LINEAR, 1000, DBL_MAX / 2, DBL_MAX},
    {CORE_SPACING_LINEAR, 300, 0, 100 * DBL_TRUE_MIN},
    {CORE_SPACING_LOGARITHMIC, 1, 3, 5},
    {CORE_SPACING_LOGARITHMIC, 2, 3, 5},
    {CORE_SPACING_LOGARITHMIC, 67, 0.01, 100},
    {CORE_SPACING_LOGARITHMIC, COUNT_MAX, 1e-300, DBL_MAX},
    {CORE_SPACING_LOGARITHMIC, 1000, 2, 2},
    {CORE_SPACING_LOGARITHMIC, 1000, 1, 1 + 1e-9},
    {CORE_SPACING_LOGARITHMIC, 1000, 1e300, DBL_MAX},
    {CORE_SPACING_LOGARITHMIC, 1000, 1e-300, 1e-290},
};
enum { GRIDS = sizeof grids / sizeof grids[0] };

UNIT_TEST(radii_follow_the_rule) {
  for (size_t i = 0; i < GRIDS; i++) {
    double r[COUNT_MAX];
    core_grid_radii(&grids[i], 0, (size_t)grids[i].count, false, r);
    assert_radii(&grids[i], 0, (size_t)grids[i].count, r);
  }
}

/* The radii of the largest grids follow the rule in any slice. */
UNIT_TEST(slices_of_the_largest_grids_follow_the_rule) {
  enum { SLICE = 100 };
  static const enum core_spacing spacings[] = {CORE_SPACING_LINEAR, CORE_SPACING_LOGARITHMIC};
  for (size_t i = 0; i < 2; i++) {
    const core_grid grid = {spacings[i], CORE_GRID_COUNT_MAX, 1e-3, 1e3};
    const uint64_t firsts[] = {0, 1, grid.count / 3, grid.count / 2, grid.count - SLICE};
    for (size_t j = 0; j < sizeof firsts / sizeof firsts[0]; j++) {
      double r[SLICE];
      core_grid_radii(&grid, firsts[j], SLICE, false, r);
      assert_radii(&grid, firsts[j], SLICE, r);
    }
  }
}

UNIT_TEST(single_precision_is_the_double_rounded) {
  for (size_t i = 0; i < GRIDS; i++) {
    const size_t count = (size_t)grids[i].count;
    double wide[COUNT_MAX];
    float narrow[COUNT_MAX];
    core_grid_radii(&grids[i], 0, count, false, wide);
    core_grid_radii(&grids[i], 0, count, true, narrow);
    for (size_t j = 0; j < count; j++) {
      assert_true(narrow[j] == (float)wide[j]);
    }
  }
}

UNIT_TEST(nothing_beyond_the_slice_is_written) {
  const core_grid grid = {CORE_SPACING_LOGARITHMIC, 100, 1, 10};
  double wide[12];
  float narrow[12];
  for (size_t i = 0; i < 12; i++) {
    wide[i] = -7;
    narrow[i] = -7;
  }
  core_grid_radii(&grid, 3, 10, false, wide + 1);
  core_grid_radii(&grid, 3, 10, true, narrow + 1);
  assert_true(wide[0] == -7 && wide[11] == -7);
  assert_true(narrow[0] == -7 && narrow[11] == -7);
  core_grid_radii(&grid, 3, 0, false, wide);
  assert_true(wide[0] == -7);
}
