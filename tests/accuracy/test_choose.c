/* The choice by tolerance: the prepared profile keeps the error that the choice promised; costs; and
 * requests that nothing can serve. */
#include <math.h>

#include "core/choose.h"
#include "tests/unit/unit.h"

static const core_medium ordinary = {0.05, 1, 0, 1.4};

static core_choose_request easy(const core_medium *media, size_t media_count) {
  return (core_choose_request){
      .media = media,
      .layer_count = 1,
      .eta_below = (double)NAN,
      .media_count = media_count,
      .wanted = CORE_QUANTITY_R,
      .radii = {5, 10},
      .radius_count = 1000000,
      .tolerance = 0.3,
  };
}

static core_candidate choose(const core_choose_request *request) {
  core_candidate candidates[CORE_TRANSPORT_CANDIDATES];
  assert_true(core_choose(request, candidates) > 0);
  assert_int_equal(candidates[0].model, CORE_MODEL_TRANSPORT);
  return candidates[0];
}

/* A candidate's profile states no more than the candidate does, and little less. */
static void check_promise(const core_choose_request *request, const core_candidate *candidate) {
  for (size_t i = 0; i < request->media_count; i++) {
    core_parameters parameters = core_parameters_none();
    core_profile profile;
    parameters.value[CORE_PARAMETER_TOLERANCE] = candidate->numerical_tolerance;
    profile = unit_profile(candidate->model, candidate->evaluator, &request->media[i], &parameters);
    const core_stated_errors errors =
        core_profile_errors(&profile, request->wanted, request->radii);
    const double stated = errors.numerical + errors.numerical_per_mm * request->radii.most_mm;
    UNIT_FAIL_IF(!(stated <= candidate->numerical_error),
                 "sigma_a %g, g %g, eta %g, wanted %u, evaluator %u: promised %.10g, stated %.10g",
                 request->media[i].sigma_a_per_mm, request->media[i].g, request->media[i].eta,
                 request->wanted, candidate->evaluator, candidate->numerical_error, stated);
    core_profile_free(&profile);
  }
}

UNIT_TEST(promises_are_what_is_stated) {
  enum { REQUESTS = 120 };
  static const unsigned wants[] = {
      CORE_QUANTITY_R,   CORE_QUANTITY_R | CORE_QUANTITY_ALBEDO, CORE_QUANTITY_PDF,
      CORE_QUANTITY_CDF, CORE_QUANTITY_LN_R | CORE_QUANTITY_R,   CORE_QUANTITY_SLOPE};
  uint64_t random = unit_seed();
  size_t promises = 0;
  for (size_t i = 0; i < REQUESTS; i++) {
    const double ratio = unit_random_log(&random, 1e-4, 9);
    const double g = i % 3 == 0 ? 0 : unit_random_between(&random, -0.49, 0.94);
    const core_medium medium = {ratio / (1 + ratio), 1 / (1 + ratio) / (1 - g), g,
                                unit_random_between(&random, 0.8, 2)};
    const double least = unit_random_log(&random, 0.01, 10);
    const core_choose_request request = {
        .media = &medium,
        .layer_count = 1,
        .eta_below = (double)NAN,
        .media_count = 1,
        .wanted = wants[unit_random_below(&random, sizeof wants / sizeof wants[0])],
        .radii = {least, least * unit_random_log(&random, 1, 10)},
        .radius_count = (uint64_t)unit_random_log(&random, 1, 1e9),
        .single = i % 2 == 1,
        .tolerance = unit_random_log(&random, 2e-4, 0.5),
    };
    core_candidate candidates[CORE_TRANSPORT_CANDIDATES];
    const size_t n = core_choose(&request, candidates);
    assert_int_equal(n, request.single ? 2 : 1);
    for (size_t k = 0; k < n && candidates[k].meets; k++) {
      assert_true(candidates[k].error <= request.tolerance);
      assert_true(candidates[k].model_error == 0);
      if (!candidates[k].looked_up) {
        assert_true(candidates[k].left <= request.tolerance);
        continue;
      }
      check_promise(&request, &candidates[k]);
      promises++;
    }
  }
  printf("%zu promises\n", promises);
  assert_true(promises > REQUESTS);
}

/* ---- costs ----------------------------------------------------------------------------------- */

static core_candidate choose_for(core_choose_request request, uint64_t radius_count) {
  request.radius_count = radius_count;
  return choose(&request);
}

UNIT_TEST(few_radii_are_not_worth_a_table) {
  core_choose_request request = easy(&ordinary, 1);
  request.single = true;
  assert_int_equal(choose_for(request, 1).evaluator, CORE_EVALUATOR_F32);
  assert_int_equal(choose_for(request, 1000000000).evaluator, CORE_EVALUATOR_LUT);
  request.wanted = CORE_QUANTITY_ALBEDO; /* no radius counts */
  assert_int_equal(choose_for(request, 1000000000).evaluator, CORE_EVALUATOR_F32);
  request.single = false;
  assert_int_equal(choose_for(request, 1000000000).evaluator, CORE_EVALUATOR_F64);
}

UNIT_TEST(the_total_is_that_of_a_medium) {
  core_choose_request request = easy(&ordinary, 1);
  request.wanted =
      CORE_QUANTITY_R | CORE_QUANTITY_PDF | CORE_QUANTITY_ALBEDO | CORE_QUANTITY_RADIUS;
  request.radius_count = 1234;
  const core_candidate one = choose(&request);
  assert_true(one.total_ns == one.prepare_ns + 2 * 1234 * one.cost_ns);
}

/* ---- what limits a choice -------------------------------------------------------------------- */

/* One more quantity never makes the error smaller. */
UNIT_TEST(what_is_wanted_has_to_be_met_together) {
  core_choose_request request = easy(&ordinary, 1);
  const double R = choose(&request).error;
  request.wanted |= CORE_QUANTITY_ALBEDO | CORE_QUANTITY_LN_R | CORE_QUANTITY_SLOPE;
  assert_true(choose(&request).error >= R);
}

/* Nothing can do it: the nearest that there is comes first, and says how near. */
UNIT_TEST(a_tolerance_that_nothing_meets) {
  core_choose_request request = easy(&ordinary, 1);
  request.tolerance = 1e-9;
  core_candidate choice = choose(&request);
  assert_false(choice.meets);
  assert_true(choice.error > 1e-9 && choice.error < 1e-5);
  request.tolerance = (double)NAN;
  assert_false(choose(&request).meets);
  request = easy(&ordinary, 1);
  request.radii.most_mm = (double)INFINITY; /* where transport does not reach */
  assert_false(choose(&request).meets);
  static const core_medium out_of_all = {0.05, 1, 0, 5};
  request = easy(&out_of_all, 1);
  choice = choose(&request);
  assert_false(choice.meets);
  assert_true(isinf(choice.error));
  core_candidate candidates[CORE_TRANSPORT_CANDIDATES];
  request.media_count = 0;
  assert_int_equal(core_choose(&request, candidates), 0);
}

/* A medium of which nothing is known spoils the promise for all. */
UNIT_TEST(the_choice_holds_for_all_channels) {
  const core_medium media[3] = {ordinary, {0.06, 1, 0, 1.4}, {0.05, 1, 0, 5}};
  core_choose_request request = easy(media, 2);
  assert_true(choose(&request).meets);
  request = easy(media, 3);
  assert_false(choose(&request).meets);
}

/* Where the table of solutions has no medium, or is not exact enough, it is solved: with the tolerance
 * as the error, which the profile then states or misses. */
UNIT_TEST(what_the_table_does_not_keep_is_solved) {
  const core_medium beyond = {0.1, 1, 0, 2.5}, tissue = {0.05, 2, 0.5, 1.4};
  core_choose_request request = easy(&beyond, 1);
  core_candidate choice = choose(&request);
  assert_true(choice.meets && !choice.looked_up && choice.error <= request.tolerance);
  assert_true(isnan(choice.numerical_tolerance)); /* that of every solution */
  request = easy(&tissue, 1);
  choice = choose(&request);
  assert_true(choice.looked_up && isnan(choice.left));
  request.tolerance = 2.5e-4;
  choice = choose(&request);
  assert_true(choice.meets && !choice.looked_up && choice.error <= 2.5e-4);
  assert_true(choice.prepare_ns > 1e8 && choice.evaluator == CORE_EVALUATOR_F64);
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = choice.numerical_tolerance;
  assert_true(core_prepares_slowly(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, &tissue, &parameters));
  core_profile profile =
      unit_profile(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, &tissue, &parameters);
  const core_stated_errors errors = core_profile_errors(&profile, request.wanted, request.radii);
  assert_true(errors.numerical + errors.numerical_per_mm * request.radii.most_mm <= choice.left);
  core_profile_free(&profile);
  request.radii.least_mm = 0.01; /* nearer, solutions are less exact */
  assert_true(choose(&request).numerical_tolerance < 0.3 * choice.numerical_tolerance);
  request.tolerance = 1e-5;
  choice = choose(&request);
  assert_true(!choice.meets && choice.error < 2e-3);
}

/* The same in other units of length, for the radii are relative to the medium. */
UNIT_TEST(lengths_do_not_matter) {
  const core_medium dense = {50, 1000, 0, 1.4};
  core_choose_request request = easy(&ordinary, 1);
  const core_candidate choice = choose(&request);
  request = easy(&dense, 1);
  request.radii = (core_radii_range){5e-3, 10e-3};
  assert_true(choice.error == choose(&request).error);
}

/* Other models are offered with the costs of their evaluators. */
UNIT_TEST(an_offer_has_its_costs) {
  const core_choose_request request = easy(&ordinary, 1);
  size_t count = 0;
  for (; core_costed_models[count] != 0; count++) {
    core_candidate one;
    core_offer(&one, &request, core_costed_models[count], CORE_EVALUATOR_F64, 0.1, 0.01);
    assert_true(one.cost_ns > 0 && one.prepare_ns > 0);
    assert_true(one.total_ns == one.prepare_ns + 1e6 * one.cost_ns);
    assert_true(fabs(one.error - (0.1 + 1.1 * 0.01)) < 1e-15 && one.meets);
  }
  assert_int_equal(2 * count, CORE_CANDIDATES_MAX);
}
