/* Media outside of the table of solutions, which transport solves: with isotropic scattering beside
 * the independent solver, with other g beside finer grids. */
#include <math.h>
#include <stdio.h>

#include "core/kernels.h"
#include "core/solver/solver.h"
#include "tests/accuracy/isotropic/isotropic.h"
#include "tests/unit/unit.h"

/* The wanted quantity at r of a profile, and the error that is stated there. */
static double value_of(const core_profile *profile, enum core_quantity quantity, double r,
                       double *stated) {
  double value;
  core_eval_f64(profile, quantity, 1, &r, &value);
  const core_stated_errors errors =
      core_profile_errors(profile, quantity, (core_radii_range){r, r});
  *stated = errors.numerical + errors.numerical_per_mm * r;
  return value;
}

static core_profile prepared(double ratio, double g, double eta, bool derivatives) {
  const double albedo = 1 / (1 + ratio);
  const core_medium medium = {ratio * albedo, albedo / (1 - g), g, eta};
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = 1e-2;
  parameters.value[CORE_PARAMETER_DERIVATIVES] = derivatives ? 1 : (double)NAN;
  assert_false(core_transport_is_stored(&medium));
  core_profile profile =
      unit_profile(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, &medium, &parameters);
  assert_true((profile.notes & CORE_NOTE_SIMILARITY) == 0);
  return profile;
}

static void expect(const core_profile *profile, enum core_quantity quantity, double r, double truth,
                   bool relative, double *worst) {
  double stated;
  const double value = value_of(profile, quantity, r, &stated);
  const double off = fabs(value - truth) / (relative ? fabs(truth) : 1);
  UNIT_FAIL_IF(!(off <= stated), "%s at %g is %.9g, not %.9g: off by %.2g, stated %.2g",
               core_choice_by_id(core_quantities, quantity)->name, r, value, truth, off, stated);
  *worst = fmax(*worst, off / stated);
}

static isotropic_solution *solved(double eta, double ratio) {
  return isotropic_solve(eta, fmin(1 / (1 + ratio), 1 - 0x1p-53), 1e-7, ISOTROPIC_REACH);
}

static double ln_R(const isotropic_solution *solution, double x) {
  return log(isotropic_at(solution, x).R);
}

UNIT_TEST(isotropic_media_are_as_the_independent_solver_has_them) {
  static const double media[][2] = {{300, 1.4}, {0, 0.5}, {0.1, 3}}; /* ratio, eta */
  for (size_t i = 0; i < (unit_is_long() ? 3 : 2); i++) {
    const double ratio = media[i][0], eta = media[i][1], albedo = 1 / (1 + ratio), h = 1e-3;
    core_profile profile = prepared(ratio, 0, eta, true);
    isotropic_solution *truth = solved(eta, ratio);
    isotropic_solution *above = solved(eta, ratio * exp(h));
    isotropic_solution *below = solved(eta, ratio * exp(-h));
    double worst = 0;
    for (double x = 1e-6; x < 3 * profile.reach.most_mm; x *= 2.5) {
      const double R = isotropic_at(truth, x).R;
      if (!(R > 1e-15)) {
        break;
      }
      const double by_x = (ln_R(truth, x * exp(h)) - ln_R(truth, x * exp(-h))) / (2 * h);
      const double by_ratio = (ln_R(above, x) - ln_R(below, x)) / (2 * h);
      expect(&profile, CORE_QUANTITY_R, x, R, true, &worst);
      expect(&profile, CORE_QUANTITY_SLOPE, x, by_x * R / x, true, &worst);
      expect(&profile, CORE_QUANTITY_BY_SIGMA_A, x, (1 - albedo) * (2 + by_x) + by_ratio, false,
             &worst);
      expect(&profile, CORE_QUANTITY_BY_SIGMA_S, x, albedo * (2 + by_x) - by_ratio, false, &worst);
      expect(&profile, CORE_QUANTITY_CDF, x, isotropic_at(truth, x).within / isotropic_total(truth),
             true, &worst);
    }
    assert_true(fabs(profile.albedo / (ratio > 0 ? isotropic_total(truth) : 1) - 1) <=
                profile.numerical_errors[CORE_ERROR_BANDS]);
    printf("ratio %g, eta %g: %.2g of what is stated\n", ratio, eta, worst);
    isotropic_free(truth);
    isotropic_free(above);
    isotropic_free(below);
    core_profile_free(&profile);
  }
}

UNIT_TEST(anisotropic_media_are_as_finer_grids_have_them) {
  static const double media[][3] = {{1, -0.6, 0.5}, {200, 0.9, 2}, {0.05, 0.97, 1.4}, {0, 0.99, 3}};
  const size_t count = unit_is_long() ? 4 : 1;
  for (size_t i = 0; i < count; i++) {
    const double ratio = media[i][0], g = media[i][1], eta = media[i][2];
    core_profile profile = prepared(ratio, g, eta, false);
    solver_solution *truth;
    const solver_phase phase = {.g = g};
    unit_accept(solver_solve(&truth, core_isa_select(NULL), ratio, &phase, &eta, 1,
                             unit_is_long() ? 1e-4 : 3e-3));
    double worst = 0;
    for (double x = 1e-5; x < profile.reach.most_mm; x *= 1.7) {
      const transport_number R = solver_at(truth, 0, x);
      double stated;
      const double value = value_of(&profile, CORE_QUANTITY_R, x, &stated);
      const double off = fabs(value - R.value), allowed = stated * R.value + R.error;
      UNIT_FAIL_IF(!(off <= allowed), "R at %g is off by %g, stated %g", x, off / R.value,
                   allowed / R.value);
      worst = fmax(worst, off / allowed);
    }
    printf("ratio %g, g %g, eta %g: %.2g of what is stated\n", ratio, g, eta, worst);
    solver_free(truth);
    core_profile_free(&profile);
  }
}
