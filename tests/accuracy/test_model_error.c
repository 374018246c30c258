/* The model error that is stated for the radii of a request: never smaller than what is seen at
 * media and radii that were drawn, and unknown where nothing was measured. Transport is core's own:
 * for anisotropic scattering its table of solutions, its solver, and an independent Monte Carlo
 * program's rings, where ../shared is there. */
#include <math.h>

#include "core/solver/solver.h"
#include "core/transport/transport.h"
#include "tests/unit/unit.h"

static core_profile prepared(unsigned model, core_medium medium, bool *refused) {
  core_profile profile = {0};
  *refused = core_profile_prepare(&profile, core_isa_select(NULL), model, CORE_MOMENTS_EXACT,
                                  CORE_EVALUATOR_F64, &medium, NULL)
                 .field != NULL;
  return profile;
}

static double stated(const core_profile *profile, unsigned wanted, double from_mm, double to_mm) {
  return core_profile_errors(profile, wanted, (core_radii_range){from_mm, to_mm}).model;
}

/* Of R, for radii in mm. */
static double error_of(unsigned model, core_medium medium, double from_mm, double to_mm) {
  bool refused;
  core_profile profile = prepared(model, medium, &refused);
  assert_false(refused);
  const double error = stated(&profile, CORE_QUANTITY_R, from_mm, to_mm);
  core_profile_free(&profile);
  return error;
}

/* sigma_t' = 1 per mm. */
static core_medium medium_of(double ratio, double g, double eta) {
  return (core_medium){ratio / (1 + ratio), 1 / (1 + ratio) / (1 - g), g, eta};
}

/* Models that give out more than went in: nothing is known of their error where it was not
 * measured, and an albedo of more than 1 says nothing of R. */
UNIT_TEST(an_albedo_above_1_is_no_bound_of_R) {
  const core_medium medium = {0, 1, 0, 1.5};
  bool refused;
  core_profile profile = prepared(CORE_MODEL_CLASSICAL_SINGLE, medium, &refused);
  assert_false(refused);
  assert_true((profile.notes & CORE_NOTE_ALBEDO_ABOVE_1) != 0);
  assert_true(stated(&profile, CORE_QUANTITY_R, 0.66, 0.66) >= 0.64);
  assert_true(stated(&profile, CORE_QUANTITY_ALBEDO, 0, 0) >= profile.albedo - 1);
  core_profile_free(&profile);
  assert_true(error_of(CORE_MODEL_EXITANCE, medium, 0.1, 0.1) >= 0.88);
  assert_true(isnan(error_of(CORE_MODEL_EXITANCE, (core_medium){0, 1, 0, 2.5}, 0.1, 0.1)));
  assert_true(isnan(error_of(CORE_MODEL_BURLEY_DMFP, (core_medium){0.05, 1, 0, 1.4}, 1, 100)));
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

static void check_rings(unsigned model, const char *name, const struct ring *rings, size_t count,
                        size_t *checked) {
  bool refused;
  core_profile profile = prepared(model, medium_of(0.05, 0.9, 1.4), &refused);
  for (size_t i = 0; i < count && !refused; i++) {
    const double error = stated(&profile, CORE_QUANTITY_R, rings[i].from, rings[i].to);
    if (isnan(error)) {
      continue;
    }
    *checked += 1;
    const double off = fabs(ring_mean(&profile, rings[i].from, rings[i].to) / rings[i].R - 1);
    if (!(off <= error + 4 * rings[i].sigma + 0.003)) {
      fail_msg("%s at g 0.9, ring %g to %g: off by %.3g, stated %.3g", name, rings[i].from,
               rings[i].to, off, error);
    }
  }
  core_profile_free(&profile);
}

/* MCML's rings for g = 0.9. */
UNIT_TEST(anisotropy_is_within_what_is_said) {
  enum { RINGS_MAX = 256 };
  static struct ring rings[RINGS_MAX];
  char *text = unit_read_file("../shared/mcml/r0.05_n1.4_g0.9.csv");
  size_t count = 0, checked = 0;
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
      check_rings(model->id, model->name, rings, count, &checked);
    }
  }
  printf("%zu rings at g = 0.9, %zu errors of models\n", count, checked);
  assert_true(count > 5 && checked > 50);
}

enum { RADII = 40 };

/* What is taken for the truth of a medium, with its own relative error. */
struct truth {
  core_medium medium;
  double r[RADII], R[RADII], error[RADII];
  double albedo, albedo_error;
};

/* 0.0101 to 19.9 mean free paths, in equal ratios. */
static void set_radii(struct truth *truth) {
  for (size_t i = 0; i < RADII; i++) {
    truth->r[i] = 0.0101 * pow(19.9 / 0.0101, (double)i / (RADII - 1));
  }
}

/* Each model's error at each radius and of the albedo is at most what is stated there. Returns how
 * many errors are known. */
static size_t check_stated(const struct truth *truth) {
  size_t known = 0;
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    bool refused = model->id == CORE_MODEL_TRANSPORT || model->id == CORE_MODEL_GAUSSIANS;
    core_profile profile = {0};
    double R[RADII];
    if (!refused) {
      profile = prepared(model->id, truth->medium, &refused);
    }
    if (refused) {
      continue;
    }
    core_eval_f64(&profile, CORE_QUANTITY_R, RADII, truth->r, R);
    for (size_t i = 0; i <= RADII; i++) {
      const bool albedo = i == RADII;
      const double r = truth->r[albedo ? 0 : i];
      const double error = stated(&profile, albedo ? CORE_QUANTITY_ALBEDO : CORE_QUANTITY_R, r, r);
      const double slack = albedo ? truth->albedo_error : truth->error[i];
      const double off =
          fabs((albedo ? profile.albedo / truth->albedo : R[i] / truth->R[i]) - 1) - 2 * slack;
      known += !isnan(error);
      if (!isnan(error) && off > error) {
        fail_msg("%s at ratio %g, g %g, eta %g, r %g: off by %.4g, stated %.4g", model->name,
                 truth->medium.sigma_a_per_mm / (1 - truth->medium.sigma_a_per_mm), truth->medium.g,
                 truth->medium.eta, albedo ? 0 : r, off, error);
      }
    }
    core_profile_free(&profile);
  }
  return known;
}

/* Against the table of solutions, at media between those that were measured. */
UNIT_TEST(errors_hold_at_any_g) {
  enum { MEDIA = 150 };
  core_parameters parameters = core_parameters_none();
  uint64_t random = unit_seed();
  size_t known = 0;
  parameters.value[CORE_PARAMETER_TOLERANCE] = 1e-4;
  for (size_t i = 0; i < MEDIA; i++) {
    const double ratio =
        i % 10 == 0 ? unit_random_log(&random, 1e-6, 1e-4) : unit_random_log(&random, 1e-4, 9.99);
    struct truth truth = {.medium = medium_of(ratio, unit_random_between(&random, -0.499, 0.949),
                                              unit_random_between(&random, 1, 2))};
    core_profile profile;
    set_radii(&truth);
    unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                                           CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &truth.medium,
                                           &parameters),
                      NULL, 0);
    core_eval_f64(&profile, CORE_QUANTITY_R, RADII, truth.r, truth.R);
    truth.albedo = profile.albedo;
    known += check_stated(&truth);
    core_profile_free(&profile);
  }
  printf("%zu errors at %d media\n", known, MEDIA);
  assert_true(known > (size_t)MEDIA * 10 * RADII);
}

/* Against the solver, which knows no table. */
UNIT_TEST(errors_hold_against_the_solver) {
  static const double etas[] = {1.03, 1.16, 1.37, 1.52, 1.93};
  const solver_phase phase = {0.83, 0, NULL};
  enum { ETAS = sizeof etas / sizeof etas[0] };
  solver_solution *solution;
  solver_total totals[ETAS];
  size_t known = 0;
  const double ratio = 0.034;
  unit_assert_fault(solver_solve(&solution, core_isa_select(NULL), ratio, &phase, etas, ETAS, 1e-3),
                    NULL, 0);
  unit_assert_fault(solver_totals(totals, core_isa_select(NULL), ratio, &phase, etas, ETAS), NULL,
                    0);
  for (size_t k = 0; k < ETAS; k++) {
    struct truth truth = {.medium = medium_of(ratio, phase.g, etas[k])};
    set_radii(&truth);
    for (size_t i = 0; i < RADII; i++) {
      const transport_number R = solver_at(solution, k, truth.r[i]);
      truth.R[i] = R.value;
      truth.error[i] = R.error / R.value;
    }
    truth.albedo = totals[k].normal.value;
    truth.albedo_error = totals[k].normal.error / totals[k].normal.value;
    known += check_stated(&truth);
  }
  solver_free(solution);
  printf("%zu errors against the solver\n", known);
  assert_true(known > (size_t)ETAS * 10 * RADII);
}

/* ---- where it is stated ---------------------------------------------------------------------- */

static double better(double ratio, double g, double eta, double from, double to) {
  return error_of(CORE_MODEL_BETTER, medium_of(ratio, g, eta), from, to);
}

UNIT_TEST(it_is_stated_where_it_was_measured) {
  assert_true(better(0, 0, 1, 0.01, 20) > 0);
  assert_true(better(1e-3, 0, 1.4, 0.3, 0.3) > 0);
  assert_true(better(10, 0, 2, 0.01, 20) > 0);
  assert_true(isnan(better(10.1, 0, 1.4, 1, 2)));
  assert_true(isnan(better(0.1, 0, 0.99, 1, 2)));
  assert_true(isnan(better(0.1, 0, 2.01, 1, 2)));
  assert_true(isnan(better(0.1, 0, 1.4, 0.0099, 2)));
  assert_true(isnan(better(0.1, 0, 1.4, 1, 20.1)));
  assert_true(isnan(better(0.1, 0, 1.4, 0, (double)INFINITY)));
  assert_true(better(1e-3, 0.9, 1.4, 0.01, 20) > 0);
  assert_true(better(10, -0.5, 1, 0.1, 2) > 0);
  assert_true(better(1e-3, 0.95, 2, 0.1, 2) > 0);
  assert_true(isnan(better(1e-3, 0.9, 1.4, 0.0099, 2)));
  assert_true(isnan(better(0.1, 0.99, 1.4, 1, 2)));
  assert_true(isnan(better(0.1, -0.51, 1.4, 1, 2)));
  assert_true(isnan(better(10.1, 0.9, 1.4, 1, 2)));
  assert_true(isnan(better(0.1, 0.9, 0.99, 1, 2)));
  assert_true(error_of(CORE_MODEL_SINGLE, medium_of(0.1, 0.5, 1.4), 1, 2) > 0);
  assert_true(isnan(error_of(CORE_MODEL_SKIN_RED, medium_of(0.1, 0, 1.4), 1, 2)));
  assert_true(error_of(CORE_MODEL_TRANSPORT, medium_of(0.1, 0, 1.4), 0, (double)INFINITY) == 0);
  assert_true(error_of(CORE_MODEL_TRANSPORT, medium_of(0.1, 0.9, 1.4), 1, 2) == 0);
  assert_true(error_of(CORE_MODEL_TRANSPORT, medium_of(0.1, 0.97, 1.4), 1, 2) == 0);
  assert_true(better(0.1, 0.97, 1.4, 1, 2) > 0);
}

/* The error of the cdf and of dR/dr was not measured. */
UNIT_TEST(it_speaks_of_what_was_measured) {
  bool refused;
  core_profile profile = prepared(CORE_MODEL_BETTER, medium_of(0.1, 0, 1.4), &refused);
  const double R = stated(&profile, CORE_QUANTITY_R, 1, 2);
  const double albedo = stated(&profile, CORE_QUANTITY_ALBEDO, 0, 0);
  assert_true(stated(&profile, CORE_QUANTITY_RING | CORE_QUANTITY_S, 1, 2) == R);
  assert_true(stated(&profile, CORE_QUANTITY_R | CORE_QUANTITY_CDF, 1, 2) == R);
  assert_true(stated(&profile, CORE_QUANTITY_R | CORE_QUANTITY_ALBEDO, 1, 2) == fmax(R, albedo));
  assert_true(stated(&profile, CORE_QUANTITY_LN_R, 1, 2) > R);
  assert_true(isnan(stated(&profile, CORE_QUANTITY_CDF, 1, 2)));
  assert_true(isnan(stated(&profile, CORE_QUANTITY_SLOPE, 1, 2)));
  core_profile_free(&profile);
}

/* Other moments, and another surface albedo than Burley's default, were not measured. */
UNIT_TEST(it_is_unknown_for_other_settings) {
  const core_medium medium = medium_of(0.1, 0, 1.4);
  core_parameters parameters = core_parameters_none();
  core_profile profile;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_BETTER,
                                         CORE_MOMENTS_FIT, CORE_EVALUATOR_F64, &medium, NULL),
                    NULL, 0);
  assert_true(isnan(stated(&profile, CORE_QUANTITY_R, 1, 2)));
  core_profile_free(&profile);
  parameters.value[CORE_PARAMETER_SURFACE_ALBEDO] = 0.3;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_BURLEY,
                                         CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &medium,
                                         &parameters),
                    NULL, 0);
  assert_true(isnan(stated(&profile, CORE_QUANTITY_R, 1, 2)));
  core_profile_free(&profile);
}

/* Between the media that were measured the larger error of the neighbours holds. */
UNIT_TEST(between_measured_media_the_larger_error_is_stated) {
  const double low = error_of(CORE_MODEL_CLASSICAL, medium_of(0.5, 0, 1.3), 0.1, 20);
  const double high = error_of(CORE_MODEL_CLASSICAL, medium_of(0.63, 0, 1.3), 0.1, 20);
  const double between = error_of(CORE_MODEL_CLASSICAL, medium_of(0.55, 0, 1.3), 0.1, 20);
  assert_true(between == fmax(low, high));
}

/* ---- phase functions of which gamma is known ------------------------------------------------- */

static core_profile prepared_with_gamma(core_medium medium, double gamma) {
  core_profile profile;
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_GAMMA] = gamma;
  unit_assert_fault(core_profile_prepare(&profile, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                                         CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &medium,
                                         &parameters),
                    NULL, 0);
  return profile;
}

static double R_at(const core_profile *profile, double r_mm) {
  double R;
  core_eval_f64(profile, CORE_QUANTITY_R, 1, &r_mm, &R);
  return R;
}

/* A phase function that was not measured, half 3 cos^2 and Henyey-Greenstein in part, in media
 * between the measured ones: R is within the stated error of the solver's, which has all
 * moments. */
UNIT_TEST(gamma_is_within_what_is_said) {
  enum { MOMENTS = 300 };
  static const double etas[] = {0.9, 1.33, 1.5};
  static const double ratio = 0.03, share = 0.93, g = 0.85;
  static const double radii[] = {0.013, 0.03, 0.07, 0.15, 0.3, 0.7, 1.5, 3, 7, 15};
  double moment[MOMENTS], power = share;
  for (size_t l = 0; l < MOMENTS; l++, power *= g) {
    moment[l] = power + (l == 0 ? 1 - share : l == 2 ? 0.4 * (1 - share) : 0);
  }
  const solver_phase phase = {0, MOMENTS, moment};
  const double gamma = (1 - moment[2]) / (1 - moment[1]);
  solver_solution *truth;
  unit_assert_fault(solver_solve(&truth, core_isa_select(NULL), ratio, &phase, etas, 3, 1e-3), NULL,
                    0);
  for (size_t eta = 0; eta < 3; eta++) {
    core_profile profile = prepared_with_gamma(medium_of(ratio, moment[1], etas[eta]), gamma);
    assert_true((profile.notes & CORE_NOTE_GAMMA) != 0);
    assert_true((profile.notes & CORE_NOTE_SIMILARITY) == 0);
    for (size_t i = 0; i < sizeof radii / sizeof radii[0]; i++) {
      const double off = fabs(R_at(&profile, radii[i]) / solver_at(truth, eta, radii[i]).value - 1);
      const double said = stated(&profile, CORE_QUANTITY_R, radii[i], radii[i]);
      printf("gamma %.3f, eta %g, r %g: off by %.3f, stated %.3f\n", gamma, etas[eta], radii[i],
             off, said);
      assert_true(off <= said);
      assert_true(radii[i] < 0.5 || said < 0.3);
    }
    core_profile_free(&profile);
  }
  solver_free(truth);
}

/* Without another phase function gamma changes nothing, and beyond what was measured its error is
 * not known. */
UNIT_TEST(gamma_of_henyey_greenstein_changes_nothing) {
  bool refused;
  core_profile usual = prepared(CORE_MODEL_TRANSPORT, medium_of(0.1, 0.5, 1.4), &refused);
  core_profile same = prepared_with_gamma(medium_of(0.1, 0.5, 1.4), 1.5);
  assert_true(R_at(&same, 1) == R_at(&usual, 1) && same.albedo == usual.albedo);
  assert_true(stated(&usual, CORE_QUANTITY_R, 1, 1) == 0);
  assert_true(stated(&same, CORE_QUANTITY_R, 1, 1) > 0);
  assert_true(isnan(stated(&same, CORE_QUANTITY_R, 0.005, 1)));
  core_profile_free(&usual);
  core_profile_free(&same);
  static const struct {
    double ratio, eta, gamma;
  } beyond[] = {{0.1, 1.4, 0.7}, {2, 1.4, 1.5}, {1e-5, 1.4, 1.5}, {0.1, 2.1, 1.5}};
  for (size_t i = 0; i < sizeof beyond / sizeof beyond[0]; i++) {
    core_profile profile =
        prepared_with_gamma(medium_of(beyond[i].ratio, 0.5, beyond[i].eta), beyond[i].gamma);
    assert_true(isnan(stated(&profile, CORE_QUANTITY_R, 1, 1)));
    core_profile_free(&profile);
  }
}
