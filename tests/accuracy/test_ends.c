/* Models next to the source and far away from it, where what they become is known, and in media
 * next to which a solver has nothing to hold on to. */
#include <math.h>

#include "core/transport/decay.h"
#include "core/transport/transport.h"
#include "tests/unit/unit.h"

static core_profile prepared(unsigned model, core_medium medium, double tolerance) {
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
  core_profile profile;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), model, CORE_MOMENTS_EXACT,
                                         CORE_EVALUATOR_F64, &medium, &parameters),
                    NULL, 0);
  return profile;
}

static double value_of(const core_profile *profile, enum core_quantity quantity, double r) {
  double value;
  core_eval_f64(profile, quantity, 1, &r, &value);
  return value;
}

static void assert_near(double value, double truth, double relative, const char *what, double r) {
  if (!(fabs(value - truth) <= relative * fabs(truth))) {
    fail_msg("%s at %g is %.12g, not %.12g: off by %.3g", what, r, value, truth, value / truth - 1);
  }
}

/* ---- transport ---------------------------------------------------------------------------- */

/* The same R whatever the tolerance, where nothing or next to nothing is absorbed, or scattered; up
 * to where the solver has digits. */
UNIT_TEST(transport_is_the_same_for_every_tolerance) {
  static const core_medium media[] = {
      {0, 1, 0, 1.3}, {1e-20, 1, 0, 1.3}, {1e-8, 1, 0, 1.3}, {0, 1, 0, 0.8}, {1, 1e-8, 0, 1.3}};
  static const double tolerances[] = {1e-4, 1e-5, 1e-7};
  double worst = 0;
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    core_profile fine = prepared(CORE_MODEL_TRANSPORT, media[i], 1e-8);
    for (size_t t = 0; t < sizeof tolerances / sizeof tolerances[0]; t++) {
      core_profile coarse = prepared(CORE_MODEL_TRANSPORT, media[i], tolerances[t]);
      const double sigma_t = media[i].sigma_a_per_mm + media[i].sigma_s_per_mm;
      const double allowed = coarse.numerical_error + fine.numerical_error;
      /* only an albedo of next to nothing may be worse than was asked for */
      assert_true(media[i].sigma_s_per_mm < 1e-6 || allowed <= 1.001 * tolerances[t] + 1e-8);
      assert_true(allowed < 2e-3);
      const double most = fmin(30 / transport_kappa(media[i].sigma_s_per_mm / sigma_t), 1e4);
      for (double x = 1e-6; x < most; x *= 1.3) {
        const double truth = value_of(&fine, CORE_QUANTITY_R, x / sigma_t);
        const double value = value_of(&coarse, CORE_QUANTITY_R, x / sigma_t);
        if (truth > 1e-300) {
          assert_near(value, truth, allowed, "transport", x);
          worst = fmax(worst, fabs(value / truth - 1) / allowed);
        }
      }
      core_profile_free(&coarse);
    }
    core_profile_free(&fine);
  }
  printf("transport differs between tolerances by at most %.2g of them\n", worst);
}

UNIT_TEST(transport_without_absorption_falls_like_diffusion) {
  static const double tolerances[] = {1e-4, 1e-7};
  for (size_t t = 0; t < sizeof tolerances / sizeof tolerances[0]; t++) {
    core_profile profile =
        prepared(CORE_MODEL_TRANSPORT, (core_medium){0, 1, 0, 1.3}, tolerances[t]);
    const double first = 1e12 * value_of(&profile, CORE_QUANTITY_R, 1e4);
    for (double x = 1e4; x < 1e12; x *= 10) {
      assert_near(x * x * x * value_of(&profile, CORE_QUANTITY_R, x), first, 1e-6, "x^3 R", x);
    }
    core_profile_free(&profile);
  }
}

/* ---- beam --------------------------------------------------------------------------------- */

/* Simpson's rule for r pdf over ln r, from where nothing is left. */
static double integral_of_pdf(const core_profile *profile, double r) {
  enum { STEPS = 2000 };
  const double step = 20.0 / STEPS;
  double sum = 0;
  for (int i = 0; i <= STEPS; i++) {
    const double at = r * exp(-step * i);
    const double weight = i == 0 || i == STEPS ? 1 : i % 2 ? 4 : 2;
    sum += weight * at * value_of(profile, CORE_QUANTITY_PDF, at);
  }
  return sum * step / 3;
}

UNIT_TEST(the_cdf_of_beam_is_the_integral_of_its_pdf) {
  static const core_medium media[] = {{0.1, 0.9, 0, 1.3}, {0, 1, 0, 1.3}, {0.9, 0.1, 0, 0.7}};
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    core_profile profile = prepared(CORE_MODEL_BEAM, media[i], (double)NAN);
    for (double x = 1e-12; x < 3e-7; x *= 2.7) {
      assert_near(value_of(&profile, CORE_QUANTITY_CDF, x), integral_of_pdf(&profile, x), 1e-6,
                  "the cdf of beam", x);
    }
    core_profile_free(&profile);
  }
}

/* ---- extended ----------------------------------------------------------------------------- */

UNIT_TEST(extended_without_absorption_goes_on_falling) {
  core_profile profile = prepared(CORE_MODEL_EXTENDED, (core_medium){0, 1, 0, 1.3}, (double)NAN);
  const double first = 1e36 * value_of(&profile, CORE_QUANTITY_R, 1e12);
  assert_true(first > 0);
  for (double x = 1e12; x < 2e25; x *= 3) {
    assert_near(x * x * x * value_of(&profile, CORE_QUANTITY_R, x), first, 1e-9, "x^3 R", x);
  }
  core_profile_free(&profile);
}

/* ---- transport of nearly no scattering ----------------------------------------------------- */

enum { FEW_RADII = 6 };

/* For a medium's transport: R at some radii over that of single scattering, less 1. This is the
 * part that was scattered more often. */
struct few_scattered {
  double r[FEW_RADII], more_often[FEW_RADII], stated;
};

static struct few_scattered few_scattered(const core_medium *medium) {
  struct few_scattered few;
  core_profile transport = prepared(CORE_MODEL_TRANSPORT, *medium, (double)NAN);
  core_profile single = prepared(CORE_MODEL_SINGLE, *medium, (double)NAN);
  for (int i = 0; i < FEW_RADII; i++) {
    few.r[i] = 0.01 * pow(2500, i / (FEW_RADII - 1.0));
    few.more_often[i] = value_of(&transport, CORE_QUANTITY_R, few.r[i]) /
                            value_of(&single, CORE_QUANTITY_R, few.r[i]) -
                        1;
  }
  few.stated = transport.numerical_error;
  assert_near(transport.albedo, single.albedo, 1e-10, "albedo", 0);
  core_profile_free(&transport);
  core_profile_free(&single);
  return few;
}

/* Below an albedo of 1e-12 the solver solves another medium: what was scattered once is in
 * proportion to the albedo, and what was scattered twice to its square. */
UNIT_TEST(transport_of_nearly_no_scattering) {
  static const double etas[] = {0.8, 2}, albedos[] = {1e-13, 1e-31};
  for (size_t n = 0; n < 4; n++) {
    const double albedo = albedos[n % 2], eta = etas[n / 2], share = albedo / 1e-12;
    const struct few_scattered solved = few_scattered(&(core_medium){1, 1e-12, 0, eta});
    const struct few_scattered scaled = few_scattered(&(core_medium){1, albedo, 0, eta});
    for (int i = 0; i < FEW_RADII; i++) {
      const double expected = solved.more_often[i] * share;
      const double allowed =
          scaled.stated * (1 + expected) + solved.stated * share * (1 + solved.more_often[i]);
      if (!(fabs(scaled.more_often[i] - expected) <= allowed)) {
        fail_msg("albedo %g, eta %g, r %g: %g of it was scattered more often, not %g", albedo, eta,
                 solved.r[i], scaled.more_often[i], expected);
      }
    }
  }
}

/* ln R bends where light that was scattered twice becomes more than what was scattered once. */
UNIT_TEST(transport_of_little_scattering_is_right_where_it_bends) {
  static const double albedos[] = {1e-6, 1e-8};
  transport_boundary *boundary;
  unit_assert_fault(transport_boundary_create(&boundary, 1.5, 1e-6), NULL, 0);
  for (size_t a = 0; a < sizeof albedos / sizeof albedos[0]; a++) {
    const core_medium medium = {1 - albedos[a], albedos[a], 0, 1.5};
    core_profile profile = prepared(CORE_MODEL_TRANSPORT, medium, (double)NAN);
    transport_solution *solution;
    unit_assert_fault(transport_solve(&solution, boundary, albedos[a]), NULL, 0);
    for (double r = 3; r < 20; r *= 1.1) {
      assert_near(value_of(&profile, CORE_QUANTITY_R, r), transport_at(solution, r).R.value,
                  profile.numerical_error, "R of transport", r);
    }
    transport_solution_free(solution);
    core_profile_free(&profile);
  }
  transport_boundary_free(boundary);
}

/* A table of transport that is made from the shipped solutions, which are less exact there. */
UNIT_TEST(a_table_of_transport_far_away_with_eta_1) {
  const core_medium medium = {.9, .1, 0, 1};
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = 1e-5;
  core_profile exact = prepared(CORE_MODEL_TRANSPORT, medium, 1e-7), table;
  unit_assert_fault(core_profile_prepare(&table, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                                         CORE_MOMENTS_EXACT, CORE_EVALUATOR_LUT, &medium,
                                         &parameters),
                    NULL, 0);
  for (float r = 20; r < 29.8f; r *= 1.01f) {
    float R;
    core_eval_f32(&table, CORE_QUANTITY_R, 1, &r, &R);
    assert_near((double)R, value_of(&exact, CORE_QUANTITY_R, (double)r),
                table.numerical_error + exact.numerical_error, "R of a table", (double)r);
  }
  core_profile_free(&exact);
  core_profile_free(&table);
}
