/* The transfer function R(f), the Hankel transform of R(r): that of a beam has no step, that of
 * transport is an integral by other means. truth.c compares those of all other models with their
 * forms, and its filter with them. */
#include <math.h>

#include "core/kernels.h"
#include "tests/unit/unit.h"

static const double pi = 3.14159265358979323846;

static core_profile prepared(unsigned model, unsigned evaluator, core_medium medium) {
  const core_medium needed = unit_medium(model, &medium);
  return unit_profile(model, evaluator, &needed, NULL);
}

static double transfer(const core_profile *profile, double f) {
  return unit_value_at(profile, CORE_QUANTITY_TRANSFER, f);
}

static void assert_within(double value, double truth, double allowed, const char *what, double f) {
  UNIT_FAIL_IF(!(fabs(value - truth) <= allowed),
               "%s at %g per mm is %.12g, not %.12g: off by %.3g", what, f, value, truth,
               value - truth);
}

/* The beam has no closed form, but a transform without steps: what it lacks to the albedo grows no
 * faster than k^2. */
UNIT_TEST(the_transform_of_a_beam_has_no_step) {
  enum { MANY = 5000 };
  static double f[MANY], values[MANY];
  for (double eta = 5; eta <= 1e3; eta *= 1.7) {
    core_profile profile =
        prepared(CORE_MODEL_BEAM, CORE_EVALUATOR_F64, (core_medium){0, 1, 0, eta});
    size_t n = 0;
    for (double k = 1e-24; k < 1e-6; k *= 1.01) {
      assert_true(n < MANY);
      f[n++] = k / (2 * pi);
    }
    core_eval_f64(&profile, CORE_QUANTITY_TRANSFER, n, f, values);
    double before = profile.albedo;
    for (size_t i = 0; i < n; i++) {
      const double allowed = 0.0202 * (profile.albedo - values[i]) + 2e-9 * profile.albedo;
      assert_within(values[i], before, allowed, "R(f) of a beam", f[i]);
      before = values[i];
    }
    core_profile_free(&profile);
  }
}

/* The integral of R in rings with many points that are equidistant in ln r: R falls exponentially, so
 * that few periods matter. */
enum { STEPS = 400000 };

struct rings {
  double r[STEPS], energy[STEPS]; /* 2 pi r R times the width of the ring */
};

static void find_rings(struct rings *rings, const core_profile *profile) {
  const double from = log(1e-9), to = log(3e3), step = (to - from) / STEPS;
  for (size_t i = 0; i < STEPS; i++) {
    rings->r[i] = exp(from + ((double)i + 0.5) * step);
  }
  core_eval_f64(profile, CORE_QUANTITY_RING, STEPS, rings->r, rings->energy);
  for (size_t i = 0; i < STEPS; i++) {
    rings->energy[i] *= rings->r[i] * step;
  }
}

static double integral(const struct rings *rings, double f) {
  double sum = 0;
  for (size_t i = 0; i < STEPS; i++) {
    sum += rings->energy[i] * j0(2 * pi * f * rings->r[i]);
  }
  return sum;
}

UNIT_TEST(transport_has_the_transform_of_its_R) {
  static const core_medium media[] = {
      {0.02, 1, 0, 1.4}, {1, 1, 0, 1}, {0.1, 5, 0.8, 1.33}, {0.05, 10, 0.9, 1.5}, {10, 1, 0, 1.5}};
  static struct rings rings;
  double worst = 0;
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    core_profile profile = prepared(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, media[i]);
    find_rings(&rings, &profile);
    assert_true(transfer(&profile, 0) == profile.albedo);
    assert_true(transfer(&profile, (double)INFINITY) == 0);
    for (double f = 1e-3; f < 2; f *= 2.2) {
      const double value = transfer(&profile, f), truth = integral(&rings, f);
      worst = fmax(worst, fabs(value - truth));
      assert_within(value, truth, 1e-6, "R(f) of transport", f);
    }
    assert_within(transfer(&profile, 1e-9), profile.albedo, 1e-4, "R(f) near 0", 1e-9);
    core_profile_free(&profile);
  }
  printf("off by %.2g at most\n", worst);
}
