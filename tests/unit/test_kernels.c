/* The kernels of every instruction set of this machine give the bits of the portable kernels: at
 * every length, offset and lane, whatever values lie beside. */
#include <float.h>
#include <math.h>

#include "tests/unit/unit.h"

enum {
  LENGTH_MAX = 67, /* four of the widest vectors and a remainder */
  OFFSETS = 16,    /* offsets of the first element: all misalignments of the widest vector */
  GUARD = 0xa5,
  KEPT_MAX = 1000, /* values of the portable kernels that are kept */
};

/* ---- values of either precision ----------------------------------------------------------- */

/* An array for values of either precision, aligned for a double. */
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

/* An elementwise operation of a profile: evaluating one quantity, or drawing radii (quantity 0). */
typedef struct operation {
  unsigned quantity;
  const char *name;
} operation;

static void apply(const core_profile *profile, operation todo, size_t n, const void *in,
                  void *out) {
  const bool f64 = profile->evaluator == CORE_EVALUATOR_F64;
  if (todo.quantity == 0 && f64) {
    core_sample_f64(profile, n, in, out);
  } else if (todo.quantity == 0) {
    core_sample_f32(profile, n, in, out);
  } else if (f64) {
    core_eval_f64(profile, todo.quantity, n, in, out);
  } else {
    core_eval_f32(profile, todo.quantity, n, in, out);
  }
}

/* Sets out[n] to what the portable kernels give, which is kept for the next instruction set: with
 * transcendental functions in software they take longer than others. */
static void apply_portable(const core_profile *profile, operation todo, size_t n, const void *in,
                           void *out) {
  static struct {
    core_profile profile;
    operation todo;
    size_t n;
    double in[KEPT_MAX], out[KEPT_MAX];
  } kept;
  const size_t bytes = n * value_bytes(profile->evaluator);
  assert_true(n <= KEPT_MAX);
  if (kept.n != n || kept.todo.quantity != todo.quantity ||
      memcmp(&kept.profile, profile, sizeof *profile) != 0 || memcmp(kept.in, in, bytes) != 0) {
    apply(profile, todo, n, in, kept.out);
    memcpy(kept.in, in, bytes);
    memcpy(&kept.profile, profile, sizeof *profile);
    kept.todo = todo;
    kept.n = n;
  }
  memcpy(out, kept.out, bytes);
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

/* The same profile for the portable kernels and for others, and the operation to compare. */
typedef struct kernel_pair {
  core_profile portable;
  core_profile other;
  size_t medium;    /* its position in the list of media */
  bool is_portable; /* whether the portable kernels are compared with themselves */
  operation todo;
} kernel_pair;

typedef void pair_test(const kernel_pair *pair, uint64_t *random);
static pair_test compare_edges, compare_preparation;

/* Prepares a profile. Returns false if the medium lies outside the domain of the model. */
static bool prepare(core_profile *profile, const char *isa, unsigned model, unsigned evaluator,
                    const core_medium *medium) {
  const core_medium needed = unit_medium(model, medium);
  core_parameters parameters = core_parameters_none();
  if (core_has_derivatives(model)) {
    parameters.value[CORE_PARAMETER_DERIVATIVES] = 1;
  }
  if (evaluator == CORE_EVALUATOR_LUT) { /* A coarse table tests the kernels as well. */
    parameters.value[CORE_PARAMETER_TOLERANCE] = 0.01;
  }
  const core_fault fault = core_profile_prepare(
      profile, core_isa_select(isa), model, CORE_MOMENTS_EXACT, evaluator, &needed, &parameters);
  if (fault.field == NULL) {
    return true;
  }
  assert_true(strcmp(fault.field, "eta") == 0 || strcmp(fault.field, "sigma_a") == 0 ||
              strcmp(fault.field, "fit_from") == 0 ||
              (evaluator == CORE_EVALUATOR_LUT && strcmp(fault.field, "tolerance") == 0));
  return false;
}

/* Returns whether a test compares a quantity. Not all models have derivatives. A quantity that a table does not hold is evaluated by
 * the kernels of double precision, which are compared without a table: only its edges are tested. A
 * Hankel transform of R is the same code for all instruction sets: only its edges are tested,
 * once. */
static bool is_compared(const kernel_pair *pair, unsigned quantity, pair_test *test) {
  const core_profile *profile = &pair->portable;
  if (core_wants_derivatives(quantity) && !core_has_derivatives(profile->model)) {
    return false;
  }
  const bool transforms = core_call_cost(profile, quantity) > 0;
  const bool held = profile->lut == NULL || core_table_has(quantity);
  return test == compare_edges ? !transforms || pair->is_portable : held && !transforms;
}

enum { COSTLY_MEDIA = 2 };

/* A sum counts as costly, because its parts' kernels are compared with their own models. */
static bool is_costly(const core_profile *profile) {
  return profile->cost > 2 || profile->parts != NULL;
}

/* Drawing radii from expensive models takes most of the time. It is the same code for all of them,
 * in blocks around their kernels. */
static bool is_slow(const kernel_pair *pair) {
  return is_costly(&pair->portable) && pair->todo.quantity == 0;
}

/* Returns the step between the lengths that are tried. It is larger for expensive models, and
 * larger yet for drawing radii from them and for portable kernels, which have no lanes, except
 * around the lengths of their blocks. */
static size_t stride(const kernel_pair *pair, size_t n) {
  const bool few = is_slow(pair) || pair->is_portable;
  return !is_costly(&pair->portable) ? 1 : n == 31 || n == 32 ? 1 : few ? 31 : 11;
}

/* Returns whether a length and an offset are tried together with the medium of the pair. Half
 * of the media together try each length at each offset. */
static bool is_share(const kernel_pair *pair, size_t n, size_t offset) {
  return is_costly(&pair->portable) ? offset == 11 * ((n + pair->medium) % COSTLY_MEDIA)
                                    : (n + offset + pair->medium) % (MEDIA / 2) == 0;
}

/* The kernels that evaluate each model. */
static const struct {
  unsigned model;
  const char *kernels;
} kernels_of[] = {
#define CORE_MODEL(id, IDENT, name, formula, kernels, variant, parameters, source) {id, #kernels},
#define CORE_SUM(id, IDENT, name, FIRST, SECOND, source) {id, "sum"},
#include "core/models.def"
};

/* A profile that is prepared once for all tests. */
typedef struct kept_profile {
  bool tried;
  bool valid; /* the medium lies in the domain of the model */
  core_profile profile;
} kept_profile;

enum { ISAS_MAX = 8, EVALUATORS_MAX = 8, MODELS_MAX = 64 };

static const core_profile *prepared(size_t isa, size_t model, unsigned evaluator, size_t medium) {
  static kept_profile *kept[ISAS_MAX][MODELS_MAX][EVALUATORS_MAX];
  assert_true(isa < ISAS_MAX && model < MODELS_MAX && evaluator < EVALUATORS_MAX);
  kept_profile **row = &kept[isa][model][evaluator];
  if (*row == NULL) {
    *row = calloc(MEDIA, sizeof **row);
    assert_non_null(*row);
  }
  kept_profile *here = &(*row)[medium];
  if (!here->tried) {
    here->tried = true;
    here->valid = prepare(&here->profile, core_isa_listed(isa), kernels_of[model].model, evaluator,
                          &media[medium]);
  }
  return here->valid ? &here->profile : NULL;
}

static size_t portable_isa(void) {
  size_t isa = 0;
  while (strcmp(core_isa_listed(isa), "portable") != 0) {
    isa++;
  }
  return isa;
}

/* Returns for how many media a model is tested on an instruction set. */
static size_t medium_count(size_t isa, unsigned model, unsigned evaluator) {
  const bool slow =
      core_prepares_slowly(model, evaluator, NULL, NULL) && model != CORE_MODEL_BURLEY;
  const bool is_best = strcmp(core_isa_listed(isa), core_isa_name(core_isa_select(NULL))) == 0;
  /* Transport without absorption, and of layers, takes seconds to prepare, in either precision by the
   * same solver. */
  const bool few = core_solves(model) &&
                   ((isa != portable_isa() && !is_best) || evaluator != CORE_EVALUATOR_F64);
  return !slow ? MEDIA : few && !unit_is_long() ? 1 : COSTLY_MEDIA;
}

/* Runs a test of one operation for every instruction set, with the same random numbers for all, so
 * that the portable kernels' values serve all of them. */
static void with_every_isa(size_t model, unsigned evaluator, size_t medium, operation todo,
                           pair_test *test, uint64_t *random) {
  const uint64_t seed = unit_random(random);
  for (size_t isa = 0; core_isa_listed(isa) != NULL; isa++) {
    if (core_isa_select(core_isa_listed(isa)) == NULL ||
        medium >= medium_count(isa, kernels_of[model].model, evaluator)) {
      continue;
    }
    const core_profile *portable = prepared(portable_isa(), model, evaluator, medium);
    const core_profile *other = prepared(isa, model, evaluator, medium);
    assert_true((portable == NULL) == (other == NULL));
    if (portable != NULL &&
        (!is_costly(portable) || medium < COSTLY_MEDIA || test == compare_edges)) {
      const kernel_pair pair = {*portable, *other, medium, isa == portable_isa(), todo};
      uint64_t own = seed;
      if (todo.quantity == 0 || is_compared(&pair, todo.quantity, test)) {
        test(&pair, &own);
      }
    }
  }
}

static void with_every_medium(size_t model, unsigned evaluator, pair_test *test, uint64_t *random) {
  /* Two media try each length at half of the offsets; the long form tries all. */
  const bool all = unit_is_long() || test == compare_edges || test == compare_preparation;
  for (size_t medium = 0; medium < (all ? MEDIA : 2); medium++) {
    for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
      const unsigned derived = CORE_QUANTITY_MODEL_ERRORS | CORE_PATHS | CORE_MODULATED;
      if (core_quantity_elementwise(quantity->id) && (quantity->id & derived) == 0) {
        const operation todo = {quantity->id, quantity->name};
        with_every_isa(model, evaluator, medium, todo, test, random);
      }
    }
    with_every_isa(model, evaluator, medium, (operation){0, "sample"}, test, random);
  }
}

static bool same_way(size_t a, size_t b) {
  if (strcmp(kernels_of[a].kernels, kernels_of[b].kernels) != 0) {
    return false;
  }
  core_profile first, second;
  prepare(&first, "portable", kernels_of[a].model, CORE_EVALUATOR_F64, &media[0]);
  prepare(&second, "portable", kernels_of[b].model, CORE_EVALUATOR_F64, &media[0]);
  const bool same = (first.table == NULL) == (second.table == NULL);
  core_profile_free(&first);
  core_profile_free(&second);
  return same;
}

/* Returns whether a model has the kernels of an earlier one and differs only in its coefficients,
 * so that the earlier one is enough. */
static bool is_like_an_earlier_one(size_t model) {
  for (size_t i = 0; i < model; i++) {
    if (same_way(i, model)) {
      return true;
    }
  }
  return false;
}

/* Returns whether to test an evaluator with a model. All models share the kernels of tables, so
 * that a flat and a steep model are enough for these. */
static bool is_due(size_t model, unsigned evaluator) {
  return evaluator != CORE_EVALUATOR_LUT || strcmp(kernels_of[model].kernels, "dipole") == 0 ||
         kernels_of[model].model == CORE_MODEL_BURLEY;
}

/* Runs a test for every instruction set of this machine, operation, evaluator and medium. The
 * portable kernels are among them: they must agree with themselves at every length. */
static void with_every_pair(pair_test *test) {
  uint64_t random = unit_seed();
  for (size_t model = 0; model < sizeof kernels_of / sizeof kernels_of[0]; model++) {
    if (is_like_an_earlier_one(model)) {
      continue;
    }
    for (const core_choice *e = core_evaluators; e->name != NULL; e++) {
      if (is_due(model, e->id)) {
        with_every_medium(model, e->id, test, &random);
      }
    }
  }
}

/* ---- inputs ------------------------------------------------------------------------------- */

static const double edge_radii[] = {0,     -0.0, 5e-324, 2.3e-308, 1e-300, 1e-45,   1.2e-38, 1e-30,
                                    1e-15, 1,    1e15,   1e19,     3e38,   1e150,   1e151,   1e300,
                                    1e-7,  1e7,  1e-154, 1e160,    1e-20,  DBL_MAX, INFINITY};
static const double edge_cdfs[] = {
    0,     -0.0, 5e-324,   1e-300,      1e-45,          1.2e-38, 1e-31, 1e-30, 1.1e-13,
    1e-13, 1e-7, .5,       1 - 1e-7,    1 - 0x1p-24,    1,       .9999, 1e-12, 1 - 1e-12,
    1e-20, .999, 0x1p-126, 1 - 0x1p-53, 1 - FLT_EPSILON};

enum {
  EDGE_RADII = sizeof edge_radii / sizeof edge_radii[0],
  EDGE_CDFS = sizeof edge_cdfs / sizeof edge_cdfs[0],
};

static size_t edge_count(const kernel_pair *pair) {
  return pair->todo.quantity == 0 ? EDGE_CDFS : EDGE_RADII;
}

static double edge(const kernel_pair *pair, size_t index) {
  return pair->todo.quantity == 0 ? edge_cdfs[index] : edge_radii[index];
}

static double mfp_of(const core_profile *profile) {
  const core_medium *medium = &profile->medium;
  return 1 / (medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g));
}

/* Returns a random input: mostly a radius within the range of the profile, sometimes an edge. */
static double random_input(uint64_t *random, const kernel_pair *pair) {
  const size_t kind = unit_random_below(random, 8);
  if (kind == 0) {
    return edge(pair, unit_random_below(random, edge_count(pair)));
  }
  if (pair->todo.quantity != 0) {
    return unit_random_log(random, 1e-6, 1e6) * mfp_of(&pair->portable);
  }
  return kind < 5   ? unit_random_between(random, 0, 1)
         : kind < 7 ? 1 - unit_random_log(random, 1e-16, 1)
                    : unit_random_log(random, 1e-40, 1);
}

/* Returns a value that a neighbouring lane might hold, perhaps an invalid one. */
static double garbage(uint64_t *random) {
  static const double kinds[] = {NAN,     -NAN,   INFINITY, -INFINITY, -1,      -DBL_MAX,
                                 DBL_MAX, 5e-324, -5e-324,  0,         FLT_MAX, 1e-40};
  return kinds[unit_random_below(random, sizeof kinds / sizeof kinds[0])];
}

static void fill_inputs(void *in, const kernel_pair *pair, size_t n, uint64_t *random) {
  for (size_t i = 0; i < n; i++) {
    put(in, pair->portable.evaluator, i, random_input(random, pair));
  }
}

/* ---- comparing ---------------------------------------------------------------------------- */

static void assert_same_bits(const kernel_pair *pair, const void *expected, const void *got,
                             size_t n, const char *what) {
  const unsigned evaluator = pair->other.evaluator;
  const size_t bytes = value_bytes(evaluator);
  for (size_t i = 0; i < n; i++) {
    if (memcmp((const char *)expected + i * bytes, (const char *)got + i * bytes, bytes) != 0) {
      fail_msg("%s %s of %s %s: value %zu of %zu is %.17g, portable has %.17g", pair->todo.name,
               what, core_choice_by_id(core_models, pair->other.model)->name,
               core_choice_by_id(core_evaluators, evaluator)->name, i, n, get(got, evaluator, i),
               get(expected, evaluator, i));
    }
  }
}

static void assert_guard(const unsigned char *from, const unsigned char *to) {
  for (; from < to; from++) {
    if (*from != GUARD) { /* assert_int_equal() for each byte would be too slow */
      fail_msg("byte %#x was written beside the values", *from);
    }
  }
}

/* Checks that n values from `first` on are as expected and that nothing around them was written. */
static void assert_output(const kernel_pair *pair, const values *expected, values *output,
                          size_t first, size_t n) {
  const unsigned evaluator = pair->other.evaluator;
  assert_same_bits(pair, expected->storage, at(output, evaluator, first), n, "at an offset");
  assert_guard(at(output, evaluator, 0), at(output, evaluator, first));
  assert_guard(at(output, evaluator, first + n),
               (const unsigned char *)output->storage + sizeof output->storage);
}

/* ---- the tests ---------------------------------------------------------------------------- */

static void compare_preparation(const kernel_pair *pair, uint64_t *random) {
  (void)random;
  const core_profile *portable = &pair->portable;
  const core_profile *other = &pair->other;
  assert_memory_equal(&other->coefficients, &portable->coefficients, sizeof other->coefficients);
  assert_memory_equal(&other->albedo, &portable->albedo, sizeof other->albedo);
  assert_true(other->numerical_error == portable->numerical_error);
  assert_true(other->numerical_error_per_mm == portable->numerical_error_per_mm);
  assert_int_equal(other->lut_count, portable->lut_count);
  assert_memory_equal(other->lut, portable->lut, portable->lut_count * sizeof *portable->lut);
}

UNIT_TEST(preparation_does_not_depend_on_the_instruction_set) {
  with_every_pair(compare_preparation);
}

static void compare_lengths_and_offsets(const kernel_pair *pair, uint64_t *random) {
  const unsigned evaluator = pair->portable.evaluator;
  values inputs, expected, noise;
  unit_random_bytes(random, &noise, sizeof noise);
  const size_t most = is_slow(pair) ? LENGTH_MAX / 2 : LENGTH_MAX;
  fill_inputs(inputs.storage, pair, most, random);
  apply_portable(&pair->portable, pair->todo, most, inputs.storage, expected.storage);
  for (size_t n = 0; n <= most; n += stride(pair, n)) {
    for (size_t offset = 0; offset < OFFSETS; offset++) {
      const size_t out_offset = (offset * 7 + n + 3) % OFFSETS;
      if (!is_share(pair, n, offset)) {
        continue;
      }
      values output, input = noise;
      memcpy(at(&input, evaluator, offset), inputs.storage, n * value_bytes(evaluator));
      memset(&output, GUARD, sizeof output);
      const values before = input;
      apply(&pair->other, pair->todo, n, at(&input, evaluator, offset),
            at(&output, evaluator, out_offset));
      assert_output(pair, &expected, &output, out_offset, n);
      assert_memory_equal(&input, &before, sizeof input);
    }
  }
}

UNIT_TEST(every_length_and_offset_gives_the_same_bits) {
  with_every_pair(compare_lengths_and_offsets);
}

/* Puts values under test into every second lane, in turn each value into each lane, and garbage
 * into the other lanes. */
static void compare_lanes(const kernel_pair *pair, uint64_t *random) {
  enum { LANES = 2 * OFFSETS, RANDOM = 10 };
  const unsigned evaluator = pair->portable.evaluator;
  const size_t count = edge_count(pair) + RANDOM;
  if (pair->is_portable) { /* which have no lanes */
    return;
  }
  const bool costly = is_costly(&pair->portable);
  const size_t step = is_slow(pair) ? count : costly ? 5 : 1;
  values alone, expected, input, output;
  assert_true(count <= LENGTH_MAX);
  for (size_t i = 0; i < count; i++) {
    put(alone.storage, evaluator, i,
        i < edge_count(pair) ? edge(pair, i) : random_input(random, pair));
  }
  apply_portable(&pair->portable, pair->todo, count, alone.storage, expected.storage);
  for (size_t i = 0; i < 2 * count; i += step) {
    for (size_t lane = 0; lane < LANES; lane++) {
      const bool tested = (lane + i) % 2 == 0;
      put(input.storage, evaluator, lane,
          tested ? get(at(&alone, evaluator, (lane + i / 2) % count), evaluator, 0)
                 : garbage(random));
    }
    apply(&pair->other, pair->todo, LANES, input.storage, output.storage);
    for (size_t lane = i % 2; lane < LANES; lane += 2) {
      assert_same_bits(pair, at(&expected, evaluator, (lane + i / 2) % count),
                       at(&output, evaluator, lane), 1, "in a lane");
    }
  }
}

UNIT_TEST(a_lane_does_not_see_its_neighbours) {
  with_every_pair(compare_lanes);
}

/* ---- edges -------------------------------------------------------------------------------- */

/* Nearer to the source than this, some models may give infinity. */
#define NEAR_MM 1e-7

static bool good_R(double r, double value, bool scatters) {
  return value >= 0 && !signbit(value) && (isfinite(value) || (r < NEAR_MM && scatters)) &&
         (r != 0 || (value > 0) == scatters) && (!isinf(r) || value == 0);
}

static bool good_cdf(double r, double value, bool scatters) {
  return value >= 0 && value <= (scatters ? 1 : 0) && !signbit(value) && (r != 0 || value == 0) &&
         (!isinf(r) || value >= (scatters ? 1 - 1e-12 : 0));
}

static bool good_slope(double r, double value, bool scatters) {
  return value <= 0 && (isfinite(value) || (r < NEAR_MM && scatters)) &&
         ((!isinf(r) && scatters) || value == 0);
}

static bool good_ln_R(double r, double value, bool scatters) {
  return !isnan(value) && (value < 1000 || (isinf(value) && r < NEAR_MM && scatters)) &&
         (!isinf(r) || value == -INFINITY) && (r > NEAR_MM || (value > -INFINITY) == scatters);
}

static bool good_pdf(double r, double value, bool scatters) {
  return value >= 0 && isfinite(value) && ((!isinf(r) && scatters) || value == 0);
}

static bool good_transfer(double f, double value, bool scatters) {
  return value >= 0 && value < 1.2 && ((!isinf(f) && scatters) || value == 0);
}

static bool good_derivative(double r, double value, bool scatters) {
  return (isfinite(value) || r > 1e30) && !isnan(value) && ((!isinf(r) && scatters) || value == 0);
}

/* These media have none. */
static bool good_T(double r, double value, bool scatters) {
  (void)r;
  (void)scatters;
  return value == 0 && !signbit(value);
}

static bool good_sample(double u, double value, bool scatters) {
  return value >= 0 && !signbit(value) && ((u > 0 && scatters) || value == 0) &&
         (u < 1 || !scatters || isinf(value));
}

/* Checks a value at any input: it is not NaN, and has the sign and the limits of its quantity. */
static void check_edge(const kernel_pair *pair, double input, double value, bool scatters) {
  typedef bool good_value(double input, double value, bool scatters);
  static const struct {
    unsigned quantity;
    good_value *good;
  } checks[] = {
      {0, good_sample},
      {CORE_QUANTITY_R, good_R},
      {CORE_QUANTITY_CDF, good_cdf},
      {CORE_QUANTITY_SLOPE, good_slope},
      {CORE_QUANTITY_LN_R, good_ln_R},
      {CORE_QUANTITY_PDF, good_pdf},
      {CORE_QUANTITY_RING, good_pdf},
      {CORE_QUANTITY_S, good_R},
      {CORE_QUANTITY_TRANSFER, good_transfer},
      {CORE_QUANTITY_BY_SIGMA_A, good_derivative},
      {CORE_QUANTITY_BY_SIGMA_S, good_derivative},
      {CORE_QUANTITY_T, good_T},
  };
  for (size_t i = 0; i < sizeof checks / sizeof checks[0]; i++) {
    if (checks[i].quantity == pair->todo.quantity) {
      if (!checks[i].good(input, value, scatters)) {
        fail_msg("%s of %s %s, sigma_t' %g, eta %g, at %g is %.17g", pair->todo.name,
                 core_choice_by_id(core_models, pair->other.model)->name,
                 core_choice_by_id(core_evaluators, pair->other.evaluator)->name,
                 1 / mfp_of(&pair->other), pair->other.medium.eta, input, value);
      }
      return;
    }
  }
  fail_msg("the edges of %s are not checked", pair->todo.name);
}

static void compare_edges(const kernel_pair *pair, uint64_t *random) {
  (void)random;
  const unsigned evaluator = pair->portable.evaluator;
  const bool scatters = pair->portable.albedo > 0;
  values in, expected, out;
  for (size_t i = 0; i < edge_count(pair); i++) {
    put(in.storage, evaluator, i, edge(pair, i));
  }
  apply_portable(&pair->portable, pair->todo, edge_count(pair), in.storage, expected.storage);
  if (pair->is_portable) {
    out = expected;
  } else {
    apply(&pair->other, pair->todo, edge_count(pair), in.storage, out.storage);
  }
  assert_same_bits(pair, expected.storage, out.storage, edge_count(pair), "at an edge");
  for (size_t i = 0; i < edge_count(pair); i++) {
    check_edge(pair, get(in.storage, evaluator, i), get(out.storage, evaluator, i), scatters);
  }
}

UNIT_TEST(edges_have_their_limits) {
  with_every_pair(compare_edges);
}

/* ---- choosing ----------------------------------------------------------------------------- */

UNIT_TEST(instruction_sets_are_chosen_by_name) {
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
