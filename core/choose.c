#include "core/choose.h"

#include <assert.h>
#include <float.h>
#include <math.h>

#include "core/kernels.h"
#include "core/solver/solver.h"

static const struct cost {
  unsigned model;
  double radius_ns[2]; /* time of one radius, in f64 and in f32 */
  double prepare_ns;
  double prepare_lut_ns;
} costs[] = {
#define COST(model, f64, f32, prepare, prepare_lut) {model, {f64, f32}, prepare, prepare_lut},
    CORE_EACH_COST(COST)};

#define MODEL(model, ...) model,
const unsigned core_costed_models[] = {CORE_EACH_COST(MODEL) 0};

enum {
  FOLLOWS_R = CORE_QUANTITY_R | CORE_MULTIPLES | CORE_QUANTITY_SLOPE | CORE_QUANTITY_LN_R,
  ELEMENTWISE = FOLLOWS_R | CORE_QUANTITY_CDF | CORE_QUANTITY_TRANSFER,
};

/* ---- errors ---------------------------------------------------------------------------------- */

/* Returns the layers of a medium. */
static const core_medium *medium_at(const core_choose_request *request, size_t i) {
  return &request->media[i * request->layer_count];
}

static bool is_half_space(const core_medium *medium) {
  return !(medium->thickness_mm > 0);
}

/* Returns whether `transport` is valid for all media of the request. */
static bool is_taken(const core_choose_request *request) {
  core_parameters parameters = core_parameters_none();
  bool taken = true;
  parameters.layer_count = request->layer_count;
  parameters.value[CORE_PARAMETER_ETA_BELOW] = request->eta_below;
  for (size_t i = 0; i < request->media_count && taken; i++) {
    taken = core_profile_check(CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64,
                               medium_at(request, i), &parameters, NULL)
                .field == NULL;
  }
  return taken;
}

/* The largest errors of the media of a request. */
struct media_errors {
  double table; /* of R in the table of solutions; INFINITY if that does not cover one of them */
  double added; /* besides, beyond the reach and for anisotropic scattering */
  double slope; /* of dR/dr in the table; 0 if it is not wanted */
  double ln_R;  /* the bound 8 epsilon |ln R| that core/core.h adds; 0 if ln R is not wanted */
};

/* Within 20 mean free paths of any medium that was measured, R is above e^-64 per squared mean free
 * path. Beyond, ln R falls by at most 1 per mean free path. */
static struct media_errors media_errors_of(const core_choose_request *request) {
  const double epsilon = request->single ? (double)FLT_EPSILON : DBL_EPSILON;
  const double most_mm = request->radii.most_mm;
  struct media_errors errors = {0};
  for (size_t i = 0; i < request->media_count; i++) {
    const core_medium *medium = medium_at(request, i);
    const bool stored = is_half_space(medium) && core_transport_is_stored(medium);
    const double table = stored ? core_transport_table_error(medium) : (double)INFINITY;
    const double beyond = core_error_beyond(core_transport_reach(medium),
                                            (request->wanted & FOLLOWS_R) != 0 ? most_mm : 0);
    core_added_errors added;
    core_transport_added_errors(medium, &added);
    errors.table = fmax(errors.table, table);
    errors.added = fmax(errors.added, beyond + core_banded_error(added.banded, added.all, medium,
                                                                 request->wanted, request->radii));
    if ((request->wanted & CORE_QUANTITY_SLOPE) != 0) {
      errors.slope = fmax(errors.slope, core_transport_slope_error(medium->g) + DBL_EPSILON);
    }
    if ((request->wanted & CORE_QUANTITY_LN_R) != 0) {
      const double ln_R = 64 + 64 + most_mm * core_sigma_t_prime(medium);
      errors.ln_R = fmax(errors.ln_R, 8 * epsilon * ln_R);
    }
  }
  return errors;
}

/* Rounding adds to the tolerance and to the error of the table. */
#define ROUNDING_F32 1.3e-7

/* Tolerances that are preferred: requests with equal tolerances share prepared profiles. */
#define LOOSE 1e-3
#define BELOW (1 - 1e-12) /* the margin for rounding where errors are added */

/* Sets the parameter `tolerance` of the preparation, and the numerical error. left: the largest
 * value allowed for that error. */
static void set_numerical_error(core_candidate *candidate, const core_choose_request *request,
                                const struct media_errors *errors, double left) {
  const bool lut = candidate->evaluator == CORE_EVALUATOR_LUT;
  const double rounding = request->single && !lut ? ROUNDING_F32 : 0;
  const double of_table = errors->table;
  const double least = fmax(CORE_LUT_TOLERANCE_MIN, 2 * of_table);
  const double tolerance = fmin(fmax(left * BELOW, least), LOOSE);
  candidate->looked_up = true;
  candidate->numerical_tolerance = lut ? tolerance : (double)NAN;
  candidate->numerical_error = isinf(of_table) ? (double)INFINITY
                               : lut           ? fmax(tolerance, errors->slope)
                                     : rounding + fmax(of_table + DBL_EPSILON, errors->slope);
}

/* Errors of the cdf, of the quantities that follow from it, and of dR/dr, over the error of R: see
 * core/models/transport.c. */
#define CDF_ERRORS 2
#define SLOPE_ERRORS 8

/* Sets the candidate to the solver. left: the largest numerical error that its profile may have. */
static void set_solved(core_candidate *candidate, const core_choose_request *request, double left) {
  const bool follows_R = (request->wanted & FOLLOWS_R) != 0;
  const bool of_cdf = (request->wanted & (ELEMENTWISE & ~FOLLOWS_R)) != 0;
  bool near = of_cdf || (request->wanted & (CORE_QUANTITY_PDF | CORE_QUANTITY_SLOPE)) != 0;
  bool layered = false;
  double beyond = 0;
  for (size_t i = 0; i < request->media_count; i++) {
    const core_medium *medium = medium_at(request, i);
    if (!is_half_space(medium)) {
      layered = true;
      continue; /* The errors of layers are nearly the same at all radii. */
    }
    if (follows_R) {
      near |= request->radii.least_mm * core_sigma_t_prime(medium) < SOLVER_NEAR;
      beyond =
          fmax(beyond, core_error_beyond(core_transport_reach(medium), request->radii.most_mm));
    }
  }
  const bool doubled = of_cdf || (request->wanted & CORE_QUANTITY_PDF) != 0;
  const double errors = (request->wanted & CORE_QUANTITY_SLOPE) != 0 ? SLOPE_ERRORS
                        : doubled                                    ? CDF_ERRORS
                                                                     : 1;
  const double rounding = request->single ? ROUNDING_F32 : 0, of_R = (left - rounding) / errors;
  const double least = near ? SOLVER_LEAST_NEAR : SOLVER_LEAST;
  if (of_R >= least + beyond) {
    const double tolerance = of_R * BELOW / (near ? SOLVER_NEAR_FACTOR : 1);
    candidate->looked_up = false;
    candidate->left = left;
    candidate->numerical_tolerance = tolerance >= LOOSE && !layered   ? (double)NAN
                                     : tolerance >= SOLVER_NOT_FINEST ? tolerance
                                                                      : CORE_TOLERANCE_FINEST;
    candidate->numerical_error = left;
  } else if (isinf(candidate->numerical_error)) {
    candidate->looked_up = false;
    candidate->left = left;
    candidate->numerical_tolerance = CORE_TOLERANCE_FINEST;
    const double missed = request->tolerance * (1 + 1e-6); /* errors of quantities other than R */
    candidate->numerical_error = fmax(errors * (least + beyond) + rounding, missed);
  }
}

/* ---- costs ----------------------------------------------------------------------------------- */

static const struct cost *cost_of(unsigned model) {
  const struct cost *cost = costs;
  while (cost->model != model) {
    cost++;
    assert(cost < costs + sizeof costs / sizeof costs[0]);
  }
  return cost;
}

/* Returns the number of values for one medium: one for each radius and elementwise quantity. */
static double value_count(const core_choose_request *request) {
  return (double)request->radius_count * __builtin_popcount(request->wanted & ELEMENTWISE);
}

/* Sets the costs of the candidate and its total error and time. */
static void finish_candidate(core_candidate *candidate, const core_choose_request *request) {
  const struct cost *cost = cost_of(candidate->model);
  const bool lut = candidate->evaluator == CORE_EVALUATOR_LUT;
  candidate->cost_ns =
      lut ? CORE_COST_LUT_NS : cost->radius_ns[candidate->evaluator == CORE_EVALUATOR_F32];
  candidate->prepare_ns = lut ? cost->prepare_lut_ns : cost->prepare_ns;
  if (!candidate->looked_up) {
    candidate->prepare_ns += CORE_COST_SOLVE_NS;
  }
  candidate->error =
      candidate->model_error + (1 + candidate->model_error) * candidate->numerical_error;
  candidate->total_ns = candidate->prepare_ns + value_count(request) * candidate->cost_ns;
  candidate->meets = candidate->error <= request->tolerance;
}

void core_offer(core_candidate *candidate, const core_choose_request *request, unsigned model,
                enum core_evaluator evaluator, double model_error, double numerical_error) {
  *candidate = (core_candidate){.model = model,
                                .evaluator = evaluator,
                                .numerical_tolerance = (double)NAN,
                                .model_error = model_error,
                                .numerical_error = numerical_error,
                                .looked_up = true};
  finish_candidate(candidate, request);
}

/* ---- choosing -------------------------------------------------------------------------------- */

/* Returns transport by the table of solutions, whose error is INFINITY if that lacks a medium.
 * errors: NULL if transport is not valid for the media. */
static core_candidate look_up(const core_choose_request *request, enum core_evaluator evaluator,
                              const struct media_errors *errors) {
  core_candidate candidate = {.model = CORE_MODEL_TRANSPORT,
                              .evaluator = evaluator,
                              .numerical_tolerance = (double)NAN,
                              .left = (double)NAN,
                              .numerical_error = (double)INFINITY};
  if (errors != NULL) {
    const double besides = errors->ln_R + errors->added;
    set_numerical_error(&candidate, request, errors, request->tolerance - besides);
    candidate.numerical_error += besides;
  }
  finish_candidate(&candidate, request);
  return candidate;
}

/* Returns transport by the table, or solved if the table misses the tolerance. */
static core_candidate make_candidate(const core_choose_request *request,
                                     enum core_evaluator evaluator,
                                     const struct media_errors *errors) {
  core_candidate candidate = look_up(request, evaluator, errors);
  if (!candidate.meets && evaluator != CORE_EVALUATOR_LUT && errors != NULL) {
    set_solved(&candidate, request, request->tolerance * BELOW - errors->ln_R);
    candidate.numerical_error += candidate.looked_up ? 0 : errors->ln_R;
    finish_candidate(&candidate, request);
  }
  return candidate;
}

double core_choose_stored_error(const core_choose_request *request) {
  const bool taken = is_taken(request);
  const struct media_errors errors = taken ? media_errors_of(request) : (struct media_errors){0};
  return look_up(request, request->single ? CORE_EVALUATOR_F32 : CORE_EVALUATOR_F64,
                 taken ? &errors : NULL)
      .error;
}

/* Returns whether candidate `one` is preferred to `other`. */
static bool is_better(const core_candidate *one, const core_candidate *other) {
  return one->meets != other->meets ? one->meets
         : one->meets               ? one->total_ns < other->total_ns
                                    : one->error < other->error;
}

size_t core_choose(const core_choose_request *request,
                   core_candidate candidates[CORE_TRANSPORT_CANDIDATES]) {
  if (request->media_count == 0) {
    return 0;
  }
  const bool taken = is_taken(request);
  const struct media_errors found = taken ? media_errors_of(request) : (struct media_errors){0};
  const struct media_errors *errors = taken ? &found : NULL;
  if (!request->single) {
    candidates[0] = make_candidate(request, CORE_EVALUATOR_F64, errors);
    return 1;
  }
  const core_candidate f32 = make_candidate(request, CORE_EVALUATOR_F32, errors);
  const core_candidate lut = make_candidate(request, CORE_EVALUATOR_LUT, errors);
  const bool table_first = is_better(&lut, &f32);
  candidates[0] = table_first ? lut : f32;
  candidates[1] = table_first ? f32 : lut;
  return 2;
}
