/* What tables are like, whatever their tolerance: the cdf never turns back, samples keep the order
 * of their numbers, and the ends of all functions are those of the model; and which are refused.
 * truth.c compares all that they hold with the models. */
#include <float.h>
#include <math.h>

#include "core/kernels.h"
#include "core/lut/lut.h"
#include "tests/unit/unit.h"

static const double pi = 3.14159265358979323846;

/* Towards the source R is like 1 / r, like -ln r, or constant. Far away it falls like 1 / r^3, or
 * underflows. */
static const struct {
  unsigned model;
  core_medium medium;
} subjects[] = {
    {CORE_MODEL_BETTER, {0.032, 0.74, 0, 1.3}},
    {CORE_MODEL_BETTER, {0, 1, 0, 1.3}},
    {CORE_MODEL_BETTER, {1e3, 1, 0, 0.7}},
    {CORE_MODEL_BETTER, {1e10, 1e12, 0, 1.3}},
    {CORE_MODEL_BURLEY, {0.032, 0.74, 0, 1.3}},
    {CORE_MODEL_SKIN_RED, {0.032, 0.74, 0, 1.3}},
    {CORE_MODEL_EXTENDED, {1e-14, 1e-12, 0, 1.3}},
    {CORE_MODEL_BEAM, {0.024310505952361242, 1, 0, 1.3}}, /* keep_order_at_first_u() is needed */
    {CORE_MODEL_BEAM, {0, 1, 0, 1.3}},
    {CORE_MODEL_BETTER_SINGLE, {0.48, 1.01, 0.5, 1.4}},
    {CORE_MODEL_MULTIPOLE_TRANSMITTED, {0.032, 0.74, 0, 1.3}},
    {CORE_MODEL_TRANSPORT, {0.032, 0.74, 0, 1.3}},
};
enum { SUBJECTS = sizeof subjects / sizeof subjects[0] };

static core_fault table_prepare(core_profile *table, unsigned model, const core_medium *medium,
                                double tolerance) {
  const core_medium needed = unit_medium(model, medium);
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
  return core_profile_prepare(table, core_isa_select(NULL), model, CORE_MOMENTS_EXACT,
                              CORE_EVALUATOR_LUT, &needed, &parameters);
}

/* Returns the relative error of a value in single precision; 0 if it is no more than core.h allows
 * for underflow. */
static double table_error(float value, double truth) {
  const double off = fabs((double)value - truth);
  if (off <= 16 * 0x1p-149) {
    return 0;
  }
  /* What is too large for single precision is infinite in it, or next to that. */
  const double error =
      fmin(truth, (double)FLT_MAX) == (double)FLT_MAX && isinf(value) ? 0 : off / truth;
  return isnan(error) ? (double)INFINITY : error;
}

/* A table, and the model that it was made from. */
struct pair {
  core_profile table;
  const core_profile *model;
  double tolerance;
  double mfp_mm;
};

static const double tolerances[] = {1e-3, 1e-6};
enum { PAIRS = 2 * SUBJECTS };
static struct pair pairs[PAIRS];

UNIT_SETUP(prepare_all) {
  for (size_t i = 0; i < PAIRS; i++) {
    const core_medium *medium = &subjects[i / 2].medium;
    struct pair *pair = &pairs[i];
    pair->tolerance = tolerances[i % 2];
    pair->mfp_mm = 1 / core_sigma_t_prime(medium);
    unit_accept(table_prepare(&pair->table, subjects[i / 2].model, medium, pair->tolerance));
    pair->model = pair->table.source;
  }
}

UNIT_TEARDOWN(free_all) {
  for (size_t i = 0; i < PAIRS; i++) {
    core_profile_free(&pairs[i].table);
  }
}

typedef void pair_test(const struct pair *pair, uint64_t *random);

static void with_every_pair(pair_test *test) {
  uint64_t random = unit_seed();
  for (size_t i = 0; i < PAIRS; i++) {
    test(&pairs[i], &random);
  }
}

static double model_value(const struct pair *pair, enum core_quantity quantity, float r) {
  const double radius = (double)r;
  return unit_value_at(pair->model, quantity, radius);
}

static float table_value(const struct pair *pair, enum core_quantity quantity, float r) {
  float value;
  core_eval_f32(&pair->table, quantity, 1, &r, &value);
  return value;
}

static void fail_at(const struct pair *pair, const char *what, float at, float value) {
  const core_medium *m = &pair->table.medium;
  fail_msg("%s, %s to %g, sigma_a %g sigma_s %g: at %.9g is %.9g", what,
           core_choice_by_id(core_models, pair->table.model)->name, pair->tolerance,
           m->sigma_a_per_mm, m->sigma_s_per_mm, (double)at, (double)value);
}

/* ---- order -------------------------------------------------------------------------------- */

enum { RUN = 24, RUNS = 3000 };

static float float_of(uint32_t bits) {
  float x;
  memcpy(&x, &bits, sizeof x);
  return x;
}

static uint32_t bits_of(float x) {
  uint32_t bits;
  memcpy(&bits, &x, sizeof bits);
  return bits;
}

typedef void evaluate_function(const struct pair *pair, size_t n, const float *in, float *out);

/* Neighbouring floats around a number, in order. */
static void assert_run_rises(const struct pair *pair, evaluate_function *evaluate, float middle,
                             float most) {
  float in[RUN] = {0}, out[RUN];
  size_t n = 0;
  for (float x = float_of(bits_of(middle) > RUN / 2 ? bits_of(middle) - RUN / 2 : 0);
       n < RUN && x <= most; x = nextafterf(x, INFINITY)) {
    in[n++] = x;
    if (isinf(x)) {
      break;
    }
  }
  evaluate(pair, n, in, out);
  for (size_t i = 1; i < n; i++) {
    if (!(out[i] >= out[i - 1])) {
      fail_at(pair, "turns back", in[i], out[i]);
    }
  }
}

/* Joints between pieces are where the mantissa's first few bits change; so most numbers tried are
 * at one of an octave with some number of cuts. */
static float random_joint(uint64_t *random, float from, float to) {
  const uint32_t first = bits_of(from);
  const uint32_t bits = first + (uint32_t)unit_random_below(random, bits_of(to) - first);
  const unsigned cuts = (unsigned)unit_random_below(random, 14);
  return float_of(cuts < 13 ? bits & ~((UINT32_C(1) << (23 - cuts)) - 1) : bits);
}

static void evaluate_cdf(const struct pair *pair, size_t n, const float *in, float *out) {
  core_eval_f32(&pair->table, CORE_QUANTITY_CDF, n, in, out);
}

static void evaluate_samples(const struct pair *pair, size_t n, const float *in, float *out) {
  core_sample_f32(&pair->table, n, in, out);
}

static int ascending(const void *a, const void *b) {
  const float x = *(const float *)a, y = *(const float *)b;
  return (x > y) - (x < y);
}

/* And from afar. */
static void assert_sorted_rise(const struct pair *pair, evaluate_function *evaluate, float *in,
                               size_t n) {
  static float out[RUNS];
  qsort(in, n, sizeof *in, ascending);
  evaluate(pair, n, in, out);
  for (size_t i = 1; i < n; i++) {
    if (!(out[i] >= out[i - 1])) {
      fail_at(pair, "turns back from afar", in[i], out[i]);
    }
  }
}

static void check_cdf_order(const struct pair *pair, uint64_t *random) {
  static float in[RUNS];
  for (size_t i = 0; i < RUNS; i++) {
    const double near = fmin(pair->mfp_mm * unit_random_log(random, 1e-13, 1e6), 1e37);
    in[i] = i % 3 == 0   ? random_joint(random, 0, INFINITY)
            : i % 3 == 1 ? random_joint(random, (float)near, (float)(4 * near))
                         : (float)near;
    assert_run_rises(pair, evaluate_cdf, in[i], INFINITY);
    const float cdf = table_value(pair, CORE_QUANTITY_CDF, in[i]);
    assert_true(cdf >= 0 && cdf <= 1);
  }
  assert_sorted_rise(pair, evaluate_cdf, in, RUNS);
  /* where the pieces begin and end */
  for (int k = -1; k <= 1; k++) {
    assert_run_rises(pair, evaluate_cdf, pair->table.lut[0] * ldexpf(1, k), INFINITY);
    assert_run_rises(pair, evaluate_cdf, pair->table.lut[1] * ldexpf(1, k), INFINITY);
  }
}

UNIT_TEST(the_cdf_never_turns_back) {
  with_every_pair(check_cdf_order);
}

static void check_sample_order(const struct pair *pair, uint64_t *random) {
  static float in[RUNS];
  for (size_t i = 0; i < RUNS; i++) {
    in[i] = i % 4 == 0   ? random_joint(random, 0, 1)
            : i % 4 == 1 ? random_joint(random, 0.25f, 1)
            : i % 4 == 2 ? 1 - random_joint(random, 0x1p-24f, 0.5f)
                         : (float)unit_random_between(random, 0, 1);
    assert_run_rises(pair, evaluate_samples, in[i], 1);
  }
  assert_sorted_rise(pair, evaluate_samples, in, RUNS);
  assert_run_rises(pair, evaluate_samples, 0.5f, 1);
  assert_run_rises(pair, evaluate_samples, FLT_MIN, 1);
}

UNIT_TEST(samples_keep_the_order_of_their_numbers) {
  with_every_pair(check_sample_order);
}

/* ---- ends --------------------------------------------------------------------------------- */

static const enum core_quantity held[] = {CORE_QUANTITY_R, CORE_QUANTITY_CDF, CORE_QUANTITY_PDF,
                                          CORE_QUANTITY_RING};
enum { HELD = sizeof held / sizeof held[0] };

static void assert_like_model(const struct pair *pair, float r) {
  for (size_t q = 0; q < HELD; q++) {
    double right = model_value(pair, held[q], r);
    /* A model that rises like a logarithm stops at 1e-30 mean free paths; a table goes on. */
    if (pair->table.lut[CORE_LUT_NEAR_LOG] > 0 && r > 0 && (double)r < 1e-29 * pair->mfp_mm) {
      const double risen = pair->table.lut[CORE_LUT_NEAR_LOG] * pair->table.lut[CORE_LUT_SCALE] *
                           log2(1e-29 * pair->mfp_mm / (double)r);
      right = model_value(pair, CORE_QUANTITY_R, (float)(1e-29 * pair->mfp_mm)) + risen;
      right *= held[q] == CORE_QUANTITY_R      ? 1
               : held[q] == CORE_QUANTITY_CDF  ? 0
               : held[q] == CORE_QUANTITY_RING ? 2 * pi * (double)r
                                               : 2 * pi * (double)r / pair->table.albedo;
    }
    const float value = table_value(pair, held[q], r);
    const double error = isinf(right) && isinf(value) ? 0 : table_error(value, right);
    if (!(error <= pair->tolerance)) {
      fail_at(pair, core_choice_by_id(core_quantities, held[q])->name, r, value);
    }
  }
}

static void assert_value(const struct pair *pair, enum core_quantity quantity, float r,
                         float right) {
  const float value = table_value(pair, quantity, r);
  if (!(value == right) || signbit(value) != 0) {
    fail_at(pair, core_choice_by_id(core_quantities, quantity)->name, r, value);
  }
}

static void check_ends(const struct pair *pair, uint64_t *random) {
  static const float radii[] = {0, -0.0f, 1e-45f, 1e-40f, FLT_MIN, 1e-30f, 1e-20f};
  for (size_t i = 0; i < sizeof radii / sizeof radii[0]; i++) {
    assert_like_model(pair, radii[i]);
  }
  assert_value(pair, CORE_QUANTITY_CDF, 0, 0);
  assert_value(pair, CORE_QUANTITY_CDF, -0.0f, 0);
  assert_value(pair, CORE_QUANTITY_CDF, INFINITY, 1);
  assert_value(pair, CORE_QUANTITY_R, INFINITY, 0);
  assert_value(pair, CORE_QUANTITY_PDF, INFINITY, 0);
  assert_value(pair, CORE_QUANTITY_RING, INFINITY, 0);
  /* on both sides of the first and the last radius of the pieces */
  for (int end = 0; end < 2; end++) {
    const float joint = pair->table.lut[end];
    assert_like_model(pair, joint);
    assert_like_model(pair, nextafterf(joint, 0));
    assert_like_model(pair, nextafterf(joint, INFINITY));
  }
  for (int i = 0; i < 200; i++) { /* subnormal radii */
    assert_like_model(pair, float_of(1 + (uint32_t)unit_random_below(random, (1 << 23) - 1)));
  }
}

UNIT_TEST(ends_are_those_of_the_model) {
  with_every_pair(check_ends);
}

static void check_sample_ends(const struct pair *pair, uint64_t *random) {
  static const float ends[] = {0, -0.0f, 1};
  float r[3];
  core_sample_f32(&pair->table, 3, ends, r);
  assert_true(r[0] == 0 && !signbit(r[0]) && r[1] == 0 && !signbit(r[1]) && isinf(r[2]));
  for (int i = 0; i < 200; i++) { /* subnormal u */
    const float u = float_of(1 + (uint32_t)unit_random_below(random, (1 << 23) - 1));
    const double wide = (double)u;
    double right;
    core_sample_f32(&pair->table, 1, &u, r);
    core_sample_f64(pair->model, 1, &wide, &right);
    if (!(table_error(r[0], right) <= pair->tolerance)) {
      fail_at(pair, "the radius of a subnormal cdf", u, r[0]);
    }
  }
}

UNIT_TEST(samples_have_their_ends) {
  with_every_pair(check_sample_ends);
}

/* ---- what a table does not hold ----------------------------------------------------------- */

UNIT_TEST(nothing_leaves_where_nothing_scatters) {
  const core_medium medium = {0.3, 0, 0, 1.3};
  static const float radii[] = {0, -0.0f, 1e-45f, 1e-10f, 1, 1e10f, FLT_MAX, INFINITY};
  static const float numbers[] = {0, -0.0f, 1e-45f, 0.25f, 0.5f, 0.75f, 1 - 0x1p-24f, 1};
  float out[8];
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    core_profile table;
    core_fault fault = table_prepare(&table, model->id, &medium, 1e-4);
    if (model->id == CORE_MODEL_GAUSSIANS) { /* there is nothing to fit */
      unit_assert_fault(fault, fault.field, 0);
      assert_non_null(fault.field);
      continue;
    }
    unit_accept(fault);
    for (size_t q = 0; table.albedo > 0 ? false : q < HELD; q++) {
      core_eval_f32(&table, held[q], 8, radii, out);
      for (size_t i = 0; i < 8; i++) {
        assert_true(out[i] == 0 && !signbit(out[i]));
      }
    }
    core_sample_f32(&table, 8, numbers, out);
    for (size_t i = 0; i < 8 && !(table.albedo > 0); i++) {
      assert_true(out[i] == 0 && !signbit(out[i]));
    }
    const bool every_medium = (table.notes & CORE_NOTE_MEDIUM_UNUSED) != 0;
    assert_true((table.albedo > 0) == every_medium);
    core_profile_free(&table);
  }
}

/* ---- what is refused ------------------------------------------------------------------------ */

/* Media as they are met with: a measured one, and by turns one of a grid of eta and absorption. */
UNIT_TEST(ordinary_media_are_never_refused) {
  static const double etas[] = {1, 1.3, 1.5, 2}, ratios[] = {1e-4, 1e-2, 1, 10};
  for (size_t m = 0; core_models[m].name != NULL; m++) {
    const double ratio = ratios[m % 4];
    const core_measured_medium *measured = &core_measured_media[m % core_measured_media_count];
    const size_t layers = measured->layer_count; /* of these, the half space below */
    const core_medium media[] = {measured->channel[(m % 3 + 1) * layers - 1],
                                 {ratio / (1 + ratio), 1 / (1 + ratio), 0, etas[m / 4 % 4]}};
    for (size_t i = 0; i < 2; i++) {
      const core_medium needed = unit_medium(core_models[m].id, &media[i]);
      const core_parameters none = core_parameters_none();
      core_profile table;
      if (!unit_is_long() && core_has_to_solve(core_models[m].id, &needed, &none)) {
        continue;
      }
      unit_accept(table_prepare(&table, core_models[m].id, &media[i], i ? 1e-4 : 1e-6));
      core_profile_free(&table);
    }
  }
}

/* Light in a slab of a fraction of a mean free path falls like 1 / r^3 where the solver ends: without
 * its absorption it would never end. */
UNIT_TEST(thin_slabs_are_not_refused) {
  static const double slabs[][2] = {{0.01, 1}, {0.01, 0.3}, {0.1, 2}, {1, 0.3}};
  for (size_t i = 0; i < sizeof slabs / sizeof slabs[0]; i += unit_is_long() ? 1 : 3) {
    const core_medium slab = {0.1, slabs[i][0], 0.75, 1, slabs[i][1]};
    core_profile table;
    unit_accept(table_prepare(&table, CORE_MODEL_TRANSPORT, &slab, (double)NAN));
    core_profile_free(&table);
  }
}

/* Pieces of these media's tables keep the tolerance at the places where a fit looks, and miss it by a
 * little between them. */
UNIT_TEST(pieces_that_miss_between_their_places_are_cut_again) {
  const core_medium media[] = {{0.11286881739557351, 1, 0, 1.4}, {0.11611040316130428, 1, 0, 1.4}};
  for (size_t i = 0; i < 2; i++) {
    core_profile table;
    unit_accept(table_prepare(&table, CORE_MODEL_BEAM, &media[i], (double)NAN));
    assert_true(table.numerical_error <= 1e-4);
    core_profile_free(&table);
  }
}

UNIT_TEST(tolerances_have_their_range) {
  const core_medium medium = {0.032, 0.74, 0, 1.3};
  static const double good[] = {1e-6, 1.1e-6, 0.01, 0.1, 1};
  static const double bad[] = {9.99e-7, 1e-12, 0, -1, 1.001, INFINITY};
  core_profile table;
  for (size_t i = 0; i < sizeof good / sizeof good[0]; i++) {
    unit_accept(table_prepare(&table, CORE_MODEL_BETTER, &medium, good[i]));
    assert_true(table.numerical_error <= good[i]);
    core_profile_free(&table);
  }
  for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
    unit_assert_fault(table_prepare(&table, CORE_MODEL_BETTER, &medium, bad[i]), "tolerance", 0);
  }
  unit_accept(table_prepare(&table, CORE_MODEL_BETTER, &medium, (double)NAN));
  assert_true(table.numerical_error <= 1e-4);
  core_profile_free(&table);
}
