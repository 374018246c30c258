/* The reference of the Fresnel moments against numbers that this project did not make. */
#include <math.h>

#include "tests/accuracy/reference_fresnel.h"
#include "tests/unit/unit.h"

static void assert_close(double value, double expected, double tolerance, const char *what) {
  if (!(fabs(value - expected) <= tolerance)) {
    fail_msg("%s: %.17g, expected %.17g", what, value, expected);
  }
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
    const reference_fresnel *moments = reference_fresnel_moments(CORE_MOMENTS_EXACT, rows[i].eta);
    const double one_minus_2c1 = mpfr_get_d(moments->one_minus_2c1, MPFR_RNDN);
    const double one_minus_3c2 = mpfr_get_d(moments->one_minus_3c2, MPFR_RNDN);
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
    const reference_fresnel *exact = reference_fresnel_moments(CORE_MOMENTS_EXACT, rows[i].eta);
    const reference_fresnel *fit = reference_fresnel_moments(CORE_MOMENTS_FIT, rows[i].eta);
    assert_close(mpfr_get_d(exact->one_minus_2c1, MPFR_RNDN) -
                     mpfr_get_d(fit->one_minus_2c1, MPFR_RNDN),
                 rows[i].two_c1, rows[i].unit, "2 C1 fit - exact");
    assert_close(mpfr_get_d(exact->one_minus_3c2, MPFR_RNDN) -
                     mpfr_get_d(fit->one_minus_3c2, MPFR_RNDN),
                 rows[i].three_c2, rows[i].unit, "3 C2 fit - exact");
  }
}

UNIT_TEARDOWN(forget) {
  reference_fresnel_forget();
}
