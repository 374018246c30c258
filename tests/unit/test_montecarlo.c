/* Monte Carlo: refusals, results at the extremes, and the same bits for every slicing. test_mc.py has
 * threads. */
#include <math.h>

#include "core/montecarlo/lane_math.h"
#include "core/montecarlo/plan.h"
#include "tests/accuracy/montecarlo_run.h"
#include "tests/unit/unit.h"

/* ---- what a request may be ---------------------------------------------------------------- */

/* Requests are accepted up to the limits of each field. tests/e2e/test_mc.py tests more fields. */
UNIT_TEST(requests_are_taken_up_to_their_limits) {
#define CHECK(member, value, field)                                                                \
  do {                                                                                             \
    core_mc_request changed = montecarlo_request(0.9, 0, 1.4);                                     \
    changed.member = (value);                                                                      \
    unit_assert_fault(core_mc_check(&changed), (field), 0);                                        \
  } while (0)
#define EDGES(...) ((core_grid){__VA_ARGS__})
  CHECK(sigma_t_per_mm, 1, NULL);
  CHECK(sigma_t_per_mm, 0, "sigma_t");
  CHECK(sigma_t_per_mm, 2.1e15, "sigma_t");
  CHECK(g, CORE_MC_G_MAX, NULL);
  CHECK(g, -CORE_MC_G_MAX, NULL);
  CHECK(eta, CORE_ETA_MIN, NULL);
  CHECK(eta, CORE_ETA_MAX, NULL);
  CHECK(thickness_mm, 0, NULL);
  CHECK(thickness_mm, CORE_MC_THICKNESS_MIN_MFP, NULL);
  CHECK(thickness_mm, 0.9 * CORE_MC_THICKNESS_MIN_MFP, "thickness");
  CHECK(roulette_weight, CORE_MC_ROULETTE_WEIGHT_MIN, NULL);
  CHECK(roulette_weight, 1, NULL);
  CHECK(roulette_weight, 1e-7, "roulette_weight");
  CHECK(roulette_weight, 1.1, "roulette_weight");
  CHECK(roulette_weight, (double)NAN, "roulette_weight");
  CHECK(scatterings_max, 2, NULL);
  CHECK(scatterings_max, CORE_MC_SCATTERINGS_MAX, NULL);
  CHECK(scatterings_max, 1, "scatterings_max");
  CHECK(scatterings_max, CORE_MC_SCATTERINGS_MAX + 1, "scatterings_max");
  CHECK(albedo_count, 0, "albedo_count");
  CHECK(albedo_count, CORE_MC_ALBEDOS_MAX, NULL);
  CHECK(edges, EDGES(CORE_SPACING_LINEAR, CORE_MC_RINGS_MAX + 1, 1, CORE_MC_RADIUS_MAX_MFP), NULL);
  CHECK(edges, EDGES(CORE_SPACING_LINEAR, 2, 1, 2 * CORE_MC_RADIUS_MAX_MFP), "radius_stop");
  CHECK(edges, EDGES(CORE_SPACING_LINEAR, 4097, 0, 1e-8), NULL);
  CHECK(edges, EDGES(CORE_SPACING_LOGARITHMIC, 2, CORE_MC_RADIUS_MIN_MFP, 1), NULL);
#undef CHECK
}

UNIT_TEST(layers_are_taken_up_to_their_limits) {
#define CHECK(member, value, field, index)                                                         \
  do {                                                                                             \
    core_mc_request changed = montecarlo_request(0.9, 0, 1.4);                                     \
    changed.thickness_mm = 1;                                                                      \
    changed.below_count = 2;                                                                       \
    changed.below[0] = (core_medium){1, 2, 0.5, 1.3, 2};                                           \
    changed.below[1] = (core_medium){1, 2, 0.5, 1.3, (double)INFINITY};                            \
    changed.member = (value);                                                                      \
    unit_assert_fault(core_mc_check(&changed), (field), (index));                                  \
  } while (0)
  CHECK(eta_below, 0, NULL, 0);
  CHECK(eta_below, CORE_ETA_MAX, NULL, 0);
  CHECK(eta_below, 2e3, "eta_below", 0);
  CHECK(thickness_mm, 0, "thickness", 0);
  CHECK(thickness_mm, (double)INFINITY, "thickness", 0);
  CHECK(below[0].thickness_mm, (double)INFINITY, "thickness", 1);
  CHECK(below[1].thickness_mm, 3, NULL, 0);
  CHECK(below[1].thickness_mm, 0, "thickness", 2);
  CHECK(below[0].sigma_a_per_mm, -1, "sigma_a", 1);
  CHECK(below[1].sigma_s_per_mm, -1, "sigma_s", 2);
  CHECK(below[1].sigma_s_per_mm, (double)INFINITY, "sigma_t", 2);
  CHECK(below[0].g, 1, "g", 1);
  CHECK(below[0].eta, 0, "eta", 1);
  CHECK(albedo_count, 2, "albedo_count", 0);
  CHECK(phase, CORE_PHASE_MODIFIED, "phase", 0);
  CHECK(below_count, CORE_LAYERS_MAX, "layer_count", 0);
#undef CHECK
}

UNIT_TEST(media_become_requests) {
  const core_medium medium = {0.5, 1.5, 0.25, 1.3};
  core_mc_request request = montecarlo_request(0.9, 0, 1);
  request.albedo_count = 7;
  core_mc_request_medium(&request, &medium, 1);
  assert_true(request.sigma_t_per_mm == 2 && request.g == 0.25 && request.eta == 1.3);
  assert_true(request.albedo_count == 1 && request.albedo[0] == 0.75);
}

/* ---- random numbers and functions of lanes ------------------------------------------------ */

/* The outputs of Philox are the known answers that its authors publish with their code. */
UNIT_TEST(philox_gives_its_known_answers) {
  static const struct {
    uint32_t counter[4], key[2], expected[4];
  } rows[] = {
      {{0, 0, 0, 0}, {0, 0}, {0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}},
      {{0xffffffff, 0xffffffff, 0xffffffff, 0xffffffff},
       {0xffffffff, 0xffffffff},
       {0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}},
      {{0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344},
       {0xa4093822, 0x299f31d0},
       {0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}},
  };
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    lane_random counter;
    for (int k = 0; k < 4; k++) {
      counter.word[k] = (lane_words){0} + rows[i].counter[k];
    }
    const lane_random random = lane_philox(counter, rows[i].key);
    for (int k = 0; k < 4; k++) {
      uint64_t word;
      memcpy(&word, &random.word[k], sizeof word);
      assert_int_equal((uint32_t)word, rows[i].expected[k]);
    }
  }
}

UNIT_TEST(lane_functions_are_accurate) {
  uint64_t random = unit_seed();
  double worst_log = 0;
  double worst_azimuth = 0;
  double worst_root = 0;
  for (int i = 0; i < 200000; i++) {
    /* Numbers with few bits set, or few bits clear, also test both ends of the range. */
    uint32_t bits = (uint32_t)unit_random(&random) >> (i % 32);
    bits = i & 32 ? ~bits : bits;
    const lane_uniform u = lane_uniform_from(bits);
    const double v = ((bits >> 1) + 0.5) * 0x1p-31;
    assert_true(u.v > 0 && u.w > 0 && u.v <= 1 && u.w <= 1);
    assert_true(fabs((double)u.v - v) <= 1.2e-7 * v);
    assert_true(fabs((double)u.w - (1 - v)) <= 1.2e-7 * (1 - v));
    const double path = -log1p(-v);
    worst_log = fmax(worst_log, fabs((double)lane_minus_log(u.v, u.w) - path) / path);

    const float t = u.v - u.w;
    const double root = cbrt((double)t);
    worst_root = fmax(worst_root, fabs((double)lane_cube_root(t) - root) / fmax(fabs(root), 1e-9));

    const lane_direction azimuth = lane_azimuth(bits);
    const double length = hypot((double)azimuth.cosine, (double)azimuth.sine);
    const double eighth = ((bits >> 9) + 0.5) * 0x1p-23 * acos(-1) / 4;
    const double smaller = fmin(fabs((double)azimuth.cosine), fabs((double)azimuth.sine));
    worst_azimuth = fmax(worst_azimuth, fabs(length - 1));
    worst_azimuth = fmax(worst_azimuth, fabs(smaller - sin(eighth)));
  }
  printf("-ln: %.1e relative, directions: %.1e, cube roots: %.1e relative\n", worst_log,
         worst_azimuth, worst_root);
  assert_true(worst_log <= 2.5e-7);
  assert_true(worst_azimuth <= 1.5e-7);
  assert_true(worst_root <= 2.5e-7);
  assert_true(fabs((double)lane_cube_root(0)) <= 2e-10);
  assert_true(lane_cube_root(1) == 1 && lane_cube_root(-1) == -1);
}

/* Three bits of the random number choose the eighth of the circle: all eight occur. */
UNIT_TEST(azimuths_cover_the_circle) {
  unsigned seen = 0;
  for (uint32_t bits = 0; bits < 8; bits++) {
    const lane_direction azimuth = lane_azimuth(bits | UINT32_C(1) << 31);
    const double angle = atan2((double)azimuth.sine, (double)azimuth.cosine) + acos(-1);
    seen |= 1u << (unsigned)(angle / (acos(-1) / 4));
  }
  assert_int_equal(seen, 0xff);
}

/* ---- phase functions ---------------------------------------------------------------------- */

/* Phase functions of three kinds; g is the mean cosine. */
static const struct phase_case {
  unsigned phase;
  double g, share, second;
} phase_cases[] = {
    {CORE_PHASE_HENYEY_GREENSTEIN, 0.9, 0, 0}, {CORE_PHASE_HENYEY_GREENSTEIN, -0.3, 0, 0},
    {CORE_PHASE_MODIFIED, 0.8, 0.889, 0},      {CORE_PHASE_MODIFIED, -0.2, 0.5, 0},
    {CORE_PHASE_MODIFIED, 0, 1e-6, 0},         {CORE_PHASE_MODIFIED, 0.9, 1, 0},
    {CORE_PHASE_TWO_TERM, 0.9, 0.95, -0.3},    {CORE_PHASE_TWO_TERM, 0.3, 0.4, 0.1},
    {CORE_PHASE_TWO_TERM, -0.1, 0.3, 0.2},     {CORE_PHASE_TWO_TERM, 0, 0.5, 0},
};
enum { PHASE_CASES = sizeof phase_cases / sizeof phase_cases[0] };

static void set_phase(core_mc_request *request, const struct phase_case *of) {
  request->g = of->g;
  request->phase = of->phase;
  request->phase_share = of->share;
  request->phase_g = of->second;
}

/* The part of Henyey and Greenstein's function at cosines below mu. */
static double hg_below(double g, double mu) {
  return fabs(g) < 1e-12 ? 0.5 * (1 + mu)
                         : (1 - g * g) / (2 * g) * (1 / sqrt(1 + g * g - 2 * g * mu) - 1 / (1 + g));
}

static double below(const core_mc_request *request, double mu) {
  const double share = request->phase == CORE_PHASE_HENYEY_GREENSTEIN ? 1 : request->phase_share;
  const double other = request->phase == CORE_PHASE_MODIFIED ? 0.5 * (1 + mu * mu * mu)
                                                             : hg_below(request->phase_g, mu);
  return share * hg_below(core_mc_first_g(request), mu) + (1 - share) * other;
}

static int rising(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

extern const walk_functions walk_functions_portable;

/* Scatters photons that fly straight down, and stores the cosines of their deflections. They are so
 * deep that none of them meets the boundary. */
static void scatter(const core_mc_request *request, double *cosines, uint32_t count) {
  core_mc_plan *plan = core_mc_plan_create(request);
  assert_non_null(plan);
  for (uint32_t first = 0; first < count; first += WALK_LANES) {
    walk_lanes lanes = {.x = {0}};
    for (uint32_t i = 0; i < WALK_LANES; i++) {
      lanes.z[i] = 1e9f;
      lanes.uz[i] = 1;
      lanes.photon[i] = first + i;
    }
    walk_functions_portable.step(&plan->walk, 0, WALK_LANES, &lanes);
    for (uint32_t i = 0; i < WALK_LANES; i++) {
      const double ux = (double)lanes.ux[i], uy = (double)lanes.uy[i], uz = (double)lanes.uz[i];
      assert_true(fabs(ux * ux + uy * uy + uz * uz - 1) < 1e-6);
      cosines[first + i] = uz;
    }
  }
  core_mc_plan_free(plan);
}

/* Kolmogorov and Smirnov's test: of right samples the largest distance between both distributions
 * exceeds 2.2 / sqrt(n) once in 8,000 cases. */
UNIT_TEST(deflections_have_the_phase_functions_distribution) {
  enum { COUNT = 1 << 20 };
  double *cosines = malloc(COUNT * sizeof *cosines);
  assert_non_null(cosines);
  for (size_t i = 0; i < PHASE_CASES; i++) {
    core_mc_request request = montecarlo_request(0.9, 0, 1);
    set_phase(&request, &phase_cases[i]);
    unit_accept(core_mc_check(&request));
    scatter(&request, cosines, COUNT);
    qsort(cosines, COUNT, sizeof *cosines, rising);
    double worst = 0, mean = 0;
    for (size_t n = 0; n < COUNT; n++) {
      worst = fmax(worst, fabs(below(&request, cosines[n]) - (n + 0.5) / COUNT));
      mean += cosines[n] / COUNT;
    }
    UNIT_FAIL_IF(!(worst * sqrt(COUNT) < 2.2 && fabs(mean - request.g) < 4 / sqrt(COUNT)),
                 "case %zu: distance %g / sqrt(n), mean cosine %g, not %g", i, worst * sqrt(COUNT),
                 mean, request.g);
  }
  free(cosines);
}

/* ---- the same bits ------------------------------------------------------------------------ */

enum { RINGS = 30, BIT_BATCHES = 3, BIT_REQUESTS_HG = 18, BIT_REQUESTS = BIT_REQUESTS_HG + 12 + 5 };

/* All results of a run for one albedo. */
struct answer {
  core_mc_energy energy;
  core_mc_ring rings[CORE_MC_SIDES][RINGS];
};

static struct answer answer_of(const core_mc_total *total, size_t albedo) {
  struct answer answer;
  memset(&answer, 0, sizeof answer);
  core_mc_total_energy(total, albedo, &answer.energy);
  for (size_t side = 0; side < CORE_MC_SIDES; side++) {
    core_mc_total_rings(total, albedo, side, answer.rings[side]);
  }
  return answer;
}

static void assert_same(const core_mc_request *request, const core_mc_total *a,
                        const core_mc_total *b) {
  for (size_t k = 0; k < request->albedo_count; k++) {
    const struct answer answer_a = answer_of(a, k);
    const struct answer answer_b = answer_of(b, k);
    assert_memory_equal(&answer_a, &answer_b, sizeof answer_a);
  }
}

/* An absorbing film, a guide that scatters backwards, and a foot of either kind. */
static core_mc_request layered_request(size_t i) {
  const core_medium layers[] = {{30, 0.1, 0.5, 1.5, 0.002},
                                {0.01, 15, -0.4, 1.33, 0.6},
                                {0, 8, 0, 1.33, 0.1},
                                {0.2, 9, 0.9, 1.6, i % 2 == 0 ? 0.3 : 0}};
  core_mc_request request = {.edges = {CORE_SPACING_LOGARITHMIC, 31, 0.01, 30}, .seed = i};
  core_mc_request_medium(&request, layers + i % 4, 4 - i % 4);
  request.eta_below = 0.75;
  request.aperture = i % 3 == 0 ? 0.5 : 0;
  request.scatterings_max = i == 1 ? 50 : 0;
  return request;
}

/* Returns request number i. Together they run every loop of the walk: each phase function, in a
 * half space or a slab, and layers. */
static core_mc_request bit_request(size_t i) {
  static const double g[] = {0, 0.85, -0.4};
  static const double thickness_mm[] = {(double)INFINITY, 1.5, 0.001};
  static const double eta[] = {1.4, 0.8};
  if (i >= BIT_REQUESTS - 5) {
    return layered_request(i - (BIT_REQUESTS - 5));
  }
  core_mc_request request = montecarlo_request(0.95, g[i % 3], eta[i % 2]);
  request.thickness_mm = thickness_mm[i / 3 % 3];
  request.albedo_count = 1 + i % 5;
  for (size_t k = 1; k < request.albedo_count; k++) {
    request.albedo[k] = 0.2 * (double)k;
  }
  request.seed = UINT64_C(0x123456789abcdef0) + i;
  if (i >= BIT_REQUESTS_HG) {
    set_phase(&request, &phase_cases[i % PHASE_CASES]);
  }
  return request;
}

/* Seeds that differ, even only in their upper half, give different walks. An abandoned batch does
 * not change the next one. */
UNIT_TEST(seeds_differ_and_batches_start_afresh) {
  core_mc_request request = bit_request(0);
  montecarlo_run first = montecarlo_run_batches(&request, 1);
  const double R = montecarlo_energy(&first, 0).left[CORE_MC_REFLECTED].value;
  for (int bit = 0; bit < 64; bit += 9) {
    core_mc_request other = request;
    other.seed ^= UINT64_C(1) << bit;
    montecarlo_run run = montecarlo_run_batches(&other, 1);
    assert_true(montecarlo_energy(&run, 0).left[CORE_MC_REFLECTED].value != R);
    montecarlo_run_free(&run);
  }
  core_mc_batch *batch = core_mc_batch_create(first.plan);
  core_mc_total *total = core_mc_total_create(first.plan);
  assert_true(batch != NULL && total != NULL);
  core_mc_batch_start(batch, 3);
  assert_false(core_mc_batch_walk(batch, core_isa_select(NULL), 1000));
  core_mc_batch_start(batch, 0);
  while (!core_mc_batch_walk(batch, core_isa_select(NULL), 1000)) {
  }
  core_mc_total_merge(total, batch);
  assert_same(&request, total, first.total);
  core_mc_total_free(total);
  core_mc_batch_free(batch);
  montecarlo_run_free(&first);
}

/* ---- extremes ----------------------------------------------------------------------------- */

UNIT_TEST(nothing_is_known_before_the_second_batch) {
  const core_mc_request request = montecarlo_request(0.9, 0, 1.4);
  double first = 0;
  for (uint64_t batches = 0; batches < 3; batches++) {
    montecarlo_run run = montecarlo_run_batches(&request, batches);
    const struct answer answer = answer_of(run.total, 0);
    const core_mc_value R = answer.energy.left[CORE_MC_REFLECTED];
    assert_true(batches < 2 ? isinf(R.error) : R.error > 0 && R.error < 0.1);
    /* the standard error of the mean of two numbers is their distance from it */
    assert_true(batches < 2 || fabs(R.error / fabs(R.value - first) - 1) < 1e-9);
    first = R.value;
    assert_true(batches == 0 ? R.value == 0 : R.value > 0.1);
    assert_true(fabs(answer.energy.imbalance) < 1e-12);
    for (size_t i = 0; i < RINGS; i++) {
      const core_mc_ring *ring = &answer.rings[CORE_MC_REFLECTED][i];
      assert_true(batches < 2 ? isinf(ring->error_per_mm2) : ring->error_per_mm2 > 0);
    }
    montecarlo_run_free(&run);
  }
}

/* A ring that no photon has reached has an error that is not 0. */
UNIT_TEST(empty_rings_have_errors) {
  core_mc_request request = montecarlo_request(0.5, 0, 1.4);
  request.thickness_mm = 3;
  montecarlo_rings(&request, RINGS, 1000, 2000);
  montecarlo_run run = montecarlo_run_batches(&request, 2);
  const struct answer answer = answer_of(run.total, 0);
  for (size_t i = 0; i < RINGS; i++) {
    const core_mc_ring *ring = &answer.rings[CORE_MC_REFLECTED][i];
    const double area = acos(-1) * (ring->to_mm - ring->from_mm) * (ring->to_mm + ring->from_mm);
    const double *away = answer.energy.unscattered;
    const double heaviest = 0.5 * (1 - away[0] - away[1]) / (2 * CORE_MC_BATCH_PHOTONS);
    assert_true(ring->photons == 0 && ring->R_per_mm2 == 0);
    assert_true(fabs(ring->error_per_mm2 * area - heaviest) <= 1e-12 * heaviest);
  }
  assert_true(answer.energy.under[CORE_MC_REFLECTED].value > 0.05);
  assert_true(answer.energy.over[CORE_MC_REFLECTED].value == 0);
  montecarlo_run_free(&run);
}

/* All light that leaves counts in a ring, under, over, or as unscattered. */
UNIT_TEST(rings_add_up_to_the_total) {
  for (size_t i = 0; i < BIT_REQUESTS; i++) {
    core_mc_request request = bit_request(i);
    request.aperture = 0;
    montecarlo_rings(&request, RINGS, 0.3, 2);
    montecarlo_run run = montecarlo_run_batches(&request, 2);
    for (size_t k = 0; k < request.albedo_count; k++) {
      const struct answer answer = answer_of(run.total, k);
      for (size_t side = 0; side < CORE_MC_SIDES; side++) {
        double sum = answer.energy.unscattered[side] + answer.energy.under[side].value +
                     answer.energy.over[side].value;
        for (size_t j = 0; j < RINGS; j++) {
          const core_mc_ring *ring = &answer.rings[side][j];
          sum += ring->R_per_mm2 * acos(-1) *
                 (ring->to_mm * ring->to_mm - ring->from_mm * ring->from_mm);
        }
        assert_true(fabs(sum - answer.energy.left[side].value) <= 1e-12);
      }
    }
    montecarlo_run_free(&run);
  }
}

/* Without scattering, the result is the law of Beer and Lambert between two mirrors, exactly. In a slab
 * without thickness nothing scatters, whatever its albedo. */
UNIT_TEST(without_scattering_the_answer_is_exact) {
  static const double etas[] = {1, 1.5, 0.7, 30};
  static const double thicknesses_mm[] = {0, 1e-6, 0.3, 2, 50, 1e6, 1e300, (double)INFINITY};
  for (size_t i = 0; i < sizeof etas / sizeof etas[0]; i++) {
    for (size_t j = 0; j < sizeof thicknesses_mm / sizeof thicknesses_mm[0]; j++) {
      const double albedo = thicknesses_mm[j] > 0 ? 0 : i % 2 == 0 ? 0.5 : 1;
      core_mc_request request = montecarlo_request(albedo, 0.3, etas[i]);
      request.thickness_mm = thicknesses_mm[j];
      montecarlo_run run = montecarlo_run_batches(&request, 2);
      const core_mc_energy energy = montecarlo_energy(&run, 0);
      const double F = pow((etas[i] - 1) / (etas[i] + 1), 2);
      const double passed = exp(-thicknesses_mm[j]);
      const double q = F * passed;
      const double T = (1 - F) * passed / (1 - q * q);
      assert_true(fabs(energy.left[CORE_MC_TRANSMITTED].value - T) <= 1e-15 + 1e-14 * T);
      assert_true(fabs(energy.left[CORE_MC_REFLECTED].value - T * q) <= 1e-15);
      assert_true(energy.left[CORE_MC_TRANSMITTED].error == 0);
      assert_true(energy.left[CORE_MC_REFLECTED].error == 0);
      assert_true(fabs(energy.absorbed.value - (1 - T * (1 + q))) <= 1e-15);
      assert_true(energy.unfinished.value == 0 && energy.roulette.value == 0);
      montecarlo_run_free(&run);
    }
  }
}

/* Without absorption all light comes back. Light that has not come back when a walk is ended is
 * counted as unfinished. */
UNIT_TEST(without_absorption_all_comes_back) {
  static const struct {
    double g, eta, thickness_mm;
    uint32_t scatterings_max;
  } rows[] = {
      {0, 1, (double)INFINITY, 0},
      {0, 1.5, (double)INFINITY, 20000},
      {0.9, 1.3, (double)INFINITY, 20000},
      {0, 1.4, (double)INFINITY, 100},
      {0.999, 1.4, 5, 0},
      {0, 1.5, 3, 0},
      {-0.999, 0.7, 5, 0},
      {0.5, 1.5, (double)INFINITY, 2},
  };
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    core_mc_request request = montecarlo_request(1, rows[i].g, rows[i].eta);
    request.thickness_mm = rows[i].thickness_mm;
    request.scatterings_max = rows[i].scatterings_max;
    montecarlo_run run = montecarlo_run_batches(&request, 4);
    const core_mc_energy energy = montecarlo_energy(&run, 0);
    const core_mc_value R = energy.left[CORE_MC_REFLECTED];
    const core_mc_value T = energy.left[CORE_MC_TRANSMITTED];
    assert_true(energy.absorbed.value == 0);
    assert_true(fabs(R.value + T.value + energy.unfinished.value - 1) <=
                6 * energy.roulette.error + 1e-12);
    assert_true(isinf(rows[i].thickness_mm) == (T.value == 0));
    assert_true((energy.unfinished.value > 0) == isinf(rows[i].thickness_mm));
    assert_true(rows[i].scatterings_max != 0 || energy.unfinished.value < 0.03);
    montecarlo_run_free(&run);
  }
}

/* Russian roulette changes the cost, but not the expected results. */
UNIT_TEST(roulette_is_unbiased) {
  static const double weights[] = {CORE_MC_ROULETTE_WEIGHT_MIN, 0.01, 1};
  enum { WEIGHTS = 3, BATCHES = 100 };
  struct answer answers[WEIGHTS];
  for (size_t i = 0; i < WEIGHTS; i++) {
    core_mc_request request = montecarlo_request(0.8, 0.3, 1.3);
    montecarlo_rings(&request, RINGS, 0.05, 3);
    request.roulette_weight = weights[i];
    request.seed = i;
    montecarlo_run run = montecarlo_run_batches(&request, BATCHES);
    answers[i] = answer_of(run.total, 0);
    montecarlo_run_free(&run);
    const core_mc_value roulette = answers[i].energy.roulette;
    assert_true(fabs(roulette.value) <= 4 * roulette.error);
  }
  for (size_t i = 1; i < WEIGHTS; i++) {
    double squares = 0;
    for (size_t j = 0; j < RINGS; j++) {
      const core_mc_ring *a = &answers[0].rings[CORE_MC_REFLECTED][j];
      const core_mc_ring *b = &answers[i].rings[CORE_MC_REFLECTED][j];
      squares += pow((a->R_per_mm2 - b->R_per_mm2) / hypot(a->error_per_mm2, b->error_per_mm2), 2);
    }
    assert_true(fabs(squares - RINGS) <= 4 * sqrt(2.0 * RINGS));
  }
}

/* The results for an albedo do not depend on the other albedos of the request. Both requests have
 * the same largest albedo, because roulette depends on it. */
UNIT_TEST(albedos_are_independent) {
  enum { BATCHES = 5 };
  core_mc_request many = montecarlo_request(0.9, 0, 1.4);
  many.albedo_count = CORE_MC_ALBEDOS_MAX;
  for (size_t k = 1; k < CORE_MC_ALBEDOS_MAX; k++) {
    many.albedo[k] = k == 7 ? 0 : 0.9 / (double)k;
  }
  const core_mc_request one = montecarlo_request(0.9, 0, 1.4);
  montecarlo_run many_run = montecarlo_run_batches(&many, BATCHES);
  montecarlo_run one_run = montecarlo_run_batches(&one, BATCHES);
  assert_same(&one, many_run.total, one_run.total);
  const struct answer same = answer_of(many_run.total, 1);
  const struct answer first = answer_of(many_run.total, 0);
  assert_memory_equal(&same, &first, sizeof same);
  const core_mc_energy none = montecarlo_energy(&many_run, 7);
  assert_true(none.absorbed.value == 1 && none.left[CORE_MC_REFLECTED].value == 0);
  for (size_t k = 8; k + 1 < CORE_MC_ALBEDOS_MAX; k++) {
    assert_true(montecarlo_energy(&many_run, k).left[CORE_MC_REFLECTED].value >
                montecarlo_energy(&many_run, k + 1).left[CORE_MC_REFLECTED].value);
  }
  montecarlo_run_free(&many_run);
  montecarlo_run_free(&one_run);
}

/* Walks in media at the limits of single precision end, and conserve energy. */
UNIT_TEST(corners_end) {
  static const double g[] = {-CORE_MC_G_MAX, -1e-9, 1e-300, CORE_MC_G_MAX};
  static const double eta[] = {CORE_ETA_MIN, 0.999999, 1.0000001, CORE_ETA_MAX};
  static const double thickness_mm[] = {CORE_MC_THICKNESS_MIN_MFP, 1, 1e25, (double)INFINITY};
  for (size_t i = 0; i < 64; i++) {
    core_mc_request request = montecarlo_request(0.9, g[i % 4], eta[i / 4 % 4]);
    request.thickness_mm = thickness_mm[i / 16];
    request.edges = (core_grid){CORE_SPACING_LOGARITHMIC, RINGS + 1, 1e-8, 1e12};
    montecarlo_run run = montecarlo_run_batches(&request, 2);
    const struct answer answer = answer_of(run.total, 0);
    for (size_t side = 0; side < CORE_MC_SIDES; side++) {
      assert_true(answer.energy.left[side].value >= 0 && answer.energy.left[side].value <= 1);
      assert_true(answer.energy.over[side].value == 0);
    }
    montecarlo_run_free(&run);
  }
}
