/* Fits: coefficients from readings of the model itself, with noise and without. wrong.txt and
 * test_fit.py have what is refused. $FIT_SETS is the number of random sets for each test. */
#include "core/fit/fit.h"

#include <math.h>

#include "core/fit/discs.h"
#include "tests/accuracy/fit_model.h"
#include "tests/accuracy/montecarlo_run.h"
#include "tests/unit/unit.h"

enum {
  READINGS = 12,
  MEDIA = 10, /* that are fitted with one design, where designs have tables, which take long */
};

static size_t sets(void) {
  const char *given = getenv("FIT_SETS");
  return given != NULL ? strtoul(given, NULL, 10) : unit_is_long() ? 300 : 100;
}

/* ---- designs --------------------------------------------------------------------------------- */

/* Where readings come from: profiles, as `eval` gives them, or the design's own model. */
enum source { PROFILES, OWN };

struct recovery {
  unsigned model, axis;
  double g;
  size_t sets;
  unsigned scale;
  enum source source;
  size_t media;  /* that are fitted with one design */
  double errors; /* of the readings, relative */
};

/* Absolute readings of R at distances, of eta 1.4. */
static core_fit_design usual_design(unsigned model, double g, size_t count, const double *at) {
  return (core_fit_design){.model = model,
                           .moments = CORE_MOMENTS_EXACT,
                           .g = g,
                           .eta = 1.4,
                           .axis = CORE_FIT_AXIS_RADIUS,
                           .count = count,
                           .at = at,
                           .scale = CORE_FIT_SCALE_ABSOLUTE};
}

struct subject {
  core_fit_design design;
  core_medium medium;
  double at[READINGS];
  double values[READINGS];
  double errors[READINGS];
};

/* Sets the readings to a profile's values, of a medium with the design's g and the same sigma_s'. */
static void evaluate(struct subject *subject) {
  const core_fit_design *design = &subject->design;
  core_medium medium = subject->medium;
  medium.g = design->g;
  medium.sigma_s_per_mm /= 1 - design->g;
  core_profile profile =
      unit_profile(design->model, CORE_EVALUATOR_F64, &medium, design->parameters);
  core_eval_f64(&profile,
                design->axis == CORE_FIT_AXIS_RADIUS ? CORE_QUANTITY_R : CORE_QUANTITY_TRANSFER,
                design->count, subject->at, subject->values);
  core_profile_free(&profile);
}

/* A random medium, and four or more random distances from 0.1 to 10 transport mean free paths, or
 * spatial frequencies. */
static void draw(struct subject *subject, const struct recovery *of, uint64_t *random) {
  const double ratio = unit_random_log(random, 1e-4, 3);
  const double scattering = unit_random_log(random, 0.1, 10);
  const double eta = unit_random_between(random, 1, 1.6);
  const double path = 1 / (scattering * (1 + ratio));
  subject->medium = (core_medium){ratio * scattering, scattering, 0, eta};
  subject->design =
      usual_design(of->model, of->g, 4 + unit_random_below(random, READINGS - 3), subject->at);
  subject->design.eta = eta;
  subject->design.axis = of->axis;
  subject->design.scale = of->scale;
  for (size_t i = 0; i < subject->design.count; i++) {
    const double r = path * unit_random_log(random, 0.1, 10);
    subject->at[i] = of->axis == CORE_FIT_AXIS_RADIUS ? r : i == 0 ? 0 : 0.05 / r;
  }
}

/* Another random medium for the same design: of the same transport mean free path. */
static void redraw(struct subject *subject, uint64_t *random) {
  core_medium *medium = &subject->medium;
  const double ratio = unit_random_log(random, 1e-4, 3);
  const double sigma_t = medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g);
  medium->sigma_a_per_mm = sigma_t * ratio / (1 + ratio);
  medium->sigma_s_per_mm = sigma_t / (1 + ratio) / (1 - medium->g);
}

static void set_errors(struct subject *subject, double relative) {
  for (size_t i = 0; i < subject->design.count; i++) {
    subject->errors[i] = relative * subject->values[i];
  }
}

static core_fit *created(const core_fit_design *design) {
  core_fit *fit;
  unit_accept(core_fit_create(&fit, core_isa_select(NULL), design));
  return fit;
}

/* Returns what core_fit_run() says of one set of readings. */
static core_fit_result run_alone(const core_fit_design *design, const double *values,
                                 const double *errors) {
  core_fit_result result;
  core_fit *fit = created(design);
  core_fit_run(fit, values, errors, &result, NULL);
  core_fit_free(fit);
  return result;
}

/* Sets values to the readings that a design models of a medium. */
static void model_readings(const core_fit_design *design, double sigma_a, double sigma_s_prime,
                           double *values) {
  core_fit *fit = created(design);
  fit_model_readings(fit, sigma_a, sigma_s_prime, values);
  core_fit_free(fit);
}

/* Fits, and refines as long as the fit wants it. */
static core_fit_result refined(const core_fit *fit, const struct subject *subject) {
  const core_fit_design *design = &subject->design;
  core_fit_result result;
  core_medium medium;
  core_fit_run(fit, subject->values, subject->errors, &result, NULL);
  bool goes_on = core_fit_wants_exact(fit, subject->values, subject->errors, &result, &medium);
  for (int i = 0; i < CORE_FIT_REFINE_MOST && goes_on; i++) {
    core_profile profile =
        unit_profile(design->model, CORE_EVALUATOR_F64, &medium, design->parameters);
    goes_on =
        core_fit_refine(fit, &profile, subject->values, subject->errors, &result, NULL, &medium);
    core_profile_free(&profile);
  }
  return result;
}

static core_fit_result fitted(const struct subject *subject) {
  core_fit *fit = created(&subject->design);
  const core_fit_result result = refined(fit, subject);
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

/* Fits random sets of readings and checks that their media come back. */
static void expect_recovery(struct recovery of) {
  uint64_t random = unit_seed();
  double worst = 0;
  size_t told = 0;
  struct subject subject;
  core_fit *fit = NULL;
  for (size_t i = 0; i < of.sets; i++) {
    if (i % of.media == 0) {
      core_fit_free(fit);
      draw(&subject, &of, &random);
      fit = created(&subject.design);
    } else {
      redraw(&subject, &random);
    }
    core_fit_result result;
    if (of.source == OWN) {
      fit_model_readings(fit, subject.medium.sigma_a_per_mm, subject.medium.sigma_s_per_mm,
                         subject.values);
      set_errors(&subject, of.errors);
      core_fit_run(fit, subject.values, subject.errors, &result, NULL);
    } else {
      evaluate(&subject);
      set_errors(&subject, of.errors);
      result = refined(fit, &subject);
    }
    const double error = off(&subject, &result.best);
    told += result.status == CORE_FIT_STATUS_FITTED;
    worst = is_undetermined(&result) ? worst : fmax(worst, error);
    if (!is_undetermined(&result) && !(error < 1e-6)) {
      print_error(
          "set %zu, %s, axis %u, g %g: sigma_a %.9g, sigma_s' %.9g, eta %.4f, %zu readings: "
          "off by %.3g, status %d, condition %.3g, chi-squared %.3g, second %.3g, %u evaluations\n",
          i, core_choice_by_id(core_models, of.model)->name, of.axis, of.g,
          subject.medium.sigma_a_per_mm, subject.medium.sigma_s_per_mm, subject.medium.eta,
          subject.design.count, error, (int)result.status, result.condition,
          result.best.chi_squared, result.second.chi_squared, result.evaluations);
    }
  }
  core_fit_free(fit);
  printf("%s, source %u, axis %u, g %g, scale %u: off by %.2g at most; %zu of %zu fitted\n",
         core_choice_by_id(core_models, of.model)->name, of.source, of.axis, of.g, of.scale, worst,
         told, of.sets);
  assert_true(worst < 1e-6);
}

UNIT_TEST(dipoles_come_back) {
#define DIPOLE(model, scale)                                                                       \
  expect_recovery((struct recovery){CORE_MODEL_##model, CORE_FIT_AXIS_RADIUS, 0, sets(),           \
                                    CORE_FIT_SCALE_##scale, PROFILES, 1, 0.01})
  DIPOLE(BETTER, ABSOLUTE);
  DIPOLE(CLASSICAL, ABSOLUTE);
  DIPOLE(BETTER, FREE);
  DIPOLE(BURLEY, ABSOLUTE);
#undef DIPOLE
}

#define RECOVERY(model, axis, g, sets, source, errors)                                             \
  expect_recovery((struct recovery){CORE_MODEL_##model, CORE_FIT_AXIS_##axis, g, sets,             \
                                    CORE_FIT_SCALE_ABSOLUTE, source, MEDIA, errors})

UNIT_TEST(transport_and_frequencies_come_back) {
  RECOVERY(BETTER, FREQUENCY, 0, sets(), OWN, 0.01);
  RECOVERY(TRANSPORT, RADIUS, 0, sets() / 3, OWN, 0.01);
  RECOVERY(TRANSPORT, RADIUS, 0.8, sets(), OWN, 0.01);
  RECOVERY(TRANSPORT, FREQUENCY, 0.9, sets() / 3, OWN, 0.01);
}

/* Their errors are so small that a table would count. */
UNIT_TEST(readings_of_profiles_come_back) {
  RECOVERY(TRANSPORT, RADIUS, 0.8, sets() / 10, PROFILES, 1e-4);
  RECOVERY(TRANSPORT, RADIUS, -0.3, sets() / 10, PROFILES, 1e-4);
  RECOVERY(TRANSPORT, FREQUENCY, 0.9, sets() / 10, PROFILES, 1e-4);
  RECOVERY(TRANSPORT, RADIUS, 0, sets() / 100, PROFILES, 1e-4);
  RECOVERY(BETTER, FREQUENCY, 0, sets() / 3, PROFILES, 1e-4);
  RECOVERY(BURLEY, FREQUENCY, 0, sets() / 3, PROFILES, 1e-4);
  RECOVERY(EXTENDED, RADIUS, 0, sets() / 30, PROFILES, 1e-4);
  RECOVERY(QUANTIZED, RADIUS, 0, sets() / 30, PROFILES, 1e-4);
  RECOVERY(BEAM, RADIUS, 0, sets() / 30, PROFILES, 1e-4);
  RECOVERY(BETTER_SINGLE, RADIUS, 0, sets() / 30, PROFILES, 1e-4);
}

/* A medium that absorbs hardly anything, seen close by: along the valley of media that fit, chi-squared
 * goes from 0 at the medium to 0.158 at the least sigma_a. */
UNIT_TEST(flat_valleys_are_not_left_at_their_end) {
  struct subject subject = {
      .medium = {0.00018047113022462311, 0.34200634425599358, 0, 1.065859681605833},
      .at = {0.35648855019753578, 1.9043188863509601, 1.7838892316056296, 1.7853767432776231,
             4.3845154913532802, 0.62602462038294182}};
  subject.design = usual_design(CORE_MODEL_TRANSPORT, 0.8, 6, subject.at);
  subject.design.eta = subject.medium.eta;
  model_readings(&subject.design, subject.medium.sigma_a_per_mm, subject.medium.sigma_s_per_mm,
                 subject.values);
  set_errors(&subject, 0.01);
  const core_fit_result result = run_alone(&subject.design, subject.values, subject.errors);
  assert_true(off(&subject, &result.best) < 1e-6);
  assert_true(result.best.chi_squared < 1e-12);
}

/* Two readings, or with an unknown factor three to five, that another medium fits, too: only the true one
 * may be called fitted. */
UNIT_TEST(a_second_medium_is_not_taken_for_the_true_one) {
  static const struct {
    bool by_frequency;
    double g, sigma_a, sigma_s_prime;
    size_t count;
    double at[5];
  } cases[] = {
      {false, 0, 1.49187, 2.43285, 2, {2.68653, 2.70632}},
      {false, 0, 0.0213261, 0.363207, 3, {0.376676, 0.388602, 6.2604}},
      {false, 0, 8.2398e-4, 0.687633, 4, {0.656725, 0.716807, 0.869347, 3.09034}},
      {true, 0, 0.0200309, 0.357889, 3, {0.0522253, 0.05851, 0.0899281}},
      {true, 0.8, 0.00668344, 0.675241, 3, {0.202849, 1.09962, 1.25052}},
      {true, 0.8, 0.00122661, 0.704848, 4, {0.0330736, 0.0868234, 0.0936793, 0.101087}},
      {true, 0, 0.0505865, 0.977555, 5, {0.122293, 0.136323, 0.142326, 0.163989, 0.219017}},
  };
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    const bool two = cases[i].count == 2;
    struct subject subject = {.medium = {cases[i].sigma_a, cases[i].sigma_s_prime, 0, 1.4},
                              .design = usual_design(two ? CORE_MODEL_BETTER : CORE_MODEL_TRANSPORT,
                                                     cases[i].g, cases[i].count, cases[i].at)};
    subject.design.axis = cases[i].by_frequency ? CORE_FIT_AXIS_FREQUENCY : CORE_FIT_AXIS_RADIUS;
    subject.design.scale = two ? CORE_FIT_SCALE_ABSOLUTE : CORE_FIT_SCALE_FREE;
    model_readings(&subject.design, cases[i].sigma_a, cases[i].sigma_s_prime, subject.values);
    set_errors(&subject, 3e-4);
    const core_fit_result result = run_alone(&subject.design, subject.values, subject.errors);
    printf("case %zu: status %d, off by %.2g, chi-squared %.2g\n", i, (int)result.status,
           off(&subject, &result.best), result.best.chi_squared);
    assert_true(result.status != CORE_FIT_STATUS_FITTED || off(&subject, &result.best) < 1e-6);
  }
}

/* Ten readings with 3 % noise and an unknown factor, of sigma_a 0.024768 and sigma_s' 0.18937: chi-squared
 * of this medium is 10.79 and 10.99, which a fit has to reach. Other minima have 20. */
UNIT_TEST(a_noisy_set_with_a_free_factor_finds_the_better_minimum) {
  enum { COUNT = 10 };
  static const struct {
    double at[COUNT], values[COUNT], errors[COUNT], most;
  } cases[] = {
      {{1.098107, 2.079175, 2.347071, 2.501337, 2.59758, 2.932075, 3.340836, 7.267164, 7.781626,
        26.39179},
       {4.478940e-3, 1.816652e-3, 1.496697e-3, 1.279463e-3, 1.264209e-3, 1.021686e-3, 8.709075e-4,
        2.191445e-4, 1.882528e-4, 5.921181e-6},
       {9.755e-5, 3.637e-5, 7.175e-5, 3.923e-5, 2.451e-5, 2.537e-5, 2.083e-5, 4.856e-6, 6.108e-6,
        2.248e-7},
       10.79},
      {{1.00445, 1.341794, 3.525746, 4.464271, 5.918823, 14.68357, 22.58314, 25.58882, 27.1836,
        27.52739},
       {5.397677e-3, 3.595649e-3, 7.921901e-4, 5.794169e-4, 3.248023e-4, 4.557703e-5, 1.082771e-5,
        6.657477e-6, 5.607445e-6, 4.731882e-6},
       {2.343e-4, 7.700e-5, 4.744e-5, 3.689e-5, 7.026e-6, 2.401e-6, 4.052e-7, 3.316e-7, 2.18e-7,
        1.558e-7},
       10.99},
  };
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    core_fit_design design = usual_design(CORE_MODEL_TRANSPORT, 0, COUNT, cases[i].at);
    design.scale = CORE_FIT_SCALE_FREE;
    const core_fit_result result = run_alone(&design, cases[i].values, cases[i].errors);
    printf("case %zu: status %d, chi-squared %.4g\n", i, (int)result.status,
           result.best.chi_squared);
    assert_true(result.best.chi_squared < cases[i].most);
  }
}

/* The table of a model against profiles of single media, R and R(f). */
static void compare_table(unsigned model, unsigned axis, double g) {
  enum { PLACES = 8 };
  static const double ratios[] = {1e-4, 2e-3, 0.03, 0.4, 3};
  double at[PLACES], worst = 0;
  for (int i = 0; i < PLACES; i++) {
    at[i] = axis == CORE_FIT_AXIS_RADIUS ? 0.05 * pow(2, i) : 0.02 * i;
  }
  core_fit_design design = usual_design(model, g, PLACES, at);
  design.eta = 1.37;
  design.axis = axis;
  core_fit *fit = created(&design);
  for (size_t i = 0; i < sizeof ratios / sizeof ratios[0]; i++) {
    const core_medium medium = {1.3 * ratios[i], 1.3 / (1 - g), g, design.eta};
    core_profile profile = unit_profile(model, CORE_EVALUATOR_F64, &medium, NULL);
    double value[PLACES], modelled[PLACES];
    core_eval_f64(&profile, axis == CORE_FIT_AXIS_RADIUS ? CORE_QUANTITY_R : CORE_QUANTITY_TRANSFER,
                  PLACES, at, value);
    fit_model_readings(fit, medium.sigma_a_per_mm, 1.3, modelled);
    for (int k = 0; k < PLACES; k++) {
      const core_radii_range here = {at[k], at[k]};
      const double stated = core_profile_errors(&profile, CORE_QUANTITY_R, here).numerical;
      worst = fmax(worst, fabs(modelled[k] / value[k] - 1) - stated);
    }
    core_profile_free(&profile);
  }
  core_fit_free(fit);
  printf("the table of %s, axis %u, g %g: %.2g more than stated of a profile\n",
         core_choice_by_id(core_models, model)->name, axis, g, worst);
  assert_true(worst < FIT_TABLE_ERROR);
}

UNIT_TEST(the_table_is_the_model) {
  static const unsigned others[] = {
      CORE_MODEL_EXTENDED,         CORE_MODEL_QUANTIZED,     CORE_MODEL_BEAM,
      CORE_MODEL_SINGLE,           CORE_MODEL_BETTER_SINGLE, CORE_MODEL_EXTENDED_SINGLE,
      CORE_MODEL_QUANTIZED_SINGLE, CORE_MODEL_BEAM_SINGLE};
  compare_table(CORE_MODEL_TRANSPORT, CORE_FIT_AXIS_RADIUS, 0);
  compare_table(CORE_MODEL_TRANSPORT, CORE_FIT_AXIS_RADIUS, 0.8);
  compare_table(CORE_MODEL_TRANSPORT, CORE_FIT_AXIS_FREQUENCY, 0);
  compare_table(CORE_MODEL_TRANSPORT, CORE_FIT_AXIS_FREQUENCY, 0.9);
  compare_table(CORE_MODEL_BETTER, CORE_FIT_AXIS_FREQUENCY, 0);
  compare_table(CORE_MODEL_BURLEY, CORE_FIT_AXIS_FREQUENCY, 0);
  for (size_t i = 0; i < sizeof others / sizeof others[0]; i++) {
    compare_table(others[i], CORE_FIT_AXIS_RADIUS, 0);
    compare_table(others[i], CORE_FIT_AXIS_FREQUENCY, 0);
  }
}

/* ---- fibres ---------------------------------------------------------------------------------- */

/* Returns the mean of R over two discs from evenly spread pairs of points (Roberts 2018, the
 * sequence of the generalized golden ratio in four dimensions). */
static double mean_of_points(const core_profile *profile, double apart, double source,
                             double detector) {
  enum { PAIRS = 400000 };
  static double r[PAIRS], R[PAIRS];
  const double phi = 1.1673039782614187, two_pi = 6.28318530717958647693;
  for (int i = 0; i < PAIRS; i++) {
    double u[4], step = 1;
    for (int k = 0; k < 4; k++) {
      step /= phi;
      u[k] = fmod(0.5 + step * i, 1);
    }
    const double a = 0.5 * source * sqrt(u[0]), b = 0.5 * detector * sqrt(u[2]);
    r[i] = hypot(apart + b * cos(two_pi * u[3]) - a * cos(two_pi * u[1]),
                 b * sin(two_pi * u[3]) - a * sin(two_pi * u[1]));
  }
  core_eval_f64(profile, CORE_QUANTITY_R, PAIRS, r, R);
  double sum = 0;
  for (int i = 0; i < PAIRS; i++) {
    sum += R[i];
  }
  return sum / PAIRS;
}

UNIT_TEST(discs_have_the_mean_of_R) {
  static const double discs[][3] = {{1, .2, .2}, {.3, .2, .4}, {0, .4, .4},   {.1, .4, .2},
                                    {2, 0, 1},   {.5, .6, .4}, {.05, 1, 1.1}, {0, .2, 1}};
  static const core_medium media[] = {{.01, 1, 0, 1.4}, {1, 2, 0, 1.4}};
  for (size_t m = 0; m < 2; m++) {
    core_profile profile = unit_profile(CORE_MODEL_BETTER, CORE_EVALUATOR_F64, &media[m], NULL);
    for (size_t i = 0; i < sizeof discs / sizeof discs[0]; i++) {
      double at[FIT_DISC_NODES], weight[FIT_DISC_NODES], R[FIT_DISC_NODES], sum = 0;
      const size_t n = fit_disc_nodes(discs[i][0], discs[i][1], discs[i][2], at, weight);
      assert_int_equal(fit_disc_count(discs[i][0], discs[i][1], discs[i][2]), n);
      assert_true(n <= FIT_DISC_NODES);
      core_eval_f64(&profile, CORE_QUANTITY_R, n, at, R);
      for (size_t k = 0; k < n; k++) {
        sum += weight[k] * R[k];
      }
      const double truth = mean_of_points(&profile, discs[i][0], discs[i][1], discs[i][2]);
      UNIT_FAIL_IF(!(fabs(sum / truth - 1) < 3e-4), "discs %zu, medium %zu: %.8g, not %.8g", i, m,
                   sum, truth);
    }
  }
}

/* A point of light in the middle of a detector sees the energy within its radius: exact, with a
 * source as steep as transport's. */
UNIT_TEST(a_disc_around_a_point_has_the_energy_within) {
  static const core_medium media[] = {{.01, 1, 0, 1.4}, {.1, 5, .8, 1.33}, {.5, 20, .9, 1.4}};
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = 1e-3;
  for (size_t m = 0; m < 3; m++) {
    core_profile profile =
        unit_profile(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, &media[m], &parameters);
    for (double diameter = .02; diameter < 10; diameter *= 3) {
      double at[FIT_DISC_NODES], weight[FIT_DISC_NODES], R[FIT_DISC_NODES], sum = 0, within;
      const double radius = 0.5 * diameter;
      const size_t n = fit_disc_nodes(0, 0, diameter, at, weight);
      core_eval_f64(&profile, CORE_QUANTITY_R, n, at, R);
      core_eval_f64(&profile, CORE_QUANTITY_CDF, 1, &radius, &within);
      for (size_t k = 0; k < n; k++) {
        sum += weight[k] * R[k];
      }
      const double truth = within * profile.albedo / (3.14159265358979323846 * radius * radius);
      UNIT_FAIL_IF(!(fabs(sum / truth - 1) < 1e-4 + 2 * profile.numerical_error),
                   "medium %zu, diameter %g: %.8g, not %.8g: %.3g off", m, diameter, sum, truth,
                   sum / truth - 1);
    }
    core_profile_free(&profile);
  }
}

/* ---- with noise ------------------------------------------------------------------------------ */

static double normal(uint64_t *random) {
  const double u = unit_random_between(random, 1e-300, 1), v = unit_random_between(random, 0, 1);
  return sqrt(-2 * log(u)) * cos(6.28318530717958647693 * v);
}

/* Fits noisy sets, whose standard errors have to be right, and whose spread that of the bound of Cramer
 * and Rao, which is the covariance of the noiseless readings. It has a relative standard error of
 * 1 / sqrt(2 sets) itself, of which three are allowed besides the 5 %. */
static void expect_noise(unsigned scale, int count, double noise) {
  enum { MOST = 40, SETS = 1000 };
  double at[MOST], clean[MOST], errors[MOST], values[MOST];
  uint64_t random = unit_seed();
  for (int i = 0; i < count; i++) {
    at[i] = 0.3 * pow(20, i / (count - 1.0));
  }
  core_fit_design design = usual_design(CORE_MODEL_TRANSPORT, 0.8, (size_t)count, at);
  design.scale = scale;
  core_fit *fit = created(&design);
  fit_model_readings(fit, 0.02, 1.1, clean);
  for (int i = 0; i < count; i++) {
    errors[i] = noise * clean[i];
  }
  core_fit_result ideal, result;
  core_fit_run(fit, clean, errors, &ideal, NULL);
  double sum_a = 0, sum_s = 0, squares_a = 0, squares_s = 0;
  size_t one = 0, two = 0, told = 0;
  for (int n = 0; n < SETS; n++) {
    for (int i = 0; i < count; i++) {
      values[i] = clean[i] + errors[i] * normal(&random);
    }
    core_fit_run(fit, values, errors, &result, NULL);
    told += result.status == CORE_FIT_STATUS_FITTED;
    const double a = result.best.sigma_a_per_mm - 0.02;
    const double s = result.best.sigma_s_prime_per_mm - 1.1;
    sum_a += a;
    sum_s += s;
    squares_a += a * a;
    squares_s += s * s;
    one += (a * a < result.covariance.a_a) + (s * s < result.covariance.s_s);
    two += (a * a < 4 * result.covariance.a_a) + (s * s < 4 * result.covariance.s_s);
  }
  core_fit_free(fit);
  const double bound_a = sqrt(ideal.covariance.a_a), bound_s = sqrt(ideal.covariance.s_s);
  const double spread_a = sqrt((squares_a - sum_a * sum_a / SETS) / (SETS - 1)) / bound_a;
  const double spread_s = sqrt((squares_s - sum_s * sum_s / SETS) / (SETS - 1)) / bound_s;
  const double share_1 = (double)one / (2 * SETS), share_2 = (double)two / (2 * SETS);
  printf(
      "scale %u, %d readings, noise %g: spread %.3f and %.3f of the bound, bias %.2f and %.2f of "
      "it; %.1f %% within one error, %.1f %% within two\n",
      scale, count, noise, spread_a, spread_s, sum_a / SETS / bound_a, sum_s / SETS / bound_s,
      100 * share_1, 100 * share_2);
  assert_true(told > SETS * 98 / 100); /* noise may make a second medium fit as well */
  assert_true(fabs(share_1 - 0.683) < 0.04 && fabs(share_2 - 0.954) < 0.02);
  const double allowed = 0.05 + 3 / sqrt(2.0 * SETS);
  assert_true(fabs(spread_a - 1) < allowed && fabs(spread_s - 1) < allowed);
}

/* Readings at steady distances. */
static void space_out(struct subject *subject, size_t count) {
  *subject = (struct subject){.medium = {.05, 1, 0, 1.4}};
  subject->design = usual_design(CORE_MODEL_BETTER, 0, count, subject->at);
  for (size_t k = 0; k < count; k++) {
    subject->at[k] = 0.5 * (double)(k + 1);
  }
  evaluate(subject);
}

/* A walk that counts the light within an aperture alone gives back its coefficients within three of
 * their standard errors, with the scale absolute, so that the share counts, too. */
static void expect_aperture(double ratio, double g, double eta, double NA, uint64_t batches) {
  enum { RINGS = 24 };
  const double sigma_s = 1 / (1 + ratio * (1 - g)), sigma_a = 1 - sigma_s;
  const double unit = 1 / (sigma_a + sigma_s * (1 - g));
  core_mc_request request = montecarlo_request(sigma_s, g, eta);
  montecarlo_rings(&request, RINGS, 0.2 * unit, 8 * unit);
  request.aperture = NA;
  montecarlo_run run = montecarlo_run_batches(&request, batches);
  core_mc_ring rings[RINGS];
  core_mc_total_rings(run.total, 0, CORE_MC_REFLECTED, rings);
  montecarlo_run_free(&run);
  double at[RINGS], values[RINGS], errors[RINGS];
  for (size_t i = 0; i < RINGS; i++) {
    at[i] = sqrt(rings[i].from_mm * rings[i].to_mm);
    values[i] = rings[i].R_per_mm2;
    errors[i] = rings[i].error_per_mm2;
  }
  core_fit_design design = usual_design(CORE_MODEL_TRANSPORT, g, RINGS, at);
  design.eta = eta;
  design.detector_na = NA;
  const core_fit_result result = run_alone(&design, values, errors);
  const double off_a = (result.best.sigma_a_per_mm - sigma_a) / sqrt(result.covariance.a_a);
  const double off_s =
      (result.best.sigma_s_prime_per_mm - sigma_s * (1 - g)) / sqrt(result.covariance.s_s);
  printf("aperture %.2f, eta %g, g %g, ratio %g: off by %.1f and %.1f errors, chi-squared %.2f\n",
         NA, eta, g, ratio, off_a, off_s, result.reduced_chi_squared);
  assert_int_equal(result.status, CORE_FIT_STATUS_FITTED);
  assert_true(fabs(off_a) < 3 && fabs(off_s) < 3);
}

UNIT_TEST(light_within_an_aperture_gives_back_its_coefficients) {
  expect_aperture(0.01, 0, 1.4, 0.22, 400);
  expect_aperture(0.2, 0, 1.33, 0.39, 400);
  expect_aperture(0.1, 0.5, 0.95, 0.15, 200);
  expect_aperture(0.05, 0.8, 1.4, 0.5, 100);
}

/* The aperture of a known medium is that of its own g and eta, and what is detected of both at all
 * angles is R. */
UNIT_TEST(apertures_of_designs) {
  static const double at[] = {0.3, 1, 3};
  core_fit_design design = usual_design(CORE_MODEL_TRANSPORT, 0.5, 3, at);
  double all[3], narrow[3], known[3], ratio[3];
  model_readings(&design, 0.1, 1, all);
  design.detector_na = 1;
  model_readings(&design, 0.1, 1, narrow);
  assert_memory_equal(all, narrow, sizeof all);
  design.detector_na = 0.3;
  model_readings(&design, 0.1, 1, narrow);
  for (size_t i = 0; i < 3; i++) {
    assert_true(narrow[i] > 0.09 * 0.5 * all[i] && narrow[i] < 0.09 * 1.5 * all[i]);
  }
  design.g = 0;
  design.eta = 1.2;
  model_readings(&design, 0.02, 2, known);
  design.g = 0.5;
  design.eta = 1.4;
  design.scale = CORE_FIT_SCALE_REFERENCE;
  design.reference = (core_medium){0.02, 2, 0, 1.2};
  model_readings(&design, 0.1, 1, ratio);
  for (size_t i = 0; i < 3; i++) {
    assert_true(fabs(ratio[i] * known[i] / narrow[i] - 1) < 3e-4);
  }
}

/* A set is implausible from that chi-squared on whose probability is 1e-6. For 2 and 10 readings more
 * than unknowns the limits follow from e^(-x / 2) sum (x / 2)^i / i!, for 1 from tables. */
UNIT_TEST(wrong_errors_are_implausible) {
  static const struct {
    size_t readings;
    double limit;
  } rows[] = {{2, 23.928127}, {3, 23.928127}, {4, 27.631021}, {12, 46.863047}};
  struct subject subject;
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    space_out(&subject, rows[i].readings);
    core_fit *fit = created(&subject.design);
    UNIT_FAIL_IF(!(fabs(fit->chi_squared_most / rows[i].limit - 1) < 1e-7),
                 "%zu readings: chi-squared up to %.9g", rows[i].readings, fit->chi_squared_most);
    core_fit_free(fit);
  }
  /* Two readings are half a percent too large, first with errors of 1 %, then of 0.01 %. */
  space_out(&subject, 6);
  subject.values[0] *= 1.005;
  subject.values[5] *= 1.005;
  set_errors(&subject, 1e-2);
  assert_int_equal(fitted(&subject).status, CORE_FIT_STATUS_FITTED);
  set_errors(&subject, 1e-4);
  const core_fit_result result = fitted(&subject);
  assert_int_equal(result.status, CORE_FIT_STATUS_IMPLAUSIBLE);
  assert_true(result.reduced_chi_squared > 10 && isfinite(result.best.sigma_a_per_mm));
}

/* R of every medium falls with the distance. Readings that rise say nothing of a medium, whatever
 * the search comes to; but ratios to a medium that absorbs more rise, and large errors allow it. */
UNIT_TEST(readings_that_rise_with_the_distance_are_implausible) {
  static const unsigned models[] = {CORE_MODEL_TRANSPORT, CORE_MODEL_BETTER, CORE_MODEL_BURLEY};
  static const double at[] = {2, 1, 4, 8}, discs[] = {0.4, 0.4, 0.4, 0.4};
  static const double rising[] = {0.01, 0.001, 0.1, 1}, falling[] = {0.01, 0.03, 0.002, 0.0002};
  struct subject subject = {.design = usual_design(0, 0, 4, at)};
  core_fit_design *design = &subject.design;
  for (size_t i = 0; i < sizeof models / sizeof models[0]; i++) {
    design->model = models[i];
    for (int k = 0; k < 4; k++) {
      design->scale = k % 2 == 0 ? CORE_FIT_SCALE_ABSOLUTE : CORE_FIT_SCALE_FREE;
      design->source_mm = k < 2 ? NULL : discs;
      memcpy(subject.values, rising, sizeof rising);
      set_errors(&subject, 0.1);
      const core_fit_result result = fitted(&subject);
      assert_int_equal(result.status, CORE_FIT_STATUS_IMPLAUSIBLE);
      assert_true(result.best.chi_squared > 24);
      set_errors(&subject, 1);
      assert_int_not_equal(fitted(&subject).status, CORE_FIT_STATUS_IMPLAUSIBLE);
      memcpy(subject.values, falling, sizeof falling);
      set_errors(&subject, 1);
      assert_int_not_equal(fitted(&subject).status, CORE_FIT_STATUS_IMPLAUSIBLE);
    }
    design->source_mm = NULL;
    design->scale = CORE_FIT_SCALE_REFERENCE;
    design->reference = (core_medium){0.1, 1, 0, 1.4};
    core_fit *fit = created(design);
    fit_model_readings(fit, 0.01, 1, subject.values);
    assert_true(subject.values[3] > 2 * subject.values[2] && subject.values[2] > subject.values[0]);
    set_errors(&subject, 0.01);
    assert_int_equal(refined(fit, &subject).status, CORE_FIT_STATUS_FITTED);
    core_fit_free(fit);
  }
}

/* ---- the inverse of two readings ------------------------------------------------------------- */

static bool is_same(double a, double b, double within) {
  return (isnan(a) && isnan(b)) || fabs(a - b) <= within * fabs(b);
}

/* Fits sets of two readings with the inverse and without it. They give the same status, medium and
 * second medium, whatever the noise. */
static void compare_inverse(const core_fit_design *design, const double places[2], size_t count,
                            uint64_t *random) {
  core_fit *fit = created(design);
  assert_non_null(fit->inverse);
  struct core_fit full = *fit; /* shares everything but the inverse */
  full.inverse = NULL;
  size_t inverted = 0, fitted_sets = 0;
  double worst = 0;
  for (size_t i = 0; i < count; i++) {
    double values[2], errors[2];
    const double ratio = unit_random_log(random, 1e-4, 5);
    const double scattering = unit_random_log(random, 0.03, 30);
    const double relative = unit_random_log(random, 1e-3, 0.2);
    fit_model_readings(fit, ratio * scattering, scattering, values);
    for (int k = 0; k < 2; k++) {
      errors[k] = relative * values[k];
      values[k] = fmax(values[k] + 1.5 * errors[k] * normal(random), 0);
    }
    core_fit_result one, other;
    struct fit_place start;
    inverted += fit_inverse_start(fit->inverse, values, errors, &start);
    core_fit_run(fit, values, errors, &one, NULL);
    core_fit_run(&full, values, errors, &other, NULL);
    fitted_sets += other.status == CORE_FIT_STATUS_FITTED;
    const double within = 1e-9 * fmax(other.condition, 1);
    worst = fmax(worst, fabs(one.best.sigma_a_per_mm / other.best.sigma_a_per_mm - 1));
    UNIT_FAIL_IF(
        one.status != other.status ||
            !is_same(one.best.sigma_a_per_mm, other.best.sigma_a_per_mm, within) ||
            !is_same(one.best.sigma_s_prime_per_mm, other.best.sigma_s_prime_per_mm, within) ||
            !is_same(one.second.sigma_a_per_mm, other.second.sigma_a_per_mm, 1e-4),
        "at %g and %g, readings %.17g and %.17g, errors of %g: %d, %.12g, %.12g, second %g; "
        "without the inverse %d, %.12g, %.12g, second %g",
        places[0], places[1], values[0], values[1], relative, (int)one.status,
        one.best.sigma_a_per_mm, one.best.sigma_s_prime_per_mm, one.second.chi_squared,
        (int)other.status, other.best.sigma_a_per_mm, other.best.sigma_s_prime_per_mm,
        other.second.chi_squared);
  }
  printf("at %g and %g: %zu of %zu by the inverse, %zu fitted, off by %.2g at most\n", places[0],
         places[1], inverted, count, fitted_sets, worst);
  core_fit_free(fit);
}

UNIT_TEST(the_inverse_gives_what_the_search_gives) {
  static const struct {
    unsigned axis;
    double g, eta;
    double at[2];
  } rows[] = {{CORE_FIT_AXIS_FREQUENCY, 0, 1.4, {0, 0.2}},
              {CORE_FIT_AXIS_FREQUENCY, 0.8, 1.33, {0, 0.1}},
              {CORE_FIT_AXIS_FREQUENCY, 0.9, 1.4, {0.05, 0.4}},
              {CORE_FIT_AXIS_FREQUENCY, -0.3, 1, {0.1, 0.12}},
              {CORE_FIT_AXIS_RADIUS, 0, 1.4, {0.5, 3}},
              {CORE_FIT_AXIS_RADIUS, 0.8, 1.5, {0.2, 0.6}}};
  uint64_t random = unit_seed();
  for (size_t i = 0; i < 2 * sizeof rows / sizeof rows[0]; i++) {
    const bool reference = i % 2 == 1;
    const double g = rows[i / 2].g, eta = rows[i / 2].eta;
    core_fit_design design = usual_design(CORE_MODEL_TRANSPORT, g, 2, rows[i / 2].at);
    design.eta = eta;
    design.axis = rows[i / 2].axis;
    design.scale = reference ? CORE_FIT_SCALE_REFERENCE : CORE_FIT_SCALE_ABSOLUTE;
    design.reference = (core_medium){.05, 1 / (1 - g), g, eta};
    compare_inverse(&design, rows[i / 2].at, (unit_is_long() ? 10 : 2) * sets(), &random);
  }
}

UNIT_TEST(noise_of_2_percent_spreads_as_the_bound) {
  expect_noise(CORE_FIT_SCALE_ABSOLUTE, 10, 0.02);
  expect_noise(CORE_FIT_SCALE_FREE, 40, 0.02);
}

/* A slab is fitted at any scale, though many of the media that are tried are too thin for its model. */
UNIT_TEST(slabs_a_fraction_of_a_mm_thick_come_back) {
  static const double thickness_mm[] = {0.15, 1.5, 3}, paths = 3;
  static const unsigned models[] = {CORE_MODEL_MULTIPOLE, CORE_MODEL_BETTER_MULTIPOLE_TRANSMITTED};
  for (size_t i = 0; i < 6; i++) {
    const double sigma_t = paths / thickness_mm[i % 3];
    struct subject subject = {
        .medium = {.05 * sigma_t, .95 * sigma_t, 0, 1.4, thickness_mm[i % 3]}};
    subject.design = usual_design(models[i / 3], 0, 4, subject.at);
    subject.design.thickness_mm = thickness_mm[i % 3];
    for (size_t k = 0; k < 4; k++) {
      subject.at[k] = (2 + 2.5 * (double)k) / sigma_t;
    }
    evaluate(&subject);
    set_errors(&subject, 0.01);
    const core_fit_result result = fitted(&subject);
    assert_int_equal(result.status, CORE_FIT_STATUS_FITTED);
    assert_true(off(&subject, &result.best) < 1e-6);
  }
}
