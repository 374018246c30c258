#include "core/fit/search.h"

#include <stdlib.h>

#define CORE_REAL 64
#include "core/kernel.h"

/* Of a descent. Along a narrow valley it takes up to some 200. */
enum { EVALUATIONS_MAX = 300 };

/* How starts are chosen. In the grid each reading has the relative error `error` besides its own,
 * so that the valley of media that fit is wider than the grid's steps. The starts are the best
 * `most` media that no neighbour is better than; with `rows`, no neighbour of the same ratio. A
 * start may have `worse` more chi-squared for each reading than the best one. */
struct choosing {
  double error;
  bool rows;
  size_t most;
  double worse;
};
static const struct choosing usual = {0.3, false, 4, 3};

/* The search for a second solution tries more starts if the readings exceed the unknowns by at most
 * FIT_SPARSE, twice that with a free factor, or if the best one is not a good fit, has a standard error
 * of a logarithm above CAREFUL_ERROR, or is at a bound: where a model hardly depends on sigma_a, a
 * valley that ends at the bound is so flat that rounding of the model's table may leave a minimum
 * there. */
static const struct choosing careful = {0.1, true, FIT_STARTS_MAX, 1e300};
#define CAREFUL_REDUCED 3.0
#define CAREFUL_ERROR 0.05

/* Readings with a free factor that exceed the unknowns by at most FIT_SPARSE, or others that do not
 * exceed them, may also have a second solution so near to the first that the starts of the grid lead
 * to one of them alone. So a last round starts in eight directions around the best, at these
 * distances in both logarithms. */
static const double distances[] = {0.15, 0.6, 2};
enum { DIRECTIONS = FIT_STARTS_MAX * sizeof distances[0] / sizeof distances };
_Static_assert(DIRECTIONS == 8, "all neighbours on a square grid");

/* First the residuals are those of logarithms, which are less curved, until steps are shorter than
 * this. */
#define STEP_LOGARITHMS 5e-2

/* The search ends with a step that is shorter than this in both logarithms, or, if rounding keeps
 * chi-squared from falling, one that is shorter than STEP_ROUNDED. */
#define STEP_END 1e-9
#define STEP_ROUNDED 1e-5
#define STEP_MOST 2.0 /* the longest step, in both logarithms; a longer one is cut to it */

/* A descent that starts from the inverse makes Newton steps; its step before the last is shorter
 * than this. */
#define STEP_NEWTON 1e-5

/* Refining ends after a step shorter than STEP_EXACT. It fails at a step longer than STEP_FAR,
 * because the table's error is smaller than that. */
#define STEP_EXACT 1e-8
#define STEP_FAR 0.1

#define DAMPING_FIRST 1e-2
#define DAMPING_LEAST 1e-12
#define DAMPING_MOST 1e10

/* Two readings that a medium explains have less chi-squared than this. */
#define CHI_SQUARED_NONE 1e-8

/* Two solutions within this in both logarithms are one. */
#define SAME 1e-3

size_t fit_spare(const core_fit *fit) {
  const size_t unknowns = fit->free_factor ? 3 : 2;
  return fit->count > unknowns ? fit->count - unknowns : 0;
}

struct fit_place fit_grid_place(const core_fit *fit, size_t i) {
  const double ratio = (double)(i / FIT_GRID_SCATTERINGS) / (FIT_GRID_RATIOS - 1);
  const double scattering = (double)(i % FIT_GRID_SCATTERINGS) / (FIT_GRID_SCATTERINGS - 1);
  return (struct fit_place){
      fma(ratio, fit->most.ln_ratio - fit->least.ln_ratio, fit->least.ln_ratio),
      fma(scattering, fit->most.ln_scattering - fit->least.ln_scattering, fit->least.ln_scattering),
  };
}

/* ---- chi-squared ----------------------------------------------------------------------------- */

/* The terms of a residual (value - factor model) / error, or of its logarithmic form, and the
 * derivatives of the model. */
struct residual {
  double value;
  double model;
  double weight;
  double by_r;
  double by_s;
};

/* Sets out[count] to the terms of the residuals, from the model's values and derivatives. */
static void take_apart(const core_fit *fit, struct fit_readings readings, bool logarithms,
                       const double *model, const double *by_r, const double *by_s,
                       struct residual *out) {
  double scaled[CORE_FIT_READINGS_MAX], ln[CORE_FIT_READINGS_MAX];
  for (size_t i = 0; i < fit->count; i++) {
    scaled[i] = fit->weight[i] * model[i];
  }
  if (logarithms) {
    fit->model.loops->logarithms(fit->count, scaled, ln);
  }
  for (size_t i = 0; i < fit->count; i++) {
    const double m = scaled[i], value = readings.values[i], weight = 1 / readings.errors[i];
    if (logarithms) {
      const double slope = fit->weight[i] / real_max(m, 0x1p-1022);
      out[i] = (struct residual){readings.logarithms[i], ln[i], real_max(value, 0) * weight,
                                 by_r[i] * slope, by_s[i] * slope};
    } else {
      out[i] =
          (struct residual){value, m, weight, by_r[i] * fit->weight[i], by_s[i] * fit->weight[i]};
    }
  }
}

/* Returns the factor that fits best, or its logarithm. */
static double best_factor(const core_fit *fit, bool logarithms, const struct residual *parts) {
  double both = 0, square = 0;
  for (size_t i = 0; fit->free_factor && i < fit->count; i++) {
    const double m = parts[i].weight * (logarithms ? 1 : parts[i].model);
    both += m * parts[i].weight * (parts[i].value - (logarithms ? parts[i].model : 0));
    square += m * m;
  }
  return fit->free_factor ? (square > 0 ? both / square : 0) : logarithms ? 0 : 1;
}

static void eliminate_factor(struct fit_quadratic *q) {
  if (q->ff > 0) {
    q->rr -= q->fr * q->fr / q->ff;
    q->rs -= q->fr * q->fs / q->ff;
    q->ss -= q->fs * q->fs / q->ff;
  }
}

/* Adds a residual's square, and the products of its derivatives, to the quadratic form. */
static void add_residual(struct fit_quadratic *q, bool free_factor, const struct residual *part,
                         double off) {
  const double scale = part->weight * (q->logarithms ? 1 : q->factor);
  const double r = scale * part->by_r, s = scale * part->by_s;
  const double f = free_factor ? scale * (q->logarithms ? 1 : part->model) : 0;
  q->chi_squared += off * off;
  q->to_r += off * r;
  q->to_s += off * s;
  q->rr += r * r;
  q->rs += r * s;
  q->ss += s * s;
  q->fr += f * r;
  q->fs += f * s;
  q->ff += f * f;
}

/* Evaluates the model with its derivatives. Returns false if there is no such medium or no finite
 * chi-squared. exact: the values of the model to take, or NULL. residuals may be NULL. */
static bool expand_around(const core_fit *fit, struct fit_readings readings, bool logarithms,
                          struct fit_place place, const double *exact, struct fit_quadratic *q,
                          double *residuals) {
  double own[CORE_FIT_READINGS_MAX], by_r[CORE_FIT_READINGS_MAX], by_s[CORE_FIT_READINGS_MAX];
  struct residual parts[CORE_FIT_READINGS_MAX];
  if (fit_values(&fit->model, place, &fit->places, own, by_r, by_s).field != NULL) {
    return false;
  }
  const double *model = exact != NULL ? exact : own;
  take_apart(fit, readings, logarithms, model, by_r, by_s, parts);
  *q = (struct fit_quadratic){
      .place = place, .logarithms = logarithms, .factor = best_factor(fit, logarithms, parts)};
  for (size_t i = 0; i < fit->count; i++) {
    const double scaled = logarithms ? q->factor + parts[i].model : q->factor * parts[i].model;
    const double off = parts[i].weight * (parts[i].value - scaled);
    add_residual(q, fit->free_factor, &parts[i], off);
    if (residuals != NULL) {
      residuals[i] = off;
    }
  }
  eliminate_factor(q);
  return q->chi_squared < (double)INFINITY;
}

static bool expand(const core_fit *fit, struct fit_readings readings, bool logarithms,
                   struct fit_place place, struct fit_quadratic *q, double *residuals) {
  return expand_around(fit, readings, logarithms, place, NULL, q, residuals);
}

/* ---- the starts ------------------------------------------------------------------------------ */

/* Sets chi[FIT_GRID] to chi-squared of the logarithms for each medium of the grid, and returns the
 * least. */
static double measure_grid(const core_fit *fit, struct fit_readings readings, double error,
                           double *chi) {
  double weights[CORE_FIT_READINGS_MAX];
  for (size_t k = 0; k < fit->count; k++) {
    const double value = real_max(readings.values[k], 0), own = readings.errors[k];
    weights[k] = value * value / (own * own + error * error * value * value);
  }
  return fit->model.loops->measure(FIT_GRID, fit->grid, fit->count, readings.logarithms, weights,
                                   fit->free_factor, chi);
}

/* Whether no neighbour of medium i has a smaller chi-squared, or an equal one and comes first. */
static bool is_minimum(const double *chi, size_t i, bool rows) {
  const int ratio = (int)(i / FIT_GRID_SCATTERINGS), scattering = (int)(i % FIT_GRID_SCATTERINGS);
  const int beside = rows ? 0 : 1;
  bool least = chi[i] < (double)INFINITY;
  for (int u = ratio - beside; least && u <= ratio + beside; u++) {
    for (int v = scattering - 1; least && v <= scattering + 1; v++) {
      if (u >= 0 && u < FIT_GRID_RATIOS && v >= 0 && v < FIT_GRID_SCATTERINGS) {
        const size_t other = (size_t)u * FIT_GRID_SCATTERINGS + (size_t)v;
        least = !(chi[other] < chi[i]) && !(chi[other] <= chi[i] && other < i);
      }
    }
  }
  return least;
}

/* Sets starts[FIT_STARTS_MAX] to places of the grid, the best first, and returns their number. */
static size_t find_starts(const core_fit *fit, struct fit_readings readings,
                          const struct choosing *choosing, struct fit_place *starts) {
  double chi[FIT_GRID];
  size_t count = 0, found[FIT_STARTS_MAX];
  const double least = measure_grid(fit, readings, choosing->error, chi);
  const double most = least + choosing->worse * (double)fit->count;
  for (size_t i = 0; i < FIT_GRID; i++) {
    if (!(chi[i] <= most) || !is_minimum(chi, i, choosing->rows)) {
      continue;
    }
    const size_t last = choosing->most;
    size_t at = count < last ? count++ : last;
    while (at > 0 && chi[i] < chi[found[at - 1]]) {
      if (at < last) {
        found[at] = found[at - 1];
      }
      at--;
    }
    if (at < last) {
      found[at] = i;
    }
  }
  for (size_t k = 0; k < count; k++) {
    starts[k] = fit_grid_place(fit, found[k]);
  }
  return count;
}

/* ---- Levenberg and Marquardt ----------------------------------------------------------------- */

static double clamp(double x, double least, double most) {
  return real_min(real_max(x, least), most);
}

/* Returns whether a step of this sign would leave the bounds at once. */
static bool blocked(double at, double least, double most, double step) {
  return (at <= least && step < 0) || (at >= most && step > 0);
}

/* Returns the damped step from a medium. A logarithm that stands on its bound stays there if the
 * step would cross it. */
static struct fit_place step_from(const core_fit *fit, const struct fit_quadratic *q,
                                  double damping) {
  const double rr = q->rr * (1 + damping), ss = q->ss * (1 + damping);
  const double determinant = fma(rr, ss, -q->rs * q->rs);
  struct fit_place step = {0, 0};
  if (determinant > 1e-15 * rr * ss) {
    step.ln_ratio = fma(ss, q->to_r, -q->rs * q->to_s) / determinant;
    step.ln_scattering = fma(rr, q->to_s, -q->rs * q->to_r) / determinant;
  }
  const bool no_ratio =
      blocked(q->place.ln_ratio, fit->least.ln_ratio, fit->most.ln_ratio, step.ln_ratio);
  const bool no_scattering = blocked(q->place.ln_scattering, fit->least.ln_scattering,
                                     fit->most.ln_scattering, step.ln_scattering);
  if (no_ratio) {
    step = (struct fit_place){0, no_scattering || !(ss > 0) ? 0 : q->to_s / ss};
  } else if (no_scattering) {
    step = (struct fit_place){rr > 0 ? q->to_r / rr : 0, 0};
  }
  const double longest = real_max(fabs(step.ln_ratio), fabs(step.ln_scattering));
  const double kept = longest > STEP_MOST ? STEP_MOST / longest : 1;
  return (struct fit_place){step.ln_ratio * kept, step.ln_scattering * kept};
}

static struct fit_place moved(const core_fit *fit, struct fit_place place, struct fit_place step) {
  return (struct fit_place){
      clamp(place.ln_ratio + step.ln_ratio, fit->least.ln_ratio, fit->most.ln_ratio),
      clamp(place.ln_scattering + step.ln_scattering, fit->least.ln_scattering,
            fit->most.ln_scattering),
  };
}

static double distance(struct fit_place a, struct fit_place b) {
  return real_max(fabs(a.ln_ratio - b.ln_ratio), fabs(a.ln_scattering - b.ln_scattering));
}

/* Returns by how much chi-squared falls with a step if it is quadratic. */
static double expected_fall(const struct fit_quadratic *q, struct fit_place from,
                            struct fit_place to) {
  const double r = to.ln_ratio - from.ln_ratio, s = to.ln_scattering - from.ln_scattering;
  return r * (2 * q->to_r - q->rr * r - 2 * q->rs * s) + s * (2 * q->to_s - q->ss * s);
}

enum descended { DESCENDS, SETTLED, GAVE_UP };

/* A descent from *q, until a step is shorter than `end`. */
static struct fit_descent descent_from(double damping, double end) {
  return (struct fit_descent){.damping = damping, .end = end, .left = EVALUATIONS_MAX};
}

/* Tries one step of a descent. */
static enum descended descend(const core_fit *fit, struct fit_readings readings,
                              struct fit_descent *descent, struct fit_quadratic *q,
                              unsigned *evaluations) {
  if (descent->left-- == 0 || descent->damping >= DAMPING_MOST) {
    return GAVE_UP;
  }
  const struct fit_place to = moved(fit, q->place, step_from(fit, q, descent->damping));
  const double length = distance(to, q->place);
  struct fit_quadratic next;
  const bool valid = length > 0 && expand(fit, readings, q->logarithms, to, &next, NULL);
  *evaluations += length > 0;
  if (valid && next.chi_squared <= q->chi_squared) {
    const double fell = q->chi_squared - next.chi_squared;
    const double expected = expected_fall(q, q->place, to);
    const double factor = fell > 0.7 * expected ? 0.1 : fell < 0.2 * expected ? 3 : 1;
    descent->damping = real_max(descent->damping * factor, DAMPING_LEAST);
    *q = next;
    return length < descent->end ? SETTLED : DESCENDS;
  }
  descent->damping *= 5;
  return length < STEP_ROUNDED ? SETTLED : DESCENDS;
}

/* ---- the result ------------------------------------------------------------------------------ */

static core_fit_solution solution_of(const struct fit_model *model, const struct fit_quadratic *q) {
  const core_medium medium = fit_medium(model, q->place);
  return (core_fit_solution){medium.sigma_a_per_mm, medium.sigma_s_per_mm * (1 - model->g),
                             q->factor, q->chi_squared};
}

/* Sets the condition number and the covariance, from the information by the logarithms of sigma_a
 * and sigma_s': ln(ratio) = ln sigma_a - ln sigma_s'. */
static void set_errors(const struct fit_quadratic *q, core_fit_result *result) {
  const double aa = q->rr, as = q->rs - q->rr, ss = q->rr - 2 * q->rs + q->ss;
  const double half = 0.5 * (aa + ss), apart = 0.5 * (aa - ss);
  const double larger = half + sqrt(fma(apart, apart, as * as));
  const double determinant = fma(q->rr, q->ss, -q->rs * q->rs);
  const bool known = determinant > 1e-15 * q->rr * q->ss;
  const core_fit_solution *best = &result->best;
  core_fit_covariance *c = &result->covariance;
  result->condition = known ? larger / sqrt(determinant) : (double)INFINITY;
  if (!known) {
    *c = (core_fit_covariance){
        (double)INFINITY, 0, (double)INFINITY, 0, 0, q->ff > 0 ? (double)INFINITY : 0};
    return;
  }
  const double var_a = ss / determinant, cov = -as / determinant, var_s = aa / determinant;
  *c = (core_fit_covariance){
      .a_a = best->sigma_a_per_mm * best->sigma_a_per_mm * var_a,
      .a_s = best->sigma_a_per_mm * best->sigma_s_prime_per_mm * cov,
      .s_s = best->sigma_s_prime_per_mm * best->sigma_s_prime_per_mm * var_s,
  };
  if (q->ff > 0) {
    const double fa = q->fr / q->ff, fs = (q->fs - q->fr) / q->ff;
    const double a = -(fa * var_a + fs * cov), s = -(fa * cov + fs * var_s);
    c->a_factor = best->factor * best->sigma_a_per_mm * a;
    c->s_factor = best->factor * best->sigma_s_prime_per_mm * s;
    c->factor_factor = best->factor * best->factor * (1 / q->ff - fa * a - fs * s);
  }
}

static unsigned bounds_of(const core_fit *fit, struct fit_place place) {
  return (place.ln_ratio <= fit->least.ln_ratio ? CORE_FIT_RATIO_LEAST : 0u) |
         (place.ln_ratio >= fit->most.ln_ratio ? CORE_FIT_RATIO_MOST : 0u) |
         (place.ln_scattering <= fit->least.ln_scattering ? CORE_FIT_SCATTERING_LEAST : 0u) |
         (place.ln_scattering >= fit->most.ln_scattering ? CORE_FIT_SCATTERING_MOST : 0u);
}

enum core_fit_status fit_status(bool bound, bool implausible, bool vague, bool settled,
                                bool second) {
  return bound                    ? CORE_FIT_STATUS_AT_BOUND
         : settled && implausible ? CORE_FIT_STATUS_IMPLAUSIBLE
         : vague                  ? CORE_FIT_STATUS_UNDETERMINED
         : !settled               ? CORE_FIT_STATUS_UNFINISHED
         : second                 ? CORE_FIT_STATUS_AMBIGUOUS
                                  : CORE_FIT_STATUS_FITTED;
}

static enum core_fit_status status_of(const core_fit *fit, const core_fit_result *result,
                                      bool settled) {
  const core_fit_solution *best = &result->best;
  const double limit = CORE_FIT_LN_ERROR_MAX * CORE_FIT_LN_ERROR_MAX;
  const bool vague =
      !(best->factor > 0) || !(result->condition < CORE_FIT_CONDITION_MAX) ||
      !(result->covariance.a_a < limit * best->sigma_a_per_mm * best->sigma_a_per_mm) ||
      !(result->covariance.s_s < limit * best->sigma_s_prime_per_mm * best->sigma_s_prime_per_mm);
  return fit_status(result->bounds != 0, best->chi_squared > fit->chi_squared_most, vague, settled,
                    result->second.chi_squared >= 0);
}

/* Returns a lower bound of chi-squared over all media, for models that never rise with the
 * distance: chi-squared of the readings against the nearest values that never rise. Pooling of
 * adjacent violators finds these (Ayer, Brunk, Ewing, Reid, Silverman 1955). */
static double least_chi_squared(const core_fit *fit, struct fit_readings readings) {
  double mean[CORE_FIT_READINGS_MAX], weight[CORE_FIT_READINGS_MAX], sum = 0;
  size_t pools = 0;
  for (size_t i = 0; fit->falling != NULL && i < fit->count; i++) {
    const size_t k = fit->falling[i];
    double m = readings.values[k], w = 1 / (readings.errors[k] * readings.errors[k]);
    for (; pools > 0 && mean[pools - 1] < m; pools--) {
      const double before = weight[pools - 1], both = before + w, rise = m - mean[pools - 1];
      sum += before * w / both * rise * rise;
      m -= before / both * rise;
      w = both;
    }
    mean[pools] = m;
    weight[pools++] = w;
  }
  return sum;
}

/* Inserts a minimum into the best two, unless it is the same as one of them. */
static void keep_minimum(struct fit_minimum *best, struct fit_minimum *second,
                         const struct fit_minimum *now) {
  if (best->found && distance(best->at.place, now->at.place) < SAME) {
    if (now->settled && (!best->settled || now->at.chi_squared < best->at.chi_squared)) {
      *best = *now;
    }
  } else if (!best->found || now->at.chi_squared < best->at.chi_squared) {
    *second = *best;
    *best = *now;
  } else if (!second->found || now->at.chi_squared < second->at.chi_squared) {
    *second = *now;
  }
}

static const core_fit_solution no_solution = {(double)NAN, (double)NAN, (double)NAN, (double)NAN};

static bool is_known(const core_fit_search *s, struct fit_place place) {
  const struct fit_minimum *best = &s->best, *second = &s->second;
  return (best->settled && distance(best->at.place, place) < SAME) ||
         (second->settled && distance(second->at.place, place) < SAME);
}

/* ---- the search ------------------------------------------------------------------------------ */

/* Begins with the inverse, if it is shown that the readings come from one medium alone. */
static void begin_inverse(core_fit_search *s) {
  struct fit_place start;
  s->stage = FIT_BEGINS_ROUND;
  if (s->fit->inverse != NULL &&
      fit_inverse_start(s->fit->inverse, s->readings.values, s->readings.errors, &start)) {
    s->evaluations++;
    if (expand(s->fit, s->readings, false, start, &s->now.at, NULL)) {
      s->descent = descent_from(DAMPING_LEAST, STEP_NEWTON);
      s->stage = FIT_INVERTS;
    }
  }
}

static void end_inverse(core_fit_search *s) {
  const bool found = s->now.settled && s->now.at.chi_squared < CHI_SQUARED_NONE;
  s->stage = found ? FIT_IS_DONE : FIT_BEGINS_ROUND;
  if (found) {
    s->best = s->now;
  }
}

/* Whether the standard errors of ln sigma_a and ln sigma_s' are below a limit. */
static bool is_determined(const struct fit_quadratic *q, double limit) {
  const double determinant = fma(q->rr, q->ss, -q->rs * q->rs);
  const double larger = real_max(q->rr, q->rr - 2 * q->rs + q->ss);
  return larger < limit * limit * determinant;
}

/* Returns whether the search for a second solution tries more starts. */
static bool wants_care(const core_fit_search *s) {
  const size_t spare = fit_spare(s->fit);
  return spare <= (s->fit->free_factor ? 2 : 1) * FIT_SPARSE || !s->best.found ||
         !s->best.settled || s->best.at.chi_squared > CAREFUL_REDUCED * (double)spare ||
         !is_determined(&s->best.at, CAREFUL_ERROR) || bounds_of(s->fit, s->best.at.place) != 0;
}

/* Sets starts[FIT_STARTS_MAX] to places around the best medium, and returns their number. */
static size_t find_places_around(const core_fit *fit, struct fit_place best,
                                 struct fit_place *starts) {
  for (size_t i = 0; i < FIT_STARTS_MAX; i++) {
    const double far = distances[i / DIRECTIONS];
    const int at = (int)(i % DIRECTIONS) + (i % DIRECTIONS >= DIRECTIONS / 2); /* not the middle */
    starts[i] = moved(fit, best, (struct fit_place){far * (at / 3 - 1), far * (at % 3 - 1)});
  }
  return FIT_STARTS_MAX;
}

static void begin_round(core_fit_search *s) {
  s->start_count = s->round == 2 ? find_places_around(s->fit, s->best.at.place, s->starts)
                                 : find_starts(s->fit, s->readings,
                                               s->round == 1 ? &careful : &usual, s->starts);
  s->next_start = 0;
  s->stage = FIT_BEGINS_START;
}

/* Begins to descend from a medium of the grid, with logarithms if possible. */
static void begin_start(core_fit_search *s) {
  if (s->next_start == s->start_count) {
    const bool again = s->round == 0
                           ? wants_care(s)
                           : s->round == 1 && s->best.found &&
                                 fit_spare(s->fit) <= (s->fit->free_factor ? FIT_SPARSE : 0);
    s->round++;
    s->stage = again ? FIT_BEGINS_ROUND : FIT_IS_DONE;
    return;
  }
  s->now = (struct fit_minimum){.found = true};
  s->place = s->starts[s->next_start++];
  s->descent = descent_from(DAMPING_FIRST, STEP_LOGARITHMS);
  s->evaluations++;
  s->stage = expand(s->fit, s->readings, true, s->place, &s->now.at, NULL) ? FIT_COMES_NEAR
                                                                           : FIT_BEGINS_MINIMUM;
}

static void begin_minimum(core_fit_search *s) {
  s->descent = descent_from(DAMPING_FIRST, STEP_END);
  s->evaluations++;
  s->stage =
      !is_known(s, s->place) && expand(s->fit, s->readings, false, s->place, &s->now.at, NULL)
          ? FIT_SETTLES
          : FIT_BEGINS_START;
}

/* Tries one step of the descent. */
static void go_down(core_fit_search *s) {
  const enum descended descended =
      descend(s->fit, s->readings, &s->descent, &s->now.at, &s->evaluations);
  if (descended == DESCENDS) {
    return;
  }
  s->now.settled = descended == SETTLED;
  s->now.found = true;
  if (s->stage == FIT_INVERTS) {
    end_inverse(s);
  } else if (s->stage == FIT_COMES_NEAR) {
    s->place = s->now.at.place;
    s->now.settled = false;
    s->stage = FIT_BEGINS_MINIMUM;
  } else {
    keep_minimum(&s->best, &s->second, &s->now);
    s->stage = FIT_BEGINS_START;
  }
}

/* Returns the model error of readings, or of their ratios to the reference medium. */
static double model_error_of(const core_fit *fit, const core_fit_solution *best) {
  const struct fit_model *model = &fit->model;
  const core_medium medium = {best->sigma_a_per_mm, best->sigma_s_prime_per_mm / (1 - model->g),
                              model->g, model->eta, model->thickness_mm};
  const double error = fit_model_error(model, &medium, &fit->places);
  return fit->reference_error < 1 ? (error + fit->reference_error) / (1 - fit->reference_error)
                                  : (double)NAN;
}

/* Sets the part of the result that follows from the best medium: coefficients, standard errors and
 * status. */
static void set_best(const core_fit *fit, struct fit_readings readings,
                     const struct fit_quadratic *q, bool settled, core_fit_result *result) {
  const size_t spare = fit_spare(fit);
  result->best = solution_of(&fit->model, q);
  result->model_error = model_error_of(fit, &result->best);
  result->bounds = (uint16_t)bounds_of(fit, q->place);
  result->reduced_chi_squared = spare > 0 ? q->chi_squared / (double)spare : (double)NAN;
  set_errors(q, result);
  const bool impossible = q->chi_squared > fit->chi_squared_most &&
                          least_chi_squared(fit, readings) > fit->chi_squared_most;
  result->status = impossible ? CORE_FIT_STATUS_IMPLAUSIBLE : status_of(fit, result, settled);
}

static void put_result(const core_fit_search *s, core_fit_result *result, double *residuals) {
  const core_fit *fit = s->fit;
  const struct fit_minimum *best = &s->best, *second = &s->second;
  *result = (core_fit_result){.status = CORE_FIT_STATUS_UNFINISHED,
                              .best = no_solution,
                              .second = no_solution,
                              .model_error = (double)NAN,
                              .evaluations = s->evaluations,
                              .notes = fit->notes};
  if (!best->found) {
    return;
  }
  if (second->found && second->settled &&
      second->at.chi_squared < best->at.chi_squared + CORE_FIT_AMBIGUOUS) {
    result->second = solution_of(&fit->model, &second->at);
  }
  set_best(fit, s->readings, &best->at, best->settled, result);
  if (residuals != NULL) {
    struct fit_quadratic again;
    expand(fit, s->readings, false, best->at.place, &again, residuals);
  }
}

/* ---- a set of readings ----------------------------------------------------------------------- */

struct fit_wrong fit_check_set(size_t count, const double *values, const double *errors) {
  for (size_t i = 0; i < count; i++) {
    const bool known = isfinite(values[i]);
    if (!known || !(errors[i] > 0 && errors[i] < (double)INFINITY)) {
      return (struct fit_wrong){known ? 2 : 1, (uint32_t)i};
    }
  }
  return (struct fit_wrong){0, 0};
}

static void refuse(const core_fit *fit, struct fit_wrong wrong, core_fit_result *result,
                   double *residuals) {
  const double nan = (double)NAN;
  *result = (core_fit_result){
      .status = CORE_FIT_STATUS_REFUSED,
      .field = wrong.field,
      .index = wrong.index,
      .best = no_solution,
      .reduced_chi_squared = nan,
      .condition = nan,
      .covariance = {nan, nan, nan, nan, nan, nan},
      .second = no_solution,
      .model_error = nan,
  };
  for (size_t i = 0; residuals != NULL && i < fit->count; i++) {
    residuals[i] = nan;
  }
}

core_fit_search *core_fit_search_new(void) {
  return malloc(sizeof(core_fit_search));
}

void core_fit_search_free(core_fit_search *search) {
  free(search);
}

bool core_fit_begin(core_fit_search *s, const core_fit *fit, const double *values,
                    const double *errors, core_fit_result *result, double *residuals) {
  const struct fit_wrong wrong = fit_check_set(fit->count, values, errors);
  if (wrong.field != 0) {
    refuse(fit, wrong, result, residuals);
    return false;
  }
  s->fit = fit;
  s->readings = (struct fit_readings){values, errors, s->logarithms};
  fit->model.loops->logarithms(fit->count, values, s->logarithms);
  s->evaluations = 0;
  s->best.found = s->best.settled = s->second.found = s->second.settled = false;
  s->round = 0;
  s->stage = FIT_BEGINS;
  return true;
}

bool core_fit_step(core_fit_search *s, core_fit_result *result, double *residuals) {
  switch (s->stage) {
  case FIT_BEGINS:
    begin_inverse(s);
    break;
  case FIT_BEGINS_ROUND:
    begin_round(s);
    break;
  case FIT_BEGINS_START:
    begin_start(s);
    break;
  case FIT_BEGINS_MINIMUM:
    begin_minimum(s);
    break;
  case FIT_INVERTS:
  case FIT_COMES_NEAR:
  case FIT_SETTLES:
    go_down(s);
    break;
  case FIT_IS_DONE:
    break;
  }
  if (s->stage != FIT_IS_DONE) {
    return true;
  }
  put_result(s, result, residuals);
  return false;
}

void core_fit_run(const core_fit *fit, const double *values, const double *errors,
                  core_fit_result *result, double *residuals) {
  core_fit_search search;
  bool goes_on = core_fit_begin(&search, fit, values, errors, result, residuals);
  while (goes_on) {
    goes_on = core_fit_step(&search, result, residuals);
  }
}

/* ---- refining -------------------------------------------------------------------------------- */

static struct fit_place place_of(const core_fit_solution *solution) {
  return (struct fit_place){fit_ln(solution->sigma_a_per_mm / solution->sigma_s_prime_per_mm),
                            fit_ln(solution->sigma_s_prime_per_mm)};
}

bool core_fit_wants_exact(const core_fit *fit, const double *values, const double *errors,
                          const core_fit_result *result, core_medium *medium) {
  bool precise = fit->model.table != NULL && result->status != CORE_FIT_STATUS_REFUSED &&
                 result->bounds == 0 && result->best.sigma_a_per_mm > 0;
  for (size_t i = 0; i < fit->count; i++) {
    precise &= errors[i] < CORE_FIT_EXACT_BELOW * values[i];
  }
  if (precise) {
    *medium = fit_medium(&fit->model, place_of(&result->best));
  }
  return precise;
}

/* The derivatives of the table are off by about as much as its values, so that each step leaves a
 * small share of the last one. */
bool core_fit_refine(const core_fit *fit, const core_profile *profile, const double *values,
                     const double *errors, core_fit_result *result, double *residuals,
                     core_medium *medium) {
  const struct fit_readings readings = {values, errors, NULL};
  const struct fit_place place = place_of(&result->best);
  double exact[CORE_FIT_READINGS_MAX];
  struct fit_quadratic q;
  fit_values_of_profile(&fit->model, profile, &fit->places, exact);
  result->evaluations++;
  if (!expand_around(fit, readings, false, place, exact, &q, residuals)) {
    return false;
  }
  const struct fit_place to = moved(fit, place, step_from(fit, &q, 0));
  const double length = distance(to, place);
  set_best(fit, readings, &q, true, result);
  if (!(length > STEP_EXACT && length < STEP_FAR)) {
    return false;
  }
  *medium = fit_medium(&fit->model, to);
  result->best.sigma_a_per_mm = medium->sigma_a_per_mm;
  result->best.sigma_s_prime_per_mm = medium->sigma_s_per_mm * (1 - fit->model.g);
  return true;
}
