/* Every instruction set that this machine runs gives the portable kernels' bits: at every length,
 * offset, lane and slicing, whatever stands beside the values. */
#include <float.h>
#include <math.h>

#include "tests/unit/unit.h"

enum {
  LENGTH_MAX = 67, /* more than four of the widest vectors, and a remainder */
  OFFSETS = 16,    /* elements: a vector's worth of misalignments */
  GUARD = 0xa5,
};

/* ---- values of either precision ----------------------------------------------------------- */

/* Aligned for a double; holds the values of either precision. */
typedef struct values {
  double storage[2 * OFFSETS + LENGTH_MAX];
} values;

static size_t value_bytes(unsigned evaluator) {
  return evaluator == CORE_EVALUATOR_F64 ? sizeof(double) : sizeof(float);
}

static void *at(values *v, unsigned evaluator, size_t index) {
  return (unsigned char *)v->storage + index * value_bytes(evaluator);
}

static void put(void *to, unsigned evaluator, size_t index, double value) {
  if (evaluator == CORE_EVALUATOR_F64) {
    ((double *)to)[index] = value;
  } else {
    ((float *)to)[index] = (float)value;
  }
}

static double get(const void *from, unsigned evaluator, size_t index) {
  return evaluator == CORE_EVALUATOR_F64 ? ((const double *)from)[index]
                                         : (double)((const float *)from)[index];
}

static void evaluate_one(const core_profile *profile, enum core_quantity quantity, size_t n,
                         const void *r, void *out) {
  if (out == NULL) {
    return;
  }
  if (profile->evaluator == CORE_EVALUATOR_F64) {
    core_eval_f64(profile, quantity, n, r, out);
  } else {
    core_eval_f32(profile, quantity, n, r, out);
  }
}

/* R or cdf may be NULL: not wanted. */
static void evaluate(const core_profile *profile, size_t n, const void *r, void *R, void *cdf) {
  evaluate_one(profile, CORE_QUANTITY_R, n, r, R);
  evaluate_one(profile, CORE_QUANTITY_CDF, n, r, cdf);
}

/* ---- every pair of kernels that should agree ---------------------------------------------- */

static const core_medium media[] = {
    {0.032, 0.74, 0, 1.3},       /* skin1 */
    {0, 2.5, 0.9, 1.5},          /* no absorption */
    {3, 0.1, -0.5, 1},           /* hardly any scattering, matched indices */
    {0.3, 0, 0, 1.3},            /* no scattering */
    {1e9, 1e14, 0, 0.4},         /* the domain's ends */
    {1e-12, 1e-14, 0.99, 900},   /* and corners */
    {1e-300, 1, 0.999999999, 3}, /* next to no absorption */
    {0, 1e15, 0, 1000},          /* the largest R */
};
enum { MEDIA = sizeof media / sizeof media[0] };

/* The same profile for the portable kernels and for others. */
typedef void pair_test(const core_profile *portable, const core_profile *other, uint64_t *random);

static void prepare(core_profile *profile, const char *isa, unsigned model, unsigned evaluator,
                    const core_medium *medium) {
  unit_assert_fault(core_profile_prepare(profile, core_isa_select(isa), model, CORE_MOMENTS_EXACT,
                                         evaluator, medium),
                    NULL, 0);
}

static void with_every_medium(const char *isa, unsigned model, unsigned evaluator, pair_test *test,
                              uint64_t *random) {
  for (size_t i = 0; i < MEDIA; i++) {
    core_profile portable, other;
    prepare(&portable, "portable", model, evaluator, &media[i]);
    prepare(&other, isa, model, evaluator, &media[i]);
    test(&portable, &other, random);
  }
}

/* Every instruction set of this machine (portable included, which must agree with itself whatever
 * the length), model, evaluator and medium. */
static void with_every_pair(pair_test *test) {
  uint64_t random = unit_seed();
  for (size_t i = 0; core_isa_listed(i) != NULL; i++) {
    const char *isa = core_isa_listed(i);
    if (core_isa_select(isa) == NULL) {
      printf("not tested: this machine cannot run %s\n", isa);
      continue;
    }
    for (const core_choice *model = core_models; model->name != NULL; model++) {
      for (const core_choice *e = core_evaluators; e->name != NULL; e++) {
        with_every_medium(isa, model->id, e->id, test, &random);
      }
    }
  }
}

/* ---- radii -------------------------------------------------------------------------------- */

static const double edges[] = {0,     -0.0, 5e-324, 2.3e-308, 1e-300, 1e-45,   1.2e-38, 1e-30,
                               1e-15, 1,    1e15,   1e19,     3e38,   1e150,   1e151,   1e300,
                               1e-7,  1e7,  1e-154, 1e160,    1e-20,  DBL_MAX, INFINITY};
enum { EDGES = sizeof edges / sizeof edges[0] };

static double mfp_of(const core_profile *profile) {
  const core_medium *medium = &profile->medium;
  return 1 / (medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g));
}

/* Mostly where the profile has something to say, now and then an edge. */
static double random_radius(uint64_t *random, const core_profile *profile) {
  if (unit_random_below(random, 8) == 0) {
    return edges[unit_random_below(random, EDGES)];
  }
  return unit_random_log(random, 1e-6, 1e6) * mfp_of(profile);
}

/* What a neighbouring lane might hold, allowed or not. */
static double garbage(uint64_t *random) {
  static const double kinds[] = {NAN,     -NAN,   INFINITY, -INFINITY, -1,      -DBL_MAX,
                                 DBL_MAX, 5e-324, -5e-324,  0,         FLT_MAX, 1e-40};
  return kinds[unit_random_below(random, sizeof kinds / sizeof kinds[0])];
}

static void fill_radii(values *r, const core_profile *profile, size_t n, uint64_t *random) {
  for (size_t i = 0; i < n; i++) {
    put(r->storage, profile->evaluator, i, random_radius(random, profile));
  }
}

/* ---- comparing ---------------------------------------------------------------------------- */

static void assert_same_bits(const core_profile *other, const void *expected, const void *got,
                             size_t n, const char *what) {
  const size_t bytes = value_bytes(other->evaluator);
  for (size_t i = 0; i < n; i++) {
    if (memcmp((const char *)expected + i * bytes, (const char *)got + i * bytes, bytes) != 0) {
      fail_msg("%s of %s: value %zu of %zu is %.17g, portable has %.17g", what,
               core_choice_by_id(core_models, other->model)->name, i, n,
               get(got, other->evaluator, i), get(expected, other->evaluator, i));
    }
  }
}

static void assert_guard(const unsigned char *from, const unsigned char *to) {
  for (; from < to; from++) {
    assert_int_equal(*from, GUARD);
  }
}

/* The array of n values from `first` on is as expected and nothing around it was written. */
static void assert_output(const core_profile *other, const values *expected, values *output,
                          size_t first, size_t n, const char *what) {
  const unsigned evaluator = other->evaluator;
  assert_same_bits(other, expected->storage, at(output, evaluator, first), n, what);
  assert_guard(at(output, evaluator, 0), at(output, evaluator, first));
  assert_guard(at(output, evaluator, first + n),
               (const unsigned char *)output->storage + sizeof output->storage);
}

/* ---- the tests ---------------------------------------------------------------------------- */

static void compare_preparation(const core_profile *portable, const core_profile *other,
                                uint64_t *random) {
  (void)random;
  core_profile copy = *other;
  copy.kernels = portable->kernels;
  assert_memory_equal(&copy.coefficients, &portable->coefficients, sizeof copy.coefficients);
  assert_memory_equal(&copy.albedo, &portable->albedo, sizeof copy.albedo);
  assert_true(copy.numerical_error == portable->numerical_error);
  assert_true(copy.numerical_error_per_mm == portable->numerical_error_per_mm);
}

static void preparation_does_not_depend_on_the_instruction_set(void **state) {
  (void)state;
  with_every_pair(compare_preparation);
}

static void compare_lengths_and_offsets(const core_profile *portable, const core_profile *other,
                                        uint64_t *random) {
  const unsigned evaluator = portable->evaluator;
  values radii, R, cdf;
  fill_radii(&radii, portable, LENGTH_MAX, random);
  evaluate(portable, LENGTH_MAX, radii.storage, R.storage, cdf.storage);
  for (size_t n = 0; n <= LENGTH_MAX; n++) {
    for (size_t offset = 0; offset < OFFSETS; offset++) {
      const size_t R_offset = (offset * 7 + 3) % OFFSETS;
      const size_t cdf_offset = (offset * 11 + n) % OFFSETS;
      values input, R_out, cdf_out;
      unit_random_bytes(random, &input, sizeof input);
      memcpy(at(&input, evaluator, offset), radii.storage, n * value_bytes(evaluator));
      memset(&R_out, GUARD, sizeof R_out);
      memset(&cdf_out, GUARD, sizeof cdf_out);
      const values before = input;
      evaluate(other, n, at(&input, evaluator, offset), at(&R_out, evaluator, R_offset),
               at(&cdf_out, evaluator, cdf_offset));
      assert_output(other, &R, &R_out, R_offset, n, "R");
      assert_output(other, &cdf, &cdf_out, cdf_offset, n, "cdf");
      assert_memory_equal(&input, &before, sizeof input);
    }
  }
}

static void every_length_and_offset_gives_the_same_bits(void **state) {
  (void)state;
  with_every_pair(compare_lengths_and_offsets);
}

/* The value under test in each lane in turn, anything in the others. */
static void compare_lanes(const core_profile *portable, const core_profile *other,
                          uint64_t *random) {
  enum { LANES = 2 * OFFSETS };
  const unsigned evaluator = portable->evaluator;
  for (size_t i = 0; i < EDGES + 10; i++) {
    const double radius = i < EDGES ? edges[i] : random_radius(random, portable);
    values alone, R, cdf;
    put(alone.storage, evaluator, 0, radius);
    evaluate(portable, 1, alone.storage, R.storage, cdf.storage);
    for (size_t lane = 0; lane < LANES; lane++) {
      values input, R_out, cdf_out;
      for (size_t j = 0; j < LANES; j++) {
        put(input.storage, evaluator, j, j == lane ? radius : garbage(random));
      }
      evaluate(other, LANES, input.storage, R_out.storage, cdf_out.storage);
      assert_same_bits(other, R.storage, at(&R_out, evaluator, lane), 1, "R in a lane");
      assert_same_bits(other, cdf.storage, at(&cdf_out, evaluator, lane), 1, "cdf in a lane");
    }
  }
}

static void a_lane_does_not_see_its_neighbours(void **state) {
  (void)state;
  with_every_pair(compare_lanes);
}

/* Arrays of exactly the size that is asked for, so that a sanitizer sees every access beyond. */
static void compare_slicing(const core_profile *portable, const core_profile *other,
                            uint64_t *random) {
  enum { COUNT = 1000 };
  const unsigned evaluator = portable->evaluator;
  const size_t bytes = value_bytes(evaluator);
  char *r = malloc(COUNT * bytes);
  char *expected = malloc(COUNT * bytes);
  char *R = malloc(COUNT * bytes);
  assert_true(r != NULL && expected != NULL && R != NULL);
  for (size_t i = 0; i < COUNT; i++) {
    put(r, evaluator, i, random_radius(random, portable));
  }
  evaluate(portable, COUNT, r, expected, NULL);
  for (int repeat = 0; repeat < 20; repeat++) {
    for (size_t first = 0, n = 0; first < COUNT; first += n) {
      n = 1 + unit_random_below(random, repeat % 2 ? 20 : 300);
      n = n < COUNT - first ? n : COUNT - first;
      evaluate(other, n, r + first * bytes, R + first * bytes, NULL);
    }
    assert_same_bits(other, expected, R, COUNT, "R in slices");
  }
  free(r);
  free(expected);
  free(R);
}

static void slicing_gives_the_same_bits(void **state) {
  (void)state;
  with_every_pair(compare_slicing);
}

/* One quantity alone is the same as both. */
static void compare_wanted(const core_profile *portable, const core_profile *other,
                           uint64_t *random) {
  values r, R, cdf, alone;
  fill_radii(&r, portable, LENGTH_MAX, random);
  evaluate(portable, LENGTH_MAX, r.storage, R.storage, cdf.storage);
  evaluate(other, LENGTH_MAX, r.storage, alone.storage, NULL);
  assert_same_bits(other, R.storage, alone.storage, LENGTH_MAX, "R alone");
  evaluate(other, LENGTH_MAX, r.storage, NULL, alone.storage);
  assert_same_bits(other, cdf.storage, alone.storage, LENGTH_MAX, "cdf alone");
  evaluate(other, LENGTH_MAX, r.storage, NULL, NULL);
}

static void quantities_are_had_singly_and_together(void **state) {
  (void)state;
  with_every_pair(compare_wanted);
}

/* Whatever the radius: R is neither negative nor NaN, the cdf is from 0 to 1, and both have their
 * limits. */
static void compare_edges(const core_profile *portable, const core_profile *other,
                          uint64_t *random) {
  (void)random;
  const unsigned evaluator = portable->evaluator;
  const bool scatters = portable->medium.sigma_s_per_mm > 0;
  values r, R_expected, cdf_expected, R, cdf;
  for (size_t i = 0; i < EDGES; i++) {
    put(r.storage, evaluator, i, edges[i]);
  }
  evaluate(portable, EDGES, r.storage, R_expected.storage, cdf_expected.storage);
  evaluate(other, EDGES, r.storage, R.storage, cdf.storage);
  assert_same_bits(other, R_expected.storage, R.storage, EDGES, "R at an edge");
  assert_same_bits(other, cdf_expected.storage, cdf.storage, EDGES, "cdf at an edge");
  for (size_t i = 0; i < EDGES; i++) {
    const double R_value = get(R.storage, evaluator, i);
    const double cdf_value = get(cdf.storage, evaluator, i);
    assert_true(R_value >= 0 && isfinite(R_value) && !signbit(R_value));
    assert_true(cdf_value >= 0 && cdf_value <= 1 && !signbit(cdf_value));
    if (edges[i] == 0) {
      assert_true((R_value > 0) == scatters);
      assert_true(cdf_value == 0);
    }
    if (isinf(edges[i])) {
      assert_true(R_value == 0);
      assert_true(cdf_value == (scatters ? 1 : 0));
    }
  }
}

static void edges_have_their_limits(void **state) {
  (void)state;
  with_every_pair(compare_edges);
}

/* ---- choosing ----------------------------------------------------------------------------- */

static void instruction_sets_are_chosen_by_name(void **state) {
  (void)state;
  const core_isa *best = NULL;
  assert_string_equal(core_isa_listed(0), "portable");
  for (size_t i = 0; core_isa_listed(i) != NULL; i++) {
    assert_true(i < UNIT_ROWS_MAX);
    const core_isa *isa = core_isa_select(core_isa_listed(i));
    if (isa != NULL) {
      assert_string_equal(core_isa_name(isa), core_isa_listed(i));
      best = isa;
    }
  }
  assert_non_null(core_isa_select("portable"));
  assert_ptr_equal(core_isa_select(NULL), best);
  assert_null(core_isa_select(""));
  assert_null(core_isa_select("AVX2"));
  assert_null(core_isa_select("avx"));
  assert_null(core_isa_select("neon2000"));
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(instruction_sets_are_chosen_by_name),
      cmocka_unit_test(preparation_does_not_depend_on_the_instruction_set),
      cmocka_unit_test(every_length_and_offset_gives_the_same_bits),
      cmocka_unit_test(a_lane_does_not_see_its_neighbours),
      cmocka_unit_test(slicing_gives_the_same_bits),
      cmocka_unit_test(quantities_are_had_singly_and_together),
      cmocka_unit_test(edges_have_their_limits),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
