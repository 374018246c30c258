/* Compares models with each other. truth.c compares them with their formulas and with numbers that
 * other programs published. */
#include <math.h>

#include "tests/unit/unit.h"

static const double pi = 3.14159265358979323846;

/* ---- evaluating ------------------------------------------------------------------------------ */

static core_parameters with(enum core_parameter parameter, double value) {
  core_parameters parameters = core_parameters_none();
  parameters.value[parameter] = value;
  return parameters;
}

static core_profile prepared(unsigned model, unsigned moments, core_medium medium,
                             const core_parameters *parameters) {
  core_profile profile;
  unit_accept(core_profile_prepare(&profile, core_isa_select(NULL), model, moments,
                                   CORE_EVALUATOR_F64, &medium, parameters));
  return profile;
}

static double albedo_of(unsigned model, core_medium medium, const core_parameters *parameters) {
  core_profile profile = prepared(model, CORE_MOMENTS_EXACT, medium, parameters);
  const double albedo = profile.albedo;
  core_profile_free(&profile);
  return albedo;
}

static void assert_near(double value, double truth, double relative, const char *what) {
  UNIT_FAIL_IF(!(fabs(value - truth) <= relative * fabs(truth)),
               "%s is %.12g, not %.12g: off by %.3g", what, value, truth, value / truth - 1);
}

/* sigma_t' = 1 per mm. */
static core_medium medium_of_ratio(double ratio, double eta) {
  return (core_medium){ratio / (1 + ratio), 1 / (1 + ratio), 0, eta};
}

/* ---- sums, fits, the BSSRDF, energy ----------------------------------------------------------- */

/* Only a part that uses the similarity relation has its note, and the sum has it, too. */
UNIT_TEST(a_sum_has_the_notes_of_its_parts) {
  const core_medium medium = {0.032, 0.74, 0.3, 1.3};
  core_profile sum = prepared(CORE_MODEL_BETTER_SINGLE, CORE_MOMENTS_EXACT, medium, NULL);
  core_profile single = prepared(CORE_MODEL_SINGLE, CORE_MOMENTS_EXACT, medium, NULL);
  assert_int_equal(sum.notes, CORE_NOTE_SIMILARITY);
  assert_int_equal(single.notes, 0);
  core_profile_free(&sum);
  core_profile_free(&single);
}

/* The deviation that a fit states holds between the radii that it was measured at. */
UNIT_TEST(a_fit_keeps_its_stated_error) {
  static const unsigned models[] = {CORE_MODEL_BETTER, CORE_MODEL_EXTENDED, CORE_MODEL_BURLEY,
                                    CORE_MODEL_BETTER_SINGLE};
  const core_medium medium = {0.032, 0.74, 0, 1.3};
  uint64_t random = unit_seed();
  for (size_t m = 0; m < sizeof models / sizeof models[0]; m++) {
    for (int count = 1; count <= 12; count += 3) {
      core_parameters parameters = with(CORE_PARAMETER_FIT_MODEL, models[m]);
      parameters.value[CORE_PARAMETER_GAUSSIANS] = count;
      parameters.value[CORE_PARAMETER_FIT_FROM] = 0.05;
      parameters.value[CORE_PARAMETER_FIT_TO] = 8;
      core_profile fit = prepared(CORE_MODEL_GAUSSIANS, CORE_MOMENTS_EXACT, medium, &parameters);
      core_profile model = prepared(models[m], CORE_MOMENTS_EXACT, medium, NULL);
      assert_true(fit.radii.least_mm == 0.05 && fit.radii.most_mm == 8);
      assert_true(count < 10 || fit.numerical_error < 0.02);
      for (int i = 0; i < 2000; i++) {
        const double r = unit_random_log(&random, 0.05, 8);
        assert_near(unit_value_at(&fit, CORE_QUANTITY_R, r),
                    unit_value_at(&model, CORE_QUANTITY_R, r), fit.numerical_error, "a fit");
      }
      core_profile_free(&fit);
      core_profile_free(&model);
    }
  }
}

UNIT_TEST(a_fit_meets_a_tolerance_or_says_so) {
  const core_medium medium = {0.032, 0.74, 0, 1.3};
  core_parameters parameters = with(CORE_PARAMETER_TOLERANCE, 0.01);
  core_profile fit = prepared(CORE_MODEL_GAUSSIANS, CORE_MOMENTS_EXACT, medium, &parameters);
  assert_true(fit.numerical_error <= 0.01 + 1e-13);
  core_profile_free(&fit);
  parameters.value[CORE_PARAMETER_TOLERANCE] = 1e-10;
  unit_assert_fault(core_profile_prepare(&fit, core_isa_select(NULL), CORE_MODEL_GAUSSIANS,
                                         CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &medium,
                                         &parameters),
                    "tolerance", 0);
}

/* What leaves in all directions is what R says: int S cos dw = F_t(cos_in) R, for eta on both sides
 * of 1. */
UNIT_TEST(the_bssrdf_gives_out_what_R_says) {
  enum { STEPS = 2000 };
  for (double eta = 0.7; eta < 2; eta += 0.3) {
    const core_medium medium = {0.1, 1, 0, eta};
    core_parameters parameters = with(CORE_PARAMETER_COS_IN, 0.9);
    double sum = 0, R = 0;
    for (int i = 0; i < STEPS; i++) {
      /* cos = s^2: the transmittance has a square root at grazing incidence */
      const double s = (i + 0.5) / STEPS;
      parameters.value[CORE_PARAMETER_COS_OUT] = s * s;
      core_profile profile = prepared(CORE_MODEL_BETTER, CORE_MOMENTS_EXACT, medium, &parameters);
      R = unit_value_at(&profile, CORE_QUANTITY_R, 0.5);
      sum += unit_value_at(&profile, CORE_QUANTITY_S, 0.5) * 2 * pi * s * s * 2 * s / STEPS;
    }
    assert_near(sum, core_fresnel_transmittance(eta, 0.9) * R, 3e-4, "the light that leaves");
  }
  assert_near(core_fresnel_transmittance(1.5, 1), 0.96, 1e-15, "normal transmittance");
  assert_true(core_fresnel_transmittance(0.5, 0.8) == 0); /* beyond the critical angle */
  assert_near(core_fresnel_transmittance(1, 1e-9), 1, 1e-15, "no boundary");
}

/* Energy is conserved to the last bit: the better dipole returns all that enters when nothing is
 * absorbed. */
UNIT_TEST(better_dipole_returns_everything_without_absorption) {
  uint64_t random = unit_seed();
  for (int i = 0; i < 1000; i++) {
    const core_medium medium = {0, unit_random_log(&random, 1e-6, 1e6),
                                unit_random_between(&random, -.9, .9),
                                unit_random_log(&random, CORE_ETA_MIN, CORE_ETA_MAX)};
    assert_true(albedo_of(CORE_MODEL_BETTER, medium, NULL) == 1);
  }
}

/* No model gives out more than went in without saying so. */
UNIT_TEST(an_albedo_above_1_is_confessed) {
  const core_parameters none = core_parameters_none();
  size_t above = 0;
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    bool told = false; /* whether each evaluator of this model has told it once */
    for (double ratio = 0; ratio<20; ratio = ratio> 0 ? ratio * 30 : 1e-6) {
      for (double eta = 0.5; eta < 2.5; eta += 0.25) {
        const core_medium some = medium_of_ratio(ratio, eta);
        const core_medium medium = unit_medium(model->id, &some);
        if (!unit_is_long() && core_has_to_solve(model->id, &medium, &none)) {
          continue;
        }
        core_profile profile;
        const core_fault fault =
            core_profile_prepare(&profile, core_isa_select(NULL), model->id, CORE_MOMENTS_EXACT,
                                 CORE_EVALUATOR_F64, &medium, NULL);
        if (fault.field != NULL) {
          assert_string_equal(fault.field, "sigma_a"); /* Burley's diffuse mean free path */
          continue;
        }
        const bool confessed = (profile.notes & CORE_NOTE_ALBEDO_ABOVE_1) != 0;
        const bool first = confessed && !told;
        told = told || confessed;
        for (const core_choice *one = core_evaluators; one->name != NULL && first; one++) {
          core_profile same;
          if (core_profile_prepare(&same, core_isa_select(NULL), model->id, CORE_MOMENTS_EXACT,
                                   one->id, &medium, NULL)
                  .field == NULL) {
            assert_int_equal(same.notes, profile.notes);
            core_profile_free(&same);
          }
        }
        assert_int_equal(confessed, profile.albedo > 1 + profile.numerical_error);
        above += confessed;
        core_profile_free(&profile);
      }
    }
  }
  printf("%zu profiles give out more than went in, and say so\n", above);
  assert_true(above > 0);
}
