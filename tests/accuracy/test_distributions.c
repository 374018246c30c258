/* Every model's density of radii, its cdf and its sampler, against each other: the density
 * integrates to 1 and to the cdf, drawn radii follow it, and single precision agrees with double.
 */
#include <math.h>

#include "tests/unit/unit.h"

static const core_medium media[] = {
    {0.032, 0.74, 0, 1.3}, {0.02, 2, 0.5, 1}, {1, 1.5, -0.3, 0.8}, {1e-4, 0.3, 0.9, 1.7}};
enum { MEDIA = sizeof media / sizeof media[0] };

typedef void profile_test(const core_profile *f64, const core_profile *f32, uint64_t *random);

static void with_every_model(profile_test *test) {
  uint64_t random = unit_seed();
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    for (size_t i = 0; i < MEDIA; i++) {
      const core_parameters parameters = unit_parameters(model->id, &media[i]);
      core_profile f64, f32;
      unit_assert_fault(core_profile_prepare(&f64, core_isa_select(NULL), model->id,
                                             CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &media[i],
                                             &parameters),
                        NULL, 0);
      unit_assert_fault(core_profile_prepare(&f32, core_isa_select(NULL), model->id,
                                             CORE_MOMENTS_EXACT, CORE_EVALUATOR_F32, &media[i],
                                             &parameters),
                        NULL, 0);
      test(&f64, &f32, &random);
      core_profile_free(&f64);
      core_profile_free(&f32);
    }
  }
}

static const char *name_of(const core_profile *profile) {
  return core_choice_by_id(core_models, profile->model)->name;
}

static double value_of(const core_profile *profile, enum core_quantity quantity, double r) {
  double value;
  core_eval_f64(profile, quantity, 1, &r, &value);
  return value;
}

/* ---- the density ------------------------------------------------------------------------------ */

/* Over ln r the density r pdf is smooth and ends exponentially on both sides: the trapezoidal rule.
 */
enum { STEPS = 6000 };

static double step_radius(const core_profile *profile, int i) {
  return profile->scale_mm * exp(-30 + 60.0 * i / STEPS);
}

static void check_density(const core_profile *f64, const core_profile *f32, uint64_t *random) {
  (void)f32;
  (void)random;
  const double step = 60.0 / STEPS;
  double sum = 0;
  double last = 0;
  double worst = 0;
  for (int i = 0; i <= STEPS; i++) {
    const double r = step_radius(f64, i);
    const double share = r * value_of(f64, CORE_QUANTITY_PDF, r) * step;
    const double cdf = value_of(f64, CORE_QUANTITY_CDF, r);
    sum += share;
    worst = fmax(worst, fabs(sum - 0.5 * share - cdf));
    if (!(cdf >= last - 1e-13 && cdf <= 1)) {
      fail_msg("%s: the cdf at %g is %.17g after %.17g", name_of(f64), r, cdf, last);
    }
    last = cdf;
    const double ring = value_of(f64, CORE_QUANTITY_RING, r);
    const double R = value_of(f64, CORE_QUANTITY_R, r);
    if (!(fabs(ring - 2 * acos(-1) * r * R) <= 1e-13 * ring + 1e-290)) {
      fail_msg("%s: 2 pi r R at %g is %g", name_of(f64), r, ring);
    }
  }
  if (!(fabs(sum - 1) < 1e-6 && worst < 1e-4)) {
    fail_msg("%s: the density adds up to %.9f, and strays from the cdf by %.2g", name_of(f64), sum,
             worst);
  }
}

UNIT_TEST(every_density_integrates_to_1_and_to_the_cdf) {
  with_every_model(check_density);
}

/* The derivative by central differences, where R is smooth and neither end is near. */
static void check_slope(const core_profile *f64, const core_profile *f32, uint64_t *random) {
  (void)f32;
  for (int i = 0; i < 40; i++) {
    const double r = f64->scale_mm * unit_random_log(random, 1e-3, 20);
    const double h = 1e-4 * r;
    const double up = value_of(f64, CORE_QUANTITY_R, r + h) - value_of(f64, CORE_QUANTITY_R, r - h);
    const double far =
        value_of(f64, CORE_QUANTITY_R, r + 2 * h) - value_of(f64, CORE_QUANTITY_R, r - 2 * h);
    const double slope = (8 * up - far) / (12 * h);
    const double R = value_of(f64, CORE_QUANTITY_R, r);
    const double value = value_of(f64, CORE_QUANTITY_SLOPE, r);
    if (!(fabs(value - slope) <= 1e-8 * fabs(slope) + 1e-10 * R / r)) {
      fail_msg("%s: dR/dr at %g is %.12g, by differences %.12g", name_of(f64), r, value, slope);
    }
    const double ln_R = value_of(f64, CORE_QUANTITY_LN_R, r);
    if (R > 1e-300 && !(fabs(ln_R - log(R)) < 1e-11)) {
      fail_msg("%s: ln R at %g is %.15g, not %.15g", name_of(f64), r, ln_R, log(R));
    }
  }
}

UNIT_TEST(every_slope_is_the_derivative) {
  with_every_model(check_slope);
}

/* ---- the sampler ------------------------------------------------------------------------------ */

enum { BINS = 24, SAMPLES = 24000, ROUND_TRIPS = 300 };

/* The chance of each bin, from the density alone. Bins lie between radii in equal ratios. */
static void integrate_bins(const core_profile *profile, const double *edges, double *chances) {
  enum { NODES = 400 };
  double inside = 0;
  for (int bin = 1; bin < BINS - 1; bin++) {
    const double low = log(edges[bin - 1]);
    const double step = (log(edges[bin]) - low) / NODES;
    chances[bin] = 0;
    for (int i = 0; i <= NODES; i++) {
      const double r = exp(low + i * step);
      const double weight = i == 0 || i == NODES ? 1 : i % 2 ? 4 : 2;
      chances[bin] += weight * r * value_of(profile, CORE_QUANTITY_PDF, r) * step / 3;
    }
    inside += chances[bin];
  }
  /* the two open ends share what is left as the first one's integral says */
  chances[0] = 0;
  const double low = log(edges[0]) - 40;
  for (int i = 0; i <= 4000; i++) {
    const double r = exp(low + i * 0.01);
    chances[0] +=
        (i == 0 || i == 4000 ? 0.5 : 1) * r * value_of(profile, CORE_QUANTITY_PDF, r) * 0.01;
  }
  chances[BINS - 1] = 1 - inside - chances[0];
}

static double chi_squared(const double *chances, const size_t *counts, int *freedom) {
  double sum = 0;
  *freedom = -1;
  for (int bin = 0; bin < BINS; bin++) {
    const double expected = chances[bin] * SAMPLES;
    if (expected >= 5) {
      sum += ((double)counts[bin] - expected) * ((double)counts[bin] - expected) / expected;
      ++*freedom;
    }
  }
  return sum;
}

static void count_samples(const core_profile *profile, uint64_t *random, const double *edges,
                          size_t *counts) {
  static double u[SAMPLES], r[SAMPLES];
  static float u32[SAMPLES], r32[SAMPLES];
  for (int i = 0; i < SAMPLES; i++) {
    u[i] = unit_random_between(random, 0, 1);
    u32[i] = (float)u[i];
  }
  if (profile->evaluator == CORE_EVALUATOR_F64) {
    core_sample_f64(profile, SAMPLES, u, r);
  } else {
    core_sample_f32(profile, SAMPLES, u32, r32);
    for (int i = 0; i < SAMPLES; i++) {
      r[i] = (double)r32[i];
    }
  }
  for (int i = 0; i < SAMPLES; i++) {
    int bin = 0;
    while (bin < BINS - 1 && r[i] >= edges[bin]) {
      bin++;
    }
    counts[bin]++;
  }
}

/* Wilson and Hilferty 1931: the cube root of chi squared over its degrees of freedom is nearly
 * normal. 4.5 standard deviations: about one in 300,000. */
static void check_samples(const core_profile *profile, const double *edges, const double *chances,
                          uint64_t *random) {
  size_t counts[BINS] = {0};
  int freedom;
  count_samples(profile, random, edges, counts);
  const double chi = chi_squared(chances, counts, &freedom);
  assert_true(freedom >= 8);
  const double spread = 2.0 / (9 * freedom);
  const double deviation = (cbrt(chi / freedom) - (1 - spread)) / sqrt(spread);
  if (!(deviation < 4.5)) {
    fail_msg("%s: chi squared of the samples is %.1f for %d degrees of freedom", name_of(profile),
             chi, freedom);
  }
}

static void check_sampler(const core_profile *f64, const core_profile *f32, uint64_t *random) {
  double edges[BINS - 1], chances[BINS];
  for (int i = 0; i < BINS - 1; i++) {
    edges[i] = f64->scale_mm * exp(-4 + 8.0 * i / (BINS - 2));
  }
  integrate_bins(f64, edges, chances);
  check_samples(f64, edges, chances, random);
  check_samples(f32, edges, chances, random);
}

UNIT_TEST(every_sampler_follows_its_density) {
  with_every_model(check_sampler);
}

/* |cdf(inverse(u)) - u|, from the smallest u to 1 - 1e-7. */
static void check_round_trip(const core_profile *f64, const core_profile *f32, uint64_t *random) {
  for (int i = 0; i < ROUND_TRIPS; i++) {
    const double u = i % 3 == 0   ? unit_random_log(random, 1e-12, 1)
                     : i % 3 == 1 ? unit_random_between(random, 0, 1)
                                  : 1 - unit_random_log(random, 1e-7, 1);
    double r;
    core_sample_f64(f64, 1, &u, &r);
    const double error = fabs(value_of(f64, CORE_QUANTITY_CDF, r) - u);
    if (!(error <= CORE_SAMPLE_ERROR_F64 + 1e-12)) {
      fail_msg("%s: cdf(inverse(%.17g)) is off by %.2g", name_of(f64), u, error);
    }
    const float u32 = (float)u;
    float r32;
    core_sample_f32(f32, 1, &u32, &r32);
    const double error32 = fabs(value_of(f64, CORE_QUANTITY_CDF, (double)r32) - (double)u32);
    if (u32 < 1 && !(error32 <= CORE_SAMPLE_ERROR_F32)) {
      fail_msg("%s: single precision cdf(inverse(%.9g)) is off by %.2g", name_of(f64), u, error32);
    }
  }
}

UNIT_TEST(every_sampler_inverts_its_cdf) {
  with_every_model(check_round_trip);
}

/* ---- single precision ------------------------------------------------------------------------- */

static void check_single(const core_profile *f64, const core_profile *f32, uint64_t *random) {
  for (int i = 0; i < 200; i++) {
    const float r32 = (float)(f64->scale_mm * unit_random_log(random, 1e-3, 30));
    const double r = (double)r32;
    static const enum core_quantity quantities[] = {CORE_QUANTITY_R, CORE_QUANTITY_CDF,
                                                    CORE_QUANTITY_RING, CORE_QUANTITY_PDF};
    for (size_t q = 0; q < sizeof quantities / sizeof quantities[0]; q++) {
      float value;
      core_eval_f32(f32, quantities[q], 1, &r32, &value);
      const double truth = value_of(f64, quantities[q], r);
      const double bound = f32->numerical_error + f32->numerical_error_per_mm * r;
      if (!(fabs((double)value - truth) <= 2 * bound * truth + 1e-43)) {
        fail_msg("%s: in single precision at %g: %.9g, not %.9g", name_of(f64), r, (double)value,
                 truth);
      }
    }
  }
}

UNIT_TEST(single_precision_agrees_with_double) {
  with_every_model(check_single);
}
