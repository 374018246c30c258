/* Layers, solved, beside an independent program (numpy, another language, another start of the
 * doubling), beside walks, and beside what has to hold: equal layers are one, energy is kept, deep
 * slabs are half spaces. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/kernels.h"
#include "core/solver/solver.h"
#include "core/transport/gauss.h"
#include "tests/accuracy/montecarlo_run.h"
#include "tests/unit/unit.h"

#define DEEP INFINITY

static solver_layers *solved(const solver_layer *layer, size_t count, double eta_below) {
  solver_layers *solution;
  unit_accept(
      solver_layers_solve(&solution, core_isa_select(NULL), layer, count, eta_below, 1e-2, NULL));
  return solution;
}

static solver_balance balance_of(const solver_layers *solution) {
  solver_balance balance;
  unit_accept(solver_layers_balance(solution, core_isa_select(NULL), &balance));
  return balance;
}

/* Known R and T at radii, with the reference's own absolute errors. */
struct known {
  double r_mm, R, R_error, T, T_error;
};

static const solver_layer skin[] = {{1.5, 20, 0.8, 1.4, 0.06}, {0.03, 15, 0.8, 1.4, DEEP}};
static const struct known of_skin[] = {
    {0.0036363636, 1.8170136e+01, 2.8e-03, 0.0000000e+00, 0.0e+00},
    {0.0097636364, 6.2251434e+00, 6.2e-04, 0.0000000e+00, 0.0e+00},
    {0.026163636, 2.0036995e+00, 3.6e-04, 0.0000000e+00, 0.0e+00},
    {0.0702, 6.5189221e-01, 4.8e-05, 0.0000000e+00, 0.0e+00},
    {0.18834545, 2.4696698e-01, 2.0e-05, 0.0000000e+00, 0.0e+00},
    {0.50527273, 7.9480739e-02, 1.6e-06, 0.0000000e+00, 0.0e+00},
    {1.3554909, 1.1924243e-02, 2.4e-07, 0.0000000e+00, 0.0e+00},
    {3.6363636, 5.1972151e-04, 1.0e-08, 0.0000000e+00, 0.0e+00},
};

static void expect_near(transport_number found, double truth, double error, double r_mm) {
  UNIT_FAIL_IF(!(fabs(found.value - truth) <= found.error + error),
               "%.9g at %g mm, not %.9g +- %.2g: stated %.2g", found.value, r_mm, truth, error,
               found.error);
  assert_true(r_mm < 0.05 || found.error <= 0.02 * found.value);
}

static void compare(const solver_layer *layer, size_t count, const struct known *known,
                    size_t radii, const double total[2]) {
  solver_layers *solution = solved(layer, count, 1);
  for (size_t i = 0; i < radii; i++) {
    expect_near(solver_layers_at(solution, 0, known[i].r_mm), known[i].R, known[i].R_error,
                known[i].r_mm);
    expect_near(solver_layers_at(solution, 1, known[i].r_mm), known[i].T, known[i].T_error,
                known[i].r_mm);
  }
  const solver_balance balance = balance_of(solution);
  double sum = balance.unscattered[0] + balance.unscattered[1];
  for (size_t side = 0; side < SOLVER_SIDES; side++) {
    assert_true(fabs(balance.out[side].value - total[side]) <= balance.out[side].error + 1e-9);
    sum += balance.out[side].value;
  }
  for (size_t i = 0; i < count; i++) {
    sum += balance.absorbed[i].value;
  }
  assert_true(fabs(sum - 1) < 1e-8);
  solver_layers_free(solution);
}

UNIT_TEST(layers_are_those_of_another_program) {
  compare(skin, 2, of_skin, sizeof of_skin / sizeof *of_skin, (double[]){0.394703611, 0});
  static const solver_layer slab[] = {{0.05, 10, 0.8, 1.4, 2}};
  static const struct known of_slab[] = {
      {0.0097560976, 3.5825235e+00, 6.5e-04, 2.7509688e-02, 2.8e-06},
      {0.026195122, 1.3148200e+00, 2.1e-04, 2.7496168e-02, 2.7e-06},
      {0.070195122, 4.8883748e-01, 4.9e-05, 2.7405768e-02, 2.7e-06},
      {0.18834146, 1.9349813e-01, 3.9e-06, 2.6775163e-02, 5.4e-07},
      {0.50531707, 7.5323295e-02, 1.5e-06, 2.2956896e-02, 4.6e-07},
      {1.3556098, 1.7103826e-02, 3.4e-07, 1.0638516e-02, 2.1e-07},
      {3.6366829, 9.2133818e-04, 1.8e-08, 8.7192335e-04, 1.7e-08},
      {9.7560976, 1.2091787e-06, 2.4e-11, 1.2089533e-06, 2.4e-11},
  };
  compare(slab, 1, of_slab, sizeof of_slab / sizeof *of_slab, (double[]){0.456599963, 0.236586943});
  static const solver_layer step[] = {{0.1, 10, 0.8, 1.4, 0.5}, {0.05, 8, 0.7, 1.33, 1.5}};
  static const struct known of_step[] = {
      {0.0095238095, 3.6614452e+00, 1.0e-03, 2.4406378e-02, 2.4e-06},
      {0.025571429, 1.3422086e+00, 3.1e-04, 2.4386770e-02, 2.4e-06},
      {0.06852381, 4.9948966e-01, 5.0e-05, 2.4308194e-02, 2.4e-06},
      {0.18385714, 1.9977285e-01, 4.0e-06, 2.3781367e-02, 4.8e-07},
      {0.49328571, 7.9701465e-02, 1.6e-06, 2.0553278e-02, 4.1e-07},
      {1.3233333, 1.7436651e-02, 3.5e-07, 9.5192292e-03, 1.9e-07},
      {3.5500952, 7.3845001e-04, 1.5e-08, 6.6340509e-04, 1.3e-08},
      {9.5238095, 5.0950441e-07, 1.0e-11, 4.9789949e-07, 1.0e-11},
  };
  compare(step, 2, of_step, sizeof of_step / sizeof *of_step, (double[]){0.432884772, 0.192617432});
  static const solver_layer backward[] = {{0.1, 2, -0.3, 1.4, 1}};
  static const struct known of_backward[] = {
      {0.0074074074, 2.8826844e+01, 2.9e-03, 1.1441159e+00, 3.9e-04},
      {0.019888889, 9.1183320e+00, 9.1e-04, 5.3451263e-01, 2.2e-04},
      {0.053296296, 2.4938054e+00, 2.5e-04, 2.7509464e-01, 1.5e-04},
      {0.143, 5.4788613e-01, 3.6e-05, 1.4485079e-01, 1.8e-05},
      {0.38366667, 1.0177212e-01, 2.1e-06, 6.2799810e-02, 4.8e-05},
  };
  compare(backward, 1, of_backward, sizeof of_backward / sizeof *of_backward,
          (double[]){0.387594053, 0.213319071});
}

UNIT_TEST(a_tolerance_is_kept_near_the_beam) {
  solver_layers *solution;
  unit_accept(
      solver_layers_solve(&solution, core_isa_select(NULL), skin, 2, skin[1].eta, 1e-3, NULL));
  for (size_t i = 1; i < sizeof of_skin / sizeof *of_skin; i++) { /* from 0.05 mean free paths on */
    const transport_number R = solver_layers_at(solution, 0, of_skin[i].r_mm);
    expect_near(R, of_skin[i].R, of_skin[i].R_error, of_skin[i].r_mm);
    assert_true(R.error <= 1e-3 * R.value);
  }
  solver_layers_free(solution);
}

/* Example of MCML's manual: layers that are ten times weaker below a strong one. Totals per launched
 * power: MCML's with its standard errors; the others are as above. */
UNIT_TEST(weak_layers_below_a_strong_one) {
  static const solver_layer layer[] = {
      {1, 100, 0.9, 1.37, 0.1}, {1, 10, 0, 1.37, 0.1}, {2, 10, 0.7, 1.37, 0.2}};
  static const struct known known[] = {
      {0.0048818182, 3.2240336e+01, 5.2e-03, 5.9188781e-01, 1.9e-03},
      {0.013081818, 1.1804339e+01, 1.2e-03, 5.8778781e-01, 3.9e-04},
      {0.0351, 4.5507291e+00, 1.3e-04, 5.6624000e-01, 4.2e-04},
      {0.094172727, 1.6042227e+00, 3.2e-05, 4.4907405e-01, 7.7e-05},
      {0.25263636, 2.2287667e-01, 4.5e-06, 1.4014039e-01, 3.7e-05},
      {0.67774545, 4.3754943e-03, 1.9e-07, 4.8745362e-03, 1.7e-06},
      {1.8181818, 2.9901931e-06, 6.0e-11, 3.7011359e-06, 5.6e-10},
  };
  solver_layers *solution = solved(layer, 3, 1);
  for (size_t i = 0; i < sizeof known / sizeof *known; i++) {
    const transport_number R = solver_layers_at(solution, 0, known[i].r_mm);
    const transport_number T = solver_layers_at(solution, 1, known[i].r_mm);
    expect_near(R, known[i].R, known[i].R_error, known[i].r_mm);
    assert_true(fabs(T.value - known[i].T) <= T.error + known[i].T_error);
    assert_true(R.error < 0.02 * R.value && T.error < 0.2 * T.value);
  }
  const solver_balance balance = balance_of(solution);
  const double entered = 1 - 0.37 * 0.37 / (2.37 * 2.37);
  double absorbed = 0;
  for (size_t i = 0; i < 3; i++) {
    absorbed += balance.absorbed[i].value;
  }
  assert_true(fabs(entered * balance.out[0].value - 0.237859) < 0.000312);
  assert_true(fabs(entered * balance.out[1].value - 0.096220) < 0.000186);
  assert_true(fabs(entered * absorbed - 0.641547) < 0.000293);
  solver_layers_free(solution);
}

/* R as walked by 4e7 photons (dipole mc --seed 1) from 0.0265 to 0.0305 mm, where it has its mean at
 * 0.0285 mm. */
UNIT_TEST(a_thin_strong_layer_over_weak_ones_says_its_error) {
  static const solver_layer layer[] = {{0.01741, 9.678, 0.331, 1.433, 0.05618},
                                       {0.05993, 1.889, 0.572, 1.224, 1.788},
                                       {0.04531, 1.144, 0.679, 1.22, DEEP}};
  solver_layers *solution = solved(layer, 3, 1.22);
  const transport_number R = solver_layers_at(solution, 0, 0.0285);
  printf("%.4f, walked 3.3662, stated %.2g\n", R.value, R.error);
  assert_true(fabs(R.value - 3.3662) <= R.error + 2 * 0.0109);
  assert_true(R.error <= 0.04 * R.value);
  solver_layers_free(solution);
}

/* T as walked by 9e6 photons, from 0.164 to 0.214 mm, with its standard error. */
UNIT_TEST(light_scattered_twice_behind_deep_layers_is_stated) {
  static const solver_layer layer[] = {{0.057, 0.943, 0.5732, 1.0795, 4.3956},
                                       {0.0349, 0.9651, -0.9141, 1.0795, 0.9777},
                                       {0.234, 0.766, 0.5955, 1.0795, 1.0905}};
  solver_layers *solution = solved(layer, 3, 1.0795);
  const transport_number T = solver_layers_at(solution, 1, 0.19);
  assert_true(fabs(T.value - 0.00534) <= T.error + 3 * 0.000083);
  assert_true(solver_layers_at(solution, 1, 10).error < 2e-7);
  solver_layers_free(solution);
}

/* T as walked by 6e7 photons in rings about 0.0956 and 0.0739 mm. */
UNIT_TEST(light_deflected_little_behind_deep_layers_is_found) {
  static const solver_layer peaked[] = {{0.02, 1.98, 0.6, 1.5, 0.7345},
                                        {0.01, 0.99, 0, 1.5, 0.8434},
                                        {0.01, 0.99, 0, 1.5, 2.51},
                                        {0.01, 0.49, 0.95, 1.5, 2.265}};
  static const solver_layer matched[] = {
      {0.1, 0.9, 0.8, 1.5, 4.58}, {0.02, 0.98, 0.9, 1.5, 1.415}, {0.1, 0.9, 0.6, 1.5, 1.172}};
  solver_layers *solution = solved(peaked, 4, 1);
  transport_number T = solver_layers_at(solution, 1, 0.09562);
  assert_true(fabs(T.value - 0.029483) <= T.error + 3 * 0.00019);
  assert_true(T.error < 0.06 * T.value);
  solver_layers_free(solution);
  solution = solved(matched, 3, 1.5);
  T = solver_layers_at(solution, 1, 0.07391);
  assert_true(fabs(T.value - 0.020519) <= T.error + 3 * 0.00019);
  assert_true(T.error < 0.2 * T.value);
  solver_layers_free(solution);
}

/* van de Hulst 1980: albedo 0.9, depth 2, g 0.75, equal indices. */
UNIT_TEST(a_slab_is_that_of_van_de_hulst) {
  static const solver_layer slab = {0.2, 1.8, 0.75, 1, 1};
  solver_layers *solution; /* energies are exact on any grid */
  unit_accept(solver_layers_solve_level(&solution, core_isa_select(NULL), &slab, 1, 1, 0, NULL));
  const solver_balance balance = balance_of(solution);
  assert_true(fabs(balance.out[0].value - 0.09739) < 1e-5);
  assert_true(fabs(balance.out[1].value + balance.unscattered[1] - 0.66096) < 1e-5);
  assert_true(fabs(balance.unscattered[1] - exp(-2)) < 1e-12);
  solver_layers_free(solution);
}

/* T of leaves: Monte Carlo of 2e6 photons with its standard errors, at 3 % wide rings. Far away, light
 * in a slab spreads evenly to both sides. */
UNIT_TEST(a_slab_that_absorbs_nothing_sends_as_much_light_to_both_sides) {
  static const solver_layer slab[] = {
      {0, 20, 0.8, 1.4, 0.2}, {0, 30, 0.5, 1, 0.1}, {0, 50, 0.9, 1.5, 0.4}};
  static const double walked[][3] = {{0.1314, 1.26318, 0.012},
                                     {0.1971, 0.455038, 0.0041},
                                     {0.4434, 0.11658, 0.0011},
                                     {0.9976, 0.0126325, 0.00018}};
  for (size_t i = 0; i < sizeof slab / sizeof *slab; i++) {
    solver_layers *solution = solved(&slab[i], 1, 1);
    const double far_mm = 6 * slab[i].thickness_mm;
    const transport_number R = solver_layers_at(solution, 0, far_mm);
    const transport_number T = solver_layers_at(solution, 1, far_mm);
    assert_true(fabs(R.value - T.value) <= R.error + T.error + 1e-4 * R.value);
    assert_true(R.error < 0.02 * R.value && T.error < 0.02 * T.value);
    for (size_t j = 0; i == 0 && j < sizeof walked / sizeof *walked; j++) {
      const transport_number near = solver_layers_at(solution, 1, walked[j][0]);
      assert_true(fabs(near.value - walked[j][1]) <= near.error + 3 * walked[j][2]);
      assert_true(near.error <= 0.05 * near.value);
    }
    solver_layers_free(solution);
  }
}

/* R where light is guided between both sides: around the farthest radius that light reaches that was
 * scattered once at the other side, and far away. Our walks of 1e8 to 1.5e9 photons in rings, with
 * their standard errors. */
UNIT_TEST(thin_slabs_guide_light) {
  static const solver_layer slab[] = {{0.5, 5, 0, 1.5, 0.05}, {0.1, 30, 0.8, 1.4, 0.02}};
  static const double walked[][3][3] = {
      {{0.0253, 2.979892, 0.0036}, {0.0439, 0.637353, 0.00055}, {0.0469, 0.583563, 0.00051}},
      {{0.04386, 0.89965, 0.0026}, {0.2117, 0.0774913, 0.00015}, {0.3578, 0.0213418, 0.000062}}};
  for (size_t i = 0; i < sizeof slab / sizeof *slab; i++) {
    solver_layers *solution;
    unit_accept(solver_layers_solve(&solution, core_isa_select(NULL), &slab[i], 1, 1, 1e-3, NULL));
    for (size_t j = 0; j < 3; j++) {
      const double *at = walked[i][j];
      const transport_number R = solver_layers_at(solution, 0, at[0]);
      printf("%g mm: %.5f, walked %.5f, stated %.2g\n", at[0], R.value, at[1], R.error);
      assert_true(fabs(R.value - at[1]) <= R.error + 2 * at[2]);
      assert_true(R.error < (i == 0 ? 0.01 : 0.1) * R.value);
    }
    solver_layers_free(solution);
  }
}

UNIT_TEST(a_half_space_may_be_cut_anywhere) {
  static const solver_layer whole = {0.1, 8, 0.7, 1.4, DEEP};
  solver_layer cut[3] = {whole, whole, whole};
  cut[0].thickness_mm = 0.2;
  cut[1].thickness_mm = 1;
  solver_layers *one = solved(&whole, 1, 1), *three = solved(cut, 3, 1);
  const solver_phase phase = {.g = whole.g};
  const double reduced = 0.1 + 8 * (1 - 0.7), unit = 1 / reduced;
  solver_solution *half;
  unit_accept(
      solver_solve(&half, core_isa_select(NULL), 0.1 / (8 * 0.3), &phase, &whole.eta, 1, 1e-3));
  for (double r = 0.02; r < 8; r *= 2) {
    const transport_number R = solver_layers_at(one, 0, r), same = solver_layers_at(three, 0, r);
    const transport_number known = solver_at(half, 0, r * reduced);
    assert_true(fabs(same.value / R.value - 1) < 1e-6);
    expect_near(R, known.value / (unit * unit), known.error / (unit * unit), r);
  }
  assert_true(fabs(balance_of(one).out[0].value - balance_of(three).out[0].value) < 1e-9);
  solver_free(half);
  solver_layers_free(one);
  solver_layers_free(three);
}

UNIT_TEST(layers_out_of_range_are_refused) {
  static const solver_layer good = {0.1, 10, 0.8, 1.4, 1};
  const struct {
    solver_layer layer[2];
    double eta_below, tolerance;
    size_t count, index;
    const char *field;
  } bad[] = {
      {{good, good}, 1, 1e-2, 0, 0, "layer_count"},
      {{good, good}, 1, 1e-2, SOLVER_LAYERS_MAX + 1, 0, "layer_count"},
      {{good, {-0.1, 10, 0.8, 1.4, 1}}, 1, 1e-2, 2, 1, "sigma_a"},
      {{good, {0, 0, 0.8, 1.4, 1}}, 1, 1e-2, 2, 1, "sigma_s"},
      {{{0.02, 0.18, 0, 1.4, 1}, good}, 1, 1e-2, 2, 0, "sigma_s"}, /* weaker than a fiftieth */
      {{good, {0.1, 10, 0.995, 1.4, 1}}, 1, 1e-2, 2, 1, "g"},
      {{{0.1, 10, 0.8, (double)NAN, 1}, good}, 1, 1e-2, 2, 0, "eta"},
      {{{0.1, 10, 0.8, 1.4, DEEP}, good}, 1, 1e-2, 2, 0, "thickness"},
      {{good, {0.1, 10, 0.8, 1.4, 0}}, 1, 1e-2, 2, 1, "thickness"},
      {{good, good}, 5, 1e-2, 2, 0, "eta_below"},
      {{good, good}, 1, -1, 2, 0, "tolerance"},
  };
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    solver_layers *solution;
    unit_assert_fault(solver_layers_solve(&solution, core_isa_select(NULL), bad[i].layer,
                                          bad[i].count, bad[i].eta_below, bad[i].tolerance, NULL),
                      bad[i].field, bad[i].index);
    assert_null(solution);
    if (bad[i].tolerance >= 0) { /* the same without solving */
      unit_assert_fault(solver_layers_check(bad[i].layer, bad[i].count, bad[i].eta_below),
                        bad[i].field, bad[i].index);
    }
  }
  const solver_layer weak_last[] = {good, {1e-4, 1e-3, 0.8, 1.4, 1}};
  unit_accept(solver_layers_check(weak_last, 2, 1));
  const atomic_bool stop = true;
  solver_layers *solution;
  unit_assert_fault(solver_layers_solve(&solution, core_isa_select(NULL), &good, 1, 1, 1e-2, &stop),
                    CORE_FIELD_STOPPED, 0);
}

/* ---- walks -------------------------------------------------------------------------------------- */

/* Rings in equal ratios, in reduced mean free paths of the first layer; up to TOGETHER adjacent ones
 * are compared together. With fewer photons a standard error is known too badly. */
#define RING_FROM 0.02
#define RING_TO 20.0
enum { RINGS = 26, TOGETHER = 8, PHOTONS_LEAST = 400, STACK_MOST = 5 };
#define SIGMAS_MOST 4.0

/* How far values are off beyond what is stated, in standard errors of a walk. */
struct beyond {
  double worst, squares;
  size_t rings, useful; /* useful: rings of which a tenth or less is stated */
};

static double beyond_of(const char *what, double at_mm, double off, double stated, double error) {
  const double beyond = error > 0 && isfinite(stated) ? fmax(0, fabs(off) - stated) / error : 0;
  if (beyond > SIGMAS_MOST) {
    printf("  %s to %g mm: off by %.3g, stated %.3g, standard error %.3g\n", what, at_mm, off,
           stated, error);
  }
  return beyond;
}

/* Returns the mean of R or T over a ring, by quadrature in r^2, and that of its stated errors. */
static transport_number mean_of(const core_profile *profile, size_t side,
                                const core_mc_ring *ring) {
  enum { NODES = 4 };
  const enum core_quantity quantity = side == 0 ? CORE_QUANTITY_R : CORE_QUANTITY_T;
  const double from = ring->from_mm * ring->from_mm, to = ring->to_mm * ring->to_mm;
  transport_number mean = {0, 0};
  gauss_rule rule;
  transport_gauss(&rule, NODES);
  for (size_t i = 0; i < NODES; i++) {
    const double r = sqrt(from + (to - from) * rule.x[i]);
    const double value = unit_value_at(profile, quantity, r);
    const core_stated_errors error =
        core_profile_errors(profile, quantity, (core_radii_range){r, r});
    const double stated = error.numerical + error.numerical_per_mm * r;
    mean.value += rule.weight[i] * value;
    mean.error += isinf(stated) ? stated : rule.weight[i] * value * stated;
  }
  return mean;
}

static void compare_rings(const core_profile *profile, const montecarlo_run *run, size_t side,
                          struct beyond *to) {
  core_mc_ring ring[RINGS];
  double off[RINGS], stated[RINGS], variance[RINGS];
  core_mc_total_rings(run->total, 0, (enum core_mc_side)side, ring);
  for (size_t i = 0; i < RINGS; i++) {
    const bool known = ring[i].photons >= PHOTONS_LEAST;
    const transport_number mean = mean_of(profile, side, &ring[i]);
    const double area = ring[i].to_mm * ring[i].to_mm - ring[i].from_mm * ring[i].from_mm;
    off[i] = area * (mean.value - ring[i].R_per_mm2);
    stated[i] = area * mean.error;
    variance[i] = known ? pow(area * ring[i].error_per_mm2, 2) : (double)INFINITY;
    assert_false(isnan(off[i]) || isnan(stated[i]));
    double sum[3] = {0};
    for (size_t j = i + 1; j-- > 0 && i - j < TOGETHER;) {
      sum[0] += off[j];
      sum[1] += stated[j];
      sum[2] += variance[j];
      const double beyond =
          beyond_of(side == 0 ? "R" : "T", ring[i].to_mm, sum[0], sum[1], sqrt(sum[2]));
      to->worst = fmax(to->worst, beyond);
      to->squares += i == j ? beyond * beyond : 0;
    }
    to->rings += known;
    to->useful += known && mean.error <= 0.1 * mean.value;
  }
}

/* Compares a profile of layers with a walk of so many photons. */
static struct beyond beyond_walk(const core_profile *profile, const core_medium *layer,
                                 size_t count, double eta_below, double photons, uint64_t seed) {
  const double unit = 1 / core_sigma_t_prime(layer);
  core_mc_request request = {.eta_below = eta_below, .seed = seed};
  core_mc_request_medium(&request, layer, count);
  montecarlo_rings(&request, RINGS, RING_FROM * unit, RING_TO * unit);
  montecarlo_run run =
      montecarlo_run_batches(&request, (uint64_t)(photons / CORE_MC_BATCH_PHOTONS));
  struct beyond found = {0};
  compare_rings(profile, &run, 0, &found);
  if (layer[count - 1].thickness_mm > 0) {
    compare_rings(profile, &run, 1, &found);
  }
  const core_mc_energy energy = montecarlo_energy(&run, 0);
  for (size_t i = 0; i < 2 + count; i++) {
    const core_mc_value walked = i < 2 ? energy.left[i] : energy.in_layer[i - 2];
    const double share =
        profile->balance[i < 2 ? i : 2 + i] + (i < 2 ? profile->balance[2 + i] : 0);
    found.worst = fmax(found.worst, beyond_of("shares", INFINITY, share - walked.value,
                                              profile->balance_error, walked.error));
  }
  montecarlo_run_free(&run);
  return found;
}

static core_fault prepare(core_profile *profile, const core_medium *layer, size_t count,
                          double eta_below, double tolerance) {
  core_parameters parameters = core_parameters_none();
  parameters.layer_count = (uint32_t)count;
  parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
  parameters.value[CORE_PARAMETER_ETA_BELOW] =
      layer[count - 1].thickness_mm > 0 ? eta_below : (double)NAN;
  return core_profile_prepare(profile, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                              CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, layer, &parameters);
}

/* Draws and prints layers, and returns their number. The last one may be a half space, and weaker than
 * the others may be. */
static size_t draw_stack(uint64_t *random, size_t layers_most, core_medium layer[],
                         double *eta_below) {
  const size_t count = 1 + unit_random_below(random, layers_most);
  const bool finite = count == 1 || unit_random_below(random, 2) == 0;
  const bool steps = unit_random_below(random, 2) == 0;
  double eta = unit_random_between(random, 1, 1.6);
  *eta_below = steps ? unit_random_between(random, 1, 1.6) : 1;
  printf("index below: %.6g\n", *eta_below);
  for (size_t i = 0; i < count; i++) {
    const bool last = i + 1 == count, white = finite && unit_random_below(random, 5) == 0;
    const double sigma_t = unit_random_log(random, last ? 0.03 : 0.06, 3);
    const double absorbed = white ? 0 : unit_random_log(random, 1e-3, 0.7) * sigma_t;
    const double g = unit_random_between(random, -0.5, 0.95);
    layer[i] = (core_medium){absorbed, sigma_t - absorbed, g, eta, 0};
    layer[i].thickness_mm =
        finite || !last ? unit_random_log(random, 0.01, 20) / core_sigma_t_prime(&layer[i]) : 0;
    eta = steps ? unit_random_between(random, 1, 1.6) : eta;
    printf("  %.6g,%.6g,%.6g,%.6g,%.6g\n", layer[i].sigma_a_per_mm, layer[i].sigma_s_per_mm,
           layer[i].g, layer[i].eta, layer[i].thickness_mm);
  }
  return count;
}

UNIT_TEST(random_stacks_are_as_they_are_walked) {
  const double photons = unit_is_long() ? 1e7 : 5e5;
  uint64_t random = unit_seed();
  struct beyond all = {0};
  for (size_t i = 0; i < (unit_is_long() ? 10 : 2); i++) {
    core_medium layer[STACK_MOST];
    core_profile profile;
    double eta_below;
    const size_t count = draw_stack(&random, unit_is_long() ? STACK_MOST : 2, layer, &eta_below);
    const core_fault fault = prepare(&profile, layer, count, eta_below, 1e-2);
    if (fault.field != NULL) {
      assert_string_equal(fault.field, "thickness"); /* R of thin layers is not found */
      printf("  refused\n");
      continue;
    }
    const struct beyond one = beyond_walk(&profile, layer, count, eta_below, photons, i + 1);
    printf("  %zu rings, %zu stated within .1; beyond: at most %.2f standard errors, chi-squared "
           "%.1f\n",
           one.rings, one.useful, one.worst, one.squares);
    all.worst = fmax(all.worst, one.worst);
    all.squares += one.squares;
    all.rings += one.rings;
    all.useful += one.useful;
    core_profile_free(&profile);
  }
  assert_true(all.useful > 0 && all.worst <= SIGMAS_MOST);
  assert_true(all.squares < 1.2 * (double)all.rings);
}

/* Half spaces outside of the table, and a slab that scatters back. */
UNIT_TEST(solved_media_are_as_they_are_walked) {
  static const core_medium media[] = {{0.02, 0.5, -0.95, 1, 0},  {0.1, 2, -0.9, 1.4, 1},
                                      {0.3, 0.4, -0.95, 1.4, 0}, {0.02, 0.6, -0.9, 0.3, 0},
                                      {0.2, 0.8, 0, 3.9, 0},     {0.3, 70, 0.99, 1.4, 0}};
  for (size_t i = 0; i < (unit_is_long() ? sizeof media / sizeof *media : 1); i++) {
    core_profile profile;
    unit_accept(prepare(&profile, &media[i], 1, 1, 1e-2));
    const struct beyond found =
        beyond_walk(&profile, &media[i], 1, 1, unit_is_long() ? 4e6 : 1e6, 1);
    printf("g %g, eta %g: %zu of %zu rings stated within .1, at most %.2f standard errors\n",
           media[i].g, media[i].eta, found.useful, found.rings, found.worst);
    assert_true(found.useful > 10 && found.worst <= SIGMAS_MOST);
    core_profile_free(&profile);
  }
}

UNIT_TEST(skin_keeps_a_tolerance_beside_a_walk) {
  static const core_medium layer[] = {{.1, 20, .8, 1.4, .1}, {.02, 15, .9, 1.4, 0}};
  core_profile profile;
  unit_accept(prepare(&profile, layer, 2, 1, 1e-3));
  const core_stated_errors error =
      core_profile_errors(&profile, CORE_QUANTITY_R, (core_radii_range){.1, 5});
  assert_true(error.numerical + error.numerical_per_mm * 5 <= 1e-3);
  const struct beyond found = beyond_walk(&profile, layer, 2, 1, unit_is_long() ? 2e7 : 5e5, 1);
  printf("skin: %zu rings, at most %.2f standard errors\n", found.useful, found.worst);
  assert_true(found.useful > 10 && found.worst <= SIGMAS_MOST);
  core_profile_free(&profile);
}
