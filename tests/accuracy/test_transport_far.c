/* The numerical error of transport where its solutions do not reach: beyond 30 decay lengths. Each
 * evaluator and tolerance is compared with solutions that reach to 110 decay lengths, at media and
 * radii that were drawn; so are the choices by tolerance.
 */
#include <float.h>
#include <math.h>

#include "core/choose.h"
#include "core/transport/decay.h"
#include "tests/accuracy/isotropic/isotropic.h"
#include "tests/unit/unit.h"

#define SOLVER_TOLERANCE 1e-6

enum { ETAS = 4, MEDIA = 5, RADII = 40, REQUESTS = 40 };

struct truth {
  core_medium medium;
  double r[RADII]; /* exact in both precisions, rising */
  double R[RADII];
};

static int compare(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

static void draw_truth(struct truth *truth, double eta, double albedo, uint64_t *random) {
  const double scale = unit_random_log(random, 0.1, 10), kappa = transport_kappa(albedo);
  isotropic_solution *solution =
      isotropic_solve(eta, albedo, SOLVER_TOLERANCE, ISOTROPIC_REACH_FAR);
  *truth = (struct truth){.medium = {scale * (1 - albedo), scale * albedo, 0, eta}};
  for (size_t i = 0; i < RADII; i++) {
    truth->r[i] = (double)(float)(unit_random_log(random, 1, 105) / kappa / scale);
  }
  qsort(truth->r, RADII, sizeof truth->r[0], compare);
  for (size_t i = 0; i < RADII; i++) {
    truth->R[i] = isotropic_at(solution, truth->r[i] * scale).R * scale * scale;
  }
  isotropic_free(solution);
}

/* The largest deviation of R at radii[first..last], over what is allowed of it. */
static double excess(const core_profile *profile, const struct truth *truth, size_t first,
                     size_t last, double allowed) {
  const double negligible = 16 * (profile->evaluator == CORE_EVALUATOR_F64 ? 0x1p-1074 : 0x1p-149);
  double most = 0;
  for (size_t i = first; i <= last; i++) {
    const double off = fabs(unit_value_at(profile, CORE_QUANTITY_R, truth->r[i]) - truth->R[i]);
    const double bound = fmax((allowed + SOLVER_TOLERANCE) * truth->R[i], negligible);
    if (off > bound) {
      print_error(
          "albedo %.6g, eta %.4g, r %.6g (%.3g mean free paths): off by %.3g, allowed %.3g\n",
          truth->medium.sigma_s_per_mm /
              (truth->medium.sigma_a_per_mm + truth->medium.sigma_s_per_mm),
          truth->medium.eta, truth->r[i],
          truth->r[i] * (truth->medium.sigma_a_per_mm + truth->medium.sigma_s_per_mm),
          off / truth->R[i], allowed);
    }
    most = fmax(most, off / bound);
  }
  return most;
}

static core_radii_range draw_range(const struct truth *truth, size_t *first, size_t *last,
                                   uint64_t *random) {
  const size_t a = unit_random_below(random, RADII), b = unit_random_below(random, RADII);
  *first = a < b ? a : b;
  *last = a < b ? b : a;
  return (core_radii_range){truth->r[*first], truth->r[*last]};
}

static double named(const struct truth *truth, unsigned evaluator, double tolerance,
                    uint64_t *random) {
  core_parameters parameters = core_parameters_none();
  core_profile profile;
  double most = 0;
  parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
  profile = unit_profile(CORE_MODEL_TRANSPORT, evaluator, &truth->medium, &parameters);
  for (size_t i = 0; i < REQUESTS; i++) {
    size_t first, last;
    const core_radii_range radii = draw_range(truth, &first, &last, random);
    const core_stated_errors errors = core_profile_errors(&profile, CORE_QUANTITY_R, radii);
    assert_true(errors.numerical_per_mm == 0);
    most = fmax(most, excess(&profile, truth, first, last, errors.numerical));
  }
  core_profile_free(&profile);
  return most;
}

/* Of those that say that they keep the tolerance, the first. */
static double chosen(const struct truth *truth, uint64_t *random, size_t *promises) {
  core_candidate candidates[CORE_CANDIDATES_MAX];
  core_parameters parameters = core_parameters_none();
  core_profile profile;
  size_t first, last;
  const core_choose_request request = {
      .media = &truth->medium,
      .layer_count = 1,
      .eta_below = (double)NAN,
      .media_count = 1,
      .wanted = CORE_QUANTITY_R,
      .radii = draw_range(truth, &first, &last, random),
      .single = unit_random_below(random, 2) == 1,
      .tolerance = unit_random_log(random, 1e-4, 0.5),
  };
  if (core_choose(&request, candidates) == 0 || !candidates[0].meets) {
    return 0;
  }
  parameters.value[CORE_PARAMETER_TOLERANCE] = candidates[0].numerical_tolerance;
  profile = unit_profile(candidates[0].model, candidates[0].evaluator, &truth->medium, &parameters);
  const double most = excess(&profile, truth, first, last, request.tolerance);
  core_profile_free(&profile);
  *promises += 1;
  return most;
}

UNIT_TEST(the_error_that_is_stated_holds_far_away) {
  static const double tolerances[] = {1e-6, 1e-5, 1e-4, 1e-2, 0.1};
  uint64_t random = unit_seed();
  struct truth truth;
  double most = 0, most_chosen = 0;
  size_t promises = 0;
  for (size_t e = 0; e < ETAS; e++) {
    const double eta = e == 0 ? 1.5 : unit_random_log(&random, 0.7, 2.2);
    for (size_t m = 0; m < MEDIA; m++) {
      const double albedo = e == 0 && m == 0 ? 0.65
                            : m % 2 == 0     ? unit_random_between(&random, 0.01, 0.95)
                            : m == 1         ? 1 - unit_random_log(&random, 1e-7, 0.3)
                                             : unit_random_log(&random, 0.0099, 0.3);
      draw_truth(&truth, eta, albedo, &random);
      const double tolerance = tolerances[(e + m) % (sizeof tolerances / sizeof tolerances[0])];
      most = fmax(most, named(&truth, CORE_EVALUATOR_F64, tolerance, &random));
      most = fmax(most, named(&truth, CORE_EVALUATOR_LUT, tolerance, &random));
      most = fmax(most, named(&truth, CORE_EVALUATOR_F32, tolerance, &random));
      for (size_t i = 0; i < 4; i++) {
        most_chosen = fmax(most_chosen, chosen(&truth, &random, &promises));
      }
    }
  }
  printf("largest error %.3f of what was stated, %.3f of %zu tolerances\n", most, most_chosen,
         promises);
  assert_true(most <= 1 && most_chosen <= 1);
  assert_true(promises > 20);
}

/* Light sent straight back beside isotropic scattering couples psi(mu) with psi(-mu) alone. With s^2 = 1 -
 * reversed^2 the rate k then solves albedo (1 + reversed) artanh(k / s) = k s. */
UNIT_TEST(light_sent_straight_back_decays_as_its_closed_form) {
  static const double isotropic[] = {1}, reversed[] = {0, 0.02, 0.1, 0.3};
  for (size_t i = 0; i < sizeof reversed / sizeof *reversed; i++) {
    const double back = reversed[i], s = sqrt((1 - back) * (1 + back));
    for (double albedo = 0.4; albedo + back < 1; albedo += 0.1) {
      const double k = transport_decay_rate(isotropic, 1, albedo, back, 1 - albedo - back);
      const double scattered = albedo * (1 + back) * atanh(k / s) / (k * s);
      UNIT_FAIL_IF(!(fabs(scattered - 1) < 1e-8), "albedo %g, reversed %g: k %.12g, off by %g",
                   albedo, back, k, scattered - 1);
    }
  }
}
