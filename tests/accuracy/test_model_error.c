/* The model error that profiles state, against exact solutions and an independent Monte Carlo
 * program's rings, where ../shared is there.
 */
#include <math.h>

#include "tests/unit/unit.h"

static core_profile prepared(unsigned model, core_medium medium, bool *refused) {
  core_profile profile = {0};
  *refused = core_profile_prepare(&profile, core_isa_select(NULL), model, CORE_MOMENTS_EXACT,
                                  CORE_EVALUATOR_F64, &medium, NULL)
                 .field != NULL;
  return profile;
}

static double error_of(unsigned model, core_medium medium) {
  bool refused;
  core_profile profile = prepared(model, medium, &refused);
  assert_false(refused);
  core_profile_free(&profile);
  return profile.model_error;
}

/* sigma_t' = 1 per mm. */
static core_medium medium_of(double ratio, double g, double eta) {
  return (core_medium){ratio / (1 + ratio), 1 / (1 + ratio) / (1 - g), g, eta};
}

/* ---- exact solutions ------------------------------------------------------------------------- */

enum { RADII_MAX = 256 };

/* The exact solutions of one medium: R at radii. */
struct solution {
  double a, eta;
  size_t count;
  double r[RADII_MAX];
  double R[RADII_MAX];
};

/* No model that states an error is further off at any radius. Returns how many values it checked. */
static size_t check_solution(const struct solution *exact) {
  size_t checked = 0;
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    bool refused = model->id == CORE_MODEL_GAUSSIANS;
    core_profile profile =
        refused
            ? (core_profile){0}
            : prepared(model->id, (core_medium){1 - exact->a, exact->a, 0, exact->eta}, &refused);
    if (!refused) {
      double R[RADII_MAX];
      core_eval_f64(&profile, CORE_QUANTITY_R, exact->count, exact->r, R);
      const bool stated = !isnan(profile.model_error);
      for (size_t i = 0; i < exact->count && stated; i++) {
        const double off = fabs(R[i] / exact->R[i] - 1);
        if (!(off <= profile.model_error + profile.numerical_error)) {
          fail_msg("%s at eta %g, r %g is off by %.4g, stated %.4g", model->name, exact->eta,
                   exact->r[i], off, profile.model_error);
        }
      }
      assert_true(stated || (profile.notes & CORE_NOTE_MEDIUM_UNUSED) != 0);
      checked += stated ? exact->count : 0;
    }
    core_profile_free(&profile);
  }
  return checked;
}

UNIT_TEST(no_model_is_further_from_transport_than_it_says) {
  static struct solution exact;
  char *text = unit_read_file("../shared/vectors/transport.csv");
  size_t checked = 0;
  if (text == NULL) {
    printf("skipped: ../shared/vectors/transport.csv is not there\n");
    return;
  }
  exact.count = 0;
  for (char *line = strtok(text, "\n"); line != NULL; line = strtok(NULL, "\n")) {
    double ratio, eta, a, total, r, R;
    if (sscanf(line, "%lf,%lf,%lf,%lf,%lf,%lf", &ratio, &eta, &a, &total, &r, &R) != 6 || r < 0.1 ||
        r > 20) {
      continue;
    }
    if (exact.count > 0 && (exact.a != a || exact.eta != eta)) {
      checked += check_solution(&exact);
      exact.count = 0;
    }
    exact.a = a;
    exact.eta = eta;
    assert_true(exact.count < RADII_MAX);
    exact.r[exact.count] = r;
    exact.R[exact.count++] = R;
  }
  checked += check_solution(&exact);
  free(text);
  printf("%zu values of models against exact solutions\n", checked);
  assert_true(checked > 10000);
}

/* ---- anisotropic scattering ------------------------------------------------------------------ */

/* The mean of R over a ring, from the energy within its edges. */
static double ring_mean(const core_profile *profile, double from, double to) {
  const double edges[2] = {from, to};
  double cdf[2];
  core_eval_f64(profile, CORE_QUANTITY_CDF, 2, edges, cdf);
  return profile->albedo * (cdf[1] - cdf[0]) / (3.14159265358979323846 * (to * to - from * from));
}

/* A ring of MCML's, in mean free paths 1 / sigma_t', with the mean of R over it. */
struct ring {
  double from, to, R, sigma;
};

static void check_rings(unsigned model, const char *name, const struct ring *rings, size_t count) {
  bool refused;
  core_profile profile = prepared(model, medium_of(0.05, 0.9, 1.4), &refused);
  for (size_t i = 0; i < count && !refused && !isnan(profile.model_error); i++) {
    const double off = fabs(ring_mean(&profile, rings[i].from, rings[i].to) / rings[i].R - 1);
    if (!(off <= profile.model_error + 4 * rings[i].sigma + 0.003)) {
      fail_msg("%s at g 0.9, ring %g to %g: off by %.3g, stated %.3g", name, rings[i].from,
               rings[i].to, off, profile.model_error);
    }
  }
  core_profile_free(&profile);
}

/* MCML's rings for g = 0.9. */
UNIT_TEST(anisotropy_is_within_what_is_said) {
  enum { RINGS_MAX = 256 };
  static struct ring rings[RINGS_MAX];
  char *text = unit_read_file("../shared/mcml/r0.05_n1.4_g0.9.csv");
  size_t count = 0;
  if (text == NULL) {
    printf("skipped: ../shared/mcml is not there\n");
    return;
  }
  for (char *line = strtok(text, "\n"); line != NULL; line = strtok(NULL, "\n")) {
    struct ring *ring = &rings[count];
    assert_true(count + 1 < RINGS_MAX);
    count += sscanf(line, "%lf,%lf,%lf,%lf", &ring->from, &ring->to, &ring->R, &ring->sigma) == 4 &&
             ring->from >= 0.1 && ring->to <= 20 && ring->sigma < 0.05;
  }
  free(text);
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    if (model->id != CORE_MODEL_GAUSSIANS) {
      check_rings(model->id, model->name, rings, count);
    }
  }
  printf("%zu rings at g = 0.9\n", count);
  assert_true(count > 5);
}

/* ---- where it is stated ---------------------------------------------------------------------- */

UNIT_TEST(it_is_stated_where_it_was_measured) {
  assert_true(error_of(CORE_MODEL_BETTER, medium_of(1e-3, 0, 1.4)) > 0);
  assert_true(error_of(CORE_MODEL_BETTER, medium_of(1e-4, 0, 1)) > 0);
  assert_true(error_of(CORE_MODEL_BETTER, medium_of(10, 0, 2)) > 0);
  assert_true(isnan(error_of(CORE_MODEL_BETTER, medium_of(0.99e-4, 0, 1.4))));
  assert_true(isnan(error_of(CORE_MODEL_BETTER, medium_of(10.1, 0, 1.4))));
  assert_true(isnan(error_of(CORE_MODEL_BETTER, medium_of(0.1, 0, 0.99))));
  assert_true(isnan(error_of(CORE_MODEL_BETTER, medium_of(0.1, 0, 2.01))));
  assert_true(isnan(error_of(CORE_MODEL_BETTER, medium_of(0.1, 0.99, 1.4))));
  assert_true(isnan(error_of(CORE_MODEL_BETTER, medium_of(0.1, -0.6, 1.4))));
  assert_true(isnan(error_of(CORE_MODEL_SINGLE, medium_of(0.1, 0.5, 1.4))));
  assert_true(isnan(error_of(CORE_MODEL_SKIN_RED, medium_of(0.1, 0, 1.4))));
}

/* Between the media that were measured the larger error of the neighbours holds. */
UNIT_TEST(between_measured_media_the_larger_error_is_stated) {
  const double low = error_of(CORE_MODEL_CLASSICAL, medium_of(0.5, 0, 1.3));
  const double high = error_of(CORE_MODEL_CLASSICAL, medium_of(1, 0, 1.3));
  const double between = error_of(CORE_MODEL_CLASSICAL, medium_of(0.7, 0, 1.3));
  assert_true(between == fmax(low, high));
}

/* Anisotropy is never free, and the more the dearer between neighbours that were measured. */
UNIT_TEST(anisotropy_makes_the_error_larger) {
  for (double g = -0.5; g < 0.98; g += 0.037) {
    const double isotropic = error_of(CORE_MODEL_BETTER, medium_of(0.01, 0, 1.4));
    const double error = error_of(CORE_MODEL_BETTER, medium_of(0.01, g, 1.4));
    assert_true(error > isotropic * 1.05);
  }
}
