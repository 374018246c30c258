/* Drawing radii: the inverse of the cdf, and the density that goes with it. */
#include <float.h>
#include <math.h>
#include <stdio.h>

#include "tests/unit/unit.h"

enum { NUMBERS = 400, RATIOS = 40, ETAS = 30 };

/* Uniform numbers from 0 to 1 - 1e-7, dense at both ends; ascending. */
static void make_numbers(double *u) {
  for (int i = 0; i < NUMBERS; i++) {
    const double share = (double)i / (NUMBERS - 1);
    if (share < 0.3) {
      u[i] = i == 0 ? 0 : 0.1 * pow(10, -12 * (1 - share / 0.3));
    } else if (share < 0.7) {
      u[i] = 0.1 + 0.8 * (share - 0.3) / 0.4;
    } else {
      u[i] = 1 - 0.1 * pow(10, -6 * (share - 0.7) / 0.3);
    }
  }
}

/* The domain of media, corner by corner: sigma_t', sigma_a / sigma_s', g, eta. */
static core_medium medium_at(int index) {
  static const double sigma_t_primes[] = {1e-6, 1, 1e6};
  static const double gs[] = {-0.99, 0, 0.999};
  const int ratio_index = index % RATIOS;
  const int eta_index = index / RATIOS;
  const double ratio =
      ratio_index == 0 ? 0 : pow(10, -12 + 18.0 * (ratio_index - 1) / (RATIOS - 2));
  const double sigma_t_prime = sigma_t_primes[index % 3];
  const double g = gs[(index / 3) % 3];
  return (core_medium){
      .sigma_a_per_mm = sigma_t_prime * (ratio / (1 + ratio)),
      .sigma_s_per_mm = sigma_t_prime / (1 + ratio) / (1 - g),
      .g = g,
      .eta = 0.2 * pow(25, (double)eta_index / (ETAS - 1)),
  };
}

static core_profile prepare(unsigned model, unsigned evaluator, const core_medium *medium) {
  core_profile profile;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), model, CORE_MOMENTS_EXACT,
                                         evaluator, medium),
                    NULL, 0);
  return profile;
}

/* |cdf(sample(u)) - u| with the cdf in double precision at the radius that was drawn. */
static double worst_of_medium(unsigned model, const core_medium *medium, bool single) {
  double u[NUMBERS], r[NUMBERS], cdf[NUMBERS];
  make_numbers(u);
  const core_profile f64 = prepare(model, CORE_EVALUATOR_F64, medium);
  if (single) {
    const core_profile f32 = prepare(model, CORE_EVALUATOR_F32, medium);
    float u_f32[NUMBERS], r_f32[NUMBERS];
    for (int i = 0; i < NUMBERS; i++) {
      u_f32[i] = (float)u[i];
      u[i] = (double)u_f32[i];
    }
    core_sample_f32(&f32, NUMBERS, u_f32, r_f32);
    for (int i = 0; i < NUMBERS; i++) {
      r[i] = (double)r_f32[i];
    }
  } else {
    core_sample_f64(&f64, NUMBERS, u, r);
  }
  core_eval_f64(&f64, CORE_QUANTITY_CDF, NUMBERS, r, cdf);
  double worst = 0;
  for (int i = 0; i < NUMBERS; i++) {
    assert_true(isfinite(r[i]) && r[i] >= 0);
    assert_true(i == 0 || r[i] >= r[i - 1] * (1 - (single ? 1e-5 : 1e-12)));
    worst = fmax(worst, fabs(cdf[i] - u[i]));
  }
  assert_true(r[0] == 0);
  return worst;
}

static void round_trip_holds(void **state) {
  (void)state;
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    double worst[2] = {0, 0};
    for (int i = 0; i < RATIOS * ETAS; i++) {
      const core_medium medium = medium_at(i);
      worst[0] = fmax(worst[0], worst_of_medium(model->id, &medium, false));
      worst[1] = fmax(worst[1], worst_of_medium(model->id, &medium, true));
    }
    printf("%-10s |cdf(sample(u)) - u|: f64 worst %.1e, bound %.0e; f32 worst %.1e, bound %.0e\n",
           model->name, worst[0], CORE_SAMPLE_ERROR_F64, worst[1], CORE_SAMPLE_ERROR_F32);
    assert_true(worst[0] <= CORE_SAMPLE_ERROR_F64);
    assert_true(worst[1] <= CORE_SAMPLE_ERROR_F32);
  }
}

/* Between drawn radii the density's integral (Gauss-Legendre, three points on each of many pieces)
 * is the difference of their numbers; all of them together make 1. */
static double integral_of_pdf(const core_profile *profile, double from, double to) {
  enum { PIECES = 40 };
  static const double nodes[3][2] = {
      {-0.77459666924148338, 5.0 / 9}, {0, 8.0 / 9}, {0.77459666924148338, 5.0 / 9}};
  double sum = 0;
  for (int piece = 0; piece < PIECES; piece++) {
    const double half = 0.5 * (to - from) / PIECES;
    const double middle = from + (2 * piece + 1) * half;
    for (int i = 0; i < 3; i++) {
      const double r = middle + half * nodes[i][0];
      double pdf;
      core_eval_f64(profile, CORE_QUANTITY_PDF, 1, &r, &pdf);
      sum += half * nodes[i][1] * pdf;
    }
  }
  return sum;
}

static void density_matches_the_sampler(void **state) {
  (void)state;
  double u[NUMBERS], r[NUMBERS];
  make_numbers(u);
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    for (int i = 0; i < RATIOS * ETAS; i += 7) {
      const core_medium medium = medium_at(i);
      const core_profile profile = prepare(model->id, CORE_EVALUATOR_F64, &medium);
      core_sample_f64(&profile, NUMBERS, u, r);
      double total = 0;
      for (int k = 1; k < NUMBERS; k++) {
        const double share = integral_of_pdf(&profile, r[k - 1], r[k]);
        assert_true(fabs(share - (u[k] - u[k - 1])) <= 1e-9);
        total += share;
      }
      assert_true(fabs(total - 1) <= 1.1e-7); /* 1e-7 of it lies beyond the last number */
    }
  }
}

static void ends_are_exact(void **state) {
  (void)state;
  static const double u[] = {0, 1, 5e-324, 1e-300, 1 - DBL_EPSILON / 2};
  double r[5];
  static const core_medium skin = {0.032, 0.74, 0, 1.3};
  static const core_medium absorbing = {0.5, 0, 0, 1.3};
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    core_profile profile = prepare(model->id, CORE_EVALUATOR_F64, &skin);
    core_sample_f64(&profile, 5, u, r);
    assert_true(r[0] == 0 && r[1] == INFINITY);
    assert_true(r[2] > 0 && r[3] > r[2] && isfinite(r[4]) && r[4] > 10);
    profile = prepare(model->id, CORE_EVALUATOR_F64, &absorbing);
    core_sample_f64(&profile, 5, u, r);
    for (int i = 0; i < 5; i++) {
      assert_true(r[i] == 0);
    }
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(round_trip_holds),
      cmocka_unit_test(density_matches_the_sampler),
      cmocka_unit_test(ends_are_exact),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
