#include "core/fit/layers.h"

#include <cminpack.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/fit/search.h"
#include "core/kernels.h"
#include "core/solver/solver.h"

#define CORE_REAL 64
#include "core/kernel.h"

enum { OF_LAYER = 3, MOST = CORE_UNKNOWNS + 1, STARTS = 3, CANDIDATES = 12 };
enum { FIRST_LEVEL = 0, LAST_LEVEL = 1, EVALUATIONS_MAX = 24 };

/* Difference of a logarithm for derivatives. */
#define STEP 0x1p-5
/* The standard error of a start's logarithms, which bounds what readings do not determine. */
#define START_ERROR 3.0
#define FTOL 1e-3
#define XTOL 1e-3
#define FIRST_STEP 1.0
/* A second minimum differs by so many standard errors. */
#define APART 5.0
#define AT_BOUND 1e-3
/* Steps to where readings determine an unknown, in logarithms; what lies there counts if chi-squared is
 * at most so much larger. */
#define STEP_AWAY 1.5
#define NEAR 25.0
enum { STEPS_AWAY = 4 };
/* Tolerances that the best medium is solved with in the end, until its errors are small enough. */
static const double tolerances[] = {1e-2, 1e-3};

/* Bounds of sigma_a, sigma_s and thicknesses: over the largest and the least distance, or times the
 * least and the largest one. */
static const double range[OF_LAYER][2] = {{1e-5, 50}, {1e-2, 1e3}, {1e-2, 10}};

/* The state of a search. Its unknowns are logarithms, that of a free factor is the last. */
struct search {
  const core_layers_fit_request *of;
  const core_isa *isa;
  const atomic_bool *stop;
  int count, layered;               /* numbers of unknowns: all, and those of layers */
  unsigned position[CORE_UNKNOWNS]; /* of the bit */
  double least[MOST], most[MOST], start[MOST];
  size_t level; /* for values; derivatives are those of FIRST_LEVEL */
  unsigned evaluations;
  core_fault fault;  /* of the last evaluation */
  core_fault memory; /* set by an evaluation that lacked memory: no result is that of the others */
};

/* ---- checking -------------------------------------------------------------------------------- */

static double *member_of(core_medium *layer, unsigned position) {
  core_medium *at = &layer[position / OF_LAYER];
  return position % OF_LAYER == 0   ? &at->sigma_a_per_mm
         : position % OF_LAYER == 1 ? &at->sigma_s_per_mm
                                    : &at->thickness_mm;
}

/* Checks the layers, where unknowns have values that make none of them weak: the largest sigma_s
 * that is known, no absorption, one free path. */
static core_fault check_layers(const core_layers_fit_request *request) {
  core_medium layer[CORE_LAYERS_MAX];
  core_parameters parameters = core_parameters_none();
  memcpy(layer, request->layer, request->layer_count * sizeof *layer);
  parameters.layer_count = (uint32_t)request->layer_count;
  double most = 0;
  for (size_t i = 0; i < request->layer_count; i++) {
    const bool known = i >= 2 || (request->unknowns >> (OF_LAYER * i + 1) & 1) == 0;
    most = known ? fmax(most, layer[i].sigma_s_per_mm) : most;
  }
  for (unsigned i = 0; i < 2 && i < request->layer_count; i++) {
    const unsigned unknown = request->unknowns >> OF_LAYER * i;
    core_medium *one = &layer[i];
    one->sigma_s_per_mm = (unknown & 2) == 0 ? one->sigma_s_per_mm : most > 0 ? most : 1;
    one->sigma_a_per_mm = (unknown & 1) == 0        ? one->sigma_a_per_mm
                          : one->sigma_s_per_mm > 0 ? 0
                                                    : fmax(most, 1);
    one->thickness_mm = (unknown & 4) == 0
                            ? one->thickness_mm
                            : 1 / fmax(one->sigma_a_per_mm + one->sigma_s_per_mm, 1e-30);
  }
  return core_profile_check(CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, layer,
                            &parameters, NULL);
}

core_fault core_layers_fit_check(const core_layers_fit_request *request) {
  const bool free_factor = request->scale == CORE_FIT_SCALE_FREE;
  const size_t count = (size_t)__builtin_popcount(request->unknowns) + free_factor;
  if (!free_factor && request->scale != CORE_FIT_SCALE_ABSOLUTE) {
    return (core_fault){"scale", "absolute or free", 0};
  }
  if (request->unknowns == 0 || request->unknowns >> OF_LAYER * request->layer_count != 0 ||
      request->unknowns >> CORE_UNKNOWNS != 0) {
    return (core_fault){"unknowns", "at least one, of the layers that are given", 0};
  }
  if (request->count < count || request->count > CORE_FIT_READINGS_MAX) {
    return (core_fault){"reading_count", "as many as there are unknowns, to 1024", 0};
  }
  for (size_t i = 0; i < request->count; i++) {
    const core_fault fault = !(request->at[i] > 0 && isfinite(request->at[i]))
                                 ? (core_fault){"at", "above 0, and finite", i}
                             : !isfinite(request->values[i]) ? (core_fault){"values", "finite", i}
                             : request->errors[i] > 0 && isfinite(request->errors[i])
                                 ? (core_fault){0}
                                 : (core_fault){"errors", "above 0, and finite", i};
    if (fault.field != NULL) {
      return fault;
    }
  }
  return check_layers(request);
}

/* ---- the model of the readings --------------------------------------------------------------- */

static double kept(const struct search *of, int k, double x) {
  return fmin(fmax(x, of->least[k]), of->most[k]);
}

static double factor_at(const struct search *of, const double *x) {
  return of->count > of->layered ? real_exp_signed(kept(of, of->layered, x[of->layered])) : 1;
}

/* Sets R[count], without the factor, on the grid of this level; with errors[count], which it sets
 * too, to the tolerance of this number. Returns false on a fault. */
static bool solve_readings(struct search *of, const double *x, size_t level, double *R,
                           double *errors) {
  const core_layers_fit_request *request = of->of;
  core_medium medium[CORE_LAYERS_MAX];
  solver_layer layer[CORE_LAYERS_MAX];
  solver_layers *solution;
  memcpy(medium, request->layer, request->layer_count * sizeof *medium);
  for (int k = 0; k < of->layered; k++) {
    *member_of(medium, of->position[k]) = real_exp_signed(kept(of, k, x[k]));
  }
  for (size_t i = 0; i < request->layer_count; i++) {
    const core_medium *one = &medium[i];
    layer[i] = (solver_layer){one->sigma_a_per_mm, one->sigma_s_per_mm, one->g, one->eta,
                              one->thickness_mm > 0 ? one->thickness_mm : (double)INFINITY};
  }
  of->fault = errors == NULL ? solver_layers_solve_level(&solution, of->isa, layer,
                                                         request->layer_count, 1, level, of->stop)
                             : solver_layers_solve(&solution, of->isa, layer, request->layer_count,
                                                   1, tolerances[level], of->stop);
  of->evaluations++;
  if (of->fault.field != NULL && strcmp(of->fault.field, CORE_FIELD_MEMORY) == 0) {
    of->memory = of->fault;
  }
  for (size_t i = 0; i < request->count && of->fault.field == NULL; i++) {
    const transport_number at = solver_layers_at(solution, 0, request->at[i]);
    R[i] = at.value;
    if (errors != NULL) {
      errors[i] = at.error;
    }
  }
  solver_layers_free(solution);
  return of->fault.field == NULL;
}

/* Sets column k of the derivatives of residuals, from R at x and by a difference to a neighbour. */
static void differentiate(struct search *of, const double *x, int k, const double *R, double *J) {
  double moved[MOST], other[CORE_FIT_READINGS_MAX];
  const double factor = factor_at(of, x);
  double step = STEP;
  bool ok = k == of->layered;
  memcpy(moved, x, (size_t)of->count * sizeof *x);
  for (int i = 0; i < 2 && !ok && x[k] > of->least[k] && x[k] < of->most[k]; i++) {
    step = i == 0 ? STEP : -STEP;
    moved[k] = x[k] + step;
    ok = solve_readings(of, moved, FIRST_LEVEL, other, NULL);
  }
  for (size_t i = 0; i < of->of->count; i++) {
    const double by = k == of->layered ? R[i] : (other[i] - R[i]) / step;
    J[i] = ok ? -factor * by / of->of->errors[i] : 0;
  }
}

/* The function that lmder() calls: for task 1 it sets the residuals f, for task 2 their derivatives
 * J, stored by columns. The last n of them are (x - start) / START_ERROR. A medium that the solver
 * does not take is far off. */
static int residuals_of(void *context, int m, int n, const double *x, double *f, double *J,
                        int rows, int task) {
  struct search *of = context;
  const size_t count = of->of->count;
  double R[CORE_FIT_READINGS_MAX];
  const bool known = solve_readings(of, x, task == 1 ? of->level : FIRST_LEVEL, R, NULL);
  (void)m;
  if (solver_stops(of->stop)) {
    return -1;
  }
  for (size_t i = 0; i < count && task == 1; i++) {
    f[i] = known ? (of->of->values[i] - factor_at(of, x) * R[i]) / of->of->errors[i] : 1e10;
  }
  for (int k = 0; k < n; k++) {
    if (task == 1) {
      f[count + (size_t)k] = (x[k] - of->start[k]) / START_ERROR;
      continue;
    }
    double *column = &J[(size_t)rows * (size_t)k];
    memset(column, 0, (size_t)rows * sizeof *column);
    if (known) {
      differentiate(of, x, k, R, column);
    }
    column[count + (size_t)k] = 1 / START_ERROR;
  }
  return 0;
}

/* ---- searching ------------------------------------------------------------------------------- */

/* A local minimum. */
struct minimum {
  double x[MOST], sd[MOST];
  double chi_squared;
  bool settled;
};

/* Returns the value rounded to 24 bits: what lmder() rounds otherwise on another machine. */
static double rounded(double value) {
  const double huge = value * 0x1p29;
  return (value + huge) - huge;
}

/* Minimizes from to->x. J: room for rows times unknowns. most: evaluations; if 1, the standard errors are
 * those at to->x. */
static void minimize(struct search *of, size_t level, int most, double *J, struct minimum *to) {
  const int n = of->count, rows = (int)of->of->count + n;
  double f[CORE_FIT_READINGS_MAX + MOST], work[CORE_FIT_READINGS_MAX + MOST];
  double scale[MOST], qtf[MOST], more[3][MOST];
  int pivots[MOST], calls, derivative_calls;
  of->level = level;
  memcpy(of->start, to->x, sizeof of->start);
  const int info =
      lmder(residuals_of, of, rows, n, to->x, f, J, rows, FTOL, XTOL, 0, most, scale, 1, FIRST_STEP,
            0, &calls, &derivative_calls, pivots, qtf, more[0], more[1], more[2], work);
  covar(n, J, rows, pivots, 0, more[0]);
  for (int k = 0; k < n; k++) {
    to->x[k] = rounded(kept(of, k, to->x[k]));
    to->sd[k] = rounded(sqrt(J[(size_t)k * (size_t)rows + (size_t)k]));
  }
  to->chi_squared = 0;
  for (size_t i = 0; i < of->of->count; i++) {
    to->chi_squared += f[i] * f[i];
  }
  to->settled = info >= 1 && info <= 4;
}

/* ---- starts ---------------------------------------------------------------------------------- */

/* Sets sigma_a and sigma_s of the half space that fits the readings up to or from the middle best,
 * all of them if those are too few, or what is usual for their distances. */
static void fit_half_space(const struct search *of, const core_medium *like, double middle_mm,
                           bool far, core_medium *to) {
  const core_layers_fit_request *request = of->of;
  double at[CORE_FIT_READINGS_MAX], values[CORE_FIT_READINGS_MAX], errors[CORE_FIT_READINGS_MAX];
  size_t count = 0;
  for (int all = 0; all < 2 && count < 3; all++) {
    count = 0;
    for (size_t i = 0; i < request->count; i++) {
      if (all == 1 || (far ? request->at[i] >= middle_mm : request->at[i] <= middle_mm)) {
        at[count] = request->at[i];
        values[count] = request->values[i];
        errors[count++] = request->errors[i];
      }
    }
  }
  const core_fit_design design = {.model = CORE_MODEL_TRANSPORT,
                                  .moments = CORE_MOMENTS_EXACT,
                                  .g = like->g,
                                  .eta = like->eta,
                                  .axis = CORE_FIT_AXIS_RADIUS,
                                  .count = count,
                                  .at = at,
                                  .scale = request->scale};
  core_fit *fit = NULL;
  core_fit_result result = {.status = CORE_FIT_STATUS_REFUSED};
  if (core_transport_stored_check(like->g, like->eta).field == NULL &&
      core_fit_create(&fit, of->isa, &design).field == NULL) {
    core_fit_run(fit, values, errors, &result, NULL);
  }
  core_fit_free(fit);
  const bool found = result.best.sigma_s_prime_per_mm > 0;
  to->sigma_a_per_mm = found ? result.best.sigma_a_per_mm : 0.1 / middle_mm;
  to->sigma_s_per_mm = (found ? result.best.sigma_s_prime_per_mm : 10 / middle_mm) / (1 - like->g);
}

/* Sets x of candidate number i. */
static void place_candidate(const struct search *of, const core_medium guess[2], double middle_mm,
                            int i, double *x) {
  static const double shares[] = {0.1, 0.3, 1};
  const double absorbs[] = {i / 3 % 2 == 0 ? 1 : 4, i / 6 == 0 ? 1 : 0.25};
  for (int k = 0; k < of->layered; k++) {
    const unsigned layer = of->position[k] / OF_LAYER, member = of->position[k] % OF_LAYER;
    const double value = member == 0   ? guess[layer].sigma_a_per_mm * absorbs[layer]
                         : member == 1 ? guess[layer].sigma_s_per_mm
                                       : shares[i % 3] * middle_mm;
    x[k] = kept(of, k, real_log(fmax(value, 1e-300), 0));
  }
}

/* Sets the bounds, and the candidates, the best one first. Returns how many of them are starts. */
static int find_starts(struct search *of, struct minimum start[CANDIDATES]) {
  const core_layers_fit_request *request = of->of;
  core_medium guess[2] = {{0}};
  double least_mm = (double)INFINITY, most_mm = 0;
  for (size_t i = 0; i < request->count; i++) {
    least_mm = fmin(least_mm, request->at[i]);
    most_mm = fmax(most_mm, request->at[i]);
  }
  const double middle_mm = sqrt(least_mm * most_mm);
  for (int k = 0; k < of->count; k++) {
    const double *one = range[k < of->layered ? of->position[k] % OF_LAYER : 0];
    const bool length = one == range[OF_LAYER - 1];
    const double least = length ? one[0] * least_mm : one[0] / most_mm;
    const double most = length ? one[1] * most_mm : one[1] / least_mm;
    of->least[k] = k < of->layered ? real_log(least, 0) : -600;
    of->most[k] = k < of->layered ? real_log(most, 0) : 600;
  }
  for (size_t i = 0; i < 2 && i < request->layer_count; i++) {
    fit_half_space(of, &request->layer[i], middle_mm, i > 0, &guess[i]);
  }
  int found = 0;
  for (int i = 0; i < CANDIDATES && !solver_stops(of->stop); i++) {
    struct minimum one = {.chi_squared = 0};
    double R[CORE_FIT_READINGS_MAX], along = 0, size = 0;
    place_candidate(of, guess, middle_mm, i, one.x);
    bool known = false;
    for (int k = 0; k < found; k++) {
      known |= memcmp(start[k].x, one.x, (size_t)of->layered * sizeof *one.x) == 0;
    }
    if (known || !solve_readings(of, one.x, FIRST_LEVEL, R, NULL)) {
      continue;
    }
    for (size_t k = 0; k < request->count; k++) {
      const double weight = 1 / (request->errors[k] * request->errors[k]);
      along += weight * R[k] * request->values[k];
      size += weight * R[k] * R[k];
    }
    const bool free_factor = of->count > of->layered && along > 0 && size > 0;
    one.x[of->layered] = free_factor ? real_log(along / size, 0) : 0;
    for (size_t k = 0; k < request->count; k++) {
      const double off = request->values[k] - factor_at(of, one.x) * R[k];
      one.chi_squared += off * off / (request->errors[k] * request->errors[k]);
    }
    int at = found++;
    for (; at > 0 && one.chi_squared < start[at - 1].chi_squared; at--) {
      start[at] = start[at - 1];
    }
    start[at] = one;
  }
  return found < STARTS ? found : STARTS;
}

/* ---- results --------------------------------------------------------------------------------- */

static enum core_fit_status status_of(const struct search *of, const struct minimum *best, int k) {
  return best->x[k] < of->least[k] + AT_BOUND || best->x[k] > of->most[k] - AT_BOUND
             ? CORE_FIT_STATUS_AT_BOUND
         : best->sd[k] < CORE_FIT_LN_ERROR_MAX ? CORE_FIT_STATUS_FITTED
                                               : CORE_FIT_STATUS_UNDETERMINED;
}

/* Looks at what the readings do not determine from where they do. Its derivatives vanish here, as if it
 * were known, and the search may have ended for that: takes a better minimum, or else widens the errors
 * of the others to those there. */
static void look_around(struct search *of, double *J, struct minimum *best) {
  const struct minimum from = *best;
  double wide[MOST] = {0};
  bool vague = false;
  for (int i = 0; i < 2 * of->layered && !solver_stops(of->stop); i++) {
    const int k = i / 2;
    struct minimum there = {.sd = {0}};
    if (status_of(of, &from, k) == CORE_FIT_STATUS_FITTED) {
      continue;
    }
    for (int step = 1; step <= STEPS_AWAY && !(there.sd[k] > 0 && there.sd[k] < 1); step++) {
      there = from;
      there.x[k] = kept(of, k, from.x[k] + (i % 2 == 0 ? step : -step) * STEP_AWAY);
      minimize(of, FIRST_LEVEL, 1, J, &there);
      const bool near = there.chi_squared < from.chi_squared + NEAR;
      for (int j = 0; j < of->count && near; j++) {
        wide[j] = fmax(wide[j], there.sd[j]);
      }
    }
    if (there.sd[k] < 1) {
      minimize(of, LAST_LEVEL, EVALUATIONS_MAX, J, &there);
      *best = there.settled && there.chi_squared < best->chi_squared - 1 ? there : *best;
    }
  }
  for (int k = 0; k < of->layered; k++) {
    vague |= status_of(of, best, k) != CORE_FIT_STATUS_FITTED;
  }
  for (int k = 0; k < of->count && vague; k++) {
    best->sd[k] = fmax(best->sd[k], wide[k]);
  }
}

/* Returns whether another minimum is a second solution: it fits nearly as well, and an unknown that
 * the readings determine differs. */
static bool is_second(const struct search *of, const struct minimum *best,
                      const struct minimum *other) {
  bool apart = false;
  for (int k = 0; k < of->layered; k++) {
    apart |= status_of(of, best, k) == CORE_FIT_STATUS_FITTED &&
             fabs(other->x[k] - best->x[k]) > APART * best->sd[k];
  }
  return apart && other->chi_squared < best->chi_squared + CORE_FIT_AMBIGUOUS;
}

/* Sets residuals and errors by a finer solution of the best medium. Returns the square of a bound
 * of how many standard errors the search's numerical errors shift an estimate by: it is a sum of
 * residuals times weights, and its variance is the sum of the squared weights. */
static double solve_finer(struct search *of, const struct minimum *best, core_layers_fit *fit,
                          double *residuals) {
  const core_layers_fit_request *request = of->of;
  double searched[CORE_FIT_READINGS_MAX], R[CORE_FIT_READINGS_MAX], errors[CORE_FIT_READINGS_MAX];
  double shift = (double)INFINITY;
  bool ok = solve_readings(of, best->x, LAST_LEVEL, searched, NULL);
  for (size_t k = 0; k < sizeof tolerances / sizeof *tolerances && ok && !(shift <= 1); k++) {
    ok = solve_readings(of, best->x, k, R, errors);
    shift = fit->numerical_error = fit->chi_squared = 0;
    for (size_t i = 0; i < request->count && ok; i++) {
      const double weight = fit->factor / request->errors[i];
      const double off = weight * (errors[i] + fabs(R[i] - searched[i]));
      residuals[i] = (request->values[i] - fit->factor * R[i]) / request->errors[i];
      shift += off * off;
      fit->chi_squared += residuals[i] * residuals[i];
      fit->numerical_error = fmax(fit->numerical_error, errors[i] / fmax(R[i], 1e-300));
    }
  }
  return shift;
}

/* Sets what the best medium of the search says, and its residuals. */
static core_fault put_result(struct search *of, const struct minimum *best, bool second,
                             core_layers_fit *fit, double *residuals) {
  const size_t spare = of->of->count - (size_t)of->count;
  const double none = (double)NAN;
  *fit = (core_layers_fit){.unknowns = (uint16_t)of->of->unknowns,
                           .reading_count = (uint32_t)of->of->count,
                           .unknown_count = (size_t)of->layered,
                           .factor = factor_at(of, best->x),
                           .evaluations = of->evaluations};
  const bool precise = solve_finer(of, best, fit, residuals) <= 1;
  if (of->fault.field != NULL) {
    return of->fault;
  }
  fit->reduced_chi_squared = spare > 0 ? fit->chi_squared / (double)spare : none;
  bool bound = false, vague = false;
  const bool implausible = fit->chi_squared > fit_chi_squared_most(spare);
  const enum core_fit_status whole =
      fit_status(false, implausible, false, best->settled && precise, second);
  for (int k = 0; k < of->count; k++) {
    const enum core_fit_status own = status_of(of, best, k);
    const enum core_fit_status status = own == CORE_FIT_STATUS_FITTED ? whole : own;
    const bool unknown = status == CORE_FIT_STATUS_UNDETERMINED;
    const double value = unknown ? none : real_exp_signed(best->x[k]);
    const double error = status == CORE_FIT_STATUS_FITTED ? value * best->sd[k] : (double)INFINITY;
    bound |= status == CORE_FIT_STATUS_AT_BOUND;
    vague |= unknown;
    if (k == of->layered) {
      fit->factor = value;
      fit->factor_error = error;
    } else {
      fit->unknown[k] =
          (core_estimate){(uint16_t)(1U << of->position[k]), (uint16_t)status, 0, value, error};
    }
  }
  fit->status = fit_status(bound, implausible, vague, best->settled && precise, second);
  return of->fault;
}

core_fault core_layers_fit_run(core_layers_fit *fit, const core_isa *isa,
                               const core_layers_fit_request *request, double *residuals,
                               const atomic_bool *stop) {
  struct search search = {.of = request, .isa = isa, .stop = stop};
  struct minimum found[CANDIDATES];
  for (unsigned i = 0; i < CORE_UNKNOWNS; i++) {
    if ((request->unknowns >> i & 1) != 0) {
      search.position[search.layered++] = i;
    }
  }
  search.count = search.layered + (request->scale == CORE_FIT_SCALE_FREE);
  double *J = malloc((request->count + MOST) * MOST * sizeof *J);
  if (J == NULL) {
    return (core_fault){CORE_FIELD_MEMORY, "enough for the fit", 0};
  }
  const int starts = find_starts(&search, found);
  int at = 0;
  for (int i = 0; i < starts && !solver_stops(stop); i++) {
    minimize(&search, FIRST_LEVEL, EVALUATIONS_MAX, J, &found[i]);
    at = found[i].chi_squared < found[at].chi_squared ? i : at;
  }
  bool second = false;
  for (int i = 0; i < starts; i++) {
    second |= i != at && is_second(&search, &found[at], &found[i]);
  }
  if (starts > 0 && !solver_stops(stop)) {
    minimize(&search, LAST_LEVEL, EVALUATIONS_MAX, J, &found[at]);
    look_around(&search, J, &found[at]);
  }
  free(J);
  return solver_stops(stop)            ? (core_fault){CORE_FIELD_STOPPED, "to be waited for", 0}
         : search.memory.field != NULL ? search.memory
         : starts == 0                 ? search.fault
                                       : put_result(&search, &found[at], second, fit, residuals);
}
