/* The dipole family at the ends of the domain and of both number formats, where a random round of
 * tests/accuracy/truth.c hardly comes, and against published and independent numbers. */
#include <float.h>
#include <math.h>

#include "tests/accuracy/forms.h"
#include "tests/accuracy/vectors.h"
#include "tests/unit/unit.h"

/* A bound this many times larger than the worst error found says too little. */
#define LOOSEST 4.0

/* Infinite radii and those next to the ends of both formats, then ordinary ones. */
static const double ends[] = {0,     -0.0,  5e-324, 1e-310,  1e-300, 1e-160, 1e-45,   1e-40,
                              1e-20, 1e18,  1e19,   1e20,    1e30,   3e38,   1e75,    1e100,
                              1e150, 1e155, 1e300,  DBL_MAX, 1e-38,  1.7e38, INFINITY};

enum { ENDS = sizeof ends / sizeof ends[0], ORDINARY = 17, RADII = ENDS + ORDINARY };

static const enum core_quantity quantities[CORE_ELEMENTWISE_COUNT] = {
#define CORE_QUANTITY(bit, IDENT, name, unit, SHAPE)                                               \
  CORE_IF_##SHAPE([CORE_ELEMENTWISE_##IDENT] = CORE_QUANTITY_##IDENT, )
#include "core/choices.def"
};

/* Returns the error of one value over what is stated. */
static double share_of(const form_model *form, const core_profile *profile, int quantity,
                       double r) {
  const bool single = profile->evaluator == CORE_EVALUATOR_F32;
  const float r_f32 = (float)r;
  const double far = single ? 1e12 : 1e100;
  const double at = single ? (double)r_f32 : r, x = at * (double)form->part[0].sigma_t_prime;
  float value_f32;
  double value;
  if (single) {
    core_eval_f32(profile, quantities[quantity], 1, &r_f32, &value_f32);
    value = (double)value_f32;
  } else {
    core_eval_f64(profile, quantities[quantity], 1, &at, &value);
  }
  if (quantity == CORE_ELEMENTWISE_LN_R && x > far * (1 - 1e-5)) {
    return value == -(double)INFINITY || x < far * (1 + 1e-5) ? 0 : (double)INFINITY;
  }
  const quad truth = form_truth(form, form_at(form, at, false), quantity, at);
  const bool known = !isnan(truth) && form_promises(form, quantity, at);
  return known ? form_share(form, profile, quantity, at, value, truth, 0) : 0;
}

/* Compares all quantities of a model at the ends; raises *worst to the largest share. */
static void compare(unsigned model, unsigned evaluator, const core_medium *medium, double *worst) {
  static form_model form;
  core_parameters parameters = core_parameters_none();
  core_profile profile;
  parameters.value[CORE_PARAMETER_COS_IN] = parameters.value[CORE_PARAMETER_COS_OUT] = 1;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), model, CORE_MOMENTS_EXACT,
                                         evaluator, medium, &parameters),
                    NULL, 0);
  form_prepare(&form, model, CORE_MOMENTS_EXACT, medium, &parameters);
  const double albedo = form_share(&form, &profile, FORM_ALBEDO, 0, profile.albedo, form.albedo, 0);
  assert_true(albedo <= 1);
  for (int i = 0; i < RADII; i++) {
    const double r = i < ENDS ? ends[i] : pow(10, 0.375 * (i - ENDS) - 3) * profile.scale_mm;
    for (int q = 0; q < CORE_ELEMENTWISE_COUNT; q++) {
      const double share = share_of(&form, &profile, q, r);
      if (!(share <= 1)) {
        fail_msg(
            "model %u evaluator %u, sigma_a %.17g sigma_s %.17g g %.17g eta %.17g, quantity %d "
            "at %.17g: %.3f of what is stated",
            model, evaluator, medium->sigma_a_per_mm, medium->sigma_s_per_mm, medium->g,
            medium->eta, q, r, share);
      }
      *worst = fmax(*worst, share);
    }
  }
}

UNIT_TEST(the_stated_bound_holds_at_the_ends_and_is_not_loose) {
  static const double sigmas[] = {1.1e-15, 1, 9e14}, ratios[] = {0, 1e-12, 1, 1e6, INFINITY};
  static const double gs[] = {0, -.99, .999}, etas[] = {CORE_ETA_MIN, 1, 1.4, CORE_ETA_MAX};
  for (unsigned model = CORE_MODEL_CLASSICAL; model <= CORE_MODEL_BOUNDARY_EXITANCE; model++) {
    double worst[2] = {0, 0};
    for (int i = 0; i < 3 * 5 * 3 * 4; i++) {
      const double sigma = sigmas[i % 3], ratio = ratios[i / 3 % 5], g = gs[i / 15 % 3];
      const double sigma_s_prime = isinf(ratio) ? 0 : sigma / (1 + ratio);
      const core_medium medium = {isinf(ratio) ? sigma : sigma_s_prime * ratio,
                                  fmin(sigma_s_prime / (1 - g), CORE_SIGMA_MAX_PER_MM), g,
                                  etas[i / 45]};
      compare(model, CORE_EVALUATOR_F64, &medium, &worst[0]);
      compare(model, CORE_EVALUATOR_F32, &medium, &worst[1]);
    }
    printf("model %u: at most %.3f (f64) and %.3f (f32) of what is stated\n", model, worst[0],
           worst[1]);
    assert_true(worst[0] * LOOSEST >= 1 && worst[1] * LOOSEST >= 1);
  }
  reference_fresnel_forget();
}

/* ---- the vectors -------------------------------------------------------------------------- */

/* The true values were rounded once, so half an ulp of them is added to what is allowed. */
static void assert_vector(double value, double expected, double bound, size_t row,
                          const char *what) {
  double allowed = (bound + 0.5 * DBL_EPSILON) * expected;
  if (expected < DBL_MIN) {
    allowed = fmax(allowed, 16 * DBL_TRUE_MIN);
  }
  if (!(fabs(value - expected) <= allowed)) {
    fail_msg("row %zu, %s: %.17g, expected %.17g", row + 1, what, value, expected);
  }
}

UNIT_TEST(holds_for_the_vectors) {
  size_t count;
  vector *vectors = vectors_read(VECTORS_FILE_ALL, &count);
  if (vectors == NULL) {
    vectors = vectors_read(VECTORS_FILE, &count);
  }
  assert_non_null(vectors);
  for (size_t i = 0; i < count; i++) {
    const vector *v = &vectors[i];
    core_profile profile;
    double R, cdf;
    unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), v->model, v->moments,
                                           CORE_EVALUATOR_F64, &v->medium, NULL),
                      NULL, 0);
    core_eval_f64(&profile, CORE_QUANTITY_R, 1, &v->r_mm, &R);
    core_eval_f64(&profile, CORE_QUANTITY_CDF, 1, &v->r_mm, &cdf);
    const double bound = profile.numerical_error + profile.numerical_error_per_mm * v->r_mm;
    assert_vector(profile.albedo, v->albedo, profile.numerical_error, i, "albedo");
    assert_vector(R, v->R, bound, i, "R");
    assert_vector(cdf, v->cdf, bound, i, "cdf");
  }
  printf("%zu vectors\n", count);
  free(vectors);
}

/* One renderer's test publishes these albedos as 185, 138, 112 of 255; its F_dr is Egan and
 * Hilgeman's. */
UNIT_TEST(skin2_has_its_published_albedo) {
  static const double expected[3] = {0.72775656, 0.54408776, 0.44055470};
  const core_measured_medium *skin2 = core_measured_medium_by_name("skin2");
  for (size_t i = 0; i < 3; i++) {
    core_medium medium = skin2->channel[i];
    medium.eta = 1;
    core_profile profile;
    unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_CLASSICAL,
                                           CORE_MOMENTS_JENSEN, CORE_EVALUATOR_F64, &medium, NULL),
                      NULL, 0);
    assert_true(fabs(profile.albedo - expected[i]) <= 5e-9);
  }
}

/* Energy is conserved to the last bit: the better dipole returns all that enters when nothing is
 * absorbed. */
UNIT_TEST(better_dipole_returns_everything_without_absorption) {
  uint64_t random = unit_seed();
  for (int i = 0; i < 1000; i++) {
    const core_medium medium = {0, unit_random_log(&random, 1e-6, 1e6),
                                unit_random_between(&random, -.9, .9),
                                unit_random_log(&random, CORE_ETA_MIN, CORE_ETA_MAX)};
    core_profile profile;
    unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_BETTER,
                                           CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &medium, NULL),
                      NULL, 0);
    assert_true(profile.albedo == 1);
  }
}
