#include "core/model_error.h"

#include <math.h>

#include "core/kernels.h"
#include "core/paths.h"

#define CORE_REAL 64
#include "core/kernel.h"

enum { BANDS = CORE_MODEL_ERROR_BANDS };

const double core_error_edges_mfp[] = {0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50};

_Static_assert(sizeof core_error_edges_mfp / sizeof core_error_edges_mfp[0] == CORE_ERROR_BANDS,
               "as core.h has it");

/* ---- errors by band of radii ----------------------------------------------------------------- */

core_model_errors core_model_errors_unknown(void) {
  core_model_errors errors = {.exact = false};
  for (size_t i = 0; i <= BANDS; i++) {
    errors.error[i] = (double)NAN;
  }
  return errors;
}

#define SLACK 1e-7 /* relative; rounding a radius to single precision changes it by less */

/* Returns the band that a radius in mean free paths is in, of this many bands. */
static size_t band_of(double mfp, size_t bands) {
  size_t band = 0;
  while (band + 1 < bands && core_error_edges_mfp[band + 1] < mfp) {
    band++;
  }
  return band;
}

/* Returns the larger number, or NAN if either is NAN. */
static double larger(double a, double b) {
  return isnan(a) || a > b ? a : b;
}

/* Returns the largest of errors by band at these radii. A radius within SLACK of an edge is in the band
 * above it if it is the least, in the band below if it is the largest; if it is both, the smaller error
 * holds, so that more radii never state less. */
static double largest(const double *errors, size_t bands, const core_medium *medium,
                      core_radii_range radii) {
  const double sigma_t_prime = core_sigma_t_prime(medium);
  const double most = radii.most_mm * sigma_t_prime * (1 - SLACK);
  size_t band = band_of(radii.least_mm * sigma_t_prime * (1 + SLACK), bands);
  double error = errors[band];
  if (band > 0 && core_error_edges_mfp[band] >= most) {
    error = fmin(error, errors[band - 1]);
  }
  while (band + 1 < bands && core_error_edges_mfp[band + 1] < most) {
    error = larger(error, errors[++band]);
  }
  return error;
}

/* Returns the largest error of R at these radii, or NAN if it is not known. */
static double error_of_R(const core_model_errors *errors, const core_medium *medium,
                         core_radii_range radii) {
  const double sigma_t_prime = core_sigma_t_prime(medium);
  const bool known = radii.least_mm * sigma_t_prime >= core_error_edges_mfp[0] * (1 - SLACK) &&
                     radii.most_mm * sigma_t_prime <= core_error_edges_mfp[BANDS] * (1 + SLACK);
  return known ? largest(errors->error, BANDS, medium, radii) : (double)NAN;
}

enum {
  LIKE_R = CORE_QUANTITY_R | (CORE_MULTIPLES & ~CORE_QUANTITY_PDF),
  AT_RADII = LIKE_R | CORE_QUANTITY_LN_R | CORE_QUANTITY_PDF,
};

double core_model_errors_of(const core_model_errors *errors, const core_medium *medium,
                            unsigned wanted, core_radii_range radii) {
  if (errors->exact) {
    return 0;
  }
  const double albedo = errors->error[BANDS];
  if (!(radii.least_mm <= radii.most_mm)) {
    wanted &= CORE_QUANTITY_ALBEDO;
  }
  const bool at_radii = (wanted & AT_RADII) != 0;
  const double R = at_radii ? error_of_R(errors, medium, radii) : 0;
  double error = at_radii || (wanted & CORE_QUANTITY_ALBEDO) != 0 ? 0 : (double)NAN;
  if ((wanted & LIKE_R) != 0) {
    error = larger(error, R);
  }
  if ((wanted & CORE_QUANTITY_ALBEDO) != 0) {
    error = larger(error, albedo);
  }
  /* if R is off by the share R, ln R is off by at most R / (1 - R) */
  if ((wanted & CORE_QUANTITY_LN_R) != 0) {
    error = larger(error, R < 1 ? R / (1 - R) : (double)NAN);
  }
  /* the pdf is R over the albedo: the errors combine to (1 + R) / (1 - albedo) - 1 */
  if ((wanted & CORE_QUANTITY_PDF) != 0) {
    error = larger(error, albedo < 1 ? (R + albedo) / (1 - albedo) : (double)NAN);
  }
  return error;
}

double core_ratio_of(const core_medium *medium) {
  return medium->sigma_a_per_mm / (medium->sigma_s_per_mm * (1 - medium->g));
}

bool core_is_exact(unsigned model, bool gamma) {
  return core_solves(model) && !gamma;
}

/* ---- numerical errors ------------------------------------------------------------------------ */

double core_error_beyond(core_reach reach, double most_mm) {
  if (!(most_mm > reach.most_mm)) {
    return 0;
  }
  const double logarithm = real_log(fmin(most_mm / reach.most_mm, 1e300), 0);
  const double exponent = reach.growth * logarithm * logarithm;
  return exponent < 7 ? real_exp_signed(exponent) - 1 : (double)INFINITY;
}

double core_banded_error(const double errors[CORE_ERROR_BANDS + 1], double all,
                         const core_medium *medium, unsigned wanted, core_radii_range radii) {
  enum {
    ANY = CORE_QUANTITY_CDF | CORE_QUANTITY_SLOPE | CORE_QUANTITY_PDF | CORE_QUANTITY_TRANSFER
  };
  const bool at_radii = radii.least_mm <= radii.most_mm;
  if (at_radii && (wanted & ANY) != 0) {
    return all;
  }
  if (!at_radii || (wanted & (LIKE_R | CORE_QUANTITY_LN_R)) == 0) {
    return errors[CORE_ERROR_BANDS];
  }
  const double albedo = (wanted & CORE_QUANTITY_ALBEDO) != 0 ? errors[CORE_ERROR_BANDS] : 0;
  return real_max(albedo, largest(errors, CORE_ERROR_BANDS, medium, radii));
}

/* The quantities whose numerical error grows beyond the reach. The cdf and albedo are not among
 * them, because almost no energy is left there. */
enum { FOLLOWS_R = AT_RADII | CORE_QUANTITY_SLOPE };

/* The derivatives' reach, as a share of the profile's. */
#define NEAR_REACH 0.9

/* Returns the error of the derivatives of ln R, absolute. Beyond the reach it is not known. */
static double derivative_error(const core_profile *profile, core_radii_range radii) {
  const bool known =
      radii.least_mm > radii.most_mm || radii.most_mm <= NEAR_REACH * profile->reach.most_mm;
  return known ? profile->derivative_error + core_banded_error(profile->derivative_errors, 0,
                                                               &profile->medium, CORE_QUANTITY_R,
                                                               radii)
               : (double)INFINITY;
}

/* Returns whether intermediate results of values close to the source may have underflowed. */
static bool is_too_near(const core_profile *profile, unsigned wanted, double r_mm) {
  const double least_mm = CORE_RADIUS_SMALL_MFP / core_sigma_t_prime(&profile->medium);
  return r_mm > 0 &&
         (((wanted & (FOLLOWS_R | CORE_QUANTITY_CDF)) != 0 && r_mm < CORE_RADIUS_SMALL_MM) ||
          ((wanted & CORE_QUANTITY_SLOPE) != 0 && r_mm < least_mm));
}

core_radii_range core_errors_alike(const core_profile *profile, double r_mm) {
  const double *edges = core_error_edges_mfp;
  const double mfp_mm = 1 / core_sigma_t_prime(&profile->medium);
  const size_t band = band_of(r_mm / mfp_mm * (1 + SLACK), CORE_ERROR_BANDS);
  const double most = band + 1 < CORE_ERROR_BANDS ? edges[band + 1] * (1 - 2 * SLACK) : INFINITY;
  const double least = band > 0 ? edges[band] * (1 + 2 * SLACK) : CORE_RADIUS_SMALL_MFP;
  const core_radii_range alike = {real_max(least * mfp_mm, CORE_RADIUS_SMALL_MM),
                                  real_min(most * mfp_mm, profile->reach.most_mm)};
  return r_mm >= alike.least_mm && r_mm <= alike.most_mm ? alike : (core_radii_range){1, 0};
}

/* Returns the largest errors of CORE_PATHS and CORE_MODULATED that are wanted, and of the others. */
static core_stated_errors add_light(const core_profile *profile, unsigned wanted,
                                    core_stated_errors others, core_radii_range radii) {
  const core_stated_errors derivative = {
      (wanted & CORE_PATHS) != 0 ? derivative_error(profile, radii) : 0,
      profile->derivative_error_per_mm};
  for (unsigned left = wanted & (CORE_PATHS | CORE_MODULATED); left != 0; left &= left - 1) {
    const core_stated_errors error =
        core_paths_errors(profile, left & ~(left - 1), derivative, radii);
    others.numerical = fmax(others.numerical, error.numerical);
    others.numerical_per_mm = fmax(others.numerical_per_mm, error.numerical_per_mm);
  }
  return others;
}

core_stated_errors core_profile_errors(const core_profile *profile, unsigned wanted,
                                       core_radii_range radii) {
  const unsigned by_sigma = CORE_QUANTITY_BY_SIGMA_A | CORE_QUANTITY_BY_SIGMA_S;
  const bool derivatives = (wanted & by_sigma) != 0;
  const unsigned others = wanted & ~(by_sigma | CORE_PATHS | CORE_MODULATED | CORE_QUANTITY_T |
                                     CORE_QUANTITY_MODEL_ERROR | CORE_QUANTITY_MODEL_ERRORS |
                                     CORE_QUANTITY_RADIUS | CORE_QUANTITY_BALANCE);

  double of_others = 0;
  if (others != 0) {
    const double numerical = core_banded_error(profile->numerical_errors, profile->numerical_error,
                                               &profile->medium, wanted, radii);
    of_others =
        real_max(numerical, (wanted & CORE_QUANTITY_SLOPE) != 0 ? profile->slope_error : 0) +
        core_error_beyond(profile->reach, (wanted & FOLLOWS_R) != 0 ? radii.most_mm : 0) +
        ((wanted & CORE_QUANTITY_S) != 0 ? CORE_S_ERROR : 0) +
        ((wanted & CORE_QUANTITY_TRANSFER) != 0 ? CORE_TRANSFER_ERROR : 0);
  }
  const bool has_T = (wanted & CORE_QUANTITY_T) != 0 && profile->T_errors[0] > 0 &&
                     radii.least_mm <= radii.most_mm;
  const double of_T =
      has_T ? core_banded_error(profile->T_errors, 0, &profile->medium, CORE_QUANTITY_R, radii) +
                  core_error_beyond(profile->T_reach, radii.most_mm)
            : 0;
  if (is_too_near(profile, has_T ? wanted | CORE_QUANTITY_R : wanted, radii.least_mm)) {
    return (core_stated_errors){.numerical = (double)INFINITY};
  }
  const core_stated_errors errors = {
      .numerical =
          real_max(real_max(real_max(of_others, of_T),
                            (wanted & CORE_QUANTITY_BALANCE) != 0 ? profile->balance_error : 0),
                   derivatives ? derivative_error(profile, radii) : 0),
      .numerical_per_mm = real_max(
          (others & ~(unsigned)CORE_QUANTITY_ALBEDO) != 0 ? profile->numerical_error_per_mm : 0,
          derivatives ? profile->derivative_error_per_mm : 0),
  };
  return (wanted & (CORE_PATHS | CORE_MODULATED)) != 0 ? add_light(profile, wanted, errors, radii)
                                                       : errors;
}
