#include "server/jobs/choice.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/jobs/job.h"

enum { ROUNDED_BYTES = 12, ALLOWED_BYTES = sizeof((wire_error *)0)->allowed };

static wire_error check_media(const eval_request *request) {
  const uint32_t layers = request->fixed.layer_count;
  wire_error error = wire_error_none();
  for (uint32_t i = 0; error.status == WIRE_STATUS_OK && i < request->fixed.medium_count; i++) {
    const core_medium *medium = &request->media[(size_t)i * layers];
    const core_fault fault =
        layers > 1 || medium->thickness_mm > 0
            ? core_profile_check(CORE_MODEL_TRANSPORT, request->fixed.moments, CORE_EVALUATOR_F64,
                                 medium, &request->parameters, NULL)
            : core_layers_check(medium, layers);
    error = job_error_behind(fault, (size_t)i * layers);
  }
  return error;
}

/* Returns the quantities whose errors count. Without radii, only the albedo has a value. */
static unsigned wanted_of(const wire_eval_request *fixed) {
  return fixed->radius_count > 0 ? fixed->wanted : fixed->wanted & CORE_QUANTITY_ALBEDO;
}

wire_error choice_check(const eval_request *request) {
  const double tolerance = request->parameters.value[CORE_PARAMETER_TOLERANCE];
  if (isnan(tolerance)) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "model",
                           "a model of the list, or in its place a tolerance");
  }
  if (core_wants_derivatives(request->fixed.wanted) ||
      (request->fixed.wanted & (CORE_MODULATED | CORE_QUANTITY_BALANCE)) != 0) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "wanted",
                           "no derivatives or balance with a tolerance in place of a model");
  }
  if (!isnan(request->parameters.value[CORE_PARAMETER_GAMMA])) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "gamma",
                           "nothing without a model: the error with gamma is not known");
  }
  const wire_error error = job_error(core_parameter_check(CORE_PARAMETER_TOLERANCE, tolerance));
  return error.status == WIRE_STATUS_OK ? check_media(request) : error;
}

core_choose_request choice_request(const eval_request *request, core_radii_range radii) {
  const wire_eval_request *fixed = &request->fixed;
  return (core_choose_request){
      .media = request->media,
      .media_count = fixed->medium_count,
      .layer_count = fixed->layer_count,
      .eta_below = request->parameters.value[CORE_PARAMETER_ETA_BELOW],
      .wanted = wanted_of(fixed),
      .radii = radii,
      .radius_count = fixed->radius_count,
      .single = core_evaluator_bytes(fixed->evaluator) == sizeof(float),
      .tolerance = request->parameters.value[CORE_PARAMETER_TOLERANCE],
  };
}

/* ---- refusing -------------------------------------------------------------------------------- */

/* Returns the best candidate. */
static core_candidate best_of(const core_choose_request *requested) {
  core_candidate candidates[CORE_TRANSPORT_CANDIDATES];
  core_choose(requested, candidates);
  return candidates[0];
}

/* Writes a positive number with three digits, rounded up. */
static void round_up(char text[ROUNDED_BYTES], double value) {
  snprintf(text, ROUNDED_BYTES, "%.3g", value);
  for (double from = value; strtod(text, NULL) < value;) {
    from += 1e-3 * value;
    snprintf(text, ROUNDED_BYTES, "%.3g", from);
  }
}

/* Returns the medium whose error alone is the largest. */
static size_t worst_medium(const core_choose_request *requested) {
  core_choose_request one = *requested;
  size_t worst = 0;
  double most = -1;
  one.media_count = 1;
  for (size_t i = 0; i < requested->media_count; i++) {
    one.media = &requested->media[i * requested->layer_count];
    const double error = best_of(&one).error;
    worst = error > most ? i : worst;
    most = fmax(most, error);
  }
  return worst;
}

/* Whether an error below 1 is known for a usual medium in which one coefficient has this value. */
static bool is_known(const core_choose_request *requested, unsigned which, double value) {
  core_medium medium = {1, 1, 0, 1.3};
  core_choose_request one = *requested;
  *(which == 0 ? &medium.g : which == 1 ? &medium.eta : &medium.sigma_a_per_mm) = value;
  medium.sigma_s_per_mm /= 1 - medium.g;
  one.media = &medium;
  one.media_count = one.layer_count = 1;
  one.radii.least_mm = one.radii.most_mm = 1 / (medium.sigma_a_per_mm + 1);
  return best_of(&one).error <= 1;
}

/* Whether an error below 1 is known for a medium at one radius. */
static bool is_known_at(const core_choose_request *requested, size_t medium, double r_mm) {
  core_choose_request one = *requested;
  one.media = &requested->media[medium * requested->layer_count];
  one.media_count = 1;
  one.radii.least_mm = one.radii.most_mm = r_mm;
  return best_of(&one).error <= 1;
}

/* Writes which coefficient of a medium no error is known for, and up to where one is; else from which
 * radius on. */
static void describe_cause(const core_choose_request *requested, size_t worst, char *text,
                           size_t bytes) {
  const core_medium *medium = &requested->media[worst * requested->layer_count];
  const double reduced = medium->sigma_s_per_mm * (1 - medium->g);
  const double ratio = medium->sigma_a_per_mm / reduced;
  const struct {
    const char *name;
    double usual, given;
  } coefficients[] = {
      {"g", 0, medium->g}, {"eta", 1.3, medium->eta}, {"sigma_a/sigma_s'", 1, ratio}};
  for (unsigned i = 0; i < 3; i++) {
    double good = coefficients[i].usual, bad = coefficients[i].given;
    if (is_known(requested, i, good) && !is_known(requested, i, bad)) {
      for (int halving = 0; halving < 40; halving++) {
        const double middle = 0.5 * (good + bad);
        *(is_known(requested, i, middle) ? &good : &bad) = middle;
      }
      snprintf(text, bytes, ": %s %.4g is %s %.2g", coefficients[i].name, coefficients[i].given,
               bad > coefficients[i].usual ? "above" : "below", good);
      return;
    }
  }
  double near = 1 / (medium->sigma_a_per_mm + reduced), far = requested->radii.most_mm;
  if (is_known_at(requested, worst, near) && !is_known_at(requested, worst, far)) {
    for (int halving = 0; halving < 40; halving++) {
      const double middle = 0.5 * (near + far);
      *(is_known_at(requested, worst, middle) ? &near : &far) = middle;
    }
    snprintf(text, bytes, ": r %.4g mm is above %.3g", requested->radii.most_mm, near);
  }
}

/* Returns the candidate for the least tolerance from which on candidates are known to meet it, up to
 * the error of the best one: what is solved meets tolerances below the error of the table. */
static core_candidate least_that_meets(const core_choose_request *requested) {
  core_choose_request one = *requested;
  core_candidate best = best_of(requested);
  double missed = requested->tolerance;
  for (int halving = 0; halving < 40 && best.error <= 1; halving++) {
    one.tolerance = sqrt(missed * best.error);
    const core_candidate candidate = best_of(&one);
    if (candidate.meets && candidate.error < best.error) {
      best = candidate;
    } else {
      missed = one.tolerance;
    }
  }
  return best;
}

/* Returns the refusal of a tolerance that no candidate keeps. */
static wire_error none_meets(const core_choose_request *requested) {
  char allowed[ALLOWED_BYTES], medium[32] = "", least[ROUNDED_BYTES];
  const size_t worst = worst_medium(requested);
  const core_candidate best = least_that_meets(requested);
  if (requested->media_count > 1) {
    snprintf(medium, sizeof medium, " for medium %zu", worst + 1);
  }
  if (best.error <= 1) { /* as large as the parameter may be */
    round_up(least, best.error);
    snprintf(allowed, sizeof allowed, "at least %s%s (best: %s, %s)", least, medium,
             core_choice_by_id(core_models, best.model)->name,
             best.looked_up ? core_choice_by_id(core_evaluators, best.evaluator)->name : "solved");
  } else {
    char cause[48] = "";
    describe_cause(requested, worst, cause, sizeof cause);
    snprintf(allowed, sizeof allowed, "a model instead: no error known%s", cause);
    if (strlen(allowed) + strlen(medium) < sizeof allowed) {
      strcat(allowed, medium);
    }
  }
  wire_error error = wire_error_make(WIRE_STATUS_BAD_VALUE, "tolerance", allowed);
  error.index = worst;
  return error;
}

/* ---- taking ---------------------------------------------------------------------------------- */

/* Writes the next candidate into the request. Returns false if there is none left, or if it cannot
 * keep the tolerance. What only the solver has is solved, whatever the tolerance is, so that a refusal
 * can say what it reaches. */
static bool take_next(struct choice_state *state, const core_choose_request *requested,
                      eval_request *request) {
  core_candidate candidates[CORE_TRANSPORT_CANDIDATES];
  const size_t count = core_choose(requested, candidates);
  const core_candidate *candidate = &candidates[state->tried];
  if (state->tried >= count ||
      !(candidate->meets || (!candidate->looked_up && candidate->error <= 1))) {
    return false;
  }
  state->tried++;
  request->fixed.model = (uint16_t)candidate->model;
  request->fixed.evaluator = (uint16_t)candidate->evaluator;
  request->parameters.value[CORE_PARAMETER_TOLERANCE] = candidate->numerical_tolerance;
  state->left = candidate->left;
  return true;
}

wire_error choice_first(struct choice_state *state, eval_request *request, core_radii_range radii) {
  const core_choose_request requested = choice_request(request, radii);
  *state = (struct choice_state){.tolerance = requested.tolerance};
  return take_next(state, &requested, request) ? wire_error_none() : none_meets(&requested);
}

/* ---- preparing ------------------------------------------------------------------------------- */

bool choice_heeds_radii(const struct choice_state *state, const eval_request *request) {
  const double *value = request->parameters.value;
  return !isnan(state->tolerance) ||
         (core_solves(request->fixed.model) && request->fixed.evaluator != CORE_EVALUATOR_LUT &&
          !isnan(value[CORE_PARAMETER_TOLERANCE]) && isnan(value[CORE_PARAMETER_GAMMA]) &&
          !core_wants_derivatives(request->fixed.wanted) &&
          (request->fixed.wanted & CORE_MODULATED) == 0);
}

/* Returns the error of the table of solutions for a medium. */
static double stored_error(const eval_request *request, const core_medium *medium,
                           core_radii_range radii) {
  core_choose_request requested = choice_request(request, radii);
  requested.media = medium;
  requested.media_count = 1;
  return core_choose_stored_error(&requested);
}

core_parameters choice_parameters(const struct choice_state *state, const eval_request *request,
                                  const core_medium *medium, core_radii_range radii) {
  core_parameters parameters = request->parameters;
  double *tolerance = &parameters.value[CORE_PARAMETER_TOLERANCE];
  const double most = isnan(state->tolerance) ? *tolerance : state->tolerance;
  const bool is_half_space = request->fixed.layer_count == 1 && !(medium->thickness_mm > 0);
  if (is_half_space && request->fixed.evaluator != CORE_EVALUATOR_LUT &&
      stored_error(request, medium, radii) < most * (1 - 1e-9)) {
    *tolerance = (double)NAN;
  } else if (state->finest) {
    *tolerance = CORE_TOLERANCE_FINEST;
  }
  return parameters;
}

/* Returns the numerical error of a profile, relative. */
static double stated_error(const eval_request *request, core_radii_range radii,
                           const core_profile *profile) {
  const core_stated_errors errors = core_profile_errors(profile, wanted_of(&request->fixed), radii);
  return errors.numerical +
         (errors.numerical_per_mm > 0 ? errors.numerical_per_mm * radii.most_mm : 0);
}

bool choice_keeps(struct choice_state *state, const eval_request *request, core_radii_range radii,
                  const core_profile *profile, const core_medium *medium, uint32_t channel) {
  const double stated = stated_error(request, radii, profile);
  const bool keeps = isnan(state->left) || stated <= state->left;
  if (!keeps && !state->finest) {
    state->finest = true;
    return false;
  }
  state->finest = false;
  if (!keeps) {
    const double solved = (stated + state->tolerance - state->left) * (1 + 1e-9);
    const double least = fmin(solved, stored_error(request, medium, radii) * (1 + 1e-8));
    if (least > state->least) {
      const core_radii_range near = {radii.least_mm, radii.least_mm};
      state->worst = channel;
      state->least = least;
      state->at_mm = stated_error(request, near, profile) < stated ? radii.most_mm : radii.least_mm;
    }
  }
  return true;
}

wire_error choice_refusal(const struct choice_state *state, const eval_request *request) {
  if (!(state->least > 0)) {
    return wire_error_none();
  }
  char least[ROUNDED_BYTES], medium[23] = "", radius[24] = "", allowed[ALLOWED_BYTES];
  round_up(least, state->least);
  if (request->fixed.medium_count > 1) {
    snprintf(medium, sizeof medium, " for medium %" PRIu32, state->worst + 1);
  }
  if (request->fixed.radius_count > 1) {
    snprintf(radius, sizeof radius, " at %.3g mm", state->at_mm);
  }
  if (state->least <= 1) {
    snprintf(allowed, sizeof allowed, "at least %s%s%s (solved; else mc)", least, medium, radius);
  } else {
    snprintf(allowed, sizeof allowed, "a model instead: no error known%s%s", medium, radius);
  }
  wire_error error = wire_error_make(WIRE_STATUS_BAD_VALUE, "tolerance", allowed);
  error.index = state->worst;
  return error;
}

bool choice_again(struct choice_state *state, core_fault fault, eval_request *request,
                  core_radii_range radii) {
  if (isnan(state->tolerance) || lookup_is_busy(fault)) {
    return false;
  }
  request->parameters.value[CORE_PARAMETER_TOLERANCE] = state->tolerance;
  const core_choose_request requested = choice_request(request, radii);
  return take_next(state, &requested, request);
}
