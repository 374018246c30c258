/* What every model gives at the ends of the number formats and of the domain, and instruction sets by
 * their names. tests/bits has the bits of their kernels. */
#include <float.h>
#include <math.h>

#include "tests/unit/unit.h"

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

static const double edge_radii[] = {0,     -0.0, 5e-324, 2.3e-308, 1e-300, 1e-45,   1.2e-38, 1e-30,
                                    1e-15, 1,    1e15,   1e19,     3e38,   1e150,   1e151,   1e300,
                                    1e-7,  1e7,  1e-154, 1e160,    1e-20,  DBL_MAX, INFINITY};
static const double edge_cdfs[] = {
    0,     -0.0, 5e-324,   1e-300,      1e-45,          1.2e-38, 1e-31, 1e-30, 1.1e-13,
    1e-13, 1e-7, .5,       1 - 1e-7,    1 - 0x1p-24,    1,       .9999, 1e-12, 1 - 1e-12,
    1e-20, .999, 0x1p-126, 1 - 0x1p-53, 1 - FLT_EPSILON};

enum { EDGES = sizeof edge_radii / sizeof edge_radii[0] };
_Static_assert(EDGES == sizeof edge_cdfs / sizeof edge_cdfs[0], "as many of each");

/* Prepares a profile. Returns false if the medium lies outside the domain of the model. */
static bool prepare(core_profile *profile, unsigned model, unsigned evaluator,
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
      profile, core_isa_select(NULL), model, CORE_MOMENTS_EXACT, evaluator, &needed, &parameters);
  if (fault.field == NULL) {
    return true;
  }
  assert_true(strcmp(fault.field, "eta") == 0 || strcmp(fault.field, "sigma_a") == 0 ||
              strcmp(fault.field, "fit_from") == 0 ||
              (evaluator == CORE_EVALUATOR_LUT && strcmp(fault.field, "tolerance") == 0));
  return false;
}

/* The kernels that evaluate each model. */
static const struct {
  unsigned model;
  const char *kernels;
} kernels_of[] = {
#define MODEL(id, IDENT, name, formula, kernels, ...) {id, #kernels},
#define SUM(id, ...) {id, "sum"},
    CORE_EACH_MODEL(MODEL, SUM)};

/* Returns whether an earlier model has the same kernels and differs only in its coefficients. */
static bool is_like_an_earlier_one(size_t model) {
  size_t i = 0;
  while (strcmp(kernels_of[i].kernels, kernels_of[model].kernels) != 0 ||
         core_solves(kernels_of[i].model) != core_solves(kernels_of[model].model)) {
    i++;
  }
  return i < model;
}

/* Returns for how many media a model is tested: transport without absorption, and of layers, takes
 * seconds to prepare, in either precision by the same solver. All models share the kernels of tables,
 * so that a flat and a steep model are enough for these. */
static size_t media_of(unsigned model, unsigned evaluator) {
  if (evaluator == CORE_EVALUATOR_LUT && model != CORE_MODEL_CLASSICAL &&
      model != CORE_MODEL_BURLEY) {
    return 0;
  }
  const bool slow =
      core_prepares_slowly(model, evaluator, NULL, NULL) && model != CORE_MODEL_BURLEY;
  return !slow                                                                      ? MEDIA
         : core_solves(model) && evaluator != CORE_EVALUATOR_F64 && !unit_is_long() ? 1
                                                                                    : 2;
}

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
static void check_edge(const core_profile *profile, const char *name, unsigned quantity,
                       double input, double value) {
  const bool scatters = profile->albedo > 0;
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
    if (checks[i].quantity == quantity) {
      UNIT_FAIL_IF(!checks[i].good(input, value, scatters),
                   "%s of %s %s, sigma_a %g, sigma_s %g, eta %g, at %g is %.17g", name,
                   core_choice_by_id(core_models, profile->model)->name,
                   core_choice_by_id(core_evaluators, profile->evaluator)->name,
                   profile->medium.sigma_a_per_mm, profile->medium.sigma_s_per_mm,
                   profile->medium.eta, input, value);
      return;
    }
  }
  fail_msg("the edges of %s are not checked", name);
}

/* Checks a quantity at all edges, or radii that are drawn (quantity 0). */
static void check_edges(const core_profile *profile, const char *name, unsigned quantity) {
  const double *edges = quantity == 0 ? edge_cdfs : edge_radii;
  double in[EDGES], out[EDGES];
  float in_f32[EDGES], out_f32[EDGES];
  for (size_t i = 0; i < EDGES; i++) {
    in_f32[i] = (float)edges[i];
    in[i] = profile->evaluator == CORE_EVALUATOR_F64 ? edges[i] : (double)in_f32[i];
  }
  if (profile->evaluator == CORE_EVALUATOR_F64) {
    quantity == 0 ? core_sample_f64(profile, EDGES, in, out)
                  : core_eval_f64(profile, quantity, EDGES, in, out);
  } else {
    quantity == 0 ? core_sample_f32(profile, EDGES, in_f32, out_f32)
                  : core_eval_f32(profile, quantity, EDGES, in_f32, out_f32);
  }
  for (size_t i = 0; i < EDGES; i++) {
    check_edge(profile, name, quantity, in[i],
               profile->evaluator == CORE_EVALUATOR_F64 ? out[i] : (double)out_f32[i]);
  }
}

static void check_profile(const core_profile *profile) {
  const unsigned derived = CORE_QUANTITY_MODEL_ERRORS | CORE_PATHS | CORE_MODULATED;
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    if ((quantity->id & CORE_ARRAYS) != 0 && (quantity->id & derived) == 0 &&
        (!core_wants_derivatives(quantity->id) || core_has_derivatives(profile->model))) {
      check_edges(profile, quantity->name, quantity->id);
    }
  }
  check_edges(profile, "sample", 0);
}

UNIT_TEST(edges_have_their_limits) {
  for (size_t m = 0; m < sizeof kernels_of / sizeof *kernels_of; m++) {
    const unsigned model = kernels_of[m].model;
    for (const core_choice *e = core_evaluators; e->name != NULL && !is_like_an_earlier_one(m);
         e++) {
      for (size_t i = 0; i < media_of(model, e->id); i++) {
        core_profile profile;
        if (prepare(&profile, model, e->id, &media[i])) {
          check_profile(&profile);
          core_profile_free(&profile);
        }
      }
    }
  }
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
