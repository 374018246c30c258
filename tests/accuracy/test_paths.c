/* Path lengths and modulated light: against a random walk that measures its paths, against a dipole in
 * closed form at complex absorption, diffusion theory, published values, and what has to hold. */
#include <complex.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/paths.h"
#include "core/transport/gauss.h"
#include "tests/accuracy/plain_walk.h"
#include "tests/unit/unit.h"

#define PI 3.14159265358979323846

static const core_medium tissue = {0.01, 1, 0, 1.4, 0};

static core_profile prepared(unsigned model, unsigned evaluator, const core_medium *medium,
                             uint32_t layers, double mhz) {
  core_parameters parameters = core_parameters_none();
  parameters.layer_count = layers;
  parameters.value[CORE_PARAMETER_DERIVATIVES] = core_has_derivatives(model) ? 1 : (double)NAN;
  parameters.value[CORE_PARAMETER_MHZ] = mhz;
  return unit_profile(model, evaluator, medium, &parameters);
}

static double stated(const core_profile *profile, enum core_quantity quantity, double r) {
  const core_stated_errors error = core_profile_errors(profile, quantity, (core_radii_range){r, r});
  return error.numerical + error.numerical_per_mm * r;
}

/* omega n / c in 1/mm. */
static double wavenumber(double mhz, double index) {
  return 2 * PI * mhz * 1e-6 * index / 0.299792458;
}

static void expect(const char *what, double r, double value, double truth, double allowed) {
  UNIT_FAIL_IF(!(fabs(value - truth) <= allowed), "%s at %g mm: %.9g, not %.9g within %.3g", what,
               r, value, truth, allowed);
}

/* ---- a random walk ---------------------------------------------------------------------------- */

enum { RINGS = 6, BATCHES = 40, BATCHES_SHORT = 8, PHOTONS = 24000 };
static const double ring_mm[RINGS] = {2, 5, 10, 20, 30, 40};
#define RING_LEAST 0.95 /* of its middle */
#define RING_MOST 1.05
#define MHZ 100
#define LIGHT_LEAST 1e-5 /* what has less left is left out */

/* What of the light of a batch has left in a ring: its weight, times its path, and modulated. */
struct ring {
  double weight, path;
  double complex wave;
};

/* Two layers of equal g and eta, the second a half space. */
static const core_medium layers[2] = {{0.02, 1, 0, 1.4, 2}, {0.004, 0.5, 0, 1.4, 0}};

/* Flies to the next collision; path_mm[]: in each layer. Returns false if the photon has left. */
static bool fly(const core_medium stack[2], plain_photon *p, double path_mm[2], uint64_t *random) {
  const double deep = stack[0].thickness_mm > 0 ? stack[0].thickness_mm : (double)INFINITY;
  double depth = -log(plain_random(random));
  for (;;) {
    const int layer = p->z > deep || (p->z == deep && p->uz > 0);
    const double edge = p->uz > 0 ? (layer == 0 ? deep : (double)INFINITY) : layer == 0 ? 0 : deep;
    const double way = fmax(0, (edge - p->z) / p->uz), sigma_s = stack[layer].sigma_s_per_mm;
    const double flown = fmin(way, depth / sigma_s);
    path_mm[layer] += flown;
    p->x += p->ux * flown;
    p->y += p->uy * flown;
    p->z = flown < way ? p->z + p->uz * flown : edge;
    if (flown < way) {
      return true;
    }
    depth -= way * sigma_s;
    if (edge == 0 && plain_random(random) >= plain_reflectance(stack->eta, fabs(p->uz))) {
      p->fate = PLAIN_REFLECTED;
      return false;
    }
    p->uz *= edge == 0 ? -1 : 1;
  }
}

static void walk_batch(const core_medium stack[2], struct ring ring[RINGS], uint64_t seed) {
  const plain_medium turns = {.g = stack->g};
  const double path_most = -log(LIGHT_LEAST) / stack[stack->thickness_mm > 0].sigma_a_per_mm;
  uint64_t random = seed;
  for (int photon = 0; photon < PHOTONS; photon++) {
    plain_photon p = {.uz = 1, .weight = 1, .fate = PLAIN_INSIDE};
    double path[2] = {0, 0};
    while (fly(stack, &p, path, &random) && path[0] + path[1] < path_most) {
      plain_scatter(&turns, &p, &random);
    }
    const double r = hypot(p.x, p.y);
    for (int i = 0; i < RINGS && p.fate == PLAIN_REFLECTED && p.scattered; i++) {
      if (r >= RING_LEAST * ring_mm[i] && r < RING_MOST * ring_mm[i]) {
        const double weight =
            exp(-stack[0].sigma_a_per_mm * path[0] - stack[1].sigma_a_per_mm * path[1]);
        ring[i].weight += weight;
        ring[i].path += weight * path[0];
        ring[i].wave += weight * cexp(-I * wavenumber(MHZ, stack->eta) * (path[0] + path[1]));
      }
    }
  }
}

/* Sets *to to R's means over a ring of 1, path and e^(-i phase), by quadrature. */
static struct ring mean_of(const core_profile *profile, double middle_mm) {
  struct ring to = {0};
  gauss_rule rule;
  transport_gauss(&rule, 4);
  for (size_t i = 0; i < rule.n; i++) {
    const double r = middle_mm * (RING_LEAST + (RING_MOST - RING_LEAST) * rule.x[i]);
    const double R = rule.weight[i] * r * unit_value_at(profile, CORE_QUANTITY_R, r);
    const double phase = unit_value_at(profile, CORE_QUANTITY_PHASE, r) * (PI / 180);
    to.weight += R;
    to.path += R * unit_value_at(profile, CORE_QUANTITY_PATH, r);
    to.wave += R * unit_value_at(profile, CORE_QUANTITY_MODULATION, r) * cexp(-I * phase);
  }
  return to;
}

/* Each mean of the walk is a quotient of sums, whose standard error comes from the batches' residuals. */
static void expect_walk(const core_medium stack[2], uint32_t count, int rings) {
  static struct ring batch[BATCHES][RINGS];
  const int batches = unit_is_long() ? BATCHES : BATCHES_SHORT;
  core_profile profile = prepared(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, stack, count, MHZ);
  memset(batch, 0, sizeof batch);
  for (int b = 0; b < batches; b++) {
    walk_batch(stack, batch[b], 1203 + 977 * (uint64_t)b);
  }
  for (int i = 0; i < rings; i++) {
    struct ring sum = {0};
    double path_off = 0, phase_off = 0, modulation_off = 0;
    for (int b = 0; b < batches; b++) {
      sum.weight += batch[b][i].weight;
      sum.path += batch[b][i].path;
      sum.wave += batch[b][i].wave;
    }
    const double path = sum.path / sum.weight;
    const double complex wave = sum.wave / sum.weight;
    for (int b = 0; b < batches; b++) {
      const double complex off = batch[b][i].wave / wave - batch[b][i].weight;
      path_off += pow(batch[b][i].path - path * batch[b][i].weight, 2);
      phase_off += pow(cimag(off), 2);
      modulation_off += pow(creal(off), 2);
    }
    const struct ring known = mean_of(&profile, ring_mm[i]);
    const double complex known_wave = known.wave / known.weight;
    const double path_error = sqrt(path_off) / sum.weight;
    const double phase_error = sqrt(phase_off) / sum.weight * (180 / PI);
    const double modulation_error = sqrt(modulation_off) / sum.weight * cabs(wave);
    printf("%g mm: path %.3f +- %.3f (%.3f), phase %.4f +- %.4f (%.4f), m %.5f +- %.5f (%.5f)\n",
           ring_mm[i], path, path_error, known.path / known.weight, -carg(wave) * (180 / PI),
           phase_error, -carg(known_wave) * (180 / PI), cabs(wave), modulation_error,
           cabs(known_wave));
    expect("path", ring_mm[i], known.path / known.weight, path, 3 * path_error);
    expect("phase", ring_mm[i], -carg(known_wave) * (180 / PI), -carg(wave) * (180 / PI),
           3 * phase_error);
    expect("modulation", ring_mm[i], cabs(known_wave), cabs(wave), 3 * modulation_error);
  }
  core_profile_free(&profile);
}

/* The path is that in the first layer. */
UNIT_TEST(paths_phases_and_modulations_are_those_of_a_random_walk) {
  const core_medium alone[2] = {tissue};
  expect_walk(alone, 1, RINGS);
  expect_walk(layers, 2, 4);
}

/* ---- formulas --------------------------------------------------------------------------------- */

/* Fantini et al. 1999 (in Scholkmann, Wolf 2013): diffusion in a half space. */
UNIT_TEST(path_factors_are_near_those_of_diffusion) {
  const core_medium medium = {0.01, 10, 0.9, 1.4, 0};
  core_profile profile =
      prepared(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, &medium, 1, (double)NAN);
  for (double r = 20; r <= 40; r += 10) {
    const double diffusion = 0.5 * sqrt(3 * 1 / 0.01) * (1 - 1 / (1 + r * sqrt(3 * 0.01 * 1)));
    const double dpf = unit_value_at(&profile, CORE_QUANTITY_DPF, r);
    expect("dpf", r, dpf, diffusion, 0.05 * diffusion);
    const double path = unit_value_at(&profile, CORE_QUANTITY_PATH, r);
    expect("path", r, path, dpf * r, 1e-12 * path);
    expect("time", r, unit_value_at(&profile, CORE_QUANTITY_TIME, r), path * 1.4 / 0.299792458,
           1e-12 * path);
  }
  core_profile_free(&profile);
}

/* R of the classical dipole (Jensen et al. 2001, Eq. 4) at complex absorption and the radius x; or
 * striped, its Hankel transform at the frequency x, e^(-z sqrt(kappa^2 + (2 pi x)^2)) / 2 for each source. */
static double complex dipole(const core_medium *medium, double more_per_mm, bool striped,
                             double x) {
  const double one_minus = core_fresnel_moments(CORE_MOMENTS_EXACT, medium->eta).one_minus_2c1;
  const double A = (2 - one_minus) / one_minus,
               scattered = medium->sigma_s_per_mm * (1 - medium->g);
  const double complex absorbed = medium->sigma_a_per_mm + I * more_per_mm;
  const double complex all = absorbed + scattered, kappa = csqrt(3 * absorbed * all);
  const double complex z[2] = {1 / all, (1 + 4 * A / 3) / all};
  double complex R = 0;
  for (int i = 0; i < 2; i++) {
    const double complex d = csqrt(x * x + z[i] * z[i]);
    R += striped ? 2 * PI * cexp(-z[i] * csqrt(kappa * kappa + 4 * PI * PI * x * x))
                 : z[i] * (1 + kappa * d) * cexp(-kappa * d) / (d * d * d);
  }
  return scattered / all / (4 * PI) * R;
}

static void expect_dipoles(bool striped) {
  static const double mhz[] = {0.01, 10, 100, 300, 1000, 3000, 20000};
  static const core_medium media[] = {{0.01, 1, 0, 1.4, 0},    {0, 1, 0, 1.4, 0},
                                      {1e-4, 12, 0.9, 1.4, 0}, {0.3, 1, 0, 1.33, 0},
                                      {2, 0.5, 0, 1, 0},       {0.01, 10, 0.8, 2, 0}};
  const enum core_quantity phase_of = striped ? CORE_QUANTITY_PHASE_F : CORE_QUANTITY_PHASE,
                           modulation_of =
                               striped ? CORE_QUANTITY_MODULATION_F : CORE_QUANTITY_MODULATION;
  double worst = 0, usual_off[2] = {0}, usual_error[2] = {0};
  for (size_t m = 0; m < sizeof media / sizeof media[0]; m++) {
    for (size_t f = 0; f < sizeof mhz / sizeof mhz[0]; f++) {
      core_profile profile =
          prepared(CORE_MODEL_CLASSICAL, CORE_EVALUATOR_F64, &media[m], 1, mhz[f]);
      double turn = 0, before = 0;
      for (double r = striped ? 1e-4 : 0.01; r < (striped ? 3 : 100); r *= 1.05) {
        const double complex white = dipole(&media[m], 0, striped, r);
        const double complex R =
            dipole(&media[m], wavenumber(mhz[f], media[m].eta), striped, r) / white;
        double phase = turn - carg(R);
        turn += phase < before - PI ? 2 * PI : 0;
        phase += phase < before - PI ? 2 * PI : 0;
        before = phase;
        const double off[2] = {fabs(unit_value_at(&profile, phase_of, r) - phase * (180 / PI)),
                               fabs(unit_value_at(&profile, modulation_of, r) - cabs(R))};
        const double error[2] = {stated(&profile, phase_of, r), stated(&profile, modulation_of, r)};
        expect("R", r,
               unit_value_at(&profile, striped ? CORE_QUANTITY_TRANSFER : CORE_QUANTITY_R, r),
               creal(white), 1e-12 * creal(white));
        worst = fmax(worst, fmax(off[0] / (error[0] + 1e-12), off[1] / (error[1] + 1e-14)));
        if (m == 0 && mhz[f] <= 1000 && r < (striped ? 0.2 : 60)) {
          const size_t fast = mhz[f] > 100;
          usual_off[fast] = fmax(usual_off[fast], fmax(off[0] * (PI / 180), off[1] / cabs(R)));
          usual_error[fast] = fmax(usual_error[fast], error[0]);
        }
      }
      core_profile_free(&profile);
    }
  }
  print_message(
      "off by up to %.3g of what is stated; tissue to 100 MHz and 1 GHz: R by %.1e, %.1e, "
      "phases state %.1e, %.1e degrees\n",
      worst, usual_off[0], usual_off[1], usual_error[0], usual_error[1]);
  assert_true(worst <= 1);
  assert_true(usual_off[0] < 1e-6 && usual_error[0] < 2e-3);
  assert_true(striped || (usual_off[1] < 1e-3 && usual_error[1] < 3));
}

UNIT_TEST(continued_dipoles_are_within_the_stated_errors_of_their_formula) {
  expect_dipoles(false);
  expect_dipoles(true);
}

/* R(f) is the Hankel transform of R(r) for modulated light, too. */
UNIT_TEST(striped_light_lags_as_the_transform_of_what_leaves_at_radii) {
  enum { STEPS = 2400 };
  core_profile profile = prepared(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, &tissue, 1, MHZ);
  for (double f = 0; f < 0.2; f += 0.04) {
    double complex sum = 0, white = 0;
    for (int i = 0; i < STEPS; i++) {
      const double step = log(250 / 1e-4) / STEPS, r = 1e-4 * exp(step * i);
      const double R =
          unit_value_at(&profile, CORE_QUANTITY_R, r) * 2 * PI * r * r * step * j0(2 * PI * f * r);
      const double phase = unit_value_at(&profile, CORE_QUANTITY_PHASE, r) * (PI / 180);
      sum += R * unit_value_at(&profile, CORE_QUANTITY_MODULATION, r) * cexp(-I * phase);
      white += R;
    }
    const double phase = unit_value_at(&profile, CORE_QUANTITY_PHASE_F, f);
    const double modulation = unit_value_at(&profile, CORE_QUANTITY_MODULATION_F, f);
    print_message("f %g: %.5f degrees, %.5f by quadrature, stated %.1e; m %.6f, %.6f\n", f, phase,
                  -carg(sum) * (180 / PI), stated(&profile, CORE_QUANTITY_PHASE_F, f), modulation,
                  cabs(sum / white));
    expect("phase", f, phase, -carg(sum) * (180 / PI), 2e-3 * phase);
    expect("modulation", f, modulation, cabs(sum / white), 2e-5);
    assert_true(stated(&profile, CORE_QUANTITY_PHASE_F, f) < 0.01);
  }
  core_profile_free(&profile);
}

/* Values of transport at 100 MHz, with the digits that are known of them. */
UNIT_TEST(phases_of_tissue_are_those_that_are_known) {
  static const double known[][3] = {
      {5, 4.83, 0.9968}, {10, 10.35, 0.9917}, {20, 23.18, 0.9779}, {30, 36.9, 0.962}};
  for (unsigned evaluator = CORE_EVALUATOR_F64; evaluator <= CORE_EVALUATOR_LUT; evaluator++) {
    core_profile profile = prepared(CORE_MODEL_TRANSPORT, evaluator, &tissue, 1, 100);
    for (size_t i = 0; i < sizeof known / sizeof known[0]; i++) {
      const double r = known[i][0];
      expect("phase", r, unit_value_at(&profile, CORE_QUANTITY_PHASE, r), known[i][1],
             i < 3 ? 0.01 : 0.05);
      expect("modulation", r, unit_value_at(&profile, CORE_QUANTITY_MODULATION, r), known[i][2],
             i < 3 ? 2.5e-4 : 1e-3);
      expect("path", r, unit_value_at(&profile, CORE_QUANTITY_PATH, r),
             unit_value_at(&profile, CORE_QUANTITY_TIME, r) * 0.299792458 / 1.4,
             stated(&profile, CORE_QUANTITY_PATH, r));
    }
    core_profile_free(&profile);
  }
}

/* ---- limits and identities -------------------------------------------------------------------- */

/* Differences of d'Eon's formulas (2012, Table 2) with 150 digits; of single scattering, its integral with
 * 40 (Habel et al. 2013). sigma_s is 1 per mm. */
UNIT_TEST(paths_reach_their_limit_without_absorption) {
  static const struct {
    unsigned model;
    double sigma_a, eta, r, path;
  } known[] = {
      {CORE_MODEL_CLASSICAL, 0, 1.4, 0.25, 2.285153610122808},
      {CORE_MODEL_CLASSICAL, 0, 1.4, 10, 185.3468735370683},
      {CORE_MODEL_CLASSICAL, 0, 1, 1000, 1500008.166645},
      {CORE_MODEL_CLASSICAL, 0x1p-30, 1.4, 10, 185.2389827183318},
      {CORE_MODEL_CLASSICAL, 0x1p-12, 1, 50, 1598.122965624665},
      {CORE_MODEL_BETTER, 0, 1.4, 0.25, 5.822048070511749},
      {CORE_MODEL_BETTER, 0, 1.4, 10, 173.4379273816241},
      {CORE_MODEL_BETTER, 0, 1, 1000, 1500008.099988037},
      {CORE_MODEL_BETTER, 0x1p-30, 1.4, 10, 173.3411361744387},
      {CORE_MODEL_BETTER, 0x1p-12, 1, 50, 1597.85913600001},
      {CORE_MODEL_GROSJEAN, 0, 1.4, 0.25, 3.345110190265388},
      {CORE_MODEL_GROSJEAN, 0, 1.4, 10, 186.1313828651625},
      {CORE_MODEL_GROSJEAN, 0, 1, 1000, 1500008.766652333},
      {CORE_MODEL_GROSJEAN, 0x1p-30, 1.4, 10, 186.0234918079852},
      {CORE_MODEL_GROSJEAN, 0x1p-12, 1, 50, 1598.06047272517},
      {CORE_MODEL_SINGLE, 0, 2.2, 4, 17.714867639284763},
      {CORE_MODEL_SINGLE, 0, 2.2, 20, 84.451838246648165},
      {CORE_MODEL_BETTER_SINGLE, 0, 2.2, 4, 98.056892457371359},
  };
  for (size_t i = 0; i < sizeof known / sizeof known[0]; i++) {
    const core_medium medium = {known[i].sigma_a, 1, 0, known[i].eta, 0};
    const double r = known[i].r, path = known[i].path;
    for (unsigned evaluator = CORE_EVALUATOR_F64; evaluator <= CORE_EVALUATOR_LUT; evaluator++) {
      core_profile profile = prepared(known[i].model, evaluator, &medium, 1, (double)NAN);
      const double error = stated(&profile, CORE_QUANTITY_PATH, r);
      expect("path", r, unit_value_at(&profile, CORE_QUANTITY_PATH, r), path, error + 1e-15 * path);
      expect("dpf", r, unit_value_at(&profile, CORE_QUANTITY_DPF, r), path / r,
             stated(&profile, CORE_QUANTITY_DPF, r) + 1e-15 * path / r);
      assert_true(isfinite(stated(&profile, CORE_QUANTITY_DPF, 1e300)));
      assert_true(error > 0 && error < (evaluator == CORE_EVALUATOR_F64 ? 1e-9 : 1e-3) * path);
      core_profile_free(&profile);
    }
  }
}

UNIT_TEST(slow_modulation_lags_by_the_mean_path) {
  static const unsigned models[] = {CORE_MODEL_TRANSPORT, CORE_MODEL_BETTER,
                                    CORE_MODEL_BETTER_SINGLE};
  for (unsigned m = 0; m < 3 * sizeof models / sizeof models[0]; m++) {
    const unsigned model = models[m / 3], evaluator = CORE_EVALUATOR_F64 + m % 3;
    core_profile profile = prepared(model, evaluator, &tissue, 1, 0.1);
    for (double r = 0.5; r < 40; r *= 2) {
      const double path = unit_value_at(&profile, CORE_QUANTITY_PATH, r);
      const double lag = wavenumber(0.1, 1.4) * (180 / PI);
      expect("phase", r, unit_value_at(&profile, CORE_QUANTITY_PHASE, r), lag * path,
             lag * stated(&profile, CORE_QUANTITY_PATH, r) +
                 stated(&profile, CORE_QUANTITY_PHASE, r) + 1e-5 * lag * path);
    }
    core_profile_free(&profile);
    profile = prepared(model, evaluator, &tissue, 1, 0);
    assert_true(unit_value_at(&profile, CORE_QUANTITY_PHASE, 5) == 0);
    assert_true(unit_value_at(&profile, CORE_QUANTITY_MODULATION, 5) == 1);
    core_profile_free(&profile);
  }
}

/* The index of the light's speed is a number of its own. */
UNIT_TEST(an_index_scales_the_frequency_and_the_time) {
  core_parameters parameters = core_parameters_none();
  core_profile one = prepared(CORE_MODEL_BETTER, CORE_EVALUATOR_F64, &tissue, 1, 200);
  parameters.value[CORE_PARAMETER_INDEX] = 2.8;
  parameters.value[CORE_PARAMETER_MHZ] = 100;
  parameters.value[CORE_PARAMETER_DERIVATIVES] = 1;
  core_profile other = unit_profile(CORE_MODEL_BETTER, CORE_EVALUATOR_F64, &tissue, &parameters);
  expect("phase", 10, unit_value_at(&other, CORE_QUANTITY_PHASE, 10),
         unit_value_at(&one, CORE_QUANTITY_PHASE, 10), 1e-9);
  expect("time", 10, unit_value_at(&other, CORE_QUANTITY_TIME, 10),
         2 * unit_value_at(&one, CORE_QUANTITY_TIME, 10), 1e-9);
  core_profile_free(&one);
  core_profile_free(&other);
}
