/* From what artists have, a diffuse albedo and a mean free path, to coefficients.
 *
 * With the mean free path 1 / sigma_t' given, every model's albedo depends on the ratio
 * rho = sigma_a / sigma_s' alone and falls as rho grows. It is inverted by bisection over the
 * logarithm of rho: slow and sure, with the same bits everywhere, down to neighbouring numbers.
 */
#include <float.h>
#include <math.h>

#include "core/core.h"

/* The ratios between which the root is looked for; beyond them nothing but 0 is left of an albedo.
 */
#define RATIO_MIN 1e-80
#define RATIO_MAX 1e30

/* sigma_a and sigma_s' with the given sum and ratio, each to its last digits. */
static core_medium medium_of_ratio(double ratio, double sigma_t_prime, double eta) {
  return (core_medium){
      .sigma_a_per_mm = sigma_t_prime * (ratio / (1 + ratio)),
      .sigma_s_per_mm = sigma_t_prime / (1 + ratio),
      .g = 0,
      .eta = eta,
  };
}

struct problem {
  const core_isa *isa;
  unsigned model;
  unsigned moments;
  double sigma_t_prime;
  double eta;
};

static double albedo_of_ratio(const struct problem *problem, double ratio) {
  const core_medium medium = medium_of_ratio(ratio, problem->sigma_t_prime, problem->eta);
  core_profile profile;
  const core_fault fault = core_profile_prepare(
      &profile, problem->isa, problem->model, problem->moments, CORE_EVALUATOR_F64, &medium, NULL);
  if (fault.field != NULL) {
    return (double)NAN;
  }
  core_profile_free(&profile);
  return profile.albedo;
}

/* least <= albedo(high) < wanted <= albedo(low) */
static double solve(const struct problem *problem, double wanted) {
  double low = RATIO_MIN;
  double high = RATIO_MAX;
  while (high > low * (1 + DBL_EPSILON)) {
    const double middle = sqrt(low) * sqrt(high);
    if (!(middle > low && middle < high)) {
      break;
    }
    if (albedo_of_ratio(problem, middle) >= wanted) {
      low = middle;
    } else {
      high = middle;
    }
  }
  const double low_error = albedo_of_ratio(problem, low) - wanted;
  const double high_error = wanted - albedo_of_ratio(problem, high);
  return low_error <= high_error ? low : high;
}

static core_fault check(const struct problem *problem, double mean_free_path_mm) {
  if (!(mean_free_path_mm >= CORE_MEAN_FREE_PATH_MIN_MM &&
        mean_free_path_mm <= CORE_MEAN_FREE_PATH_MAX_MM)) {
    return (core_fault){"mean_free_path", "1e-14 to 1e14 mm", 0};
  }
  const core_medium white = medium_of_ratio(0, problem->sigma_t_prime, problem->eta);
  return core_profile_check(problem->model, problem->moments, CORE_EVALUATOR_F64, &white, NULL,
                            NULL);
}

core_inversion core_invert_albedo(unsigned model, unsigned moments, double albedo,
                                  double mean_free_path_mm, double eta) {
  const struct problem problem = {core_isa_select("portable"), model, moments,
                                  1 / mean_free_path_mm, eta};
  core_inversion inversion = {.fault = check(&problem, mean_free_path_mm)};
  if (inversion.fault.field != NULL) {
    return inversion;
  }
  inversion.albedo_least = albedo_of_ratio(&problem, RATIO_MAX);
  inversion.albedo_most = albedo_of_ratio(&problem, 0);
  if (!(albedo >= inversion.albedo_least && albedo <= inversion.albedo_most)) {
    inversion.fault = (core_fault){"albedo", "from albedo_least to albedo_most", 0};
    return inversion;
  }
  const double ratio = albedo == inversion.albedo_most ? 0 : solve(&problem, albedo);
  inversion.medium = medium_of_ratio(ratio, problem.sigma_t_prime, eta);
  return inversion;
}
