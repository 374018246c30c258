/* Light gathered through nodes against the sum of all points in double precision, at random queries
 * of eleven scenes: never outside of the tolerance, with every evaluator and several models. The same
 * bits on all instruction sets, in any order and any slices. Sheets and half planes of light against
 * the albedo and a quadrature.
 *
 * The default run takes some of the scenes' points, queries and models; `test_gather all` takes
 * 1,000 queries of each scene with 20,000 points.
 */
#include <float.h>
#include <math.h>

#include "core/gather/gather.h"
#include "tests/unit/unit.h"

enum { CHANNELS = 3, POINTS_MOST = 20000, QUERIES_MOST = 1000 };

static size_t points_in_use = 1500, queries_in_use = 24;
static bool all_of_them;

UNIT_SETUP(read_arguments) {
  all_of_them = unit_arguments[0] != NULL && strcmp(unit_arguments[0], "all") == 0;
  points_in_use = all_of_them ? POINTS_MOST : points_in_use;
  queries_in_use = all_of_them ? QUERIES_MOST : queries_in_use;
}

/* ---- scenes ---------------------------------------------------------------------------------- */

enum scene {
  UNIFORM,
  CLUSTERED,
  FAR_POINT,
  COINCIDENT,
  PLANE,
  SPHERE,
  TWO_SHEETS,
  LINE,
  COLOURED,
  FAR_AWAY,
  GRAIN,
  SCENES
};

static const char *const scene_names[SCENES] = {"uniform",
                                                "clustered",
                                                "one bright point far away",
                                                "coincident points",
                                                "a plane",
                                                "a sphere",
                                                "two sheets",
                                                "a line",
                                                "coloured light",
                                                "far from the origin",
                                                "a grain far from the origin"};

static double xyz[3 * POINTS_MOST];
static float power[CHANNELS * POINTS_MOST];
static double queries[3 * QUERIES_MOST];

static void set_point(enum scene scene, size_t i, uint64_t *random) {
  double *x = xyz + 3 * i;
  for (int k = 0; k < 3; k++) {
    x[k] = unit_random_between(random, -20, 20);
  }
  switch (scene) {
  case CLUSTERED: {
    const double size = unit_random_log(random, 1e-4, 10);
    const double centre = (double)(i % 7) - 3;
    for (int k = 0; k < 3; k++) {
      x[k] = centre * (5 - k) + size * unit_random_between(random, -1, 1);
    }
    break;
  }
  case FAR_POINT:
    x[2] = 0;
    x[0] = i == 0 ? 1e7 : x[0];
    break;
  case COINCIDENT:
    for (int k = 0; k < 3; k++) {
      x[k] = i % 2 == 0 ? k : floor(x[k] / 4) * 4;
    }
    break;
  case PLANE:
  case COLOURED:
    x[2] = 0;
    break;
  case SPHERE: {
    const double r = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]) + 1e-9;
    for (int k = 0; k < 3; k++) {
      x[k] *= 20 / r;
    }
    break;
  }
  case TWO_SHEETS:
    x[2] = i % 2 == 0 ? 0 : 1e-3;
    break;
  case LINE:
    x[1] = x[2] = 0;
    break;
  case FAR_AWAY:
  case GRAIN: /* so small that only rounding of its centroid is an error */
    for (int k = 0; k < 3; k++) {
      x[k] = 1e6 + x[k] * (scene == GRAIN ? 1e-8 : k < 2);
    }
    break;
  default:
    break;
  }
  /* Points without light add nothing, even at a query where R is infinite. */
  const double bright = i % 5 == 1 ? 0 : unit_random_log(random, 1e-2, 1);
  for (int c = 0; c < CHANNELS; c++) {
    const double own = scene == COLOURED ? unit_random_between(random, 0, 1) : 1 - 0.25 * c;
    power[CHANNELS * i + (size_t)c] =
        (float)(bright * own * (scene == FAR_POINT && i == 0 ? 1e6 : 1));
  }
}

/* On a point, beside one, somewhere between all, and far away. */
static void set_query(size_t i, uint64_t *random) {
  const double *x = xyz + 3 * unit_random_below(random, points_in_use);
  const double off = i % 4 == 0 ? 0 : i % 4 == 1 ? 0.3 : i % 4 == 2 ? 3 : 0.01;
  for (int k = 0; k < 3; k++) {
    queries[3 * i + (size_t)k] = x[k] + off * unit_random_between(random, -1, 1);
  }
}

static core_gather_points *make_scene(enum scene scene, uint64_t *random) {
  for (size_t i = 0; i < points_in_use; i++) {
    set_point(scene, i, random);
  }
  for (size_t i = 0; i < queries_in_use; i++) {
    set_query(i, random);
  }
  unit_accept(core_gather_check_points(points_in_use, xyz, CHANNELS, power));
  unit_accept(core_gather_check_queries(queries_in_use, queries));
  core_gather_points *points = core_gather_points_create(points_in_use, xyz, CHANNELS, power);
  assert_non_null(points);
  while (!core_gather_points_build(points, 100000)) {
  }
  return points;
}

/* ---- sums ------------------------------------------------------------------------------------ */

typedef struct profiles {
  core_profile own[CHANNELS];
  const core_profile *list[CHANNELS];
} profiles;

static void prepare(profiles *made, const core_isa *isa, unsigned model, unsigned evaluator) {
  for (size_t c = 0; c < CHANNELS; c++) {
    const core_medium *medium = &core_measured_medium_by_name("skin1")->channel[c];
    const core_medium needed = unit_medium(model, medium);
    unit_accept(core_profile_prepare(&made->own[c], isa, model, CORE_MOMENTS_EXACT, evaluator,
                                     &needed, NULL));
    made->list[c] = &made->own[c];
  }
}

static void release(profiles *made) {
  for (size_t c = 0; c < CHANNELS; c++) {
    core_profile_free(&made->own[c]);
  }
}

/* The plain sum in the order of the caller's points, in double precision with the profile's values.
 */
static double plain_sum(const core_profile *profile, size_t c, const double *x) {
  static double r[POINTS_MOST], R[POINTS_MOST];
  static float narrow_r[POINTS_MOST], narrow_R[POINTS_MOST];
  const bool narrow = profile->evaluator != CORE_EVALUATOR_F64;
  for (size_t i = 0; i < points_in_use; i++) {
    r[i] = sqrt((x[0] - xyz[3 * i]) * (x[0] - xyz[3 * i]) +
                (x[1] - xyz[3 * i + 1]) * (x[1] - xyz[3 * i + 1]) +
                (x[2] - xyz[3 * i + 2]) * (x[2] - xyz[3 * i + 2]));
    narrow_r[i] = (float)r[i];
  }
  if (narrow) {
    core_eval_f32(profile, CORE_QUANTITY_R, points_in_use, narrow_r, narrow_R);
  } else {
    core_eval_f64(profile, CORE_QUANTITY_R, points_in_use, r, R);
  }
  double sum = 0;
  for (size_t i = 0; i < points_in_use; i++) {
    const double watts = (double)power[CHANNELS * i + c];
    sum += watts > 0 ? watts * (narrow ? (double)narrow_R[i] : R[i]) : 0;
  }
  return sum;
}

static double reference[CHANNELS * QUERIES_MOST];
static double M[CHANNELS * QUERIES_MOST];
static float bound[CHANNELS * QUERIES_MOST];

/* The largest error of M over the tolerance, and over the bound stated. */
typedef struct worst {
  double of_tolerance;
  double of_bound;
} worst;

static worst gather_and_compare(const core_gather_points *points, const profiles *made,
                                const core_isa *isa, double tolerance, core_gather_visits *visits) {
  core_gather_sum *sum;
  unit_accept(core_gather_sum_prepare(&sum, isa, CHANNELS, made->list, tolerance));
  core_gather_scratch *scratch = core_gather_scratch_create(sum, points);
  assert_non_null(scratch);
  core_gather(sum, points, scratch, queries_in_use, NULL, queries, M, bound, visits);
  worst most = {0, 0};
  for (size_t c = 0; c < CHANNELS; c++) {
    const double own = core_gather_error(sum, points, c, visits);
    const bool known = own <= 1;
    for (size_t q = 0; q < queries_in_use; q++) {
      const double exact = reference[CHANNELS * q + c], value = M[CHANNELS * q + c];
      const double stated = (double)bound[CHANNELS * q + c];
      assert_true(stated <= tolerance);
      if (isinf(exact)) {
        assert_true(isinf(value));
        continue;
      }
      assert_true(value >= 0);
      const double floor = 1e-40; /* powers are up to 1e6 */
      const double off = fmax(fabs(value - exact) - floor, 0) / fmax(exact, 1e-300);
      const double spare = known ? 2 * own : 1e-5;
      if (!(off <= stated + spare)) {
        print_message("query %zu, channel %zu: %.9g in place of %.9g, off by %.3g, stated %.3g + "
                      "%.3g\n",
                      q, c, value, exact, off, stated, own);
        fail();
      }
      most.of_tolerance = fmax(most.of_tolerance, (off - spare) / tolerance);
      most.of_bound = stated > 0 ? fmax(most.of_bound, (off - spare) / stated) : most.of_bound;
    }
  }
  core_gather_scratch_free(scratch);
  core_gather_sum_free(sum);
  return most;
}

static const struct {
  unsigned model;
  unsigned evaluator;
} tried[] = {
    {CORE_MODEL_CLASSICAL, CORE_EVALUATOR_F64},     {CORE_MODEL_BETTER, CORE_EVALUATOR_F32},
    {CORE_MODEL_TRANSPORT, CORE_EVALUATOR_LUT},     {CORE_MODEL_BURLEY, CORE_EVALUATOR_F64},
    {CORE_MODEL_MULTIPOLE, CORE_EVALUATOR_LUT},     {CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64},
    {CORE_MODEL_BETTER_SINGLE, CORE_EVALUATOR_F64}, {CORE_MODEL_GAUSSIANS, CORE_EVALUATOR_F32},
};
enum { TRIED = sizeof tried / sizeof tried[0] };

UNIT_TEST(no_query_is_outside_of_the_tolerance) {
  const core_isa *isa = core_isa_select(NULL);
  uint64_t random = unit_seed();
  for (size_t t = 0; t < TRIED; t++) {
    profiles made;
    prepare(&made, isa, tried[t].model, tried[t].evaluator);
    for (enum scene scene = 0; scene < SCENES; scene++) {
      if (!all_of_them && t > 2 && (scene + t) % 4 != 0) {
        continue;
      }
      core_gather_points *points = make_scene(scene, &random);
      for (size_t q = 0; q < queries_in_use; q++) {
        for (size_t c = 0; c < CHANNELS; c++) {
          reference[CHANNELS * q + c] = plain_sum(&made.own[c], c, queries + 3 * q);
        }
      }
      for (double tolerance = 1e-2; tolerance > 0.9e-6; tolerance /= 10) {
        core_gather_visits visits = {0};
        const worst most = gather_and_compare(points, &made, isa, tolerance, &visits);
        printf(
            "%s, %s, %s, %.0e: %.2g of the tolerance, %.2g of the bound; %.0f nodes, %.0f points, "
            "%.0f tested\n",
            core_choice_by_id(core_models, tried[t].model)->name,
            core_choice_by_id(core_evaluators, tried[t].evaluator)->name, scene_names[scene],
            tolerance, most.of_tolerance, most.of_bound,
            (double)visits.nodes / (double)visits.queries,
            (double)visits.points / (double)visits.queries,
            (double)visits.tested / (double)visits.queries);
      }
      core_gather_points_free(points);
    }
    release(&made);
  }
}

/* Rounding a distance to single precision shifts R by its slope. */
UNIT_TEST(errors_include_rounding_of_distances) {
  static const double at[3] = {0}, r_mm = 30, query[3] = {30, 0, 0};
  static const core_medium medium = {0.48, 1.01, 0, 1.3};
  static const float watt = 1;
  core_profile profile = unit_profile(CORE_MODEL_BETTER, CORE_EVALUATOR_F32, &medium, NULL);
  const core_profile *const list[1] = {&profile};
  core_gather_points *points = core_gather_points_create(1, at, 1, &watt);
  while (!core_gather_points_build(points, 1000000)) {
  }
  core_gather_sum *sum;
  unit_accept(core_gather_sum_prepare(&sum, core_isa_select(NULL), 1, list, 1e-3));
  const core_stated_errors own =
      core_profile_errors(&profile, CORE_QUANTITY_R, (core_radii_range){0, r_mm});
  core_gather_scratch *scratch = core_gather_scratch_create(sum, points);
  core_gather_visits visits = {0};
  core_gather(sum, points, scratch, 1, NULL, query, M, NULL, &visits);
  core_gather_scratch_free(scratch);
  const double rounding =
      core_gather_error(sum, points, 0, &visits) - (own.numerical + r_mm * own.numerical_per_mm);
  const double steep = -r_mm * unit_value_at(&profile, CORE_QUANTITY_SLOPE, r_mm) /
                       unit_value_at(&profile, CORE_QUANTITY_R, r_mm);
  assert_true(rounding > steep * 0x1p-24 && rounding < 1.5 * steep * 0x1p-24);
  core_gather_sum_free(sum);
  core_gather_points_free(points);
  core_profile_free(&profile);
}

/* A sum has the errors of R at the distances of its points, each by its share of the light: brute force
 * finds no more than is stated, and errors near the source and far away hardly count behind a slab. */
UNIT_TEST(errors_are_those_at_the_distances_of_the_points) {
  uint64_t random = unit_seed();
  core_gather_points *points = make_scene(PLANE, &random);
  core_profile profile =
      unit_profile(CORE_MODEL_BETTER, CORE_EVALUATOR_F64, &(core_medium){0.1, 1, 0, 1.3}, NULL);
  for (size_t i = 0; i < CORE_ERROR_BANDS; i++) {
    const double edge = core_error_edges_mfp[i];
    profile.numerical_errors[i] = edge < 2    ? 0.3 / (1 + edge)
                                  : edge < 10 ? 1e-3
                                  : edge < 20 ? 0.02
                                              : 3;
  }
  const core_profile *list[CHANNELS];
  for (size_t c = 0; c < CHANNELS; c++) {
    list[c] = &profile;
  }
  core_gather_sum *sum;
  unit_accept(core_gather_sum_prepare(&sum, core_isa_select(NULL), CHANNELS, list, 0));
  core_gather_scratch *scratch = core_gather_scratch_create(sum, points);
  for (size_t q = 0; q < queries_in_use; q++) {
    double *x = &queries[3 * q], most = 0;
    x[2] = q % 2 == 0 ? 4 : x[2];
    double all = 0;
    for (size_t i = 0; i < points_in_use; i++) {
      const double r = sqrt((x[0] - xyz[3 * i]) * (x[0] - xyz[3 * i]) +
                            (x[1] - xyz[3 * i + 1]) * (x[1] - xyz[3 * i + 1]) + x[2] * x[2]);
      const double sent = (double)power[CHANNELS * i] * unit_value_at(&profile, CORE_QUANTITY_R, r);
      const core_radii_range here = {r, r};
      all += sent;
      most += sent * fmin(core_profile_errors(&profile, CORE_QUANTITY_R, here).numerical, 1);
    }
    core_gather_visits visits = {0};
    core_gather(sum, points, scratch, 1, NULL, x, M, NULL, &visits);
    const double stated = core_gather_error(sum, points, 0, &visits);
    assert_true(isinf(all) || (stated * all >= most && stated < 1));
    assert_true(q % 2 != 0 || stated < 0.1);
  }
  core_gather_scratch_free(scratch);
  core_gather_sum_free(sum);
  core_gather_points_free(points);
  core_profile_free(&profile);
}

/* ---- sheets of light ------------------------------------------------------------------------- */

/* M at x over a sheet of 1 W/mm^2 at z = 0 that ends at x = 0 if it is a half plane, from points in
 * a square lattice of a step that a distance of 40 mm holds. */
static double lattice(const core_profile *profile, size_t per_side, bool half, double x_mm) {
  const double side = 60, step = side / (double)per_side;
  const size_t n = (half ? per_side / 2 : per_side) * per_side;
  double *places = malloc(3 * n * sizeof *places);
  float *watts = malloc(n * sizeof *watts);
  assert_non_null(places);
  assert_non_null(watts);
  for (size_t i = 0; i < n; i++) {
    places[3 * i] = ((double)(i / per_side) + 0.5) * step - side / 2;
    places[3 * i + 1] = ((double)(i % per_side) + 0.5) * step - side / 2;
    places[3 * i + 2] = 0;
    watts[i] = (float)(step * step);
  }
  core_gather_points *points = core_gather_points_create(n, places, 1, watts);
  while (!core_gather_points_build(points, UINT64_MAX)) {
  }
  core_gather_sum *sum;
  const core_profile *const list[1] = {profile};
  unit_accept(core_gather_sum_prepare(&sum, core_isa_select(NULL), 1, list, 1e-6));
  core_gather_scratch *scratch = core_gather_scratch_create(sum, points);
  core_gather_visits visits = {0};
  const double at[3] = {x_mm, 0, 0};
  double value;
  core_gather(sum, points, scratch, 1, NULL, at, &value, NULL, &visits);
  core_gather_scratch_free(scratch);
  core_gather_sum_free(sum);
  core_gather_points_free(points);
  free(places);
  free(watts);
  return value;
}

/* M over a half plane at a distance x from its edge, x < 0 where it is lit: the integral over rings
 * of R times the length of the arc that is lit, 2 r acos(x / r). */
static double half_plane(const core_profile *profile, double x_mm) {
  enum { STEPS = 200000 };
  double sum = 0;
  for (int i = 0; i < STEPS; i++) {
    const double r = 30 * (i + 0.5) / STEPS;
    const double cosine = fmin(fmax(x_mm / r, -1), 1);
    sum += 2 * r * acos(cosine) * unit_value_at(profile, CORE_QUANTITY_R, r);
  }
  return sum * 30 / STEPS;
}

UNIT_TEST(sheets_of_light_converge_to_the_albedo_and_half_planes_to_a_quadrature) {
  const core_medium medium = {0.17, 0.88, 0, 1.3};
  core_profile profile = unit_profile(CORE_MODEL_BETTER, CORE_EVALUATOR_F64, &medium, NULL);
  double sheet_before = 1, edge_before = 1;
  const double expected = half_plane(&profile, 0.7);
  for (size_t per_side = 60; per_side <= 480; per_side *= 2) {
    const double sheet = fabs(lattice(&profile, per_side, false, 0) / profile.albedo - 1);
    const double edge = fabs(lattice(&profile, per_side, true, 0.7) / expected - 1);
    printf("%zu points a side: the sheet is off by %.2e, the half plane by %.2e\n", per_side, sheet,
           edge);
    assert_true(sheet <= fmax(0.5 * sheet_before, 2e-6));
    assert_true(edge <= fmax(0.5 * edge_before, 2e-6));
    sheet_before = sheet;
    edge_before = edge;
  }
  assert_true(sheet_before < 1e-4);
  assert_true(edge_before < 1e-3);
  core_profile_free(&profile);
}
