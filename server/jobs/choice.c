#include "server/jobs/choice.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "server/store/profiles.h"

/* A medium has the same layout on the wire and in core, so core reads the payload as an array. */
_Static_assert(sizeof(core_medium) == WIRE_BYTES_medium, "one medium after the other");

static wire_error check_media(const core_medium *media, size_t count) {
  for (size_t i = 0; i < count; i++) {
    const core_fault fault = core_medium_check(&media[i]);
    if (fault.field != NULL) {
      wire_error error = wire_error_make(WIRE_STATUS_BAD_VALUE, fault.field, fault.allowed);
      error.index = i;
      return error;
    }
  }
  return wire_error_none();
}

/* Returns the quantities whose errors count. Without radii, only the albedo has a value. */
static unsigned wanted_of(const wire_eval_request *fixed) {
  return fixed->radius_count > 0 ? fixed->wanted : fixed->wanted & CORE_QUANTITY_ALBEDO;
}

static const core_medium *media_of(const eval_request *request) {
  return (const core_medium *)(const void *)request->media;
}

wire_error choice_check(const eval_request *request) {
  const double tolerance = request->parameters.value[CORE_PARAMETER_TOLERANCE];
  if (isnan(tolerance)) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "model",
                           "a model of the list; 0 with the parameter tolerance alone");
  }
  const core_fault fault = core_parameter_check(CORE_PARAMETER_TOLERANCE, tolerance);
  return fault.field == NULL ? check_media(media_of(request), request->fixed.medium_count)
                             : wire_error_make(WIRE_STATUS_BAD_VALUE, fault.field, fault.allowed);
}

void choice_list(const eval_request *request, core_radii_range radii, struct choice *choice) {
  const wire_eval_request *fixed = &request->fixed;
  const double gamma = request->parameters.value[CORE_PARAMETER_GAMMA];
  const core_choose_request asked = {
      .media = media_of(request),
      .media_count = fixed->medium_count,
      .moments = fixed->moments,
      .wanted = wanted_of(fixed),
      .radii = radii,
      .radius_count = fixed->radius_count,
      .single = core_evaluator_bytes(fixed->evaluator) == sizeof(float),
      .tolerance = request->parameters.value[CORE_PARAMETER_TOLERANCE],
      .gamma = isnan(gamma) ? 0 : gamma,
  };
  choice->count = core_choose(&asked, choice->candidates);
}

static wire_error none_meets(const struct choice *choice) {
  char allowed[80];
  if (choice->count == 0 || !(choice->candidates[0].error < (double)INFINITY)) {
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "tolerance",
                           "a model instead: no error is known for this medium and range");
  }
  const core_candidate *best = &choice->candidates[0];
  snprintf(allowed, sizeof allowed, "at least %.3g: %s (%s) is the best there is",
           best->error * (1 + 5e-3), core_choice_by_id(core_models, best->model)->name,
           core_choice_by_id(core_evaluators, best->evaluator)->name);
  return wire_error_make(WIRE_STATUS_BAD_VALUE, "tolerance", allowed);
}

/* Writes the next candidate into the request. Returns false if there is none left, or if it does
 * not keep the tolerance. */
static bool take_next(struct choice_state *state, const struct choice *choice,
                      eval_request *request) {
  if (state->tried >= choice->count || !choice->candidates[state->tried].meets) {
    return false;
  }
  const core_candidate *candidate = &choice->candidates[state->tried++];
  state->model_error = candidate->model_error;
  request->fixed.model = (uint16_t)candidate->model;
  request->fixed.evaluator = (uint16_t)candidate->evaluator;
  request->parameters.value[CORE_PARAMETER_TOLERANCE] = candidate->numerical_tolerance;
  return true;
}

wire_error choice_first(struct choice_state *state, eval_request *request, core_radii_range radii) {
  struct choice choice;
  choice_list(request, radii, &choice);
  state->tolerance = request->parameters.value[CORE_PARAMETER_TOLERANCE];
  state->tried = 0;
  return take_next(state, &choice, request) ? wire_error_none() : none_meets(&choice);
}

bool choice_again(struct choice_state *state, core_fault fault, eval_request *request,
                  core_radii_range radii) {
  if (isnan(state->tolerance) || profiles_is_busy(fault)) {
    return false;
  }
  struct choice choice;
  request->parameters.value[CORE_PARAMETER_TOLERANCE] = state->tolerance;
  choice_list(request, radii, &choice);
  return take_next(state, &choice, request);
}

static int by_cost(const void *a, const void *b) {
  const core_candidate *left = a, *right = b;
  const int cost = (left->total_ns > right->total_ns) - (left->total_ns < right->total_ns);
  const int model = (int)left->model - (int)right->model;
  const int evaluator = (int)left->evaluator - (int)right->evaluator;
  return cost != 0 ? cost : model != 0 ? model : evaluator;
}

size_t choice_sort_by_cost(struct choice *choice) {
  if (choice->count == 0) {
    return 0;
  }
  const core_candidate first = choice->candidates[0];
  qsort(choice->candidates, choice->count, sizeof choice->candidates[0], by_cost);
  size_t at = 0;
  while (by_cost(&choice->candidates[at], &first) != 0) {
    at++;
  }
  return first.meets ? at : choice->count;
}
