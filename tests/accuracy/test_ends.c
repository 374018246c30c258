/* Models next to the source and far away from it, where what they become is known, and in media
 * next to which a solver has nothing to hold on to. */
#include <math.h>

#include "core/transport/decay.h"
#include "tests/accuracy/isotropic/isotropic.h"
#include "tests/unit/unit.h"

static core_profile prepared(unsigned model, core_medium medium, double tolerance) {
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
  return unit_profile(model, CORE_EVALUATOR_F64, &medium, &parameters);
}

static void assert_near(double value, double truth, double relative, const char *what, double r) {
  UNIT_FAIL_IF(!(fabs(value - truth) <= relative * fabs(truth)),
               "%s at %g is %.12g, not %.12g: off by %.3g", what, r, value, truth,
               value / truth - 1);
}

/* ---- transport ---------------------------------------------------------------------------- */

/* R of the independent solver, where nothing or next to nothing is absorbed, which the table of
 * solutions extrapolates to. */
UNIT_TEST(transport_without_absorption_is_the_solution) {
  static const core_medium media[] = {
      {0, 1, 0, 1.3}, {1e-20, 1, 0, 1.3}, {1e-8, 1, 0, 1.3}, {0, 1, 0, 0.8}, {0, 1, 0, 2.2}};
  double worst = 0;
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    const double sigma_t = media[i].sigma_a_per_mm + media[i].sigma_s_per_mm;
    const double albedo = fmin(media[i].sigma_s_per_mm / sigma_t, 1 - 0x1p-53);
    core_profile profile = prepared(CORE_MODEL_TRANSPORT, media[i], (double)NAN);
    isotropic_solution *solution = isotropic_solve(media[i].eta, albedo, 1e-8, ISOTROPIC_REACH);
    assert_true(profile.numerical_error < 1e-5);
    const double most = fmin(30 / transport_kappa(albedo), 1e4);
    for (double x = 1e-6; x < most; x *= 1.3) {
      const double truth = sigma_t * sigma_t * isotropic_at(solution, x).R;
      const double value = unit_value_at(&profile, CORE_QUANTITY_R, x / sigma_t);
      assert_near(value, truth, profile.numerical_error, "transport", x);
      worst = fmax(worst, fabs(value / truth - 1) / profile.numerical_error);
    }
    isotropic_free(solution);
    core_profile_free(&profile);
  }
  printf("white media are off by at most %.2g of what is stated\n", worst);
}

UNIT_TEST(transport_without_absorption_falls_like_diffusion) {
  static const double tolerances[] = {1e-4, 1e-7};
  for (size_t t = 0; t < sizeof tolerances / sizeof tolerances[0]; t++) {
    core_profile profile =
        prepared(CORE_MODEL_TRANSPORT, (core_medium){0, 1, 0, 1.3}, tolerances[t]);
    const double first = 1e12 * unit_value_at(&profile, CORE_QUANTITY_R, 1e4);
    for (double x = 1e4; x < 1e12; x *= 10) {
      assert_near(x * x * x * unit_value_at(&profile, CORE_QUANTITY_R, x), first, 1e-6, "x^3 R", x);
    }
    core_profile_free(&profile);
  }
}

/* Where numbers on the way to a value underflow, also beside a radius of 0, no error is promised. */
UNIT_TEST(next_to_the_source_the_error_is_not_known) {
  static const double lists[][2] = {{0, 1e-310}, {1, 1e-270}, {0, 1e-200}, {0, 1e-20}};
  core_profile profile = prepared(CORE_MODEL_BEAM, (core_medium){0.1, 1, 0, 1.4}, (double)NAN);
  for (int i = 0; i < 4; i++) {
    core_radii_range radii;
    unit_accept(core_radii_check_f64(2, lists[i], &radii));
    assert_int_equal(isinf(core_profile_errors(&profile, CORE_QUANTITY_R, radii).numerical), i < 2);
    assert_int_equal(isinf(core_profile_errors(&profile, CORE_QUANTITY_SLOPE, radii).numerical),
                     i < 3);
  }
  core_profile_free(&profile);
}

/* ---- extended ----------------------------------------------------------------------------- */

UNIT_TEST(extended_without_absorption_goes_on_falling) {
  core_profile profile = prepared(CORE_MODEL_EXTENDED, (core_medium){0, 1, 0, 1.3}, (double)NAN);
  const double first = 1e36 * unit_value_at(&profile, CORE_QUANTITY_R, 1e12);
  assert_true(first > 0);
  for (double x = 1e12; x < 2e25; x *= 3) {
    assert_near(x * x * x * unit_value_at(&profile, CORE_QUANTITY_R, x), first, 1e-9, "x^3 R", x);
  }
  core_profile_free(&profile);
}

/* A medium that the solver does not solve is refused; one that scatters nothing is as it is. */
UNIT_TEST(transport_refuses_what_it_does_not_solve) {
  static const struct {
    core_medium medium;
    const char *field;
  } cases[] = {{{1, 0.99e-3, 0, 1.4}, "sigma_a"}, {{1, 1e-30, 0.5, 1.4}, "sigma_a"},
               {{0.1, 1, -0.981, 1.4}, "g"},      {{0.1, 1, 0.991, 1.4}, "g"},
               {{0.1, 1, 0, 4.01}, "eta"},        {{0.1, 1, 0, 0.249}, "eta"},
               {{1, 1e-3, 0, 4}, NULL},           {{1, 0, 0.999, 1.4}, NULL},
               {{0, 1, 0.99, 0.25}, NULL}};
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    unit_assert_fault(core_profile_check(CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT,
                                         CORE_EVALUATOR_F64, &cases[i].medium, NULL, NULL),
                      cases[i].field, 0);
  }
}

/* A table of transport that is made from the shipped solutions, which are less exact there. */
UNIT_TEST(a_table_of_transport_far_away_with_eta_1) {
  const core_medium medium = {.9, .1, 0, 1};
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = 1e-5;
  core_profile table;
  isotropic_solution *solution = isotropic_solve(medium.eta, 0.1, 1e-8, ISOTROPIC_REACH);
  table = unit_profile(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_LUT, &medium, &parameters);
  for (float r = 20; r < 29.8f; r *= 1.01f) {
    float R;
    core_eval_f32(&table, CORE_QUANTITY_R, 1, &r, &R);
    assert_near((double)R, isotropic_at(solution, (double)r).R, table.numerical_error,
                "R of a table", (double)r);
  }
  isotropic_free(solution);
  core_profile_free(&table);
}
