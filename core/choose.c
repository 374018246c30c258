#include "core/choose.h"

#include <float.h>
#include <math.h>

#include "core/kernels.h"
#include "core/model_error.h"

static const struct cost {
  unsigned model;
  unsigned evaluator;
  double numerical; /* the error that a profile states by default */
  double numerical_least;
  double tolerance_least;
  /* With each of the tolerances. */
  struct {
    double evaluate_ns;
    double prepare_ns;
  } with[CORE_CHOOSE_TOLERANCE_COUNT];
} costs[] = {
#define CORE_COST(model, evaluator, numerical, numerical_least, least, ...)                        \
  {model, evaluator, numerical, numerical_least, least, {__VA_ARGS__}},
#define CORE_COST_WITH_G(model, evaluator, prepare_ns)
#include "core/costs.def"
};

static const struct cost_with_g {
  unsigned model;
  unsigned evaluator;
  double prepare_ns;
} costs_with_g[] = {
#define CORE_COST(model, evaluator, numerical, numerical_least, least, ...)
#define CORE_COST_WITH_G(model, evaluator, prepare_ns) {model, evaluator, prepare_ns},
#include "core/costs.def"
};

static const double tolerances[CORE_CHOOSE_TOLERANCE_COUNT] = CORE_CHOOSE_TOLERANCES;

enum {
  UNMEASURED = CORE_QUANTITY_CDF | CORE_QUANTITY_SLOPE | CORE_QUANTITY_TRANSFER |
               CORE_QUANTITY_BY_SIGMA_A | CORE_QUANTITY_BY_SIGMA_S,
  FOLLOWS_R = CORE_QUANTITY_R | CORE_QUANTITY_RING | CORE_QUANTITY_S | CORE_QUANTITY_SLOPE |
              CORE_QUANTITY_LN_R | CORE_QUANTITY_PDF,
  ELEMENTWISE = FOLLOWS_R | CORE_QUANTITY_CDF | CORE_QUANTITY_TRANSFER,
};

/* ---- the error of a model -------------------------------------------------------------------- */

/* Whether the medium and the radii are in the model's domain. */
static bool accepts(const struct cost *cost, const core_choose_request *request,
                    const core_medium *medium) {
  core_radii_range domain;
  if (core_profile_check(cost->model, request->moments, cost->evaluator, medium, NULL, &domain)
          .field != NULL) {
    return false;
  }
  return (request->wanted & ELEMENTWISE) == 0 ||
         (request->radii.least_mm >= domain.least_mm && request->radii.most_mm <= domain.most_mm);
}

/* Returns the errors of a model. What transport solves has an error that is not known before, so that
 * no tolerance is answered with it. */
static core_model_errors errors_of(const struct cost *cost, const core_choose_request *request,
                                   const core_medium *medium) {
  if (request->gamma > 0) {
    const core_medium taken = core_transport_medium(medium, request->gamma);
    return cost->model == CORE_MODEL_TRANSPORT && core_transport_is_stored(&taken)
               ? core_gamma_errors_find(request->gamma, medium->eta, core_ratio_of(medium))
               : core_model_errors_unknown();
  }
  return cost->model != CORE_MODEL_TRANSPORT
             ? core_model_errors_find(cost->model, request->moments, medium->g, medium->eta,
                                      core_ratio_of(medium))
         : core_transport_is_stored(medium) ? core_model_errors_exact()
                                            : core_model_errors_unknown();
}

/* Returns the model's largest error over the channels, or INFINITY if it is not known for one. */
static double model_error(const struct cost *cost, const core_choose_request *request) {
  double error = 0;
  for (size_t i = 0; i < request->media_count && error < (double)INFINITY; i++) {
    const core_medium *medium = &request->media[i];
    const core_model_errors errors = errors_of(cost, request, medium);
    const double here = core_model_errors_of(&errors, medium, request->wanted, request->radii);
    const bool promised =
        here < (double)INFINITY || (request->wanted & (ELEMENTWISE | CORE_QUANTITY_ALBEDO)) == 0;
    const bool unmeasured = (request->wanted & UNMEASURED) != 0 && !errors.exact;
    error = promised && !unmeasured && accepts(cost, request, medium) ? fmax(error, here)
                                                                      : (double)INFINITY;
  }
  return error;
}

/* ---- the numerical error --------------------------------------------------------------------- */

static double sigma_t_prime(const core_medium *medium) {
  return medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g);
}

/* Returns what `transport` makes of a medium. */
static core_medium taken_of(const core_choose_request *request, size_t i) {
  return core_transport_medium(&request->media[i],
                               request->gamma > 0 ? request->gamma : (double)NAN);
}

/* Returns the error that is added to transport's numerical error at radii beyond its reach and for
 * anisotropic scattering. */
static double added_error(const struct cost *cost, const core_choose_request *request) {
  double error = 0;
  for (size_t i = 0; i < request->media_count && cost->model == CORE_MODEL_TRANSPORT; i++) {
    const core_medium *medium = &request->media[i];
    const double most_mm = (request->wanted & FOLLOWS_R) != 0 ? request->radii.most_mm : 0;
    const core_medium taken = taken_of(request, i);
    core_added_errors added;
    core_transport_added_errors(&taken, &added);
    error = fmax(error, core_error_beyond(core_transport_reach(medium), most_mm) +
                            core_banded_error(added.banded, added.all, medium, request->wanted,
                                              request->radii));
  }
  return error;
}

/* Returns the bound 8 epsilon |ln R| that core/core.h adds to the error of ln R. Within 20 mean
 * free paths of any medium that was measured, R is above e^-64 per squared mean free path. Beyond,
 * ln R falls by at most 1 per mean free path. */
static double logarithm_error(const core_choose_request *request) {
  double ln_R = 0;
  if ((request->wanted & CORE_QUANTITY_LN_R) == 0) {
    return 0;
  }
  for (size_t i = 0; i < request->media_count; i++) {
    ln_R = fmax(ln_R, 64 + 64 + request->radii.most_mm * sigma_t_prime(&request->media[i]));
  }
  return 8 * (request->single ? (double)FLT_EPSILON : DBL_EPSILON) * ln_R;
}

#define SAVES 0.95 /* a cost that is less than this share of another is less */

/* Returns which of the tolerances to prepare with if the numerical error may be `most`: the
 * smallest of those that are cheapest. */
static size_t cheapest_tolerance(const struct cost *cost, double most) {
  size_t best = 0;
  for (size_t i = 1; i < CORE_CHOOSE_TOLERANCE_COUNT && tolerances[i] <= most; i++) {
    if (cost->with[i].prepare_ns < SAVES * cost->with[best].prepare_ns ||
        cost->with[i].evaluate_ns < SAVES * cost->with[best].evaluate_ns) {
      best = i;
    }
  }
  return best;
}

/* Whether the table of solutions holds all media, so that its error counts, and not the tolerance. */
static bool are_stored(const core_choose_request *request) {
  bool stored = true;
  for (size_t i = 0; i < request->media_count; i++) {
    const core_medium taken = taken_of(request, i);
    stored = stored && core_transport_is_stored(&taken);
  }
  return stored;
}

#define BELOW (1 - 1e-12) /* leaves room for rounding where errors are added */

/* Chooses the tolerance to prepare with. The numerical error may take a quarter of the tolerance
 * that the model's error leaves, but no more than the errors besides leave of that. If nothing is
 * left, the numerical error is the least that the evaluator can have. */
static void set_numerical_error(core_candidate *candidate, const struct cost *cost,
                                const core_choose_request *request) {
  const double besides = logarithm_error(request) + added_error(cost, request);
  const double left = (request->tolerance - candidate->model_error) / (1 + candidate->model_error);
  const double floor = cost->numerical_least - cost->tolerance_least;
  const double share = fmin(left / 4, left * BELOW - besides);
  const size_t which = cheapest_tolerance(cost, share - floor);
  candidate->numerical_tolerance = tolerances[which];
  const bool looked_up = cost->model == CORE_MODEL_TRANSPORT &&
                         cost->evaluator != CORE_EVALUATOR_LUT && are_stored(request);
  const double own = looked_up
                         ? fmin(tolerances[which], core_transport_slope_error()) /* the table's */
                         : tolerances[which];
  candidate->numerical_error = which > 0 ? own + floor : cost->numerical;
  candidate->cost_ns = cost->with[which].evaluate_ns;
  candidate->prepare_ns = cost->with[which].prepare_ns;
  if (share < cost->numerical && cost->numerical_least < cost->numerical) {
    candidate->numerical_tolerance = fmax(share - floor, cost->tolerance_least);
    candidate->numerical_error = candidate->numerical_tolerance + floor;
  }
  const bool slope = (request->wanted & CORE_QUANTITY_SLOPE) != 0;
  if (slope && cost->model == CORE_MODEL_TRANSPORT && cost->evaluator == CORE_EVALUATOR_LUT) {
    candidate->numerical_error = fmax(candidate->numerical_error, core_transport_slope_error());
  }
  candidate->numerical_error += besides;
}

/* Returns the time that the solver takes for a medium: the evaluator f64 solves each one if no
 * tolerance is given. */
static double solving_ns(void) {
  const struct cost *cost = costs;
  while (cost->model != CORE_MODEL_TRANSPORT || cost->evaluator != CORE_EVALUATOR_F64) {
    cost++;
  }
  return cost->with[0].prepare_ns;
}

/* Sets the cost of preparing `transport` for media that are not as those that were timed: their g is
 * other than 0, or its table does not hold one of them, which is then solved whatever the tolerance
 * is. */
static void set_cost_of_media(core_candidate *candidate, const core_choose_request *request) {
  bool with_g = candidate->model == CORE_MODEL_TRANSPORT;
  for (size_t i = 0; i < request->media_count; i++) {
    const core_medium taken = taken_of(request, i);
    with_g = with_g && (taken.g < 0 || taken.g > 0);
  }
  for (size_t i = 0; i < sizeof costs_with_g / sizeof costs_with_g[0] && with_g; i++) {
    if (costs_with_g[i].model == (unsigned)candidate->model &&
        costs_with_g[i].evaluator == (unsigned)candidate->evaluator) {
      candidate->prepare_ns = costs_with_g[i].prepare_ns;
    }
  }
  if (candidate->model == CORE_MODEL_TRANSPORT && !are_stored(request)) {
    candidate->prepare_ns = fmax(candidate->prepare_ns, solving_ns());
  }
}

/* ---- choosing -------------------------------------------------------------------------------- */

/* Returns how many values a medium has: one for each radius and elementwise quantity. */
static double value_count(const core_choose_request *request) {
  unsigned quantities = 0;
  for (unsigned left = request->wanted & ELEMENTWISE; left != 0; left &= left - 1) {
    quantities++;
  }
  return (double)request->radius_count * quantities;
}

static core_candidate make_candidate(const struct cost *cost, const core_choose_request *request) {
  core_candidate candidate = {
      .model = cost->model,
      .evaluator = cost->evaluator,
      .numerical_tolerance = (double)NAN,
      .model_error = model_error(cost, request),
      .numerical_error = (double)INFINITY,
      .error = (double)INFINITY,
      .cost_ns = cost->with[0].evaluate_ns,
      .prepare_ns = cost->with[0].prepare_ns,
  };
  if (candidate.model_error < (double)INFINITY) {
    set_numerical_error(&candidate, cost, request);
    set_cost_of_media(&candidate, request);
    candidate.error =
        candidate.model_error + (1 + candidate.model_error) * candidate.numerical_error;
  }
  candidate.total_ns = candidate.prepare_ns + value_count(request) * candidate.cost_ns;
  candidate.meets = candidate.error <= request->tolerance;
  return candidate;
}

/* Returns the position of the best candidate from position `first` on. */
static size_t best_of(const core_candidate *candidates, size_t first, size_t count) {
  double least_ns = (double)INFINITY;
  size_t best = first;
  for (size_t i = first; i < count; i++) {
    least_ns = candidates[i].meets ? fmin(least_ns, candidates[i].total_ns) : least_ns;
  }
  for (size_t i = first + 1; i < count; i++) {
    const core_candidate *one = &candidates[i], *other = &candidates[best];
    const double alike_ns = least_ns * CORE_CHOOSE_COST_ALIKE;
    const bool one_may = one->meets && one->total_ns <= alike_ns;
    const bool other_may = other->meets && other->total_ns <= alike_ns;
    if (one_may != other_may ? one_may : one->error < other->error) {
      best = i;
    }
  }
  return best;
}

/* Moves the candidate at position `from` up to position `to`; those between move down by one. */
static void move_up(core_candidate *candidates, size_t from, size_t to) {
  const core_candidate moved = candidates[from];
  for (size_t i = from; i > to; i--) {
    candidates[i] = candidates[i - 1];
  }
  candidates[to] = moved;
}

size_t core_choose(const core_choose_request *request,
                   core_candidate candidates[CORE_CANDIDATES_MAX]) {
  size_t count = 0;
  for (size_t i = 0; i < CORE_CANDIDATES_MAX && request->media_count > 0; i++) {
    if (request->single == (costs[i].evaluator != CORE_EVALUATOR_F64)) {
      candidates[count++] = make_candidate(&costs[i], request);
    }
  }
  for (size_t i = 0; i < count; i++) {
    move_up(candidates, best_of(candidates, i, count), i);
  }
  return count;
}
