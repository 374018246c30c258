/* The model transport for g other than 0: its values, derivatives and stated errors against the solver.
 * test_distributions.c compares its quantities with each other, test_models.c has light at angles, and
 * truth.c samples, and single precision. */
#include <math.h>

#include "core/choose.h"
#include "core/inverter.h"
#include "core/kernels.h"
#include "core/solver/solver.h"
#include "core/transport/table.h"
#include "tests/unit/unit.h"

#define PI 3.14159265358979323846

static core_profile prepare(const core_medium *medium, unsigned evaluator, double tolerance) {
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
  return unit_profile(CORE_MODEL_TRANSPORT, evaluator, medium, &parameters);
}

static double stated(const core_profile *profile, unsigned wanted, double least, double most) {
  const core_stated_errors errors =
      core_profile_errors(profile, wanted, (core_radii_range){least, most});
  assert_true(errors.numerical_per_mm == 0 || wanted == CORE_QUANTITY_BY_SIGMA_A);
  return errors.numerical + (least == most ? errors.numerical_per_mm * most : 0);
}

/* Lengths in mean free paths 1 / sigma_t'. */
static core_medium medium_of(double ratio, double g, double eta) {
  return (core_medium){ratio / (1 + ratio), 1 / (1 + ratio) / (1 - g), g, eta};
}

static const unsigned evaluators[] = {CORE_EVALUATOR_F64, CORE_EVALUATOR_F32, CORE_EVALUATOR_LUT};
enum { EVALUATORS = sizeof evaluators / sizeof evaluators[0] };

/* ---- the solver ----------------------------------------------------------------------------- */

/* dR/dr by differences of the solver's ln R, which is smooth, whatever its error. Differences of R
 * itself would be 2e-3 off at 20 mean free paths. */
static double slope_of(const solver_solution *solution, size_t eta, double r) {
  double by[2];
  for (int i = 0; i < 2; i++) {
    const double h = i == 0 ? 0.02 * r : 0.04 * r;
    by[i] = log(solver_at(solution, eta, r + h).value / solver_at(solution, eta, r - h).value) /
            (2 * h);
  }
  return solver_at(solution, eta, r).value * (4 * by[0] - by[1]) / 3;
}

/* How far the values of a medium are off at most, over what is allowed. */
struct excess {
  double R, slope;
};

/* Compares an evaluator's R and dR/dr with the solution for boundary e at random radii, and its total. */
static void compare_with_solution(const solver_solution *solution, size_t e, transport_number total,
                                  const core_medium *medium, unsigned evaluator,
                                  core_radii_range radii, double R_least, uint64_t *random,
                                  struct excess *excess) {
  enum { RADII = 24 };
  core_profile profile = prepare(medium, evaluator, (double)NAN);
  assert_true(fabs(profile.albedo / total.value - 1) <=
              stated(&profile, CORE_QUANTITY_ALBEDO, 1, 0) + total.error / total.value);
  for (size_t i = 0; i < RADII; i++) {
    const double r = (double)(float)unit_random_log(random, radii.least_mm, radii.most_mm);
    const transport_number truth = solver_at(solution, e, r);
    const double error = truth.error / truth.value;
    if (truth.value < R_least || error > 2e-3) {
      continue;
    }
    const double off = fabs(unit_value_at(&profile, CORE_QUANTITY_R, r) / truth.value - 1);
    const double allowed = stated(&profile, CORE_QUANTITY_R, r, r) + error;
    const double off_slope =
        fabs(unit_value_at(&profile, CORE_QUANTITY_SLOPE, r) / slope_of(solution, e, r) - 1);
    const double allowed_slope = stated(&profile, CORE_QUANTITY_SLOPE, r, r) + 3 * error;
    UNIT_FAIL_IF(
        !(off <= allowed && off_slope <= allowed_slope),
        "albedo %g, g %g, eta %g, r %g: R is off by %g, allowed %g, dR/dr by %g, allowed %g",
        profile.albedo, medium->g, medium->eta, r, off, allowed, off_slope, allowed_slope);
    excess->R = fmax(excess->R, off / allowed);
    excess->slope = fmax(excess->slope, off_slope / allowed_slope);
  }
  core_profile_free(&profile);
}

static solver_solution *solved(double ratio, double g, const double etas[3], double tolerance) {
  const solver_phase phase = {g, 0, NULL};
  solver_solution *solution;
  unit_accept(solver_solve(&solution, core_isa_select(NULL), ratio, &phase, etas, 3, tolerance));
  return solution;
}

/* The same for each evaluator and three boundaries, for which the medium is solved. Frees the solution. */
static struct excess compare_with_solver(solver_solution *solution, double ratio, double g,
                                         const double etas[3], core_radii_range radii,
                                         double R_least, uint64_t *random) {
  const solver_phase phase = {g, 0, NULL};
  struct excess excess = {0, 0};
  solver_total totals[3];
  unit_accept(solver_totals(totals, core_isa_select(NULL), ratio, &phase, etas, 3));
  for (size_t i = 0; i < 9; i++) {
    const core_medium medium = medium_of(ratio, g, etas[i / 3]);
    compare_with_solution(solution, i / 3, totals[i / 3].normal, &medium, evaluators[i % 3], radii,
                          R_least, random, &excess);
  }
  solver_free(solution);
  printf("of what is allowed: R %.2f, dR/dr %.2f\n", excess.R, excess.slope);
  return excess;
}

/* Compares derivatives of ln R with differences of solutions for media of other sigma_a, and of the
 * medium's own, `middle`, at other radii. */
static void compare_derivatives(solver_solution *middle, double ratio, double g,
                                const double etas[3], uint64_t *random) {
  enum { MEDIA = 3, RADII = 60 };
  const double h = 0.04;
  solver_solution *solutions[MEDIA] = {solved(ratio * exp(-h), g, etas, 1e-3), middle,
                                       solved(ratio * exp(h), g, etas, 1e-3)};
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_DERIVATIVES] = 1;
  double worst = 0;
  for (size_t e = 0; e < 9; e++) {
    const core_medium medium = medium_of(ratio, g, etas[e / 3]);
    core_profile profile =
        unit_profile(CORE_MODEL_TRANSPORT, evaluators[e % 3], &medium, &parameters);
    for (size_t i = 0; i < RADII; i++) {
      const double r = (double)(float)unit_random_log(random, 0.005, 25);
      double by_a[MEDIA], by_r[MEDIA], unsure = 0;
      for (int k = 0; k < MEDIA; k++) {
        const double other = 1 + medium.sigma_a_per_mm * (exp((k - 1) * h) - 1);
        const transport_number R = solver_at(solutions[k], e / 3, r * other);
        by_a[k] = log(R.value * other * other);
        by_r[k] = log(solver_at(middle, e / 3, r * exp((k - 1) * h)).value);
        unsure = fmax(unsure, R.value > 1e-12 ? R.error / R.value : 1);
      }
      const double a = (by_a[2] - by_a[0]) / (2 * h), s = 2 + (by_r[2] - by_r[0]) / (2 * h) - a;
      const double off = fmax(fabs(unit_value_at(&profile, CORE_QUANTITY_BY_SIGMA_A, r) - a),
                              fabs(unit_value_at(&profile, CORE_QUANTITY_BY_SIGMA_S, r) - s));
      const double allowed = stated(&profile, CORE_QUANTITY_BY_SIGMA_A, r, r) + unsure;
      UNIT_FAIL_IF(unsure < 3e-3 && !(off <= allowed),
                   "g %g, eta %g, evaluator %u, r %g: derivatives are off by %g, allowed %g", g,
                   medium.eta, evaluators[e % 3], r, off, allowed);
      worst = unsure < 3e-3 ? fmax(worst, off / allowed) : worst;
    }
    core_profile_free(&profile);
  }
  solver_free(solutions[0]);
  solver_free(solutions[2]);
  printf("of what is allowed: derivatives %.2f\n", worst);
  assert_true(worst > 0);
}

UNIT_TEST(values_are_those_of_the_solver) {
  static const double ends[][2] = {{0.6, 0.95}, {-0.5, 0.6}};
  uint64_t random = unit_seed();
  for (size_t m = 0; m < (unit_is_long() ? 2 : 1); m++) {
    const double g = unit_random_between(&random, ends[m][0], ends[m][1]);
    const double ratio = unit_random_log(&random, 1e-4, 2);
    const double etas[] = {unit_random_between(&random, 0.7, 1), 1,
                           unit_random_between(&random, 1, 2.2)};
    solver_solution *solution = solved(ratio, g, etas, 1e-3);
    compare_derivatives(solution, ratio, g, etas, &random);
    compare_with_solver(solution, ratio, g, etas, (core_radii_range){0.01, 20}, 1e-12, &random);
  }
}

/* The table was measured where R is above 1e-12. Its error grows beyond the reach. */
UNIT_TEST(smaller_values_are_within_what_is_stated_beyond_the_reach) {
  uint64_t random = unit_seed();
  const double etas[] = {0.782, 1, 1.16};
  const struct excess excess =
      compare_with_solver(solved(1.2162, 0.727, etas, unit_is_long() ? 1e-4 : 1e-3), 1.2162, 0.727,
                          etas, (core_radii_range){15, 25}, 1e-17, &random);
  assert_true(excess.R > 0);
}

/* What is stated holds where R is above 1e-12, up to 100 mean free paths. */
UNIT_TEST(the_reach_ends_where_R_is_negligible) {
  enum { MEDIA = 400 };
  uint64_t random = unit_seed();
  for (size_t i = 0; i < MEDIA; i++) {
    const double eta =
        i % 2 == 0 ? unit_random_between(&random, 0.7, 2.2) : 1 + unit_random_log(&random, 1e-4, 1);
    const core_medium medium = medium_of(unit_random_log(&random, 1.01e-6, 100),
                                         unit_random_between(&random, -0.5, 0.95), eta);
    core_profile profile = prepare(&medium, CORE_EVALUATOR_F64, (double)NAN);
    const double reach = profile.reach.most_mm;
    const double R = unit_value_at(&profile, CORE_QUANTITY_R, reach);
    UNIT_FAIL_IF(!(reach < 100.0001 && (reach > 99.9999 || R <= 1e-12) && R > 3e-14),
                 "sigma_a %g, g %g, eta %g: at the reach, %g, R is %g", medium.sigma_a_per_mm,
                 medium.g, eta, reach, R);
    core_profile_free(&profile);
  }
}

/* Where nearly nothing is absorbed, light leaves far away, and what is known of R there sets its scale
 * everywhere. The table is least exact for g near -0.5 and a large eta. */
UNIT_TEST(media_without_absorption_are_within_what_is_stated) {
  static const double media[][2] = {{1e-4, -0.498}, {1.5e-6, -0.498}, {1.9e-6, -0.131}};
  const double etas[] = {0.8, 1.5, 2.195};
  uint64_t random = unit_seed();
  for (size_t m = 0; m < sizeof media / sizeof media[0]; m++) {
    const struct excess excess =
        compare_with_solver(solved(media[m][0], media[m][1], etas, 1e-3), media[m][0], media[m][1],
                            etas, (core_radii_range){0.02, 400}, 1e-12, &random);
    assert_true(excess.R > 0);
  }
}

/* ---- quantities against integrals of the solver's R --------------------------------------------- */

/* The energy that leaves within some radii, per power that has entered, and its error: 2 pi r R of
 * the solver by Gauss's rule with three nodes between them. */
enum { WITHIN = 64 };
struct within {
  double r[WITHIN], energy[WITHIN], error[WITHIN];
};

/* Returns the integral of 2 pi r R J0(2 pi f r) from one radius to another, and adds the solver's
 * error to *error. */
static double between_radii(const solver_solution *solution, double from, double to, double f,
                            double *error) {
  static const double node[] = {-0.77459666924148338, 0, 0.77459666924148338};
  static const double weight[] = {5.0 / 18, 8.0 / 18, 5.0 / 18};
  double sum = 0;
  for (size_t i = 0; i < 3; i++) {
    const double r = 0.5 * (from + to + (to - from) * node[i]);
    const transport_number R = solver_at(solution, 0, r);
    sum += weight[i] * (to - from) * 2 * PI * r * R.value * j0(2 * PI * f * r);
    *error += weight[i] * (to - from) * 2 * PI * r * R.error;
  }
  return sum;
}

static void integrate(const solver_solution *solution, struct within *within) {
  *within = (struct within){.r = {0}};
  for (size_t i = 1; i < WITHIN; i++) {
    within->r[i] = 1e-3 * pow(1.2, (double)i);
    within->error[i] = within->error[i - 1];
    within->energy[i] = within->energy[i - 1] + between_radii(solution, within->r[i - 1],
                                                              within->r[i], 0, &within->error[i]);
  }
}

static void hold(const char *what, const core_profile *profile, double at, double value,
                 double truth, double allowed, double *worst) {
  UNIT_FAIL_IF(!(fabs(value - truth) <= allowed),
               "%s at %g, evaluator %u: %.9g, not %.9g: off by %.2g, allowed %.2g", what, at,
               profile->evaluator, value, truth, fabs(value - truth), allowed);
  *worst = fmax(*worst, fabs(value - truth) / allowed);
}

/* The quadrature is within 1e-5. */
static void check_cdf(const core_profile *profile, const struct within *within, double total,
                      double *worst) {
  for (size_t i = 1; i < WITHIN; i++) {
    const double r = within->r[i], cdf = within->energy[i] / total;
    hold("the cdf", profile, r, unit_value_at(profile, CORE_QUANTITY_CDF, r), cdf,
         stated(profile, CORE_QUANTITY_CDF, r, r) * cdf + within->error[i] / total + 1e-5, worst);
  }
}

/* The reflectance for stripes: the integral of 2 pi r R J0(2 pi f r). */
static void check_transform(const core_profile *profiles, const solver_solution *solution,
                            double total, double *worst) {
  static const double frequencies[] = {0.003, 0.03, 0.1, 0.4};
  for (size_t i = 0; i < sizeof frequencies / sizeof frequencies[0]; i++) {
    const double f = frequencies[i];
    double unsure = 2e-5 * total, sum = 0, from = 0;
    for (double to = 1e-3; from < 60; to = fmin(1.2 * to, to + 0.3 / f)) {
      sum += between_radii(solution, from, to, f, &unsure);
      from = to;
    }
    for (const core_profile *one = profiles; one < profiles + EVALUATORS; one++) {
      hold("R(f)", one, f, unit_value_at(one, CORE_QUANTITY_TRANSFER, f), sum,
           stated(one, CORE_QUANTITY_TRANSFER, f, f) * total + unsure, worst);
    }
  }
}

UNIT_TEST(quantities_are_integrals_of_the_solvers_R) {
  static const double media[][3] = {{2, -0.4, 0.8}, {0.1, 0.9, 1.4}};
  for (size_t m = 0; m < (unit_is_long() ? sizeof media / sizeof media[0] : 1); m++) {
    const double ratio = media[m][0], g = media[m][1], eta = media[m][2];
    const solver_phase phase = {g, 0, NULL};
    const core_medium medium = medium_of(ratio, g, eta);
    solver_solution *solution;
    solver_total totals;
    struct within within;
    double worst = 0;
    unit_accept(solver_solve(&solution, core_isa_select(NULL), ratio, &phase, &eta, 1, 1e-4));
    unit_accept(solver_totals(&totals, core_isa_select(NULL), ratio, &phase, &eta, 1));
    const double total = totals.normal.value;
    integrate(solution, &within);
    assert_true(within.r[WITHIN - 1] > 90);
    hold("all energy", &(core_profile){.evaluator = 0}, within.r[WITHIN - 1],
         within.energy[WITHIN - 1], total, within.error[WITHIN - 1] + 1e-5 * total, &worst);
    core_profile profiles[EVALUATORS];
    for (size_t i = 0; i < EVALUATORS; i++) {
      profiles[i] = prepare(&medium, evaluators[i], (double)NAN);
      check_cdf(&profiles[i], &within, total, &worst);
    }
    check_transform(profiles, solution, total, &worst);
    for (size_t i = 0; i < EVALUATORS; i++) {
      core_profile_free(&profiles[i]);
    }
    printf("sigma_a / sigma_s' %g, g %g, eta %g: %.2f of what is allowed\n", ratio, g, eta, worst);
    solver_free(solution);
  }
}

/* ---- the table ---------------------------------------------------------------------------------- */

static core_medium random_medium(uint64_t *random) {
  const double kind = unit_random_between(random, 0, 1);
  const double ratio = kind < 0.1 ? 0 : kind < 0.2 ? 100 : unit_random_log(random, 1e-8, 100);
  const double g = kind > 0.9 ? 0.95 : kind > 0.8 ? -0.5 : unit_random_between(random, -0.5, 0.95);
  core_medium medium = medium_of(ratio, g, unit_random_between(random, 0.7, 2.2));
  const double scale = unit_random_log(random, 0.01, 100);
  medium.sigma_a_per_mm *= scale;
  medium.sigma_s_per_mm *= scale;
  return medium;
}

/* The slope of the table's R jumps at its edges, 1 and 14 mean free paths among them. The profile
 * has the same R there. */
UNIT_TEST(profiles_follow_the_table_at_its_edges) {
  uint64_t random = unit_seed();
  double worst = 0;
  for (int m = 0; m < 100; m++) {
    core_medium medium = random_medium(&random);
    medium = m == 0   ? medium_of(1 / 0.023 - 1, -0.4, 1.65)
             : m == 1 ? medium_of(1 / 0.1635 - 1, -0.4843, 2.0812)
                      : medium;
    const double sigma_t = core_sigma_t_prime(&medium);
    const double albedo = medium.sigma_s_per_mm * (1 - medium.g) / sigma_t;
    if (!transport_table_covers(transport_table_shipped(), albedo, medium.g, medium.eta)) {
      continue;
    }
    core_profile profile = prepare(&medium, CORE_EVALUATOR_F64, (double)NAN);
    transport_series series;
    transport_table_look_up(transport_table_shipped(), albedo, medium.g, medium.eta, &series);
    double first = (double)NAN;
    for (double y = -9; y < series.edge[TRANSPORT_TABLE_PANELS]; y += 0.01) {
      const double x = exp(y);
      const double ln_R = unit_value_at(&profile, CORE_QUANTITY_LN_R, x / sigma_t);
      const double more = ln_R - (transport_series_at(&series, y) - series.kappa * x - y);
      first = isnan(first) ? more : first; /* the scale, which the albedo sets */
      worst = fmax(worst, fabs(more - first));
      UNIT_FAIL_IF(!(fabs(more - first) < 3e-6),
                   "g %g, albedo %g, eta %g at %g mean free paths: ln R is off by %.3g", medium.g,
                   albedo, medium.eta, x, more - first);
    }
    core_profile_free(&profile);
  }
  printf("ln R is off by %.2g at most\n", worst);
}

/* test_choose.c has a tolerance below the table's error. */
UNIT_TEST(the_stated_error_is_that_of_the_radii) {
  const core_medium medium = {0.05, 9.5, 0.9, 1.4};
  for (size_t i = 0; i < EVALUATORS; i++) {
    core_profile profile = prepare(&medium, evaluators[i], (double)NAN);
    const double middle = stated(&profile, CORE_QUANTITY_R, 1, 1);
    assert_true(stated(&profile, CORE_QUANTITY_R, 0.001, 1) >= middle);
    assert_true(stated(&profile, CORE_QUANTITY_CDF, 1, 1) >= middle);
    assert_true(stated(&profile, CORE_QUANTITY_R, 1, 1000) > 0.01);
    core_profile_free(&profile);
  }
}

/* ---- outside the table ------------------------------------------------------------------------ */

UNIT_TEST(outside_of_the_table_media_are_solved_or_refused) {
  static const struct {
    core_medium medium;
    const char *field; /* of the refusal, NULL if it is solved */
  } outside[] = {{{0.05, 9.5, 0.96, 1.4}, NULL},      {{0.05, 9.5, -0.55, 1.4}, NULL},
                 {{0.05, 9.5, 0.9, 0.65}, NULL},      {{0.05, 9.5, 0.9, 2.3}, NULL},
                 {{101 * 0.95, 9.5, 0.9, 1.4}, NULL}, {{1e-3, 9.5, 0.999999, 1.4}, "g"},
                 {{0.05, 9.5, -0.9999, 1.4}, "g"},    {{1e15, 9.5, 0.9, 1.4}, "sigma_a"}};
  const core_parameters none = core_parameters_none();
  for (size_t i = 0; i < sizeof outside / sizeof outside[0]; i++) {
    const core_medium *medium = &outside[i].medium;
    unit_assert_fault(core_profile_check(CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT,
                                         CORE_EVALUATOR_F32, medium, NULL, NULL),
                      outside[i].field, 0);
    assert_true(core_prepares_slowly(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F32, medium, &none));
    core_choose_request request = {
        .media = medium,
        .layer_count = 1,
        .eta_below = (double)NAN,
        .media_count = 1,
        .wanted = CORE_QUANTITY_R,
        .radii = {1 / core_sigma_t_prime(medium), 2 / core_sigma_t_prime(medium)},
        .tolerance = 1};
    core_candidate candidates[CORE_CANDIDATES_MAX];
    const size_t n = core_choose(&request, candidates);
    bool meets = false;
    for (size_t k = 0; k < n; k++) {
      if (candidates[k].model == CORE_MODEL_TRANSPORT && candidates[k].meets) {
        meets = true;
        assert_false(candidates[k].looked_up);
      }
    }
    assert_int_equal(meets, outside[i].field == NULL);
  }
  const core_medium inside = {0, 9.5, 0.9, 1.4};
  assert_false(core_prepares_slowly(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, &inside, &none));
  const core_medium nothing = {1, 0, 0.9, 1.4};
  core_profile profile = prepare(&nothing, CORE_EVALUATOR_F64, (double)NAN);
  assert_int_equal(profile.notes, 0);
  assert_true(unit_value_at(&profile, CORE_QUANTITY_R, 1) == 0);
  core_profile_free(&profile);
}

static double probe(const core_medium *medium) {
  core_profile profile = prepare(medium, CORE_EVALUATOR_F64, (double)NAN);
  const double albedo = profile.albedo;
  assert_int_equal(profile.notes, 0);
  core_profile_free(&profile);
  return albedo;
}

/* An inversion stays where the table holds. */
UNIT_TEST(albedos_are_inverted_with_g) {
  core_inverter inverter;
  unit_accept(core_inverter_start(&inverter, CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT, 0, false,
                                  0.9, 1.4, 1));
  while (!core_inverter_take(&inverter, probe(&inverter.medium), 0)) {
  }
  assert_true(inverter.albedo_least > 1e-6 && inverter.albedo_least < 1e-3);
  assert_true(inverter.albedo_most > 0.9999);
  for (double albedo = 2e-4; albedo < 0.9; albedo *= 1.7) {
    assert_false(core_inverter_seek(&inverter, albedo, CORE_LENGTH_FREE_PATH, 2));
    int steps = 0;
    while (!core_inverter_take(&inverter, probe(&inverter.medium), 0)) {
      assert_true(steps++ < 100);
    }
    assert_true(inverter.found && fabs(inverter.albedo / albedo - 1) < 1e-12);
    assert_true(inverter.medium.g == 0.9);
  }
  assert_true(core_inverter_seek(&inverter, inverter.albedo_least / 2, CORE_LENGTH_FREE_PATH, 2));
}
