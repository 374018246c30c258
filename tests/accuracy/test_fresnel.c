/* The reference of the Fresnel moments against numbers that this project did not make, and those of
 * the core against the reference, within what core.h states. */
#include <float.h>
#include <math.h>

#include "tests/accuracy/reference_fresnel.h"
#include "tests/unit/unit.h"

/* core_fresnel_moments(): exact moments within 4 epsilon, polynomials within 1. */
#define INTEGRAL_EPSILONS 4.0
#define POLYNOMIAL_EPSILONS 1.0
#define LOOSEST 4.0

/* ---- the reference ------------------------------------------------------------------------- */

static void assert_close(double value, double expected, double tolerance, const char *what) {
  UNIT_FAIL_IF(!(fabs(value - expected) <= tolerance), "%s: %.17g, expected %.17g", what, value,
               expected);
}

/* 30-digit quadratures of C1, C2 and of A = (1 + 3 C2) / (1 - 2 C1), to ten digits. */
UNIT_TEST(moments_equal_published_quadratures) {
  static const struct {
    double eta, c1, c2, boundary;
  } rows[] = {
      {0.5, .0802983185, .0446550277, 1.3509179652},
      {1 / 1.33, .0329654246, .0131377674, 1.1127798207},
      {1, 0, 0, 1},
      {1.1, .0971724617, .0293065807, 1.3503542321},
      {1.33, .2359745744, .1094128412, 2.5153610122},
      {1.5, .2981728799, .1548101740, 3.6279329582},
      {2, .3950745796, .2349566853, 8.1241993124},
      {3, .4597890783, .2942283369, 23.410120094},
  };
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    const reference_fresnel moments = reference_fresnel_moments(CORE_MOMENTS_EXACT, rows[i].eta);
    const double one_minus_2c1 = (double)moments.one_minus_2c1;
    const double one_minus_3c2 = (double)moments.one_minus_3c2;
    assert_close((1 - one_minus_2c1) / 2, rows[i].c1, 6e-11, "C1");
    assert_close((1 - one_minus_3c2) / 3, rows[i].c2, 6e-11, "C2");
    assert_close((2 - one_minus_3c2) / one_minus_2c1, rows[i].boundary, 6e-10 * rows[i].boundary,
                 "A");
  }
}

/* How far the polynomials of Eq. 2 are from the integrals, as truth has it. */
UNIT_TEST(fits_differ_from_exact_as_published) {
  static const struct {
    double eta, two_c1, three_c2, unit; /* differences, and the unit of their last digit */
  } rows[] = {
      {0.5, -7e-6, 1e-5, 1e-5},    {1 / 1.33, -2e-5, 4e-5, 1e-5}, {1, .00433, -.00684, 1e-5},
      {1.1, -.0016, -.0046, 1e-4}, {1.33, .00098, -.0027, 1e-4},  {1.5, .00019, -.0018, 1e-4},
      {2, .00039, .0019, 1e-4},    {3, .234, .210, 1e-3},
  };
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    const reference_fresnel exact = reference_fresnel_moments(CORE_MOMENTS_EXACT, rows[i].eta);
    const reference_fresnel fit = reference_fresnel_moments(CORE_MOMENTS_FIT, rows[i].eta);
    assert_close((double)exact.one_minus_2c1 - (double)fit.one_minus_2c1, rows[i].two_c1,
                 rows[i].unit, "2 C1 fit - exact");
    assert_close((double)exact.one_minus_3c2 - (double)fit.one_minus_3c2, rows[i].three_c2,
                 rows[i].unit, "3 C2 fit - exact");
  }
}

/* ---- the core ------------------------------------------------------------------------------ */

struct worst {
  double first; /* of 1 - 2 C1, in epsilon */
  double second;
};

static double error_epsilons(double value, quad truth) {
  return (double)fabsf128((quad)value / truth - 1) / DBL_EPSILON;
}

static void measure(enum core_moments moments, double eta, struct worst *worst) {
  const core_fresnel values = core_fresnel_moments(moments, eta);
  const reference_fresnel truth = reference_fresnel_moments(moments, eta);
  const double first = error_epsilons(values.one_minus_2c1, truth.one_minus_2c1);
  const double second = error_epsilons(values.one_minus_3c2, truth.one_minus_3c2);
  assert_true(isfinite(first) && isfinite(second));
  worst->first = fmax(worst->first, first);
  worst->second = fmax(worst->second, second);
}

/* Random etas over the range of these moments, more of them where media are, and the places where
 * something changes: the ends, 1 and its surroundings. */
static struct worst measure_many(enum core_moments moments, double eta_min, double eta_max) {
  enum { RANDOM = 3000 };
  struct worst worst = {0, 0};
  uint64_t random = unit_seed();
  measure(moments, eta_min, &worst);
  measure(moments, eta_max, &worst);
  measure(moments, 1, &worst);
  for (double away = DBL_EPSILON; away < 0.3; away *= 8) {
    measure(moments, 1 + away, &worst);
    measure(moments, 1 - away, &worst);
  }
  for (int i = 0; i < RANDOM; i++) {
    const double eta = i % 2 ? unit_random_log(&random, eta_min, eta_max)
                             : unit_random_between(&random, fmax(eta_min, 0.5), fmin(eta_max, 2));
    measure(moments, eta, &worst);
  }
  return worst;
}

static void assert_bound(const char *name, const char *what, double worst, double bound) {
  printf("%-6s %s worst %5.2f, bound %4.1f epsilon\n", name, what, worst, bound);
  assert_true(worst <= bound);
  assert_true(worst * LOOSEST >= bound);
}

UNIT_TEST(moments_hold) {
  static const struct {
    const char *name;
    enum core_moments moments;
    double eta_min, eta_max, first, second;
  } kinds[] = {
      {"exact", CORE_MOMENTS_EXACT, CORE_ETA_MIN, CORE_ETA_MAX, INTEGRAL_EPSILONS,
       INTEGRAL_EPSILONS},
      {"fit", CORE_MOMENTS_FIT, 0.195, 2.485, POLYNOMIAL_EPSILONS, POLYNOMIAL_EPSILONS},
      {"jensen", CORE_MOMENTS_JENSEN, 0.46, 2.2, POLYNOMIAL_EPSILONS, INTEGRAL_EPSILONS},
      {"pbrt", CORE_MOMENTS_PBRT, 0.195, 2.485, POLYNOMIAL_EPSILONS, POLYNOMIAL_EPSILONS},
  };
  for (size_t i = 0; i < sizeof kinds / sizeof kinds[0]; i++) {
    const struct worst worst = measure_many(kinds[i].moments, kinds[i].eta_min, kinds[i].eta_max);
    assert_bound(kinds[i].name, "1 - 2 C1", worst.first, kinds[i].first);
    assert_bound(kinds[i].name, "1 - 3 C2", worst.second, kinds[i].second);
  }
}

/* Matched indices reflect nothing, to the last bit. */
UNIT_TEST(nothing_is_reflected_at_eta_1) {
  const core_fresnel moments = core_fresnel_moments(CORE_MOMENTS_EXACT, 1);
  assert_true(moments.one_minus_2c1 == 1);
  assert_true(moments.one_minus_3c2 == 1);
}

UNIT_TEST(eta_is_limited_for_each_kind) {
  static const struct {
    enum core_moments moments;
    double min, max;
  } rows[] = {
      {CORE_MOMENTS_EXACT, CORE_ETA_MIN, CORE_ETA_MAX},
      {CORE_MOMENTS_FIT, 0.195, 2.485},
      {CORE_MOMENTS_JENSEN, 0.46, 2.2},
      {CORE_MOMENTS_PBRT, 0.195, 2.485},
  };
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    unit_accept(core_fresnel_check(rows[i].moments, rows[i].min));
    unit_accept(core_fresnel_check(rows[i].moments, rows[i].max));
    unit_assert_fault(core_fresnel_check(rows[i].moments, nextafter(rows[i].min, 0)), "eta", 0);
    unit_assert_fault(core_fresnel_check(rows[i].moments, nextafter(rows[i].max, 1e9)), "eta", 0);
    unit_assert_fault(core_fresnel_check(rows[i].moments, (double)NAN), "eta", 0);
  }
}
