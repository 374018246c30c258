#include "core/ruler.h"

#include <assert.h>
#include <float.h>
#include <math.h>

#include "core/kernels.h"

#define CORE_REAL 64
#include "core/kernel.h"

bool core_ruler_is_needed(unsigned model, const core_parameters *parameters,
                          const core_medium *medium, bool solves) {
  const double *value = parameters->value;
  const bool plain =
      isnan(value[CORE_PARAMETER_GAMMA]) && isnan(value[CORE_PARAMETER_SURFACE_ALBEDO]);
  return !core_solves(model) && plain &&
         core_profile_check(core_ruler_of(model, parameters), CORE_MOMENTS_EXACT,
                            CORE_EVALUATOR_F64, medium, NULL, NULL)
                 .field == NULL &&
         (solves || (!(medium->thickness_mm > 0) && core_transport_is_stored(medium)));
}

enum {
  COMPARED = CORE_QUANTITY_R | CORE_QUANTITY_CDF | CORE_QUANTITY_SLOPE | CORE_QUANTITY_LN_R |
             (CORE_MULTIPLES & ~CORE_QUANTITY_S) | CORE_QUANTITY_TRANSFER,
};

/* Returns the larger number, the other one if one is NAN. */
static inline double larger_known(double a, double b) {
  return b > a || isnan(a) ? b : a;
}

/* Returns the relative error of a value. least: absolute differences below this count as
 * underflow. */
static inline double off_by(enum core_quantity quantity, double value, double truth, double albedo,
                            double least) {
  const double apart = real_max(fabs(value - truth) - least, 0); /* 0 for the same infinity */
  const double unit = quantity == CORE_QUANTITY_LN_R || quantity == CORE_QUANTITY_CDF ? 1
                      : quantity == CORE_QUANTITY_TRANSFER                            ? albedo
                                                                                      : fabs(truth);
  return isnan(value) ? (double)INFINITY : apart > 0 ? apart / unit : 0;
}

static bool is_exact(const core_profile *profile) {
  return core_is_exact(profile->model, (profile->notes & CORE_NOTE_GAMMA) != 0);
}

/* Returns the error as far as it is known without a ruler: NAN if nothing is compared, INFINITY if
 * it is not known. */
static double stated_error(const core_profile *profile, unsigned wanted, core_radii_range radii) {
  const unsigned at_radii = radii.least_mm <= radii.most_mm ? COMPARED | CORE_QUANTITY_S : 0;
  return is_exact(profile)                                   ? 0
         : (wanted & (at_radii | CORE_QUANTITY_ALBEDO)) != 0 ? (double)INFINITY
                                                             : (double)NAN;
}

void core_model_errors_at(const core_profile *profile, const core_profile *transport,
                          unsigned wanted, size_t n, const double *r, double *error) {
  assert(n <= CORE_RULER_RADII);
  if (transport == NULL) {
    for (size_t i = 0; i < n; i++) {
      error[i] = stated_error(profile, wanted, (core_radii_range){r[i], r[i]});
    }
    return;
  }
  double value[CORE_RULER_RADII], truth[CORE_RULER_RADII];
  const double least =
      16 * (profile->evaluator == CORE_EVALUATOR_F64 ? DBL_TRUE_MIN : (double)FLT_TRUE_MIN);
  wanted |= (wanted & CORE_QUANTITY_S) != 0 ? (unsigned)CORE_QUANTITY_R : 0;
  for (size_t i = 0; i < n; i++) {
    error[i] = (double)NAN;
  }
  for (unsigned left = wanted & COMPARED; left != 0; left &= left - 1) {
    const enum core_quantity quantity = left & ~(left - 1);
    core_eval_any(profile, quantity, n, r, value);
    core_eval_f64(transport, quantity, n, r, truth);
    for (size_t i = 0; i < n; i++) {
      const double off = off_by(quantity, value[i], truth[i], transport->albedo, least);
      error[i] = r[i] > 0 || !isinf(truth[i]) ? larger_known(error[i], off) : error[i];
    }
  }
  core_stated_errors of_truth = {0};
  core_radii_range alike = {1, 0}; /* the radii at which these errors hold */
  for (size_t i = 0; i < n; i++) {
    if (!(r[i] >= alike.least_mm && r[i] <= alike.most_mm)) {
      of_truth = core_profile_errors(transport, wanted & COMPARED, (core_radii_range){r[i], r[i]});
      alike = core_errors_alike(transport, r[i]);
    }
    const double numerical = of_truth.numerical + of_truth.numerical_per_mm * r[i];
    error[i] += (1 + error[i]) * numerical;
  }
}

/* Returns the relative error of an albedo; `numerical` is that of the true one. */
static double off_albedo(double albedo, double truth, double numerical) {
  const double error = off_by(CORE_QUANTITY_ALBEDO, albedo, truth, 0, 16 * DBL_TRUE_MIN);
  return error + (1 + error) * numerical;
}

static double error_of_albedo(const core_profile *profile, const core_profile *transport) {
  return off_albedo(profile->albedo, transport->albedo,
                    transport->numerical_errors[CORE_ERROR_BANDS]);
}

/* The distance in ln r of radii that are compared. Between them the error is taken to be smooth. It
 * grows if CORE_RULER_RADII are not enough. */
#define RULER_STEP 0.125

/* Returns the radii above 0 and below infinity between which all others of a request lie. single: they
 * are of single precision. */
static core_radii_range ends_of(const core_requested_radii *requested, bool single) {
  const core_grid *grid = &requested->grid;
  core_radii_range ends = {grid->start_mm, grid->stop_mm};
  if (requested->listed == NULL) {
    if (!(grid->start_mm > 0)) {
      core_grid_radii(grid, 1, 1, false, &ends.least_mm);
    }
    return ends;
  }
  ends = (core_radii_range){(double)INFINITY, 0};
  for (uint64_t i = 0; i < grid->count; i++) {
    const double r = single ? (double)((const float *)requested->listed)[i]
                            : ((const double *)requested->listed)[i];
    ends.least_mm = r > 0 ? real_min(ends.least_mm, r) : ends.least_mm;
    ends.most_mm = r < (double)INFINITY ? real_max(ends.most_mm, r) : ends.most_mm;
  }
  return ends;
}

/* Sets r[] to the radii at which models are compared. *between: whether the request has radii
 * between them. Returns their number. */
static size_t choose_radii(const core_requested_radii *requested, bool single, double *r,
                           bool *between) {
  float near[CORE_RULER_RADII];
  core_grid grid = requested->grid;
  *between = grid.count > CORE_RULER_RADII;
  if (*between) {
    core_radii_range ends = ends_of(requested, single);
    ends.least_mm = fmax(ends.least_mm, CORE_GRID_LOG_MIN_MM);
    /* the request has one positive, finite radius, or none */
    if (!(ends.least_mm < ends.most_mm)) {
      *r = ends.most_mm;
      *between = false;
      return 1;
    }
    const double steps = ceil(real_log(ends.most_mm / ends.least_mm, 0) / RULER_STEP);
    grid = (core_grid){CORE_SPACING_LOGARITHMIC,
                       (uint64_t)fmin(fmax(steps, 2), CORE_RULER_RADII - 1) + 1, ends.least_mm,
                       ends.most_mm};
  }
  const size_t n = (size_t)grid.count;
  size_t kept = 0;
  if (!*between && requested->listed != NULL) {
    for (size_t i = 0; i < n; i++) {
      r[kept] = single ? (double)((const float *)requested->listed)[i]
                       : ((const double *)requested->listed)[i];
      kept += r[kept] < (double)INFINITY;
    }
    return kept;
  }
  if (single) {
    core_grid_radii(&grid, 0, n, true, near);
    for (size_t i = 0; i < n; i++) {
      r[i] = (double)near[i];
    }
  } else {
    core_grid_radii(&grid, 0, n, false, r);
  }
  return n;
}

/* Returns a margin of the error at radius i for radii around it. A curve deviates from the line between
 * two points by an eighth of its second difference; the margin is twice that. */
static double margin_at(const double *error, size_t n, size_t i) {
  double bend = 0;
  for (size_t k = i > 1 ? i - 1 : 1; k <= i + 1 && k + 1 < n; k++) {
    bend = larger_known(bend, fabs(error[k - 1] - 2 * error[k] + error[k + 1]));
  }
  return bend / 4;
}

double core_model_error(const core_profile *profile, const core_profile *transport, unsigned wanted,
                        const core_requested_radii *requested) {
  if (transport == NULL) {
    return stated_error(profile, wanted, requested->range);
  }
  double r[CORE_RULER_RADII], error[CORE_RULER_RADII];
  double most =
      (wanted & CORE_QUANTITY_ALBEDO) != 0 ? error_of_albedo(profile, transport) : (double)NAN;
  bool between = false;
  const bool at_radii = (wanted & (COMPARED | CORE_QUANTITY_S)) != 0 && requested->grid.count > 0;
  const bool single = profile->evaluator != CORE_EVALUATOR_F64;
  const size_t n = at_radii ? choose_radii(requested, single, r, &between) : 0;
  if (n > 0) {
    core_model_errors_at(profile, transport, wanted, n, r, error);
  }
  for (size_t i = 0; i < n; i++) {
    most = larger_known(most, error[i] + (between ? margin_at(error, n, i) : 0));
  }
  const double first_mm =
      requested->listed != NULL ? requested->range.least_mm : requested->grid.start_mm;
  if (between && !(first_mm > 0)) { /* some quantities are finite at r = 0 */
    const double source = 0;
    core_model_errors_at(profile, transport, wanted, 1, &source, error);
    most = larger_known(most, error[0]);
  }
  return most;
}

core_model_errors core_model_errors_measure(const core_profile *profile,
                                            const core_profile *transport) {
  core_model_errors errors = core_model_errors_unknown();
  if (transport == NULL) {
    errors.exact = is_exact(profile);
    return errors;
  }
  const double mfp_mm = 1 / core_sigma_t_prime(&profile->medium);
  for (size_t i = 0; i < CORE_MODEL_ERROR_BANDS; i++) {
    const double *edge = &core_error_edges_mfp[i];
    const core_requested_radii band = {
        {CORE_SPACING_LOGARITHMIC, CORE_GRID_COUNT_MAX, edge[0] * mfp_mm, edge[1] * mfp_mm},
        NULL,
        {edge[0] * mfp_mm, edge[1] * mfp_mm}};
    const double error = core_model_error(profile, transport, CORE_QUANTITY_R, &band);
    errors.error[i] = isinf(error) ? (double)NAN : error;
  }
  errors.error[CORE_MODEL_ERROR_BANDS] = error_of_albedo(profile, transport);
  return errors;
}

double core_ruler_albedo_error(const core_isa *isa, unsigned model, const core_medium *medium,
                               double albedo) {
  double truth, numerical;
  if (core_solves(model)) {
    return 0;
  }
  core_albedo(isa, CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT, CORE_LIGHT_BEAM, medium, &truth,
              &numerical);
  return isnan(truth) ? (double)NAN : off_albedo(albedo, truth, numerical);
}
