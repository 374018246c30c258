/* A tolerance in place of a model, without a daemon: which solutions a channel gets, and that the
 * tolerance that a refusal names is kept. Solutions are profiles that state a given error. */
#include <math.h>

#include "core/kernels.h"
#include "server/jobs/choice.h"
#include "tests/unit/unit.h"

/* Two media that the table of solutions lacks, and one that it has at 3.4e-4 (at R from 5 mm). */
static const core_medium MEDIA[] = {
    {0.1, 1, 0, 2.5}, {0.2, 1, 0, 2.5}, {0.05, 10, 0.9, 1.4}, {0.1, 10, 0.9, 2.4}};
static const core_radii_range RADII = {5, 10};

static eval_request request_of(const core_medium *media, uint32_t count, double tolerance) {
  eval_request request = {.fixed = {.model = EVAL_ANY_MODEL,
                                    .evaluator = CORE_EVALUATOR_F64,
                                    .moments = CORE_MOMENTS_EXACT,
                                    .wanted = CORE_QUANTITY_R,
                                    .medium_count = count,
                                    .layer_count = 1,
                                    .radius_count = 2},
                          .parameters = core_parameters_none(),
                          .media = media};
  request.parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
  return request;
}

/* Returns a profile that states this error everywhere. */
static core_profile profile_of(const core_medium *medium, double error) {
  core_profile profile = {.medium = *medium,
                          .model = CORE_MODEL_TRANSPORT,
                          .evaluator = CORE_EVALUATOR_F64,
                          .numerical_error = error,
                          .reach = {.most_mm = (double)INFINITY}};
  for (size_t i = 0; i <= CORE_ERROR_BANDS; i++) {
    profile.numerical_errors[i] = error;
  }
  return profile;
}

/* Prepares all channels by turns, as eval.c does: solutions state usual[channel], or the error of the
 * finest grid. Returns the refusal. *solved: how many are solved. */
static wire_error answer(eval_request *request, const core_medium *media, const double *usual,
                         const double *finest, size_t *solved) {
  struct choice_state state;
  wire_error error = choice_first(&state, request, RADII);
  *solved = 0;
  for (uint32_t i = 0; error.status == WIRE_STATUS_OK && i < request->fixed.medium_count; i++) {
    bool again = true;
    while (again) {
      const core_parameters parameters = choice_parameters(&state, request, &media[i], RADII);
      const double tolerance = parameters.value[CORE_PARAMETER_TOLERANCE];
      const bool is_stored = isnan(tolerance) && core_transport_is_stored(&media[i]);
      const core_profile profile =
          profile_of(&media[i], is_stored                            ? 3.4e-4
                                : tolerance <= CORE_TOLERANCE_FINEST ? finest[i]
                                                                     : usual[i]);
      *solved += !is_stored;
      again = !choice_keeps(&state, request, RADII, &profile, &media[i], i);
    }
  }
  return error.status == WIRE_STATUS_OK ? choice_refusal(&state, request) : error;
}

static double named_by(const wire_error *error) {
  double least;
  assert_int_equal(error->status, WIRE_STATUS_BAD_VALUE);
  assert_string_equal(error->field, "tolerance");
  assert_int_equal(sscanf(error->allowed, "at least %lf", &least), 1);
  return least;
}

static void assert_kept(wire_error error) {
  UNIT_FAIL_IF(error.status != WIRE_STATUS_OK, "refused: %s", error.allowed);
}

UNIT_TEST(a_refused_tolerance_names_one_that_is_kept) {
  static const struct {
    size_t medium, count;
    double tolerance, usual[2], finest[2], least;
  } cases[] = {
      {0, 1, 1e-9, {9e-4, 0}, {1.256e-4, 0}, 1.256e-4}, /* below what any solution states */
      {0, 1, 5e-4, {9e-4, 0}, {7e-4, 0}, 7e-4},
      {0, 2, 5e-4, {9e-4, 9e-4}, {6e-4, 8e-4}, 8e-4}, /* each channel has to keep it */
      {0, 2, 5e-4, {9e-4, 4e-4}, {8e-4, 6e-4}, 8e-4},
      {0, 2, 2e-5, {9e-4, 9e-4}, {9e-4, 8e-4}, 9e-4},
      {2, 1, 1e-4, {9e-4, 0}, {8e-4, 0}, 3.44e-4}, /* the table is better */
      {2, 1, 1e-4, {9e-4, 0}, {1.5e-4, 0}, 1.5e-4},
      {2, 2, 1e-4, {9e-4, 9e-4}, {8e-4, 3e-4}, 3.44e-4},
  };
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    const core_medium *media = &MEDIA[cases[i].medium];
    eval_request request = request_of(media, (uint32_t)cases[i].count, cases[i].tolerance);
    size_t solved;
    const wire_error error = answer(&request, media, cases[i].usual, cases[i].finest, &solved);
    const double least = named_by(&error);
    printf("tolerance %g: at least %g\n", cases[i].tolerance, least);
    assert_true(least >= 0.98 * cases[i].least && least <= 1.02 * cases[i].least);
    request = request_of(media, (uint32_t)cases[i].count, least);
    assert_kept(answer(&request, media, cases[i].usual, cases[i].finest, &solved));
  }
}

/* A channel that the usual solution serves is not solved again, nor one that the table serves. */
UNIT_TEST(only_what_misses_is_solved_finely) {
  static const double usual[] = {9e-4, 4e-4}, finest[] = {3e-4, 2e-4};
  size_t solved;
  eval_request request = request_of(MEDIA, 2, 5e-4);
  assert_kept(answer(&request, MEDIA, usual, finest, &solved));
  assert_int_equal(solved, 3);
  request = request_of(&MEDIA[1], 2, 7e-4); /* solved, and stored */
  assert_kept(answer(&request, &MEDIA[1], usual, finest, &solved));
  assert_int_equal(solved, 2);
}

/* Layers are solved to the tolerance, however loose. A refusal names the least tolerance that can be
 * kept. */
UNIT_TEST(a_tolerance_chooses_the_grids_of_layers) {
  static const core_medium skin[] = {{0.5, 10, 0.8, 1.4, 0.1}, {0.05, 10, 0.8, 1.4, 0}};
  static const double usual[] = {8e-3}, missed[] = {1.2e-2}, finest[] = {2e-3};
  size_t solved;
  eval_request request = request_of(skin, 1, 1e-2);
  request.fixed.layer_count = request.parameters.layer_count = 2;
  eval_request finer = request, hopeless = request;
  assert_kept(answer(&request, skin, usual, finest, &solved));
  assert_int_equal(solved, 1);
  const double taken = request.parameters.value[CORE_PARAMETER_TOLERANCE];
  assert_true(request.fixed.model == CORE_MODEL_TRANSPORT && taken > 9e-3 && taken <= 1e-2);
  assert_kept(answer(&finer, skin, missed, finest, &solved));
  assert_int_equal(solved, 2);
  hopeless.parameters.value[CORE_PARAMETER_TOLERANCE] = 1e-3;
  const wire_error error = answer(&hopeless, skin, missed, finest, &solved);
  assert_true(fabs(named_by(&error) - 2e-3) < 4e-5);

  request = request_of(skin, 1, 1e-2); /* a slab */
  assert_true(choice_check(&request).status == WIRE_STATUS_OK);
  request.fixed.layer_count = request.parameters.layer_count = 2;
  assert_true(choice_check(&request).status == WIRE_STATUS_OK);
  const core_medium wrong[] = {skin[0], {0.05, 10, 0.8, 5, 0}};
  request.media = wrong;
  const wire_error beyond = choice_check(&request);
  assert_string_equal(beyond.field, "eta");
  assert_int_equal(beyond.index, 1);
}

/* Named, transport comes from its table wherever that keeps the tolerance at the radii. */
UNIT_TEST(a_named_tolerance_counts_at_the_radii) {
  const struct choice_state named = {.tolerance = (double)NAN, .left = (double)NAN};
  const core_medium *tissue = &MEDIA[2];
  eval_request request = request_of(tissue, 1, 5e-4);
  request.fixed.model = CORE_MODEL_TRANSPORT;
  assert_true(choice_heeds_radii(&named, &request));
  core_parameters parameters = choice_parameters(&named, &request, tissue, RADII);
  assert_true(isnan(parameters.value[CORE_PARAMETER_TOLERANCE]));
  assert_false(core_prepares_slowly(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, tissue, &parameters));
  const core_radii_range near = {0.05, 10}; /* the table is less exact there */
  parameters = choice_parameters(&named, &request, tissue, near);
  assert_true(parameters.value[CORE_PARAMETER_TOLERANCE] == 5e-4);
  core_medium slab = *tissue; /* the table has half spaces alone */
  slab.thickness_mm = 2;
  parameters = choice_parameters(&named, &request, &slab, RADII);
  assert_true(parameters.value[CORE_PARAMETER_TOLERANCE] == 5e-4);
  request.fixed.evaluator = CORE_EVALUATOR_LUT;
  assert_false(choice_heeds_radii(&named, &request));
  request.fixed.evaluator = CORE_EVALUATOR_F64;
  request.fixed.model = CORE_MODEL_BETTER;
  assert_false(choice_heeds_radii(&named, &request));
}
