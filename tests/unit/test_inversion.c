/* From an albedo and a mean free path to a medium and back. */
#include <float.h>
#include <math.h>

#include "tests/unit/unit.h"

static double albedo_of(unsigned model, unsigned moments, const core_medium *medium) {
  core_profile profile;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select("portable"), model, moments,
                                         CORE_EVALUATOR_F64, medium),
                    NULL, 0);
  return profile.albedo;
}

static void assert_round_trip(unsigned model, unsigned moments, double albedo,
                              double mean_free_path_mm, double eta) {
  const core_inversion inversion =
      core_invert_albedo(model, moments, albedo, mean_free_path_mm, eta);
  unit_assert_fault(inversion.fault, NULL, 0);
  const core_medium *medium = &inversion.medium;
  assert_true(fabs(albedo_of(model, moments, medium) / albedo - 1) <= 1e-12);
  const double sigma_t_prime = medium->sigma_a_per_mm + medium->sigma_s_per_mm;
  assert_true(fabs(sigma_t_prime * mean_free_path_mm - 1) <= 4 * DBL_EPSILON);
  assert_true(medium->g == 0 && medium->eta == eta);
}

/* Albedos near 0, in the middle and near 1, of every model with every kind of moments. */
static void comes_back(void **state) {
  (void)state;
  static const double etas[] = {0.2, 0.5, 0.75, 1, 1.3, 2, 2.4, 5};
  static const double paths_mm[] = {1e-6, 0.37, 1e6};
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    for (const core_choice *moments = core_moments_list; moments->name != NULL; moments++) {
      for (size_t e = 0; e < sizeof etas / sizeof etas[0]; e++) {
        if (core_fresnel_check(moments->id, etas[e]).field != NULL) {
          continue;
        }
        for (int i = 0; i <= 26; i++) {
          const double small = pow(10, -8 + i / 3.25);
          const double large = 1 - pow(10, -i / 2.0 - 0.01);
          const double path_mm = paths_mm[i % 3];
          assert_round_trip(model->id, moments->id, small, path_mm, etas[e]);
          assert_round_trip(model->id, moments->id, large, path_mm, etas[e]);
        }
      }
    }
  }
}

static void everything_comes_back_without_absorption(void **state) {
  (void)state;
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    const core_inversion inversion = core_invert_albedo(model->id, CORE_MOMENTS_EXACT, 1, 0.5, 1.3);
    unit_assert_fault(inversion.fault, NULL, 0);
    assert_true(inversion.medium.sigma_a_per_mm == 0 && inversion.medium.sigma_s_per_mm == 2);
  }
}

static void what_cannot_be_reached_is_a_fault(void **state) {
  (void)state;
  static const double albedos[] = {1 + DBL_EPSILON, 1.2, -0.1, 0, INFINITY, NAN};
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    for (size_t i = 0; i < sizeof albedos / sizeof albedos[0]; i++) {
      const core_inversion inversion =
          core_invert_albedo(model->id, CORE_MOMENTS_EXACT, albedos[i], 1, 1.3);
      unit_assert_fault(inversion.fault, "albedo", 0);
      assert_true(inversion.albedo_most == 1);
      assert_true(inversion.albedo_least > 0 && inversion.albedo_least < 1e-20);
      unit_assert_fault(
          core_invert_albedo(model->id, CORE_MOMENTS_EXACT, inversion.albedo_least, 1, 1.3).fault,
          NULL, 0);
    }
  }
}

static void other_faults_name_their_field(void **state) {
  (void)state;
  const unsigned better = CORE_MODEL_BETTER;
  const unsigned exact = CORE_MOMENTS_EXACT;
  unit_assert_fault(core_invert_albedo(better, exact, 0.5, 0, 1.3).fault, "mean_free_path", 0);
  unit_assert_fault(core_invert_albedo(better, exact, 0.5, -1, 1.3).fault, "mean_free_path", 0);
  unit_assert_fault(core_invert_albedo(better, exact, 0.5, NAN, 1.3).fault, "mean_free_path", 0);
  unit_assert_fault(core_invert_albedo(better, exact, 0.5, INFINITY, 1.3).fault, "mean_free_path",
                    0);
  unit_assert_fault(core_invert_albedo(better, exact, 0.5, 1, 0).fault, "eta", 0);
  unit_assert_fault(core_invert_albedo(better, CORE_MOMENTS_FIT, 0.5, 1, 3).fault, "eta", 0);
  unit_assert_fault(core_invert_albedo(65000, exact, 0.5, 1, 1.3).fault, "model", 0);
  unit_assert_fault(core_invert_albedo(better, 65000, 0.5, 1, 1.3).fault, "moments", 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(comes_back),
      cmocka_unit_test(everything_comes_back_without_absorption),
      cmocka_unit_test(what_cannot_be_reached_is_a_fault),
      cmocka_unit_test(other_faults_name_their_field),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
