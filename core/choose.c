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
#define CORE_COST(model, f64, f32, prepare, prepare_lut) {model, {f64, f32}, prepare, prepare_lut},
#include "core/costs.def"
};

const unsigned core_costed_models[] = {
#define CORE_COST(model, f64, f32, prepare, prepare_lut) model,
#include "core/costs.def"
    0};

static const double lut_ns =
#define CORE_COST_LUT(lut) lut
#include "core/costs.def"
    ;

static const double solve_ns =
#define CORE_COST_SOLVE(solve) solve
#include "core/costs.def"
    ;

enum {
  FOLLOWS_R = CORE_QUANTITY_R | CORE_QUANTITY_RING | CORE_QUANTITY_S | CORE_QUANTITY_SLOPE |
              CORE_QUANTITY_LN_R | CORE_QUANTITY_PDF,
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

/* Returns the error that is added to the numerical error, beyond the reach and for anisotropic
 * scattering. */
static double added_error(const core_choose_request *request) {
  double error = 0;
  for (size_t i = 0; i < request->media_count; i++) {
    const core_medium *medium = medium_at(request, i);
    const double most_mm = (request->wanted & FOLLOWS_R) != 0 ? request->radii.most_mm : 0;
    core_added_errors added;
    core_transport_added_errors(medium, &added);
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
    ln_R = fmax(ln_R, 64 + 64 + request->radii.most_mm * core_sigma_t_prime(medium_at(request, i)));
  }
  return 8 * (request->single ? (double)FLT_EPSILON : DBL_EPSILON) * ln_R;
}

/* Returns the largest error of R in the table of solutions over all media; INFINITY if the table
 * does not cover one of them. */
static double table_error(const core_choose_request *request) {
  double error = 0;
  for (size_t i = 0; i < request->media_count; i++) {
    const core_medium *medium = medium_at(request, i);
    error = fmax(error, is_half_space(medium) && core_transport_is_stored(medium)
                            ? core_transport_table_error(medium)
                            : (double)INFINITY);
  }
  return error;
}

/* Returns the error of dR/dr in the table for all media, or 0 if it is not wanted. */
static double slope_error(const core_choose_request *request) {
  double error = 0;
  for (size_t i = 0; i < request->media_count && (request->wanted & CORE_QUANTITY_SLOPE) != 0;
       i++) {
    error = fmax(error, core_transport_slope_error(medium_at(request, i)->g));
  }
  return error > 0 ? error + DBL_EPSILON : 0;
}

/* Rounding adds to the tolerance and to the error of the table. */
#define ROUNDING_F32 1.3e-7

/* Tolerances that are preferred: requests with equal tolerances share prepared profiles. */
#define LOOSE 1e-3
#define BELOW (1 - 1e-12) /* the margin for rounding where errors are added */

/* Sets the parameter `tolerance` of the preparation, and the numerical error. left: the largest
 * value allowed for that error. */
static void set_numerical_error(core_candidate *candidate, const core_choose_request *request,
                                double left) {
  const bool lut = candidate->evaluator == CORE_EVALUATOR_LUT;
  const double rounding = request->single && !lut ? ROUNDING_F32 : 0;
  const double of_table = table_error(request);
  const double least = fmax(CORE_LUT_TOLERANCE_MIN, 2 * of_table);
  const double tolerance = fmin(fmax(left * BELOW, least), LOOSE);
  const double of_slope = slope_error(request);
  candidate->looked_up = true;
  candidate->numerical_tolerance = lut ? tolerance : (double)NAN;
  candidate->numerical_error = isinf(of_table) ? (double)INFINITY
                               : lut           ? fmax(tolerance, of_slope)
                                               : rounding + fmax(of_table + DBL_EPSILON, of_slope);
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
  candidate->cost_ns = lut ? lut_ns : cost->radius_ns[candidate->evaluator == CORE_EVALUATOR_F32];
  candidate->prepare_ns = lut ? cost->prepare_lut_ns : cost->prepare_ns;
  if (!candidate->looked_up) {
    candidate->prepare_ns += solve_ns;
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

/* Returns transport by the table of solutions, whose error is INFINITY if that lacks a medium. */
static core_candidate look_up(const core_choose_request *request, enum core_evaluator evaluator) {
  core_candidate candidate = {.model = CORE_MODEL_TRANSPORT,
                              .evaluator = evaluator,
                              .numerical_tolerance = (double)NAN,
                              .left = (double)NAN,
                              .numerical_error = (double)INFINITY};
  if (is_taken(request)) {
    const double besides = logarithm_error(request) + added_error(request);
    set_numerical_error(&candidate, request, request->tolerance - besides);
    candidate.numerical_error += besides;
  }
  finish_candidate(&candidate, request);
  return candidate;
}

/* Returns transport by the table, or solved if the table misses the tolerance. */
static core_candidate make_candidate(const core_choose_request *request,
                                     enum core_evaluator evaluator) {
  core_candidate candidate = look_up(request, evaluator);
  if (!candidate.meets && evaluator != CORE_EVALUATOR_LUT && is_taken(request)) {
    const double of_ln_R = logarithm_error(request);
    set_solved(&candidate, request, request->tolerance * BELOW - of_ln_R);
    candidate.numerical_error += candidate.looked_up ? 0 : of_ln_R;
    finish_candidate(&candidate, request);
  }
  return candidate;
}

double core_choose_stored_error(const core_choose_request *request) {
  return look_up(request, request->single ? CORE_EVALUATOR_F32 : CORE_EVALUATOR_F64).error;
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
  if (!request->single) {
    candidates[0] = make_candidate(request, CORE_EVALUATOR_F64);
    return 1;
  }
  const core_candidate f32 = make_candidate(request, CORE_EVALUATOR_F32);
  const core_candidate lut = make_candidate(request, CORE_EVALUATOR_LUT);
  const bool table_first = is_better(&lut, &f32);
  candidates[0] = table_first ? lut : f32;
  candidates[1] = table_first ? f32 : lut;
  return 2;
}
