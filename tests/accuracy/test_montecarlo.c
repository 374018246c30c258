/* Monte Carlo against what this project did not make, exact totals of radiative transport, against a
 * plain walk in double precision, and its standard errors against the scatter of its results.
 * tests/accuracy/rings.c compares profiles with the solver.
 *
 * Seeds are fixed. A bound of 4 standard errors is exceeded by chance once in 16,000 comparisons,
 * and here are some 1,000. */
#include <math.h>

#include "core/solver/solver.h"
#include "tests/accuracy/montecarlo_run.h"
#include "tests/accuracy/plain_walk.h"
#include "tests/unit/unit.h"

#define DEVIATIONS_MAX 4.0

enum { PLAIN_RINGS = 30, PLAIN_SLOTS = PLAIN_RINGS + 2 };

static double square(double x) {
  return x * x;
}

static double specular(double eta) {
  return square((eta - 1) / (eta + 1));
}

/* ---- exact totals ------------------------------------------------------------------------- */

/* Total reflectance with the specular, per launched power, of half spaces with isotropic
 * scattering: H functions with the Fresnel feedback, 10 digits. */
static const double exact_albedos[] = {0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 0.99, 0.999};
enum { EXACT_ALBEDOS = sizeof exact_albedos / sizeof exact_albedos[0] };
static const struct {
  double eta;
  double total[EXACT_ALBEDOS];
} exact_totals[] = {
    {1,
     {.01639034215, .05721435060, .11522587771, .20867995212, .41494747913, .53554098917,
      .75272071716, .91284533480}},
    {1.33,
     {.02768625739, .04780882670, .07918033337, .13665860713, .29479138060, .40803585632,
      .65295790940, .86908178965}},
    {1.5,
     {.04560923231, .06055011684, .08424589385, .12890516220, .25991856992, .36111781836,
      .60198078570, .84145847579}},
};

/* All albedos of an eta from one walk. */
UNIT_TEST(exact_totals_are_met) {
  for (size_t i = 0; i < sizeof exact_totals / sizeof exact_totals[0]; i++) {
    const double R_sp = specular(exact_totals[i].eta);
    core_mc_request request = montecarlo_request(1, 0, exact_totals[i].eta);
    request.albedo_count = EXACT_ALBEDOS;
    memcpy(request.albedo, exact_albedos, sizeof exact_albedos);
    montecarlo_run run = montecarlo_run_batches(&request, unit_is_long() ? 200 : 60);
    for (size_t k = 0; k < EXACT_ALBEDOS; k++) {
      const core_mc_energy energy = montecarlo_energy(&run, k);
      const double entered = (exact_totals[i].total[k] - R_sp) / (1 - R_sp);
      const double deviation = montecarlo_deviation(energy.left[CORE_MC_REFLECTED], entered);
      UNIT_FAIL_IF(!(fabs(deviation) <= DEVIATIONS_MAX), "eta %g albedo %g: %g standard errors off",
                   exact_totals[i].eta, exact_albedos[k], deviation);
    }
    montecarlo_run_free(&run);
  }
}

/* Adding-doubling, five digits (Wang, Jacques, Zheng 1995; Prahl). */
UNIT_TEST(adding_doubling_is_met) {
  static const struct {
    double albedo, g, eta, thickness, reflected, transmitted;
    uint64_t batches;
  } rows[] = {
      {0.9, 0.75, 1, 2, 0.09739, 0.66096, 500},
      {50 / 50.1, 0.8, 1.4, (double)INFINITY, 0.63166, 0, 60},
      {0.99, 0.8, 1.4, (double)INFINITY, 0.38586, 0, 100},
  };
  const double half_a_digit = 5e-6;
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    core_mc_request request = montecarlo_request(rows[i].albedo, rows[i].g, rows[i].eta);
    request.thickness_mm = rows[i].thickness;
    montecarlo_run run = montecarlo_run_batches(&request, rows[i].batches);
    const core_mc_energy energy = montecarlo_energy(&run, 0);
    const double R_sp = specular(rows[i].eta);
    const core_mc_value R = energy.left[CORE_MC_REFLECTED];
    const core_mc_value T = energy.left[CORE_MC_TRANSMITTED];
    assert_true(fabs(R_sp + (1 - R_sp) * R.value - rows[i].reflected) <=
                DEVIATIONS_MAX * R.error + half_a_digit);
    assert_true(fabs((1 - R_sp) * T.value - rows[i].transmitted) <=
                DEVIATIONS_MAX * T.error + half_a_digit);
    montecarlo_run_free(&run);
  }
}

/* ---- layers --------------------------------------------------------------------------------- */

static void assert_near(const char *what, core_mc_value ours, double theirs, double error) {
  const double deviation = (ours.value - theirs) / hypot(ours.error, error);
  UNIT_FAIL_IF(!(fabs(deviation) <= DEVIATIONS_MAX),
               "%s: %.6f +- %.6f, not %.6f: %.1f standard errors off", what, ours.value, ours.error,
               theirs, deviation);
}

static montecarlo_run walk_layers(const core_medium *layers, size_t count, double eta_below,
                                  uint64_t batches, uint64_t seed) {
  core_mc_request request = {.eta_below = eta_below, .seed = seed};
  core_mc_request_medium(&request, layers, count);
  montecarlo_rings(&request, PLAIN_RINGS, 0.003, 10);
  return montecarlo_run_batches(&request, batches);
}

/* The three layers that MCML's authors publish (Wang, Jacques, Zheng 1995, sample.mco), per launched
 * power. */
UNIT_TEST(mcml_is_met) {
  const core_medium layers[] = {
      {1, 100, 0.9, 1.37, 0.1}, {1, 10, 0, 1.37, 0.1}, {2, 10, 0.7, 1.37, 0.2}};
  montecarlo_run run = walk_layers(layers, 3, 0, 200, MONTECARLO_SEED);
  const core_mc_energy energy = montecarlo_energy(&run, 0);
  const double entered = 1 - specular(1.37);
  assert_near("R", energy.left[0], 0.237859 / entered, 0.000312);
  assert_near("T", energy.left[1], 0.096220 / entered, 0.000186);
  assert_near("A", energy.absorbed, 0.641547 / entered, 0.000293);
  montecarlo_run_free(&run);
}

/* Returns the mean of what the solver has over a ring, and adds its error's mean to *error. */
static double solved_ring(const solver_layers *solution, size_t side, const core_mc_ring *ring,
                          double *error) {
  static const double place[] = {0.0694318442029737, 0.3300094782075719}; /* Gauss, 4 points */
  static const double weight[] = {0.1739274225687269, 0.3260725774312731};
  const double from = square(ring->from_mm), to = square(ring->to_mm);
  double sum = 0;
  for (size_t i = 0; i < 4; i++) {
    const double at = i < 2 ? place[i] : 1 - place[3 - i];
    const transport_number R = solver_layers_at(solution, side, sqrt(from + (to - from) * at));
    sum += weight[i < 2 ? i : 3 - i] * R.value;
    *error += weight[i < 2 ? i : 3 - i] * R.error;
  }
  return sum;
}

/* Beside the solver of core/solver, ring by ring, within what it states; its totals are exact. The long
 * form asks it for small errors, and chi-squared says whether all rings together agree. */
UNIT_TEST(layers_are_walked_as_they_are_solved) {
  static const struct {
    size_t count;
    double eta_below;
    core_medium layer[2];
  } stacks[] = {
      {2, 1, {{2, 40, 0.9, 1.4, 0.06}, {0.05, 20, 0.85, 1.4, 0}}},
      {2, 1.5, {{2, 12, 0.5, 1.5, 0.1}, {0.1, 15, -0.4, 1.33, 0.6}}},
      {1, 0.75, {{0.1, 3, 0.8, 1.3, 2}}},
  };
  const core_isa *isa = core_isa_select(NULL);
  const double tolerance = unit_is_long() ? 1e-3 : 0.1;
  const uint64_t batches = unit_is_long() ? 1200 : 60;
  double squares = 0;
  size_t compared = 0;
  for (size_t i = 0; i < sizeof stacks / sizeof stacks[0]; i++) {
    solver_layer layers[2];
    for (size_t k = 0; k < stacks[i].count; k++) {
      const core_medium *of = &stacks[i].layer[k];
      layers[k] = (solver_layer){of->sigma_a_per_mm, of->sigma_s_per_mm, of->g, of->eta,
                                 of->thickness_mm > 0 ? of->thickness_mm : (double)INFINITY};
    }
    solver_layers *solution;
    solver_balance balance;
    unit_accept(solver_layers_solve(&solution, isa, layers, stacks[i].count, stacks[i].eta_below,
                                    tolerance, NULL));
    unit_accept(solver_layers_balance(solution, isa, &balance));
    montecarlo_run run = walk_layers(stacks[i].layer, stacks[i].count, stacks[i].eta_below, batches,
                                     MONTECARLO_SEED);
    const core_mc_energy energy = montecarlo_energy(&run, 0);
    const size_t sides = isinf(layers[stacks[i].count - 1].thickness_mm) ? 1 : CORE_MC_SIDES;
    for (size_t k = 0; k < stacks[i].count; k++) {
      assert_near("absorbed", energy.in_layer[k], balance.absorbed[k].value, 0);
    }
    for (size_t side = 0; side < sides; side++) {
      core_mc_ring rings[PLAIN_RINGS];
      const double out = balance.out[side].value + balance.unscattered[side];
      assert_near("total", energy.left[side], out, balance.out[side].error);
      assert_true(fabs(energy.unscattered[side] - balance.unscattered[side]) <= 1e-12);
      core_mc_total_rings(run.total, 0, side, rings);
      for (size_t k = 0; k < PLAIN_RINGS; k++) {
        double stated = 0;
        const double R = solved_ring(solution, side, &rings[k], &stated);
        const double off = fabs(rings[k].R_per_mm2 - R);
        if (rings[k].photons > 200) {
          squares += square(off / hypot(rings[k].error_per_mm2, stated));
          compared++;
          UNIT_FAIL_IF(!(off <= stated + 1.1 * DEVIATIONS_MAX * rings[k].error_per_mm2),
                       "stack %zu side %zu, %g mm: %g +- %g, solved %g +- %g", i, side,
                       rings[k].from_mm, rings[k].R_per_mm2, rings[k].error_per_mm2, R, stated);
        }
      }
    }
    montecarlo_run_free(&run);
    solver_layers_free(solution);
  }
  printf("solved layers: %zu rings, chi-squared %.1f\n", compared, squares);
  assert_true(compared >= 100);
  assert_true(squares <= (double)compared + DEVIATIONS_MAX * sqrt(2 * (double)compared));
}

/* ---- a plain walk ------------------------------------------------------------------------- */

struct plain_sums {
  double light;
  double squares;
};

/* Scattered light that the plain walk sees leave, by side and slot; the slots are the rings, what
 * is under them and what is over them. */
static void walk_plainly(const plain_medium *medium, int photons, const double *edges,
                         struct plain_sums sums[CORE_MC_SIDES][PLAIN_SLOTS]) {
  uint64_t random = 1905;
  memset(sums, 0, sizeof(struct plain_sums[CORE_MC_SIDES][PLAIN_SLOTS]));
  for (int i = 0; i < photons; i++) {
    const plain_photon p = plain_walk(medium, &random);
    if (p.fate == PLAIN_INSIDE || !p.scattered) {
      continue;
    }
    const double r = hypot(p.x, p.y);
    size_t slot = 0;
    while (slot <= PLAIN_RINGS && edges[slot] <= r) {
      slot++;
    }
    sums[p.fate][slot].light += p.weight / photons;
    sums[p.fate][slot].squares += square(p.weight / photons);
  }
}

/* The same slots of a run. */
static void gather_slots(const montecarlo_run *run, size_t side, core_mc_value slots[PLAIN_SLOTS],
                         uint64_t photons[PLAIN_SLOTS]) {
  core_mc_ring rings[PLAIN_RINGS];
  const core_mc_energy energy = montecarlo_energy(run, 0);
  core_mc_total_rings(run->total, 0, side, rings);
  slots[0] = energy.under[side];
  slots[PLAIN_SLOTS - 1] = energy.over[side];
  photons[0] = photons[PLAIN_SLOTS - 1] = UINT64_MAX;
  for (size_t i = 0; i < PLAIN_RINGS; i++) {
    const double area = acos(-1) * (square(rings[i].to_mm) - square(rings[i].from_mm));
    slots[i + 1].value = rings[i].R_per_mm2 * area;
    slots[i + 1].error = rings[i].error_per_mm2 * area;
    photons[i + 1] = rings[i].photons;
  }
}

static void compare_with_plain(const plain_medium *medium, int plain_photons) {
  enum { PHOTONS_MIN = 50, BATCHES_MAX = 60 };
  /* Half as many photons again as the plain walk has: more would not show more. */
  const uint64_t enough = 1 + (uint64_t)plain_photons * 3 / 2 / CORE_MC_BATCH_PHOTONS;
  struct plain_sums theirs[CORE_MC_SIDES][PLAIN_SLOTS];
  core_mc_request request = montecarlo_request(medium->albedo, medium->g, medium->eta);
  request.thickness_mm = medium->thickness;
  double edges[PLAIN_RINGS + 1];
  montecarlo_rings(&request, PLAIN_RINGS, 0.01, 30);
  core_grid_radii(&request.edges, 0, PLAIN_RINGS + 1, false, edges);
  walk_plainly(medium, plain_photons, edges, theirs);
  montecarlo_run run =
      montecarlo_run_batches(&request, enough < BATCHES_MAX ? enough : BATCHES_MAX);
  size_t compared = 0;
  double squares = 0;
  for (size_t side = 0; side < CORE_MC_SIDES; side++) {
    core_mc_value ours[PLAIN_SLOTS];
    uint64_t photons[PLAIN_SLOTS];
    gather_slots(&run, side, ours, photons);
    for (size_t i = 0; i < PLAIN_SLOTS; i++) {
      const struct plain_sums *plain = &theirs[side][i];
      const bool many = square(plain->light) > PHOTONS_MIN * plain->squares;
      if (photons[i] < PHOTONS_MIN || !many) {
        continue;
      }
      const double deviation =
          (ours[i].value - plain->light) / sqrt(square(ours[i].error) + plain->squares);
      UNIT_FAIL_IF(
          !(fabs(deviation) <= 1.1 * DEVIATIONS_MAX),
          "albedo %g g %g eta %g thickness %g side %zu slot %zu: %g +- %g, plainly %g +- %g",
          medium->albedo, medium->g, medium->eta, medium->thickness, side, i, ours[i].value,
          ours[i].error, plain->light, sqrt(plain->squares));
      squares += square(deviation);
      compared++;
    }
  }
  montecarlo_run_free(&run);
  printf("plain walk, albedo %-5g g %-6g eta %-4g thickness %-5g %2zu slots, chi-squared %.1f\n",
         medium->albedo, medium->g, medium->eta, medium->thickness, compared, squares);
  assert_true(compared >= 10);
  assert_true(squares <= (double)compared + DEVIATIONS_MAX * sqrt(2 * (double)compared));
}

/* Thin slabs with many reflections in a flight, both ends of g, an outside that is denser, and an
 * escape cone of next to nothing. */
UNIT_TEST(a_plain_walk_is_met) {
  static const struct {
    plain_medium medium;
    int photons; /* number of photons in the plain walk; thin slabs scatter only few of them */
  } rows[] = {
      {{0.9, 0, 1.5, 0.1}, 300000},
      {{0.95, 0.5, 1.7, 3}, 100000},
      {{0.8, -0.5, 1.33, 1}, 200000},
      {{0.999, 0, 1, 0.01}, 3000000},
      {{0.99, 0.999, 1.4, 20}, 200000},
      {{0.9, -0.999, 1.3, 2}, 200000},
      {{0.9, 0.9, 0.5, 1}, 200000},
      {{0.7, 0.3, 3, (double)INFINITY}, 200000},
      {{0.97, 0.8, 0.7, (double)INFINITY}, 100000},
      {{1, 0, 1.5, 2}, 100000},
      {{0.999, 0, 10, 2}, 20000},
      {{0.9, 0.2, 1.1, 0.003}, 5000000},
  };
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    compare_with_plain(&rows[i].medium, rows[i].photons / (unit_is_long() ? 1 : 3));
  }
}

/* ---- standard errors ---------------------------------------------------------------------- */

/* Over many seeds: the variance of a ring's R among them, over the mean of its squared errors, is 1
 * on the average, within what so few seeds and batches leave open (Fisher's F); and the deviations
 * of total R from the exact one are normal. */
UNIT_TEST(standard_errors_are_right) {
  enum { SEEDS = 64, BATCHES = 16, RINGS = 24 };
  static core_mc_ring rings[SEEDS][RINGS];
  const double exact = (.25991856992 - specular(1.5)) / (1 - specular(1.5));
  double sum = 0;
  double squares = 0;
  for (int seed = 0; seed < SEEDS; seed++) {
    core_mc_request request = montecarlo_request(0.9, 0, 1.5);
    request.seed = (uint64_t)seed;
    montecarlo_rings(&request, RINGS, 0.02, 5);
    montecarlo_run run = montecarlo_run_batches(&request, BATCHES);
    core_mc_total_rings(run.total, 0, CORE_MC_REFLECTED, rings[seed]);
    const core_mc_energy energy = montecarlo_energy(&run, 0);
    const double deviation = montecarlo_deviation(energy.left[CORE_MC_REFLECTED], exact);
    montecarlo_run_free(&run);
    sum += deviation;
    squares += square(deviation);
  }
  /* Student's t with BATCHES - 1 degrees of freedom has the variance n / (n - 2). */
  const double t_variance = (BATCHES - 1.0) / (BATCHES - 3);
  printf("total R, %d seeds: mean deviation %.2f, variance %.2f (expected %.2f)\n", SEEDS,
         sum / SEEDS, squares / SEEDS, t_variance);
  assert_true(fabs(sum) <= DEVIATIONS_MAX * sqrt(SEEDS * t_variance));
  assert_true(fabs(squares / SEEDS - t_variance) <= DEVIATIONS_MAX * sqrt(3.0 / SEEDS));

  double ratios = 0;
  for (int i = 0; i < RINGS; i++) {
    double mean = 0, variance = 0, stated = 0;
    for (int seed = 0; seed < SEEDS; seed++) {
      mean += rings[seed][i].R_per_mm2 / SEEDS;
      stated += square(rings[seed][i].error_per_mm2) / SEEDS;
    }
    for (int seed = 0; seed < SEEDS; seed++) {
      variance += square(rings[seed][i].R_per_mm2 - mean) / (SEEDS - 1);
    }
    ratios += variance / stated / RINGS;
  }
  const double spread = sqrt((2.0 / (SEEDS - 1) + 2.0 / (BATCHES - 1) / SEEDS) / RINGS);
  printf("%d rings, %d seeds: variance over squared error %.3f (expected 1 +- %.3f)\n", RINGS,
         SEEDS, ratios, spread);
  assert_true(fabs(ratios - 1) <= DEVIATIONS_MAX * spread);
}
