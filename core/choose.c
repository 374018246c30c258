#include "core/choose.h"

#include <float.h>
#include <math.h>

#include "core/error_code.h"
#include "core/model_error.h"

/* ---- what was measured ------------------------------------------------------------------------
 */

static const double edges_mfp[] = {
#define CORE_TRADE_EDGE(mfp) mfp,
#include "core/tradeoff.def"
};

static const double ratios[] = {
#define CORE_TRADE_RATIO(ratio) ratio,
#include "core/tradeoff.def"
};

static const double etas[] = {
#define CORE_TRADE_ETA(eta) eta,
#include "core/tradeoff.def"
};

enum {
  BANDS = sizeof edges_mfp / sizeof edges_mfp[0] - 1,
  RATIOS = sizeof ratios / sizeof ratios[0],
  ETAS = sizeof etas / sizeof etas[0],
  DIGITS = 2,          /* of a code */
  CODES = (BANDS + 1), /* of a node: the last is the albedo's */
};

static const struct measured {
  unsigned model;
  bool similarity;
  char codes[RATIOS][ETAS * CODES * DIGITS + 1];
} measured[] = {
#define CORE_TRADE_MODEL(model, similarity, ...) {model, similarity, {__VA_ARGS__}},
#include "core/tradeoff.def"
};

enum { MEASURED = sizeof measured / sizeof measured[0] };

static const struct cost {
  unsigned model;
  unsigned evaluator;
  double evaluate_ns;
  double prepare_ns;
  double numerical; /* what a profile states by default */
  double numerical_least;
  double tolerance_least;
} costs[] = {
#define CORE_TRADE_COST(model, evaluator, ns, prepare_ns, numerical, numerical_least, least)       \
  {model, evaluator, ns, prepare_ns, numerical, numerical_least, least},
#include "core/tradeoff.def"
};

/* Between nodes the largest of the errors at the nodes around is exceeded now and then: measured at
 * 4141 media in between, in 1 % of all bands; in 1 of 10,000 by more than 2 %, at most by 7 %. */
#define BETWEEN_NODES 1.03

/* ---- where in the table -----------------------------------------------------------------------
 */

/* First and last of the neighbours of a value in a rising list, or of the bands that a range
 * touches. */
struct span {
  size_t first;
  size_t last;
};

#define SLACK 1e-9 /* what rounding may have moved out of the list */

/* False: outside of the list. */
static bool enclose(const double *list, size_t count, double value, struct span *span) {
  if (!(value >= list[0] * (1 - SLACK) && value <= list[count - 1] * (1 + SLACK))) {
    return false;
  }
  span->first = 0;
  while (span->first + 1 < count && list[span->first + 1] <= value) {
    span->first++;
  }
  span->last = list[span->first] < value && span->first + 1 < count ? span->first + 1 : span->first;
  return true;
}

static bool touch(core_radii_range mfp, struct span *bands) {
  struct span least, most;
  if (!enclose(edges_mfp, BANDS + 1, mfp.least_mm, &least) ||
      !enclose(edges_mfp, BANDS + 1, mfp.most_mm, &most)) {
    return false;
  }
  bands->first = least.first < BANDS ? least.first : BANDS - 1;
  bands->last = most.last > bands->first + 1 ? most.last - 1 : bands->first;
  return true;
}

static unsigned digit(char hexadecimal) {
  return (unsigned)(hexadecimal <= '9' ? hexadecimal - '0' : hexadecimal - 'a' + 10);
}

/* The largest error around a medium, of these codes of a node. */
static double worst(const struct measured *of, struct span ratio, struct span eta,
                    struct span which) {
  unsigned most = 0;
  for (size_t i = ratio.first; i <= ratio.last; i++) {
    for (size_t j = eta.first; j <= eta.last; j++) {
      for (size_t k = which.first; k <= which.last; k++) {
        const char *text = &of->codes[i][(j * CODES + k) * DIGITS];
        const unsigned code = 16 * digit(text[0]) + digit(text[1]);
        most = code > most ? code : most;
      }
    }
  }
  return core_error_of_code(most) * BETWEEN_NODES;
}

/* ---- the error of a model ---------------------------------------------------------------------
 */

struct errors {
  double R;
  double albedo;
};

static const struct errors unknown = {(double)INFINITY, (double)INFINITY};

/* Relative errors one upon the other. */
static double both(double a, double b) {
  return (1 + a) * (1 + b) - 1;
}

static core_radii_range in_mfp(const core_medium *medium, core_radii_range radii) {
  const double sigma_t_prime = medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g);
  return (core_radii_range){radii.least_mm * sigma_t_prime, radii.most_mm * sigma_t_prime};
}

/* For isotropic scattering. */
static struct errors isotropic_errors(unsigned model, const core_medium *medium,
                                      core_radii_range radii) {
  const double ratio = medium->sigma_a_per_mm / (medium->sigma_s_per_mm * (1 - medium->g));
  struct span at_ratio, at_eta, bands;
  if (model == CORE_MODEL_TRANSPORT) {
    return (struct errors){0, 0};
  }
  for (size_t i = 0; i < MEASURED; i++) {
    if (measured[i].model == model && enclose(ratios, RATIOS, ratio, &at_ratio) &&
        enclose(etas, ETAS, medium->eta, &at_eta)) {
      const bool measured_there = touch(in_mfp(medium, radii), &bands);
      const struct span albedo = {BANDS, BANDS};
      return (struct errors){measured_there ? worst(&measured[i], at_ratio, at_eta, bands)
                                            : (double)INFINITY,
                             worst(&measured[i], at_ratio, at_eta, albedo)};
    }
  }
  return unknown;
}

/* Whether it sees sigma_s (1 - g) alone. */
static bool sees_similarity(unsigned model) {
  for (size_t i = 0; i < MEASURED; i++) {
    if (measured[i].model == model) {
      return measured[i].similarity;
    }
  }
  return model == CORE_MODEL_TRANSPORT;
}

/* Of R, by the similarity relation; the albedo's was not measured. */
static double similarity_error(const core_medium *medium, core_radii_range radii) {
  const core_radii_range mfp = in_mfp(medium, radii);
  if (!(mfp.least_mm >= 0.1 * (1 - SLACK) && mfp.most_mm <= 20 * (1 + SLACK))) {
    return (double)INFINITY;
  }
  const double error = core_model_error(CORE_MODEL_TRANSPORT, medium, true);
  return isnan(error) ? (double)INFINITY : error;
}

static struct errors model_errors(unsigned model, const core_medium *medium,
                                  core_radii_range radii) {
  const struct errors isotropic = isotropic_errors(model, medium, radii);
  if (!(medium->g < 0 || medium->g > 0)) {
    return isotropic;
  }
  if (!sees_similarity(model)) {
    return unknown;
  }
  return (struct errors){both(isotropic.R, similarity_error(medium, radii)), (double)INFINITY};
}

/* ---- the error of what is wanted --------------------------------------------------------------
 */

enum {
  LIKE_R = CORE_QUANTITY_R | CORE_QUANTITY_RING | CORE_QUANTITY_S,
  UNMEASURED = CORE_QUANTITY_CDF | CORE_QUANTITY_SLOPE,
  ELEMENTWISE = LIKE_R | UNMEASURED | CORE_QUANTITY_LN_R | CORE_QUANTITY_PDF,
};

static double wanted_error(unsigned wanted, unsigned model, struct errors of) {
  double error = 0;
  if ((wanted & LIKE_R) != 0) {
    error = fmax(error, of.R);
  }
  if ((wanted & CORE_QUANTITY_ALBEDO) != 0) {
    error = fmax(error, of.albedo);
  }
  if ((wanted & CORE_QUANTITY_LN_R) != 0) { /* -ln(1 - e) < e / (1 - e) */
    error = fmax(error, of.R < 1 ? of.R / (1 - of.R) : (double)INFINITY);
  }
  if ((wanted & CORE_QUANTITY_PDF) != 0) { /* (1 + R) / (1 - albedo) - 1 */
    error = fmax(error, of.albedo < 1 ? (of.R + of.albedo) / (1 - of.albedo) : (double)INFINITY);
  }
  if ((wanted & UNMEASURED) != 0 && (model != CORE_MODEL_TRANSPORT || of.albedo > 0)) {
    return (double)INFINITY; /* the similarity relation's were not measured either */
  }
  return error;
}

/* Whether the medium is in the model's domain, and the radii are. */
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

/* The largest over the channels. */
static double model_error(const struct cost *cost, const core_choose_request *request) {
  double error = 0;
  if (cost->model != CORE_MODEL_TRANSPORT && request->moments != CORE_MOMENTS_EXACT) {
    return (double)INFINITY;
  }
  for (size_t i = 0; i < request->media_count && error < (double)INFINITY; i++) {
    const core_medium *medium = &request->media[i];
    const struct errors of = model_errors(cost->model, medium, request->radii);
    error = fmax(error, wanted_error(request->wanted, cost->model, of));
    if (error < (double)INFINITY && !accepts(cost, request, medium)) {
      error = (double)INFINITY;
    }
  }
  return error;
}

/* ---- the numerical error ----------------------------------------------------------------------
 */

/* ln R is off by 8 epsilon |ln R| besides, absolute: core/core.h. Within 20 mean free paths of a
 * medium of the table R is above e^-64 per squared mean free path; beyond, it falls by 1 for each
 * at most. */
static double logarithm_error(const core_choose_request *request) {
  double ln_R = 0;
  if ((request->wanted & CORE_QUANTITY_LN_R) == 0) {
    return 0;
  }
  for (size_t i = 0; i < request->media_count; i++) {
    ln_R = fmax(ln_R, 64 + 64 + in_mfp(&request->media[i], request->radii).most_mm);
  }
  return 8 * (request->single ? (double)FLT_EPSILON : DBL_EPSILON) * ln_R;
}

/* What to prepare with so that the numerical error takes a quarter of what the model leaves of the
 * tolerance; where the default takes less, the default. */
static void set_numerical_error(core_candidate *candidate, const struct cost *cost,
                                const core_choose_request *request) {
  const double left = (request->tolerance - candidate->model_error) / (1 + candidate->model_error);
  const double floor = cost->numerical_least - cost->tolerance_least;
  const double share = left / 4;
  candidate->numerical_tolerance = (double)NAN;
  candidate->numerical_error = cost->numerical;
  if (left > 0 && share < cost->numerical && cost->numerical_least < cost->numerical) {
    candidate->numerical_tolerance = fmax(share - floor, cost->tolerance_least);
    candidate->numerical_error = candidate->numerical_tolerance + floor;
  }
  candidate->numerical_error += logarithm_error(request);
}

/* ---- choosing ---------------------------------------------------------------------------------
 */

static core_candidate make_candidate(const struct cost *cost, const core_choose_request *request) {
  core_candidate candidate = {
      .model = cost->model,
      .evaluator = cost->evaluator,
      .numerical_tolerance = (double)NAN,
      .model_error = model_error(cost, request),
      .numerical_error = (double)INFINITY,
      .error = (double)INFINITY,
      .cost_ns = cost->evaluate_ns,
      .prepare_ns = cost->prepare_ns,
  };
  if (candidate.model_error < (double)INFINITY) {
    set_numerical_error(&candidate, cost, request);
    candidate.error = both(candidate.model_error, candidate.numerical_error);
  }
  candidate.meets = candidate.error <= request->tolerance;
  return candidate;
}

/* The one to be taken of the candidates from first on. */
static size_t best_of(const core_candidate *candidates, size_t first, size_t count) {
  double least_ns = (double)INFINITY;
  size_t best = first;
  for (size_t i = first; i < count; i++) {
    least_ns = candidates[i].meets ? fmin(least_ns, candidates[i].cost_ns) : least_ns;
  }
  for (size_t i = first + 1; i < count; i++) {
    const core_candidate *one = &candidates[i], *other = &candidates[best];
    const double alike_ns = least_ns * CORE_CHOOSE_COST_ALIKE;
    const bool one_may = one->meets && one->cost_ns <= alike_ns;
    const bool other_may = other->meets && other->cost_ns <= alike_ns;
    if (one_may != other_may ? one_may : one->error < other->error) {
      best = i;
    }
  }
  return best;
}

/* Moves one candidate up, before the others from `to` on. */
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
