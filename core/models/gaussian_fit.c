/* A few Gaussians fitted to another model over a range of radii, for renderers that blur with
 * Gaussians.
 *
 * The fit minimizes the sum of the squares of (sum w_i e^(-b_i r^2)) / R(r) - 1 at POINTS radii in
 * equal ratios. The unknowns are ln w_i and ln b_i, which keeps w_i and b_i positive. The method is
 * Levenberg-Marquardt as in MINPACK (cminpack's lmder), from STARTS starts: widths in equal ratios
 * over parts of the range. The best result is rounded to 24 bits, so that the last digits of a
 * machine's linear algebra do not matter. The numerical error is MARGIN times the largest relative
 * deviation from the model at CHECKS radii; the margin is for the radii between them.
 *
 * If the request names a tolerance, the model takes the smallest number of Gaussians that meets it,
 * up to the number that the request names, or up to GAUSSIANS_MOST. If no number meets the
 * tolerance, the preparation fails with a fault of the field `tolerance`.
 *
 * Domain: the domain of the fitted model, and radii from fit_from to fit_to. The defaults are FROM
 * and TO mean free paths 1 / sigma_t'.
 */
#include "core/models/gaussians.h"

#include <cminpack.h>
#include <math.h>
#include <string.h>

#define CORE_REAL 64
#include "core/kernel.h"

#define FROM 0.1
#define TO 10.0
#define MARGIN 1.02
/* lmder's `factor`: bounds the first step, in units of the scaled unknowns */
#define FIRST_STEP 1.0
#define GAUSSIANS 6
#define GAUSSIANS_MOST 12 /* largest value of the parameter `gaussians` */

enum { POINTS = 100, CHECKS = 1000, STARTS = 2, CALLS_MAX = 200, UNKNOWNS = 2 * GAUSSIANS_MOST };

/* ---- what is requested ----------------------------------------------------------------------- */

struct fitted {
  unsigned model;
  core_parameters parameters; /* parameters of the fitted model */
  double from_mm;
  double to_mm;
};

static struct fitted fitted_of(const core_inputs *inputs) {
  const core_medium *medium = inputs->medium;
  const double mfp_mm = 1 / core_sigma_t_prime(medium);
  struct fitted fitted = {
      .model = (unsigned)core_parameter_or(inputs, CORE_PARAMETER_FIT_MODEL, CORE_MODEL_BETTER),
      .parameters = *inputs->parameters,
      .from_mm = core_parameter_or(inputs, CORE_PARAMETER_FIT_FROM, FROM * mfp_mm),
      .to_mm = core_parameter_or(inputs, CORE_PARAMETER_FIT_TO, TO * mfp_mm),
  };
  static const enum core_parameter own[] = {CORE_PARAMETER_TOLERANCE, CORE_PARAMETER_GAUSSIANS,
                                            CORE_PARAMETER_FIT_MODEL, CORE_PARAMETER_FIT_FROM,
                                            CORE_PARAMETER_FIT_TO};
  for (size_t i = 0; i < sizeof own / sizeof own[0]; i++) {
    fitted.parameters.value[own[i]] = (double)NAN;
  }
  return fitted;
}

static bool is_whole(double value) {
  return isnan(value) || value == floor(value);
}

core_fault core_gaussian_fit_check(const core_inputs *inputs, core_radii_range *radii) {
  const struct fitted fitted = fitted_of(inputs);
  if (!is_whole(inputs->parameters->value[CORE_PARAMETER_GAUSSIANS])) {
    return (core_fault){"gaussians", "an integer from 1 to 12", 0};
  }
  if (!is_whole(inputs->parameters->value[CORE_PARAMETER_FIT_MODEL]) ||
      fitted.model == CORE_MODEL_GAUSSIANS ||
      core_choice_by_id(core_models, fitted.model) == NULL) {
    return (core_fault){"fit_model", "the id of another model of the list", 0};
  }
  if (!(fitted.from_mm < fitted.to_mm)) {
    return (core_fault){"fit_from", "less than fit_to", 0};
  }
  *radii = (core_radii_range){fitted.from_mm, fitted.to_mm};
  return core_profile_check(fitted.model, inputs->moments, CORE_EVALUATOR_F64, inputs->medium,
                            &fitted.parameters, NULL);
}

/* Returns the fitted model's own error if it matters: for `transport` from the table with g other
 * than 0. */
static double error_of_model(const core_inputs *inputs, const struct fitted *fitted) {
  core_added_errors added = {{0}, 0};
  if (core_solves(fitted->model)) {
    core_transport_added_errors(inputs->medium, &added);
  }
  return core_banded_error(added.banded, added.all, inputs->medium, CORE_QUANTITY_R,
                           (core_radii_range){fitted->from_mm, fitted->to_mm});
}

/* ---- the model's values ---------------------------------------------------------------------- */

struct samples {
  double r[CHECKS];
  double R[CHECKS];
  size_t count;
};

/* Evaluates the model at `count` radii in equal ratios over the range. If the range begins at 0,
 * the first radius is 0 and the others cover three decades. Returns false if R is 0 or infinite
 * somewhere. */
static bool sample_model(const core_profile *profile, const struct fitted *fitted, size_t count,
                         struct samples *samples) {
  const bool from_zero = !(fitted->from_mm > 0);
  const double start = from_zero ? fitted->to_mm * 1e-3 : fitted->from_mm;
  const core_grid grid = {CORE_SPACING_LOGARITHMIC, count, start, fitted->to_mm};
  core_grid_radii(&grid, 0, count, false, samples->r);
  samples->r[0] = fitted->from_mm;
  samples->count = count;
  core_eval_f64(profile, CORE_QUANTITY_R, count, samples->r, samples->R);
  for (size_t i = 0; i < count; i++) {
    if (!(samples->R[i] > 1e-290 && samples->R[i] < 1e290)) {
      return false;
    }
  }
  return true;
}

static double deviation(const core_gaussian *gaussians, size_t count, const struct samples *to) {
  double worst = 0;
  for (size_t j = 0; j < to->count; j++) {
    double sum = 0;
    for (size_t i = 0; i < count; i++) {
      const double exponent = -gaussians[i].rate * to->r[j] * to->r[j];
      sum += real_times_exp(gaussians[i].weight, exponent, 0);
    }
    worst = fmax(worst, fabs(sum / to->R[j] - 1));
  }
  return worst;
}

/* ---- fitting --------------------------------------------------------------------------------- */

/* Returns e^x with x kept between -600 and 600, so that nothing overflows. The unknowns of the fit
 * are ln w_0, ln b_0, ln w_1, ... */
static double bounded_exp(double x) {
  return real_exp_signed(fmin(fmax(x, -600), 600));
}

/* The function that lmder() calls: for task 1 it sets the m residuals f, for task 2 their
 * derivatives J, stored by columns. */
static int residuals(void *context, int m, int n, const double *x, double *f, double *J, int rows,
                     int task) {
  const struct samples *samples = context;
  for (int j = 0; j < m; j++) {
    const double squared = samples->r[j] * samples->r[j];
    double sum = 0;
    for (int i = 0; i < n; i += 2) {
      const double slope = bounded_exp(x[i + 1]) * squared;
      const double value = bounded_exp(x[i] - slope) / samples->R[j];
      sum += value;
      if (task == 2) {
        J[j + rows * i] = value;
        J[j + rows * (i + 1)] = -value * slope;
      }
    }
    if (task == 1) {
      f[j] = sum - 1;
    }
  }
  return 0;
}

/* Sets the unknowns of a start: widths in equal ratios over a part of the range. Each Gaussian's
 * weight is R at the radius 1.5 times its width. */
static void start_at(double *x, size_t count, const struct samples *samples, int start) {
  static const double parts[STARTS][2] = {{0.05, 0.75}, {0, 0.9}};
  for (size_t i = 0; i < count; i++) {
    const double along = count > 1 ? (double)i / (double)(count - 1) : 0.5;
    const double part = parts[start][0] + along * (parts[start][1] - parts[start][0]);
    const size_t at = 1 + (size_t)(part * (double)(samples->count - 2));
    const double width = samples->r[at] / 1.5;
    x[2 * i] = real_log(samples->R[at], 0);
    x[2 * i + 1] = -real_log(2 * width * width, 0);
  }
}

/* Returns the value rounded to 24 bits. */
static double rounded(double value) {
  const double huge = value * 0x1p29;
  return (value + huge) - huge;
}

/* Fits `count` Gaussians from every start and puts those with the smallest deviation into `best`.
 * Returns the largest relative deviation of these from the model over `checks`. */
static double fit(struct samples *points, const struct samples *checks, size_t count,
                  core_gaussian *best) {
  const int unknowns = 2 * (int)count;
  double least = (double)INFINITY;
  for (int start = 0; start < STARTS; start++) {
    double x[UNKNOWNS], f[POINTS], J[POINTS * UNKNOWNS], scale[UNKNOWNS], qtf[UNKNOWNS];
    double work[3][UNKNOWNS], more_work[POINTS];
    int pivots[UNKNOWNS], calls, derivative_calls;
    core_gaussian gaussians[GAUSSIANS_MOST];
    start_at(x, count, points, start);
    /* The code ignores why lmder() stopped: only the deviation that it then measures counts. */
    lmder(residuals, points, POINTS, unknowns, x, f, J, POINTS, 1e-12, 1e-10, 0, CALLS_MAX, scale,
          1, FIRST_STEP, 0, &calls, &derivative_calls, pivots, qtf, work[0], work[1], work[2],
          more_work);
    for (size_t i = 0; i < count; i++) {
      gaussians[i].weight = rounded(bounded_exp(x[2 * i]));
      gaussians[i].rate = rounded(bounded_exp(x[2 * i + 1]));
    }
    const double worst = deviation(gaussians, count, checks);
    if (worst < least) {
      least = worst;
      memcpy(best, gaussians, count * sizeof *best);
    }
  }
  return least;
}

static core_fault fit_profile(const core_inputs *inputs, const core_profile *profile,
                              const struct fitted *fitted, core_preparation *preparation) {
  struct samples points;
  struct samples checks;
  if (!sample_model(profile, fitted, POINTS, &points) ||
      !sample_model(profile, fitted, CHECKS, &checks)) {
    return (core_fault){"fit_from", "a range where the model is neither 0 nor infinite", 0};
  }
  const double tolerance = inputs->parameters->value[CORE_PARAMETER_TOLERANCE];
  const bool has_tolerance = !isnan(tolerance);
  const size_t most = (size_t)core_parameter_or(inputs, CORE_PARAMETER_GAUSSIANS,
                                                has_tolerance ? GAUSSIANS_MOST : GAUSSIANS);
  core_gaussian gaussians[GAUSSIANS_MOST];
  size_t count = has_tolerance ? 1 : most;
  const double of_model = error_of_model(inputs, fitted);
  double error = MARGIN * fit(&points, &checks, count, gaussians) + of_model;
  while (has_tolerance && error > tolerance && count < most) {
    count++;
    error = MARGIN * fit(&points, &checks, count, gaussians) + of_model;
  }
  if (has_tolerance && error > tolerance) {
    return (core_fault){"tolerance", "what a fit reaches: more gaussians or a shorter range", 0};
  }
  const core_fault fault = core_gaussians_table(gaussians, count, NULL, preparation);
  preparation->error = error;
  return fault;
}

core_fault core_gaussian_fit_prepare(const core_inputs *inputs, core_preparation *preparation) {
  const struct fitted fitted = fitted_of(inputs);
  core_profile profile;
  core_fault fault = core_profile_prepare_until(&profile, inputs->isa, fitted.model,
                                                inputs->moments, CORE_EVALUATOR_F64, inputs->medium,
                                                &fitted.parameters, inputs->stop);
  if (fault.field != NULL) {
    return fault;
  }
  fault = fit_profile(inputs, &profile, &fitted, preparation);
  preparation->scale_mm = profile.scale_mm;
  preparation->notes = profile.notes & ~(unsigned)CORE_NOTE_ALBEDO_ABOVE_1;
  core_profile_free(&profile);
  return fault;
}
