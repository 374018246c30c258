/* Searches for the ratio rho = sigma_a / sigma_s' of a medium. ln(albedo / (most - albedo)) is
 * nearly linear in ln(rho): its slope is -1/2 where little is absorbed and -1 where much is. So a
 * secant through the last two probes converges in a few steps. A bracket encloses the root, and the
 * search halves it in ln(rho) when the secant leaves it, until its ends are neighbouring numbers.
 */
#include "core/inverter.h"

#include <assert.h>
#include <float.h>
#include <math.h>

#include "core/kernels.h"

#define CORE_REAL 64
#include "core/kernel.h"

/* The range of ratios that the search begins with. It is wider than any model's albedo can resolve.
 */
#define RATIO_MIN 1e-80
#define RATIO_MAX 1e30

/* The relative difference up to which albedos and ratios count as equal: models round by as
 * much. */
#define ALIKE (32 * DBL_EPSILON)

enum {
  /* number of secant steps after which the search only halves, because albedos may be noise */
  SECANTS_MAX = 24,
  STEPS_MAX = 400, /* halving the range in ln(rho) takes fewer steps */
};

/* Returns sigma_a / sigma_t' for the ratio sigma_a / sigma_s'. */
static double absorbed_share(double ratio) {
  return ratio < (double)INFINITY ? ratio / (1 + ratio) : 1;
}

/* Returns the medium with this ratio sigma_a / sigma_s' and this sum sigma_t'. */
static core_medium medium_of_ratio(const core_inverter *inverter, double ratio,
                                   double sigma_t_prime) {
  return (core_medium){
      .sigma_a_per_mm = sigma_t_prime * absorbed_share(ratio),
      .sigma_s_per_mm = sigma_t_prime / (1 + ratio) / (1 - inverter->g),
      .g = inverter->g,
      .eta = inverter->eta,
  };
}

static void probe(core_inverter *inverter, double ratio) {
  inverter->now.ratio = ratio;
  inverter->medium = medium_of_ratio(inverter, ratio, inverter->sigma_t_prime_per_mm);
}

/* Returns the fault of a medium. Models that are fits have a fault: their albedo depends on the
 * range of the fit and is not monotone. */
static core_fault check_medium(const core_inverter *inverter, const core_medium *medium) {
  core_radii_range radii = {0, (double)INFINITY};
  core_fault fault = core_profile_check(inverter->model, inverter->moments, CORE_EVALUATOR_F64,
                                        medium, NULL, &radii);
  if (fault.field == NULL && !(radii.least_mm <= 0 && radii.most_mm >= (double)INFINITY)) {
    fault = (core_fault){"model", "a model that covers all radii", 0};
  }
  return fault;
}

/* ---- the reach ------------------------------------------------------------------------------- */

core_fault core_inverter_start(core_inverter *inverter, unsigned model, unsigned moments,
                               enum core_light light, bool specular, double g, double eta,
                               double sigma_t_prime_per_mm) {
  *inverter = (core_inverter){
      .model = model,
      .moments = moments,
      .g = g,
      .eta = eta,
      .light = light,
      /* The albedo does not depend on sigma_t'. This keeps sigma_s in range for g close to 1. */
      .sigma_t_prime_per_mm = real_min(sigma_t_prime_per_mm, 0.5 * CORE_SIGMA_MAX_PER_MM * (1 - g)),
      .phase = CORE_INVERTER_MOST,
  };
  if (!(g > -1 && g < 1)) { /* without this check sigma_s = sigma_s' / (1 - g) would be undefined */
    const core_medium wrong = {0, 1, g, eta};
    return check_medium(inverter, &wrong);
  }
  inverter->ratio_most =
      core_solves(model) ? real_min(core_transport_ratio_most(g, eta), RATIO_MAX) : RATIO_MAX;
  probe(inverter, 0);
  core_fault fault = check_medium(inverter, &inverter->medium);
  if (fault.field != NULL) {
    probe(inverter, RATIO_MIN);
    inverter->ratio_least = RATIO_MIN;
    const core_fault absorbing = check_medium(inverter, &inverter->medium);
    fault = absorbing.field == NULL ? absorbing : fault;
  }
  fault = fault.field == NULL ? core_light_check(model, light) : fault;
  inverter->specular = specular && fault.field == NULL ? core_specular(light, eta) : 0;
  return fault;
}

double core_inverter_seen(const core_inverter *inverter, double albedo) {
  return inverter->specular + (1 - inverter->specular) * albedo;
}

core_fault core_inverter_check(const core_inverter *inverter) {
  return inverter->albedo_least < inverter->albedo_most
             ? (core_fault){0}
             : (core_fault){"model", "a model whose albedo depends on the medium", 0};
}

/* ---- the search ------------------------------------------------------------------------------ */

core_fault core_inversion_check(double albedo, double length_mm) {
  if (!(albedo >= 0 && albedo <= 1)) {
    return (core_fault){"albedo", "0 to 1", 0};
  }
  if (!(length_mm >= CORE_MEAN_FREE_PATH_MIN_MM && length_mm <= CORE_MEAN_FREE_PATH_MAX_MM)) {
    return (core_fault){"length", "1e-14 to 1e14 mm", 0};
  }
  return (core_fault){0};
}

static double kept(double x) {
  return real_min(real_max(x, 1e-300), 1e300);
}

/* Returns ln(albedo / (most - albedo)) minus the same expression of the wanted albedo; NaN if
 * undefined. */
static double distance(const core_inverter *inverter, double albedo) {
  const double most = inverter->albedo_most;
  if (!(albedo > 0 && albedo < most && inverter->wanted > 0 && inverter->wanted < most)) {
    return (double)NAN;
  }
  return real_log(kept(albedo / inverter->wanted), 0) +
         real_log(kept((most - inverter->wanted) / (most - albedo)), 0);
}

/* Returns sigma_t' of a medium with this ratio and the wanted length; infinite or NaN if no such
 * medium exists. */
static double scale(const core_inverter *inverter, double ratio) {
  const double absorbed = absorbed_share(ratio);
  switch (inverter->length) {
  case CORE_LENGTH_DIFFUSE:
    return 1 / (inverter->length_mm * sqrt(3 * absorbed / (1 + absorbed)));
  case CORE_LENGTH_CLASSICAL_DIFFUSE:
    return 1 / (inverter->length_mm * sqrt(3 * absorbed));
  case CORE_LENGTH_EXTINCTION:
    return (1 - inverter->g) / (inverter->length_mm * (1 - inverter->g * absorbed));
  default:
    return 1 / inverter->length_mm;
  }
}

/* Ends the search with this ratio. If its medium is valid, it is the last one to be probed.
 * Otherwise returns true: there is no medium. */
static bool settle(core_inverter *inverter, double ratio) {
  inverter->medium = medium_of_ratio(inverter, ratio, scale(inverter, ratio));
  inverter->found = check_medium(inverter, &inverter->medium).field == NULL;
  inverter->ratio = ratio;
  inverter->phase = CORE_INVERTER_LAST;
  return !inverter->found;
}

/* Guesses the ratio. An albedo is about 1 - 3 sqrt(ratio) where little is absorbed, and about 0.1 /
 * ratio where much is. */
static double first_guess(const core_inverter *inverter, double albedo) {
  const double odds = albedo / (inverter->albedo_most - albedo);
  return odds > 0.3 ? 0.1 / (odds * odds) : 0.3 / odds;
}

bool core_inverter_seek(core_inverter *inverter, double albedo, enum core_length length,
                        double length_mm) {
  assert(core_inversion_check(albedo, length_mm).field == NULL);
  inverter->found = false;
  inverter->wanted = (albedo - inverter->specular) / (1 - inverter->specular);
  inverter->length = length;
  inverter->length_mm = length_mm;
  if (!(fabs(inverter->wanted) > 0)) {
    return settle(inverter, (double)INFINITY); /* a medium that does not scatter */
  }
  if (!(inverter->wanted >= inverter->albedo_least && inverter->wanted <= inverter->albedo_most)) {
    return true;
  }
  if (!(inverter->wanted < inverter->albedo_most)) {
    return settle(inverter, inverter->ratio_least);
  }
  inverter->phase = CORE_INVERTER_SEARCH;
  inverter->low = RATIO_MIN;
  inverter->high = inverter->ratio_most;
  inverter->before.distance = (double)NAN;
  inverter->best.albedo = (double)INFINITY;
  inverter->steps = 0;
  const double guess = first_guess(inverter, inverter->wanted);
  probe(inverter, guess > RATIO_MIN && guess < inverter->ratio_most ? guess : 1);
  return false;
}

/* Returns the ratio at which the secant through the last two probes has the wanted albedo, or NaN.
 */
static double secant(const core_inverter *inverter) {
  const core_inversion_point *now = &inverter->now;
  const core_inversion_point *before = &inverter->before;
  double step = now->distance; /* assumes the slope -1 after the first probe */
  if (!isnan(before->distance)) {
    const double apart = real_log(kept(now->ratio / before->ratio), 0);
    step = apart * (now->distance / (before->distance - now->distance));
  }
  const double bounded = real_min(real_max(step, -40), 40);
  return isnan(step) ? step : now->ratio * real_exp_signed(bounded);
}

static double next_ratio(const core_inverter *inverter) {
  const double guess = inverter->steps < SECANTS_MAX ? secant(inverter) : (double)NAN;
  return guess > inverter->low && guess < inverter->high
             ? guess
             : sqrt(inverter->low) * sqrt(inverter->high);
}

/* Updates the bracket by the albedo of one probe. Returns true if no further probe could be
 * closer. */
static bool narrow(core_inverter *inverter, double albedo) {
  core_inversion_point *now = &inverter->now;
  now->albedo = albedo - inverter->wanted;
  now->distance = distance(inverter, albedo);
  if (fabs(now->albedo) < fabs(inverter->best.albedo)) {
    inverter->best = *now;
  }
  if (albedo >= inverter->wanted) {
    inverter->low = now->ratio;
  } else {
    inverter->high = now->ratio; /* also if the albedo is NaN */
  }
  inverter->steps++;
  return fabs(now->albedo) <= ALIKE * inverter->wanted || inverter->steps == STEPS_MAX ||
         inverter->high <= inverter->low * (1 + ALIKE);
}

static bool search(core_inverter *inverter, double albedo) {
  if (narrow(inverter, albedo)) {
    return settle(inverter, inverter->best.ratio);
  }
  const double next = next_ratio(inverter);
  if (!(next > inverter->low && next < inverter->high)) { /* low and high are adjacent numbers */
    return settle(inverter, inverter->best.ratio);
  }
  inverter->before = inverter->now;
  probe(inverter, next);
  return false;
}

/* ---- the errors of coefficients ---------------------------------------------------------------- */

/* Enters the coefficients that the medium might have instead. */
static void widen(core_inverter *inverter, double ratio) {
  const core_medium other = medium_of_ratio(inverter, ratio, scale(inverter, ratio));
  const core_medium *answer = &inverter->answer;
  inverter->sigma_a_error_per_mm =
      fmax(inverter->sigma_a_error_per_mm, fabs(other.sigma_a_per_mm - answer->sigma_a_per_mm));
  inverter->sigma_s_error_per_mm =
      fmax(inverter->sigma_s_error_per_mm, fabs(other.sigma_s_per_mm - answer->sigma_s_per_mm));
}

static bool end_errors(core_inverter *inverter) {
  inverter->medium = inverter->answer;
  return true;
}

static void probe_beside(core_inverter *inverter) {
  const bool darker = inverter->phase == CORE_INVERTER_DARKER, white = !(inverter->ratio > 0);
  const double from = white ? first_guess(inverter, inverter->aim) / 4 : inverter->ratio;
  probe(inverter, darker ? real_min(from * inverter->factor, inverter->ratio_most)
                         : real_max(from / inverter->factor, RATIO_MIN));
}

/* Aims at a brighter albedo, or a darker one before. Returns whether the search has ended. */
static bool aim_beside(core_inverter *inverter, enum core_inverter_phase phase) {
  const bool darker = phase == CORE_INVERTER_DARKER;
  inverter->phase = phase;
  inverter->aim = darker ? inverter->wanted - inverter->off : inverter->wanted + inverter->off;
  if (darker ? inverter->aim > inverter->albedo_least : inverter->aim < inverter->albedo_most) {
    const double apart = inverter->ratio > 0 ? fabs(distance(inverter, inverter->aim)) : 0;
    inverter->factor =
        apart > 0 ? real_max(real_exp_signed(real_min(2 * apart, 40)), 1 + ALIKE) : 4;
    probe_beside(inverter);
    return false;
  }
  widen(inverter, darker ? inverter->ratio_most : inverter->ratio_least);
  return darker ? aim_beside(inverter, CORE_INVERTER_BRIGHTER) : end_errors(inverter);
}

static bool take_beside(core_inverter *inverter, double albedo) {
  const bool darker = inverter->phase == CORE_INVERTER_DARKER;
  const double ratio = inverter->now.ratio;
  const bool ends = ratio >= inverter->ratio_most || ratio <= RATIO_MIN;
  if (!ends && (darker ? albedo > inverter->aim : albedo < inverter->aim)) {
    inverter->factor *= inverter->factor;
    probe_beside(inverter);
    return false;
  }
  widen(inverter, ratio);
  return darker ? aim_beside(inverter, CORE_INVERTER_BRIGHTER) : end_errors(inverter);
}

/* Takes the albedo of the medium that was found. */
static bool take_last(core_inverter *inverter, double albedo, double error) {
  const bool scatters = inverter->wanted > 0;
  inverter->albedo = albedo;
  inverter->found = scatters || !(fabs(albedo) > 0 || isnan(albedo));
  inverter->answer = inverter->medium;
  inverter->sigma_a_error_per_mm = ALIKE * inverter->medium.sigma_a_per_mm;
  inverter->sigma_s_error_per_mm = ALIKE * inverter->medium.sigma_s_per_mm;
  inverter->off = fabs(albedo - inverter->wanted) + error * albedo;
  return !inverter->finds_errors || !inverter->found || !scatters ||
         aim_beside(inverter, CORE_INVERTER_DARKER);
}

bool core_inverter_take(core_inverter *inverter, double albedo, double error) {
  switch (inverter->phase) {
  case CORE_INVERTER_MOST:
    inverter->albedo_most = albedo;
    inverter->phase = CORE_INVERTER_LEAST;
    probe(inverter, inverter->ratio_most);
    return false;
  case CORE_INVERTER_LEAST:
    inverter->albedo_least = albedo;
    return true;
  case CORE_INVERTER_SEARCH:
    return search(inverter, albedo);
  case CORE_INVERTER_LAST:
    return take_last(inverter, albedo, error);
  default:
    return take_beside(inverter, albedo);
  }
}
