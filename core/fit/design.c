/* Checks, prepares and frees designs, and reads a set of readings. */
#include "core/fit/fit.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/fit/search.h"
#include "core/fit/values.h"
#include "core/kernels.h"

#define CORE_REAL 64
#include "core/kernel.h"

/* ---- checking -------------------------------------------------------------------------------- */

static core_fault check_readings(const core_fit_design *design) {
  const bool frequency = design->axis == CORE_FIT_AXIS_FREQUENCY;
  for (size_t i = 0; i < design->count; i++) {
    const double source = design->source_mm != NULL ? design->source_mm[i] : 0;
    const double detector = design->detector_mm != NULL ? design->detector_mm[i] : 0;
    const bool point = source >= 0 && source <= 0; /* neither holds for NaN */
    if (!point || !(detector >= 0 && detector <= 0)) {
      return (core_fault){point ? "detector" : "source", "0", i};
    }
    const double at = design->at[i];
    if (!(at >= 0 && at <= 1e12)) {
      return (core_fault){"at", "0 to 1e12", i};
    }
    if (!frequency && !(at > 0)) {
      return (core_fault){"at", "above 0 without fibres", i};
    }
  }
  return (core_fault){0};
}

/* Whether R depends on the medium by its coefficients alone. */
static bool fits_model(unsigned model) {
  return model != CORE_MODEL_GAUSSIANS && model != CORE_MODEL_SKIN_RED &&
         model != CORE_MODEL_SKIN_GREEN && model != CORE_MODEL_SKIN_BLUE;
}

core_fault core_fit_check(const core_fit_design *design) {
  if (core_choice_by_id(core_fit_axes, design->axis) == NULL) {
    return (core_fault){"axis", "an axis of the list", 0};
  }
  if (core_choice_by_id(core_fit_scales, design->scale) == NULL) {
    return (core_fault){"scale", "a scale of the list", 0};
  }
  const size_t least = design->scale == CORE_FIT_SCALE_FREE ? 3 : 2;
  if (design->count < least || design->count > CORE_FIT_READINGS_MAX) {
    return (core_fault){"count", "2 to 1024 readings, 3 or more with a free factor", design->count};
  }
  if (design->axis != CORE_FIT_AXIS_RADIUS) {
    return (core_fault){"axis", "r with this model", 0};
  }
  if (!(design->g > -1 && design->g < 1)) {
    return (core_fault){"g", "above -1 and below 1", 0};
  }
  const core_medium some = {0.01, 1 / (1 - design->g), design->g, design->eta};
  core_fault fault = core_profile_check(design->model, design->moments, CORE_EVALUATOR_F64, &some,
                                        design->parameters, NULL);
  if (fault.field == NULL && !fits_model(design->model)) {
    fault = (core_fault){"model", "a model whose R depends on the coefficients alone", 0};
  }
  if (fault.field == NULL && design->scale == CORE_FIT_SCALE_REFERENCE) {
    fault = core_profile_check(design->model, design->moments, CORE_EVALUATOR_F64,
                               &design->reference, design->parameters, NULL);
  }
  return fault.field == NULL ? check_readings(design) : fault;
}

/* ---- preparing ------------------------------------------------------------------------------- */

static struct fit_model model_of(const core_isa *isa, const core_fit_design *design) {
  return (struct fit_model){
      .isa = isa,
      .model = design->model,
      .moments = design->moments,
      .quantity = CORE_QUANTITY_R,
      .g = design->g,
      .eta = design->eta,
      .parameters = design->parameters != NULL ? *design->parameters : core_parameters_none(),
  };
}

/* Sets the bounds of the search from the distances. */
static void set_bounds(core_fit *fit, const core_fit_design *design) {
  double least = 0, most = 0;
  for (size_t i = 0; i < design->count; i++) {
    const double at = design->at[i];
    const bool frequency = design->axis == CORE_FIT_AXIS_FREQUENCY;
    const double distance = frequency ? (at > 0 ? 1 / (6.28318530717958647693 * at) : 0) : at;
    if (distance > 0) {
      least = least > 0 ? real_min(least, distance) : distance;
      most = real_max(most, distance);
    }
  }
  fit->least = (struct fit_place){real_log(CORE_FIT_RATIO_MIN, 0),
                                  real_log(CORE_FIT_NEAR_MIN / (most > 0 ? most : 1), 0)};
  fit->most = (struct fit_place){real_log(CORE_FIT_RATIO_MAX, 0),
                                 real_log(CORE_FIT_NEAR_MAX / (least > 0 ? least : 1), 0)};
}

/* Sets what each reading's model is multiplied by: 1, or one over that of the reference medium. */
static core_fault set_weights(core_fit *fit, const core_fit_design *design) {
  for (size_t i = 0; i < fit->count; i++) {
    fit->weight[i] = 1;
  }
  if (design->scale != CORE_FIT_SCALE_REFERENCE) {
    return (core_fault){0};
  }
  struct fit_model reference = fit->model;
  reference.g = design->reference.g;
  reference.eta = design->reference.eta;
  const core_fault fault =
      fit_values_of_medium(&reference, &design->reference, fit->count, fit->at, fit->weight);
  for (size_t i = 0; fault.field == NULL && i < fit->count; i++) {
    if (!(fit->weight[i] > 1e-300)) {
      return (core_fault){"reference", "a medium with light at each reading", i};
    }
    fit->weight[i] = 1 / fit->weight[i];
  }
  return fault;
}

/* Evaluates the model for each medium of the grid. Media that the model does not take get NAN, which
 * is never a minimum. */
static core_fault fill_grid(core_fit *fit) {
  double values[CORE_FIT_READINGS_MAX];
  for (size_t i = 0; i < FIT_GRID; i++) {
    const core_fault fault =
        fit_values(&fit->model, fit_grid_place(fit, i), fit->count, fit->at, values, NULL, NULL);
    if (fault.field != NULL && strcmp(fault.field, CORE_FIELD_MEMORY) == 0) {
      return fault;
    }
    for (size_t k = 0; k < fit->count; k++) {
      fit->grid[k * FIT_GRID + i] =
          fault.field == NULL ? fit_ln(values[k] * fit->weight[k]) : (double)NAN;
    }
  }
  return (core_fault){0};
}

static core_fault set_notes(core_fit *fit) {
  const core_medium medium = fit_medium(&fit->model, fit_grid_place(fit, FIT_GRID / 2));
  core_profile profile;
  const core_fault fault =
      core_profile_prepare(&profile, fit->model.isa, fit->model.model, fit->model.moments,
                           CORE_EVALUATOR_F64, &medium, &fit->model.parameters);
  if (fault.field == NULL) {
    fit->notes = profile.notes;
    core_profile_free(&profile);
  }
  return fault;
}

static core_fault fill(core_fit *fit, const core_fit_design *design) {
  memcpy(fit->at, design->at, fit->count * sizeof *fit->at);
  set_bounds(fit, design);
  core_fault fault = set_notes(fit);
  if (fault.field == NULL) {
    fault = set_weights(fit, design);
  }
  return fault.field == NULL ? fill_grid(fit) : fault;
}

/* The numbers that a design holds for each reading: where it is, its weight, and the grid. */
enum { NUMBERS = 2 + FIT_GRID };

core_fault core_fit_create(core_fit **made, const core_isa *isa, const core_fit_design *design) {
  *made = NULL;
  core_fault fault = core_fit_check(design);
  if (fault.field != NULL) {
    return fault;
  }
  core_fit *fit = malloc(sizeof *fit);
  double *numbers = malloc(NUMBERS * design->count * sizeof *numbers);
  if (fit == NULL || numbers == NULL) {
    free(fit);
    free(numbers);
    return CORE_OUT_OF_MEMORY;
  }
  *fit = (core_fit){
      .model = model_of(isa, design),
      .free_factor = design->scale == CORE_FIT_SCALE_FREE,
      .count = design->count,
      .at = numbers,
      .weight = numbers + design->count,
      .grid = numbers + 2 * design->count,
  };
  fault = fill(fit, design);
  if (fault.field != NULL) {
    core_fit_free(fit);
  } else {
    *made = fit;
  }
  return fault;
}

void core_fit_free(core_fit *fit) {
  if (fit != NULL) {
    free(fit->at);
    free(fit);
  }
}

size_t core_fit_bytes(const core_fit *fit) {
  return sizeof *fit + NUMBERS * fit->count * sizeof *fit->at;
}

/* ---- a set of readings ----------------------------------------------------------------------- */

void core_fit_run(const core_fit *fit, const double *values, const double *errors,
                  core_fit_result *result, double *residuals) {
  core_fault fault = {0};
  for (size_t i = 0; i < fit->count && fault.field == NULL; i++) {
    if (!(values[i] >= 0 && values[i] < (double)INFINITY)) {
      fault = (core_fault){"value", "at least 0, and finite", i};
    } else if (!(errors[i] > 0 && errors[i] < (double)INFINITY)) {
      fault = (core_fault){"error", "above 0, and finite", i};
    }
  }
  if (fault.field == NULL) {
    fit_search(fit, values, errors, result, residuals);
    return;
  }
  const core_fit_solution none = {(double)NAN, (double)NAN, (double)NAN, (double)NAN};
  *result = (core_fit_result){
      .status = CORE_FIT_STATUS_REFUSED,
      .fault = fault,
      .best = none,
      .second = none,
      .reduced_chi_squared = (double)NAN,
      .condition = (double)NAN,
  };
  for (size_t i = 0; residuals != NULL && i < fit->count; i++) {
    residuals[i] = (double)NAN;
  }
}
