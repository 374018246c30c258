/* Every model's density of radii and its cdf against each other, and its slope against differences.
 * truth.c has samples, and single precision. */
#include <math.h>

#include "tests/unit/unit.h"

static const core_medium media[] = {
    {0.032, 0.74, 0, 1.3}, {0.02, 2, 0.5, 1}, {1, 1.5, -0.3, 0.8}, {1e-4, 0.3, 0.9, 1.7}};
enum { MEDIA = sizeof media / sizeof media[0] };

/* Those of all models and media, prepared once for all tests. */
static core_profile profiles[UNIT_ROWS_MAX * MEDIA];
static size_t profile_count;

static void prepare(core_profile *profile, unsigned model, const core_medium *medium) {
  core_parameters parameters = core_parameters_none();
  const core_medium needed = unit_medium(model, medium);
  if (model == CORE_MODEL_TRANSPORT_TRANSMITTED) {
    parameters.value[CORE_PARAMETER_TOLERANCE] = 1e-3;
  }
  *profile = unit_profile(model, CORE_EVALUATOR_F64, &needed, &parameters);
}

UNIT_SETUP(prepare_all) {
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    const bool solved = model->id == CORE_MODEL_TRANSPORT_TRANSMITTED; /* which takes seconds */
    const size_t step = !solved ? 1 : unit_is_long() ? 2 : MEDIA;
    for (size_t i = 0; i < MEDIA; i += step) {
      prepare(&profiles[profile_count++], model->id, &media[i]);
    }
  }
}

UNIT_TEARDOWN(free_all) {
  while (profile_count > 0) {
    core_profile_free(&profiles[--profile_count]);
  }
}

typedef void profile_test(const core_profile *profile, uint64_t *random);

static void with_every_model(profile_test *test) {
  uint64_t random = unit_seed();
  for (size_t i = 0; i < profile_count; i++) {
    test(&profiles[i], &random);
  }
}

static const char *name_of(const core_profile *profile) {
  return core_choice_by_id(core_models, profile->model)->name;
}

/* ---- the density ------------------------------------------------------------------------------ */

/* Over ln r the density r pdf is smooth and ends exponentially on both sides: the trapezoidal rule.
 */
enum { STEPS = 6000 };

static void check_density(const core_profile *f64, uint64_t *random) {
  (void)random;
  static double r[STEPS + 1], R[STEPS + 1], cdf[STEPS + 1], pdf[STEPS + 1], ring[STEPS + 1];
  const double step = 60.0 / STEPS;
  for (int i = 0; i <= STEPS; i++) {
    r[i] = f64->scale_mm * exp(-30 + i * step);
  }
  core_eval_f64(f64, CORE_QUANTITY_R, STEPS + 1, r, R);
  core_eval_f64(f64, CORE_QUANTITY_CDF, STEPS + 1, r, cdf);
  core_eval_f64(f64, CORE_QUANTITY_PDF, STEPS + 1, r, pdf);
  core_eval_f64(f64, CORE_QUANTITY_RING, STEPS + 1, r, ring);
  const bool solved = f64->model == CORE_MODEL_TRANSPORT_TRANSMITTED;
  double sum = 0, worst = 0, off = 0;
  for (int i = 0; i <= STEPS; i++) {
    const double share = r[i] * pdf[i] * step;
    const double last = i > 0 ? cdf[i - 1] : 0;
    sum += share;
    if (solved) { /* beyond its reach T is not known: its error is infinite, and T negligible */
      const core_radii_range at = {r[i], r[i]};
      off += share * fmin(core_profile_errors(f64, CORE_QUANTITY_R, at).numerical, 1);
    }
    worst = fmax(worst, fabs(sum - 0.5 * share - cdf[i]));
    UNIT_FAIL_IF(!(cdf[i] >= last - 1e-13 && cdf[i] <= 1), "%s: the cdf at %g is %.17g after %.17g",
                 name_of(f64), r[i], cdf[i], last);
    if (!(fabs(ring[i] - 2 * acos(-1) * r[i] * R[i]) <= 1e-13 * ring[i] + 1e-290)) {
      fail_msg("%s: 2 pi r R at %g is %g", name_of(f64), r[i], ring[i]);
    }
  }
  /* T and the total of layers come from different parts of a solution: T counts by its error. */
  UNIT_FAIL_IF(!(fabs(sum - 1) < (solved ? 1e-4 : 1e-6) + off && worst < 1e-4 + off),
               "%s: the density adds up to %.9f, and strays from the cdf by %.2g", name_of(f64),
               sum, worst);
}

UNIT_TEST(every_density_integrates_to_1_and_to_the_cdf) {
  with_every_model(check_density);
}

/* The derivative by central differences, where R is smooth and neither end is near. */
static void check_slope(const core_profile *f64, uint64_t *random) {
  enum { RADII = 40, STENCIL = 5 };
  double r[RADII][STENCIL], R[RADII][STENCIL], value[RADII][STENCIL], ln_R[RADII][STENCIL];
  for (int i = 0; i < RADII; i++) {
    const double middle = f64->scale_mm * unit_random_log(random, 1e-3, 20);
    for (int j = 0; j < STENCIL; j++) {
      r[i][j] = middle + (j - 2) * (1e-4 * middle);
    }
  }
  core_eval_f64(f64, CORE_QUANTITY_R, RADII * STENCIL, r[0], R[0]);
  core_eval_f64(f64, CORE_QUANTITY_SLOPE, RADII * STENCIL, r[0], value[0]);
  core_eval_f64(f64, CORE_QUANTITY_LN_R, RADII * STENCIL, r[0], ln_R[0]);
  for (int i = 0; i < RADII; i++) {
    const double h = 1e-4 * r[i][2];
    const double slope = (8 * (R[i][3] - R[i][1]) - (R[i][4] - R[i][0])) / (12 * h);
    UNIT_FAIL_IF(!(fabs(value[i][2] - slope) <= 1e-8 * fabs(slope) + 1e-10 * R[i][2] / r[i][2]),
                 "%s: dR/dr at %g is %.12g, by differences %.12g", name_of(f64), r[i][2],
                 value[i][2], slope);
    if (R[i][2] > 1e-300 && !(fabs(ln_R[i][2] - log(R[i][2])) < 1e-11)) {
      fail_msg("%s: ln R at %g is %.15g, not %.15g", name_of(f64), r[i][2], ln_R[i][2],
               log(R[i][2]));
    }
  }
}

UNIT_TEST(every_slope_is_the_derivative) {
  with_every_model(check_slope);
}

/* ---- the unit of length ------------------------------------------------------------------------ */

/* A medium in another unit has the same values and the same stated errors, in that unit: what is per mm
 * is so of every number. Powers of two change no digit. */
static void check_unit(const core_profile *profile, uint64_t *random) {
  enum { UNIT = 1024 };
  if (strncmp(name_of(profile), "skin-", 5) == 0) {
    return; /* numbers of one medium */
  }
  core_medium scaled = profile->medium;
  scaled.sigma_a_per_mm *= UNIT;
  scaled.sigma_s_per_mm *= UNIT;
  scaled.thickness_mm /= UNIT;
  core_profile other;
  prepare(&other, profile->model, &scaled);
  const double r_mm = profile->scale_mm * unit_random_log(random, 0.1, 5);
  const double at[] = {r_mm}, there[] = {r_mm / UNIT};
  core_radii_range range, range_there;
  core_radii_check_f64(1, at, &range);
  core_radii_check_f64(1, there, &range_there);
  const core_stated_errors here = core_profile_errors(profile, CORE_QUANTITY_R, range);
  const core_stated_errors same = core_profile_errors(&other, CORE_QUANTITY_R, range_there);
  const double value = unit_value_at(profile, CORE_QUANTITY_R, r_mm);
  const double value_there = unit_value_at(&other, CORE_QUANTITY_R, r_mm / UNIT);
  UNIT_FAIL_IF(!(fabs(same.numerical - here.numerical) <= 1e-3 * here.numerical &&
                 fabs(same.numerical_per_mm / UNIT - here.numerical_per_mm) <=
                     1e-3 * here.numerical_per_mm &&
                 fabs(value_there / UNIT / UNIT / value - 1) <= 2 * here.numerical + 1e-12),
               "%s: error %g and %g, per mm %g and %g, R %g and %g", name_of(profile),
               here.numerical, same.numerical, here.numerical_per_mm, same.numerical_per_mm / UNIT,
               value, value_there / UNIT / UNIT);
  core_profile_free(&other);
}

UNIT_TEST(errors_do_not_depend_on_the_unit_of_length) {
  with_every_model(check_unit);
}
