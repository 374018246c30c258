/* Fits: coefficients from readings of the model itself, with noise and without, and what is refused.
 * $FIT_SETS is the number of random sets for each test. */
#include "core/fit/fit.h"

#include <math.h>

#include "tests/unit/unit.h"

enum { READINGS = 12 };

static size_t sets(void) {
  const char *given = getenv("FIT_SETS");
  return given != NULL ? strtoul(given, NULL, 10) : 300;
}

/* ---- designs --------------------------------------------------------------------------------- */

struct subject {
  core_fit_design design;
  core_medium medium;
  double at[READINGS];
  double values[READINGS];
  double errors[READINGS];
};

static void evaluate(struct subject *subject) {
  core_profile profile;
  const core_fit_design *design = &subject->design;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), design->model,
                                         design->moments, CORE_EVALUATOR_F64, &subject->medium,
                                         design->parameters),
                    NULL, 0);
  core_eval_f64(&profile, CORE_QUANTITY_R, design->count, subject->at, subject->values);
  core_profile_free(&profile);
}

/* A random medium, and four or more random distances from 0.1 to 10 transport mean free paths. */
static void draw(struct subject *subject, unsigned model, unsigned scale, uint64_t *random) {
  const double ratio = unit_random_log(random, 1e-4, 3);
  const double scattering = unit_random_log(random, 0.1, 10);
  const double eta = unit_random_between(random, 1, 1.6);
  const double path = 1 / (scattering * (1 + ratio));
  subject->medium = (core_medium){ratio * scattering, scattering, 0, eta};
  subject->design = (core_fit_design){
      .model = model,
      .moments = CORE_MOMENTS_EXACT,
      .eta = eta,
      .axis = CORE_FIT_AXIS_RADIUS,
      .count = 4 + unit_random_below(random, READINGS - 3),
      .at = subject->at,
      .scale = scale,
  };
  for (size_t i = 0; i < subject->design.count; i++) {
    subject->at[i] = path * unit_random_log(random, 0.1, 10);
  }
  evaluate(subject);
}

static void set_errors(struct subject *subject, double relative) {
  for (size_t i = 0; i < subject->design.count; i++) {
    subject->errors[i] = relative * subject->values[i];
  }
}

static core_fit *created(const core_fit_design *design) {
  core_fit *fit;
  unit_assert_fault(core_fit_create(&fit, core_isa_select(NULL), design), NULL, 0);
  return fit;
}

static core_fit_result fitted(const struct subject *subject) {
  core_fit *fit = created(&subject->design);
  core_fit_result result;
  core_fit_run(fit, subject->values, subject->errors, &result, NULL);
  core_fit_free(fit);
  return result;
}

/* ---- without noise --------------------------------------------------------------------------- */

static double off(const struct subject *subject, const core_fit_solution *solution) {
  const core_medium *medium = &subject->medium;
  return fmax(fabs(solution->sigma_a_per_mm / medium->sigma_a_per_mm - 1),
              fabs(solution->sigma_s_prime_per_mm / medium->sigma_s_per_mm - 1));
}

/* Whether the status says, by numbers, why the medium need not come back. */
static bool is_undetermined(const core_fit_result *result) {
  const core_fit_covariance *c = &result->covariance;
  return result->status == CORE_FIT_STATUS_UNDETERMINED &&
         (result->condition >= CORE_FIT_CONDITION_MAX ||
          c->a_a >= pow(CORE_FIT_LN_ERROR_MAX * result->best.sigma_a_per_mm, 2) ||
          c->s_s >= pow(CORE_FIT_LN_ERROR_MAX * result->best.sigma_s_prime_per_mm, 2));
}

static void expect_recovery(unsigned model, unsigned scale) {
  uint64_t random = unit_seed();
  size_t told = 0;
  double worst = 0;
  const size_t count = sets();
  for (size_t i = 0; i < count; i++) {
    struct subject subject;
    draw(&subject, model, scale, &random);
    set_errors(&subject, 0.01);
    const core_fit_result result = fitted(&subject);
    const double error = off(&subject, &result.best);
    told += result.status == CORE_FIT_STATUS_FITTED;
    worst = is_undetermined(&result) ? worst : fmax(worst, error);
    if (!is_undetermined(&result) && !(error < 1e-6)) {
      print_error("set %zu, %zu readings, sigma_a %.9g, sigma_s' %.9g, eta %.4f: %.9g, %.9g, status "
               "%d, chi-squared %.3g, condition %.3g second %.3g evals %u\n",
               i, subject.design.count, subject.medium.sigma_a_per_mm,
               subject.medium.sigma_s_per_mm, subject.medium.eta, result.best.sigma_a_per_mm,
               result.best.sigma_s_prime_per_mm, (int)result.status, result.best.chi_squared,
               result.condition, result.second.chi_squared, result.evaluations);
    }
  }
  printf("%s, scale %u: off by %.2g at most; %zu of %zu fitted\n",
         core_choice_by_id(core_models, model)->name, scale, worst, told, count);
}

UNIT_TEST(dipoles_come_back) {
  expect_recovery(CORE_MODEL_BETTER, CORE_FIT_SCALE_ABSOLUTE);
  expect_recovery(CORE_MODEL_CLASSICAL, CORE_FIT_SCALE_ABSOLUTE);
  expect_recovery(CORE_MODEL_BETTER, CORE_FIT_SCALE_FREE);
  expect_recovery(CORE_MODEL_BURLEY, CORE_FIT_SCALE_ABSOLUTE);
}

/* ---- refusals -------------------------------------------------------------------------------- */

UNIT_TEST(wrong_readings_are_refused_with_their_index) {
  uint64_t random = unit_seed();
  struct subject subject;
  draw(&subject, CORE_MODEL_BETTER, CORE_FIT_SCALE_ABSOLUTE, &random);
  set_errors(&subject, 0.01);
  static const struct {
    double value, error;
    const char *field;
  } rows[] = {{-1e-9, 1, "value"},
              {(double)NAN, 1, "value"},
              {(double)INFINITY, 1, "value"},
              {1, 0, "error"},
              {1, -1, "error"},
              {1, (double)NAN, "error"},
              {0, 0, "error"},
              {1, (double)INFINITY, "error"},
              {-1, 0, "value"}};
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    struct subject wrong = subject;
    wrong.design.at = wrong.at;
    wrong.values[2] = rows[i].value;
    wrong.errors[2] = rows[i].error;
    const core_fit_result result = fitted(&wrong);
    assert_int_equal(result.status, CORE_FIT_STATUS_REFUSED);
    unit_assert_fault(result.fault, rows[i].field, 2);
    assert_true(isnan(result.best.sigma_a_per_mm));
  }
}

UNIT_TEST(wrong_designs_are_refused) {
  uint64_t random = unit_seed();
  struct subject subject;
  draw(&subject, CORE_MODEL_BETTER, CORE_FIT_SCALE_ABSOLUTE, &random);
  core_fit_design design = subject.design;
  design.count = 1;
  unit_assert_fault(core_fit_check(&design), "count", 1);
  design.count = 2;
  unit_assert_fault(core_fit_check(&design), NULL, 0);
  design.scale = CORE_FIT_SCALE_FREE;
  unit_assert_fault(core_fit_check(&design), "count", 2);
  design.scale = 9;
  unit_assert_fault(core_fit_check(&design), "scale", 0);
  design = subject.design;
  design.axis = 9;
  unit_assert_fault(core_fit_check(&design), "axis", 0);
  design = subject.design;
  design.g = 1;
  unit_assert_fault(core_fit_check(&design), "g", 0);
  design = subject.design;
  subject.at[3] = 0;
  unit_assert_fault(core_fit_check(&design), "at", 3);
}
