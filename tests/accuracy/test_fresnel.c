/* The Fresnel moments of the core, against the reference, within what core.h states. */
#include <float.h>
#include <math.h>

#include "tests/accuracy/reference_fresnel.h"
#include "tests/unit/unit.h"

/* core_fresnel_moments(): exact moments within 4 epsilon, polynomials within 1. */
#define INTEGRAL_EPSILONS 4.0
#define POLYNOMIAL_EPSILONS 1.0
#define LOOSEST 4.0

struct worst {
  double first; /* of 1 - 2 C1, in epsilon */
  double second;
};

static double error_epsilons(double value, const mpfr_t truth) {
  mpfr_t difference;
  mpfr_init2(difference, 64);
  mpfr_d_sub(difference, value, truth, MPFR_RNDN);
  mpfr_div(difference, difference, truth, MPFR_RNDN);
  const double error = fabs(mpfr_get_d(difference, MPFR_RNDN)) / DBL_EPSILON;
  mpfr_clear(difference);
  return error;
}

static void measure(enum core_moments moments, double eta, struct worst *worst) {
  const core_fresnel values = core_fresnel_moments(moments, eta);
  const reference_fresnel *truth = reference_fresnel_moments(moments, eta);
  const double first = error_epsilons(values.one_minus_2c1, truth->one_minus_2c1);
  const double second = error_epsilons(values.one_minus_3c2, truth->one_minus_3c2);
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

static void assert_bound(const char *what, double worst, double bound) {
  printf("%-22s worst %5.2f, bound %4.1f epsilon\n", what, worst, bound);
  assert_true(worst <= bound);
  assert_true(worst * LOOSEST >= bound);
}

UNIT_TEST(exact_moments_hold) {
  const struct worst worst = measure_many(CORE_MOMENTS_EXACT, CORE_ETA_MIN, CORE_ETA_MAX);
  assert_bound("exact 1 - 2 C1", worst.first, INTEGRAL_EPSILONS);
  assert_bound("exact 1 - 3 C2", worst.second, INTEGRAL_EPSILONS);
}

UNIT_TEST(fitted_moments_hold) {
  const struct worst worst = measure_many(CORE_MOMENTS_FIT, 0.195, 2.485);
  assert_bound("fit 1 - 2 C1", worst.first, POLYNOMIAL_EPSILONS);
  assert_bound("fit 1 - 3 C2", worst.second, POLYNOMIAL_EPSILONS);
}

UNIT_TEST(jensens_moments_hold) {
  const struct worst worst = measure_many(CORE_MOMENTS_JENSEN, 0.46, 2.2);
  assert_bound("jensen 1 - 2 C1", worst.first, POLYNOMIAL_EPSILONS);
  assert_bound("jensen 1 - 3 C2", worst.second, INTEGRAL_EPSILONS);
}

UNIT_TEST(renderers_moments_hold) {
  const struct worst worst = measure_many(CORE_MOMENTS_PBRT, 0.195, 2.485);
  assert_bound("pbrt 1 - 2 C1", worst.first, POLYNOMIAL_EPSILONS);
  assert_bound("pbrt 1 - 3 C2", worst.second, POLYNOMIAL_EPSILONS);
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
    unit_assert_fault(core_fresnel_check(rows[i].moments, rows[i].min), NULL, 0);
    unit_assert_fault(core_fresnel_check(rows[i].moments, rows[i].max), NULL, 0);
    unit_assert_fault(core_fresnel_check(rows[i].moments, nextafter(rows[i].min, 0)), "eta", 0);
    unit_assert_fault(core_fresnel_check(rows[i].moments, nextafter(rows[i].max, 1e9)), "eta", 0);
    unit_assert_fault(core_fresnel_check(rows[i].moments, (double)NAN), "eta", 0);
  }
}

UNIT_TEARDOWN(forget) {
  reference_fresnel_forget();
}
