/* The derivatives of ln R by ln sigma_a and ln sigma_s of transport: against differences of solutions
 * for isotropic scattering, of layers, and at the ends of the domain. truth.c has those of the formulas, and of
 * solutions with another g. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "core/kernels.h"
#include "core/solver/solver.h"
#include "tests/accuracy/forms.h"
#include "tests/accuracy/isotropic/isotropic.h"
#include "tests/unit/unit.h"

static const enum core_quantity both[] = {CORE_QUANTITY_BY_SIGMA_A, CORE_QUANTITY_BY_SIGMA_S};

#define ID(id, ...) id,
static const unsigned models[] = {CORE_EACH_MODEL(ID, ID)};

static core_fault prepare(core_profile *profile, unsigned model, unsigned evaluator,
                          const core_medium *medium, const core_parameters *parameters) {
  core_parameters taken = *parameters;
  taken.value[CORE_PARAMETER_DERIVATIVES] = 1;
  return core_profile_prepare(profile, core_isa_select(NULL), model, CORE_MOMENTS_EXACT, evaluator,
                              medium, &taken);
}

/* Returns the error that a reply states for a derivative at r. */
static double stated(const core_profile *profile, double r) {
  const core_stated_errors errors =
      core_profile_errors(profile, CORE_QUANTITY_BY_SIGMA_A, (core_radii_range){r, r});
  return errors.numerical + errors.numerical_per_mm * r;
}

/* Sets the derivatives by ln sigma_a of solutions for isotropic scattering at n radii, by differences
 * of order 6, and X, d ln R / d ln r. */
static void solved(const core_medium *medium, size_t n, const double *r, double *by_a, double *X) {
  static const double weights[] = {-1.0 / 60, 0.15, -0.75, 0, 0.75, -0.15, 1.0 / 60};
  const double h = 0.03;
  memset(by_a, 0, n * sizeof *by_a);
  memset(X, 0, n * sizeof *X);
  for (int k = -3; k <= 3; k++) {
    const double sigma_t = medium->sigma_a_per_mm * exp(k * h) + medium->sigma_s_per_mm;
    const double own = medium->sigma_a_per_mm + medium->sigma_s_per_mm;
    isotropic_solution *solution =
        isotropic_solve(medium->eta, medium->sigma_s_per_mm / sigma_t, 1e-8, ISOTROPIC_REACH);
    for (size_t i = 0; i < n; i++) {
      const double weight = weights[k + 3] / h;
      by_a[i] += weight * log(sigma_t * sigma_t * isotropic_at(solution, r[i] * sigma_t).R);
    }
    for (int l = -3; k == 0 && l <= 3; l++) {
      for (size_t i = 0; i < n; i++) {
        X[i] += weights[l + 3] / h * log(isotropic_at(solution, r[i] * own * exp(l * h)).R);
      }
    }
    isotropic_free(solution);
  }
}

UNIT_TEST(derivatives_of_transport_are_those_of_its_solutions) {
  static const core_medium media[] = {
      {0.02, 1, 0, 1}, {1, 0.5, 0, 1.33}, {1e-5, 1, 0, 2.2}, {1, 0.0102, 0, 0.7}};
  static const unsigned evaluators[] = {CORE_EVALUATOR_F64, CORE_EVALUATOR_F32, CORE_EVALUATOR_LUT};
  enum { RADII = 40 };
  core_parameters parameters = core_parameters_none();
  for (size_t m = 0; m < sizeof media / sizeof media[0]; m++) {
    core_profile profile;
    double r[RADII], by_a[RADII], X[RADII];
    for (int e = 0; e < 3; e++) {
      double worst = 0;
      unit_accept(prepare(&profile, CORE_MODEL_TRANSPORT, evaluators[e], &media[m], &parameters));
      const double most = fmin(0.89 * profile.reach.most_mm, 1e3);
      for (size_t i = 0; i < RADII && e == 0; i++) {
        r[i] = (double)(float)(1e-3 * pow(most / 1e-3, (double)i / (RADII - 1)));
      }
      if (e == 0) {
        solved(&media[m], RADII, r, by_a, X);
      }
      for (size_t i = 0; i < RADII; i++) {
        const double a = unit_value_at(&profile, CORE_QUANTITY_BY_SIGMA_A, r[i]);
        const double by_s = unit_value_at(&profile, CORE_QUANTITY_BY_SIGMA_S, r[i]);
        const double off = fmax(fabs(a - by_a[i]), fabs(by_s - (2 + X[i] - by_a[i])));
        worst = fmax(worst, off / stated(&profile, r[i]));
        UNIT_FAIL_IF(!(off <= stated(&profile, r[i])),
                     "medium %zu, evaluator %u at %g: off by %.3g, stated %.3g", m, evaluators[e],
                     r[i], off, stated(&profile, r[i]));
      }
      assert_true(isinf(stated(&profile, 1.01 * profile.reach.most_mm)));
      printf("sigma_a %g, eta %g, evaluator %u: stated %.2g, %.3f of it\n", media[m].sigma_a_per_mm,
             media[m].eta, evaluators[e], profile.derivative_error, worst);
      core_profile_free(&profile);
    }
  }
}

/* Prepares a stack with the derivatives of one layer, from 1 on. */
static core_profile stack_of(const core_medium *layer, uint32_t count, double at) {
  core_parameters parameters = core_parameters_none();
  core_profile profile;
  parameters.layer_count = count;
  parameters.value[CORE_PARAMETER_TOLERANCE] = 1e-2;
  parameters.value[CORE_PARAMETER_DERIVATIVE_LAYER] = at;
  unit_accept(prepare(&profile, CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, layer, &parameters));
  return profile;
}

UNIT_TEST(derivatives_of_equal_layers_sum_to_those_of_their_half_space) {
  static const core_medium layer[] = {{0.05, 10, 0.8, 1.4, 0.3}, {0.05, 10, 0.8, 1.4, 0}};
  static const double radii[] = {1e-3, 0.01, 0.03, 0.1, 0.3, 1, 3, 10};
  core_profile part[2];
  for (int i = 0; i < 2; i++) {
    part[i] = stack_of(layer, 2, i + 1);
  }
  core_profile whole = stack_of(&layer[1], 1, 1);
  double worst = 0;
  for (size_t k = 0; k < sizeof radii / sizeof *radii; k++) {
    const double r = radii[k];
    for (int q = 0; q < 2; q++) {
      double sum = 0, error = stated(&whole, r);
      for (int i = 0; i < 2; i++) {
        sum += unit_value_at(&part[i], both[q], r);
        error += stated(&part[i], r);
      }
      const double off = fabs(sum - unit_value_at(&whole, both[q], r));
      worst = fmax(worst, off / error);
      UNIT_FAIL_IF(!(off <= error), "quantity %d at %g mm: off by %.3g, stated %.3g", q, r, off,
                   error);
    }
    assert_true(r < 0.5 || stated(&part[0], r) < 5e-3);
  }
  printf("equal layers: %.3f of what is stated\n", worst);
  for (int i = 0; i < 2; i++) {
    core_profile_free(&part[i]);
  }
  core_profile_free(&whole);
}

/* R(r; sigma, d) = R(r / d; sigma d) / d^2, so that the derivatives by all sigma are 2 and those by ln
 * r and by all ln d, which differences of finer solutions give. */
UNIT_TEST(derivatives_of_layers_are_those_of_a_change_of_scale) {
  if (!unit_is_long()) {
    return;
  }
  static const core_medium skin[] = {{1.5, 20, 0.8, 1.4, 0.06}, {0.03, 15, 0.8, 1.4, 0}};
  static const double radii[] = {0.05, 0.2, 1, 4, 8};
  const double h = 0.02;
  core_profile by_layer[] = {stack_of(skin, 2, 1), stack_of(skin, 2, 2)};
  solver_layers *solution[3];
  for (int i = 0; i < 3; i++) {
    const solver_layer layer[] = {{1.5, 20, 0.8, 1.4, 0.06 * exp((i - 1) * h)},
                                  {0.03, 15, 0.8, 1.4, INFINITY}};
    unit_accept(
        solver_layers_solve_level(&solution[i], core_isa_select(NULL), layer, 2, 1, 3, NULL));
  }
  for (size_t k = 0; k < sizeof radii / sizeof *radii; k++) {
    const double r = radii[k];
    double sum = 0, error = 0;
    for (int i = 0; i < 4; i++) {
      sum += unit_value_at(&by_layer[i / 2], both[i % 2], r);
      error += stated(&by_layer[i / 2], r);
    }
    const double R[] = {solver_layers_at(solution[0], 0, r).value,
                        solver_layers_at(solution[2], 0, r).value,
                        solver_layers_at(solution[1], 0, r * exp(-h)).value,
                        solver_layers_at(solution[1], 0, r * exp(h)).value};
    const double expected = 2 + (log(R[1] / R[0]) + log(R[3] / R[2])) / (2 * h);
    UNIT_FAIL_IF(!(fabs(sum - expected) <= error), "%g mm: %.6g, not %.6g +- %.2g", r, sum,
                 expected, error);
  }
  for (int i = 0; i < 3; i++) {
    solver_layers_free(solution[i]);
  }
  core_profile_free(&by_layer[0]);
  core_profile_free(&by_layer[1]);
}

/* In single precision a model that prepares slowly is prepared in the same way, for the long form. */
UNIT_TEST(ends_have_their_limits) {
  static const core_medium media[] = {
      {0.03, 0.7, 0, 1.3}, {0, 1, 0, 1.4}, {0.5, 0, 0, 1.4}, {1e-9, 1e9, 0.9, 1}};
  for (size_t m = 0; m < sizeof models / sizeof models[0]; m++) {
    for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
      const bool few =
          !unit_is_long() && core_prepares_slowly(models[m], CORE_EVALUATOR_F64, NULL, NULL);
      const unsigned last = few ? CORE_EVALUATOR_F64 : CORE_EVALUATOR_F32;
      for (unsigned evaluator = CORE_EVALUATOR_F64; evaluator <= last; evaluator++) {
        core_profile profile;
        const core_medium medium = unit_medium(models[m], &media[i]);
        const core_parameters parameters = core_parameters_none();
        const core_fault fault = prepare(&profile, models[m], evaluator, &medium, &parameters);
        if (!core_has_derivatives(models[m])) {
          unit_assert_fault(fault, "wanted", 0);
        }
        if (fault.field != NULL) {
          continue;
        }
        for (int k = 0; k < 2; k++) {
          const double near = unit_value_at(&profile, both[k], 0);
          assert_true(isfinite(near) && unit_value_at(&profile, both[k], (double)INFINITY) == 0);
          assert_true(profile.albedo > 0 || near == 0);
          assert_true(media[i].sigma_a_per_mm > 0 || k > 0 || near == 0);
        }
        core_profile_free(&profile);
      }
    }
  }
}

/* From next to the source, where series and limits take over, to far away, r dR_dr / R is the slope of
 * ln R over ln r. */
UNIT_TEST(slopes_are_those_of_R_at_every_distance) {
  static const core_medium media[] = {{0.03, 0.7, 0, 1.3}, {1e-4, 1, 0, 1.4}, {1, 0.2, 0, 1}};
  const double h = 0.01;
  for (size_t m = 0; m < sizeof models / sizeof models[0]; m++) {
    for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
      const core_medium medium = unit_medium(models[m], &media[i]);
      core_profile profile = unit_profile(models[m], CORE_EVALUATOR_F64, &medium, NULL);
      for (double r = 1e-20; r < 30; r *= 30) {
        const double near = unit_value_at(&profile, CORE_QUANTITY_R, r * exp(-h));
        const double far = unit_value_at(&profile, CORE_QUANTITY_R, r * exp(h));
        const double R = unit_value_at(&profile, CORE_QUANTITY_R, r);
        const double slope = r * unit_value_at(&profile, CORE_QUANTITY_SLOPE, r) / R;
        const double expected = log(far / near) / (2 * h);
        UNIT_FAIL_IF(R > 0 && !(fabs(slope - expected) <= 1e-3 * (1 + fabs(expected))),
                     "model %u, medium %zu, at %g mm: slope %.9g, not %.9g", models[m], i, r, slope,
                     expected);
      }
      core_profile_free(&profile);
    }
  }
}
