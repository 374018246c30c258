/* Offers: lists the models and evaluators that could serve an eval, with their errors and costs.
 * Transport comes as an eval with a tolerance would get it (choice.h). The errors of other models are
 * computed from their profiles. */
#include <math.h>
#include <stdlib.h>

#include "server/jobs/eval.h"

struct offers_job {
  struct eval_job eval; /* the eval for which offers are made */
  uint32_t medium;      /* index of the next medium to compare */
  size_t model;         /* index of the model in core_costed_models */
  struct {              /* of each model, over the media so far; INFINITY if not known */
    double model, numerical;
  } errors[CORE_CANDIDATES_MAX / 2];
};

JOB_STRUCTURE(struct offers_job, offers_of)

static core_choose_request request_of(const struct offers_job *offers) {
  return choice_request(&offers->eval.request, offers->eval.radii);
}

/* ---- comparing ------------------------------------------------------------------------------- */

static enum core_evaluator evaluator_of(const struct offers_job *offers) {
  return offers->eval.value_bytes == sizeof(float) ? CORE_EVALUATOR_F32 : CORE_EVALUATOR_F64;
}

/* Gets the profiles of the next model and of transport, for the next medium. *fault: why there is
 * none. */
static enum lookup_state get_profiles(struct offers_job *offers, unsigned model,
                                      const core_medium *medium, core_fault *fault) {
  struct eval_job *eval = &offers->eval;
  struct profiles *profiles = &eval->job.context->profiles;
  const core_parameters none = core_parameters_none();
  core_radii_range range;
  *fault =
      core_profile_check(model, CORE_MOMENTS_EXACT, evaluator_of(offers), medium, &none, &range);
  const bool covers =
      eval->radii.least_mm >= range.least_mm && eval->radii.most_mm <= range.most_mm;
  if (fault->field != NULL || !covers || !core_ruler_is_needed(model, &none, medium, false)) {
    return LOOKUP_FAULT;
  }
  enum lookup_state state = profiles_get_ruler(profiles, &eval->ruler, model, &none, medium, false);
  *fault = eval->ruler.fault;
  if (state != LOOKUP_READY) {
    return state;
  }
  profiles_start(&eval->lookup, model, CORE_MOMENTS_EXACT, evaluator_of(offers), &none);
  state = profiles_get(profiles, &eval->lookup, medium);
  *fault = eval->lookup.fault;
  return state;
}

/* Raises the errors of the model to those for this medium. */
static void compare_model(struct offers_job *offers, bool known) {
  const struct eval_job *eval = &offers->eval;
  const core_requested_radii requested = {eval->grid, eval->request.radii, eval->radii};
  const unsigned wanted = request_of(offers).wanted;
  double model = (double)INFINITY, numerical = (double)INFINITY;
  if (known) {
    const core_stated_errors errors =
        core_profile_errors(&eval->lookup.profile, wanted, eval->radii);
    const double found =
        core_model_error(&eval->lookup.profile, &eval->ruler.profile, wanted, &requested);
    const bool any = eval->grid.count > 0;
    model = isnan(found) ? (double)INFINITY : found;
    numerical = errors.numerical + (any ? errors.numerical_per_mm * eval->radii.most_mm : 0);
  }
  offers->errors[offers->model].model = fmax(offers->errors[offers->model].model, model);
  offers->errors[offers->model].numerical =
      fmax(offers->errors[offers->model].numerical, numerical);
}

/* Compares the next model for the next medium. */
static enum job_outcome step_offers(struct job *job, uint64_t *budget) {
  struct offers_job *offers = offers_of(job);
  struct eval_job *eval = &offers->eval;
  const unsigned model = core_costed_models[offers->model];
  *budget -= *budget < JOB_SLICE_RADII ? *budget : JOB_SLICE_RADII;
  if (model == 0) {
    profiles_return(&eval->ruler);
    offers->model = 0;
    offers->medium++;
  } else {
    core_fault fault;
    const enum lookup_state state =
        get_profiles(offers, model, eval_job_medium(eval, offers->medium), &fault);
    if (state == LOOKUP_WAIT) {
      return JOB_WAITS;
    }
    if (state == LOOKUP_FAULT && fault.field != NULL && lookup_is_busy(fault)) {
      return job_refuse(job, job_fault(fault, offers->medium));
    }
    compare_model(offers, state == LOOKUP_READY);
    profiles_return(&eval->lookup);
    offers->model++;
  }
  if (offers->medium < eval->request.fixed.medium_count) {
    return JOB_GOES_ON;
  }
  const size_t evaluators = evaluator_of(offers) == CORE_EVALUATOR_F32 ? 2 : 1;
  job->part_bytes =
      WIRE_BYTES_offers_reply + CORE_CANDIDATES_MAX / 2 * evaluators * (size_t)WIRE_BYTES_offer;
  return JOB_NEXT_PART;
}

static enum job_outcome start_offers(struct job *job, const struct job_request *request) {
  struct offers_job *offers = offers_of(job);
  if (!job_passes(job, eval_job_offers(&offers->eval, request))) {
    return JOB_REFUSED;
  }
  offers->eval.repeated = NULL;
  offers->eval.head = NULL;
  job_init_lookup(job, &offers->eval.ruler, request);
  job_init_lookup(job, &offers->eval.lookup, request);
  offers->medium = 0;
  offers->model = 0;
  for (size_t i = 0; i < CORE_CANDIDATES_MAX / 2; i++) {
    offers->errors[i].model = offers->errors[i].numerical = 0;
  }
  return JOB_GOES_ON;
}

/* ---- listing --------------------------------------------------------------------------------- */

static int by_cost(const void *a, const void *b) {
  const core_candidate *left = a, *right = b;
  const int cost = (left->total_ns > right->total_ns) - (left->total_ns < right->total_ns);
  const int model = (int)left->model - (int)right->model;
  const int evaluator = (int)left->evaluator - (int)right->evaluator;
  return cost != 0 ? cost : model != 0 ? model : evaluator;
}

/* Lists all candidates by cost. Returns their number and sets *taken to the position of the one that
 * an eval would get, or to their number if it would get none. */
static size_t list_candidates(const struct offers_job *offers, core_candidate *candidates,
                              size_t *taken) {
  const core_choose_request requested = request_of(offers);
  size_t count = core_choose(&requested, candidates);
  const core_candidate first = candidates[0];
  for (size_t i = 0; core_costed_models[i] != 0 && count > 0; i++) {
    const unsigned model = core_costed_models[i];
    if (core_solves(model)) {
      continue;
    }
    core_offer(&candidates[count++], &requested, model, evaluator_of(offers),
               offers->errors[i].model, offers->errors[i].numerical);
    if (requested.single) {
      core_offer(&candidates[count++], &requested, model, CORE_EVALUATOR_LUT,
                 offers->errors[i].model, fmax(offers->errors[i].numerical, CORE_LUT_TOLERANCE));
    }
  }
  qsort(candidates, count, sizeof *candidates, by_cost);
  *taken = 0;
  while (*taken < count && (!first.meets || by_cost(&candidates[*taken], &first) != 0)) {
    ++*taken;
  }
  return count;
}

static enum job_outcome put_offers(struct job *job, uint8_t *at) {
  core_candidate candidates[CORE_CANDIDATES_MAX];
  size_t taken;
  const size_t count = list_candidates(offers_of(job), candidates, &taken);
  const wire_offers_reply reply = {.count = (uint32_t)count, .taken = (uint32_t)taken};
  wire_put_offers_reply(at, &reply);
  at += WIRE_BYTES_offers_reply;
  for (size_t i = 0; i < count; i++) {
    const core_candidate *candidate = &candidates[i];
    const wire_offer offer = {
        .model = (uint16_t)candidate->model,
        .evaluator = (uint16_t)candidate->evaluator,
        .meets = candidate->meets,
        .error = candidate->error,
        .numerical_error = candidate->numerical_error,
        .cost = candidate->cost_ns,
        .prepare_cost = candidate->prepare_ns,
    };
    wire_put_offer(at, &offer);
    at += WIRE_BYTES_offer;
  }
  return JOB_DONE;
}

const struct job_kind job_kind_OFFERS = {
    .start = start_offers, .begin_part = put_offers, .step = step_offers, .end = eval_job_end};
