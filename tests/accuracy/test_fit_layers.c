/* Fits of layers: stacks come back from readings of finer solutions with 1 % noise, within the
 * errors that are stated; what the readings do not see is said to be undetermined, and a fit of
 * readings that are better than the solver is no success. */
#include "core/fit/layers.h"

#include <math.h>

#include "core/solver/solver.h"
#include "tests/unit/unit.h"

enum { READINGS = 16 };

/* Fits readings of a stack of two layers with relative noise, by the random numbers of a seed. */
static core_layers_fit fit_of(const core_medium layer[2], unsigned unknowns, unsigned scale,
                              double from_mm, double to_mm, double error, uint64_t seed) {
  double at[READINGS], values[READINGS], errors[READINGS], residuals[READINGS];
  const core_isa *isa = core_isa_select(NULL);
  const solver_layer solved[] = {
      {layer[0].sigma_a_per_mm, layer[0].sigma_s_per_mm, layer[0].g, layer[0].eta,
       layer[0].thickness_mm},
      {layer[1].sigma_a_per_mm, layer[1].sigma_s_per_mm, layer[1].g, layer[1].eta, INFINITY}};
  solver_layers *solution;
  unit_accept(solver_layers_solve_level(&solution, isa, solved, 2, 1, 2, NULL));
  for (size_t i = 0; i < READINGS; i++) {
    double noise = -6; /* a sum of twelve numbers from 0 to 1 has the variance 1 */
    for (int k = 0; k < 12; k++) {
      noise += unit_random_between(&seed, 0, 1);
    }
    at[i] = from_mm * pow(to_mm / from_mm, (double)i / (READINGS - 1));
    values[i] = solver_layers_at(solution, 0, at[i]).value;
    errors[i] = error * values[i];
    values[i] += errors[i] * noise;
    if (scale == CORE_FIT_SCALE_FREE) {
      values[i] *= 3;
      errors[i] *= 3;
    }
  }
  solver_layers_free(solution);
  core_medium given[2] = {layer[0], layer[1]};
  if ((unknowns & CORE_UNKNOWN_SIGMA_A_2) != 0) {
    given[1].sigma_a_per_mm = (double)NAN; /* is not read */
  }
  const core_layers_fit_request request = {.scale = scale,
                                           .unknowns = unknowns,
                                           .layer = given,
                                           .layer_count = 2,
                                           .count = READINGS,
                                           .at = at,
                                           .values = values,
                                           .errors = errors};
  core_layers_fit fit;
  unit_accept(core_layers_fit_check(&request));
  unit_accept(core_layers_fit_run(&fit, isa, &request, residuals, NULL));
  double chi_squared = 0;
  for (size_t i = 0; i < READINGS; i++) {
    chi_squared += residuals[i] * residuals[i];
  }
  const size_t spare = READINGS - fit.unknown_count - (scale == CORE_FIT_SCALE_FREE);
  assert_true(fabs(chi_squared - fit.chi_squared) < 1e-9 * chi_squared);
  assert_true(fabs(chi_squared - fit.reduced_chi_squared * (double)spare) < 1e-9 * chi_squared);
  printf("status %d, chi-squared %.3g, %u evaluations, R within %.2g\n", (int)fit.status,
         fit.chi_squared, (unsigned)fit.evaluations, fit.numerical_error);
  return fit;
}

/* Expects an unknown to be `truth` within three standard errors, and these to be below `most`. */
static void expect(const core_estimate *one, enum core_unknown unknown, double truth, double most) {
  assert_int_equal(one->unknown, unknown);
  assert_int_equal(one->status, CORE_FIT_STATUS_FITTED);
  printf("  %.4g +- %.2g, not %.4g\n", one->value, one->error, truth);
  assert_true(fabs(one->value - truth) <= 3 * one->error);
  assert_true(one->error > 0 && one->error < most * truth);
}

UNIT_TEST(stacks_come_back_within_their_errors) {
  static const core_medium skin[] = {{1.5, 20, 0.8, 1.4, 0.06}, {0.03, 15, 0.8, 1.4, 0}};
  static const core_medium brain[] = {{0.018, 8.6, 0.9, 1.4, 5}, {0.04, 20, 0.9, 1.4, 0}};
  core_layers_fit fit =
      fit_of(skin, CORE_UNKNOWN_SIGMA_A_1 | CORE_UNKNOWN_THICKNESS_1 | CORE_UNKNOWN_SIGMA_A_2,
             CORE_FIT_SCALE_ABSOLUTE, 0.05, 8, 0.01, 1000);
  assert_int_equal(fit.status, CORE_FIT_STATUS_FITTED);
  assert_true(fit.factor == 1 && fit.factor_error == 0 && fit.unknown_count == 3);
  expect(&fit.unknown[0], CORE_UNKNOWN_SIGMA_A_1, 1.5, 0.1);
  expect(&fit.unknown[1], CORE_UNKNOWN_THICKNESS_1, 0.06, 0.1);
  expect(&fit.unknown[2], CORE_UNKNOWN_SIGMA_A_2, 0.03, 0.05);
  if (!unit_is_long()) {
    return;
  }
  fit = fit_of(brain, CORE_UNKNOWN_SIGMA_A_1 | CORE_UNKNOWN_SIGMA_S_1 | CORE_UNKNOWN_SIGMA_A_2,
               CORE_FIT_SCALE_FREE, 2, 40, 0.01, 2000);
  assert_int_equal(fit.status, CORE_FIT_STATUS_FITTED);
  assert_true(fit.numerical_error < 0.01);
  expect(&fit.unknown[0], CORE_UNKNOWN_SIGMA_A_1, 0.018, 0.4);
  expect(&fit.unknown[1], CORE_UNKNOWN_SIGMA_S_1, 8.6, 0.1);
  expect(&fit.unknown[2], CORE_UNKNOWN_SIGMA_A_2, 0.04, 0.6);
  assert_true(fabs(fit.factor - 3) <= 3 * fit.factor_error);
}

/* Noise often makes the absorption of the first layer too small to be seen. Its derivative vanishes there,
 * but the others' errors are not those of a known absorption. */
UNIT_TEST(what_is_not_determined_does_not_make_other_errors_small) {
  static const core_medium clear[] = {{0.0047, 5.18, 0.8, 1.3, 0.787}, {0.0876, 9.67, 0.8, 1.3, 0}};
  static const double truth[] = {0.0047, 5.18, 0.787};
  for (uint64_t seed = 1; seed <= 2; seed++) {
    const core_layers_fit fit =
        fit_of(clear, CORE_UNKNOWN_SIGMA_A_1 | CORE_UNKNOWN_SIGMA_S_1 | CORE_UNKNOWN_THICKNESS_1,
               CORE_FIT_SCALE_ABSOLUTE, 0.24, 6.6, 0.01, 100 * seed);
    for (int i = 0; i < 3; i++) {
      const core_estimate *one = &fit.unknown[i];
      printf("  %d: %.4g +- %.2g, not %.4g\n", one->status, one->value, one->error, truth[i]);
      assert_true(one->status != CORE_FIT_STATUS_FITTED ||
                  fabs(one->value - truth[i]) < 4.5 * one->error);
    }
  }
}

UNIT_TEST(a_layer_that_no_light_reaches_is_undetermined) {
  static const core_medium thick[] = {{0.1, 10, 0.8, 1.4, 60}, {0.04, 20, 0.8, 1.4, 0}};
  const core_layers_fit fit =
      fit_of(thick, CORE_UNKNOWN_SIGMA_A_1 | CORE_UNKNOWN_SIGMA_A_2 | CORE_UNKNOWN_SIGMA_S_2,
             CORE_FIT_SCALE_ABSOLUTE, 0.5, 6, 0.01, 3000);
  assert_int_equal(fit.status, CORE_FIT_STATUS_UNDETERMINED);
  expect(&fit.unknown[0], CORE_UNKNOWN_SIGMA_A_1, 0.1, 0.1);
  for (int i = 1; i < 3; i++) {
    assert_int_equal(fit.unknown[i].status, CORE_FIT_STATUS_UNDETERMINED);
    assert_true(isnan(fit.unknown[i].value) && isinf(fit.unknown[i].error));
  }
}

UNIT_TEST(readings_that_are_better_than_the_solver_are_not_fitted) {
  static const core_medium dark[] = {{1, 10, 0.8, 1.4, 0.5}, {0.5, 10, 0.8, 1.4, 0}};
  const core_layers_fit fit =
      fit_of(dark, CORE_UNKNOWN_SIGMA_A_2, CORE_FIT_SCALE_FREE, 0.5, 4, 1e-5, 4000);
  assert_int_equal(fit.status, CORE_FIT_STATUS_UNFINISHED);
  assert_true(fit.numerical_error > 1e-5);
}
