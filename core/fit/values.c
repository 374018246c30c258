#include "core/fit/values.h"

#include <stdlib.h>

#define CORE_REAL 64
#include "core/kernel.h"

/* The step in a logarithm that derivatives are taken over: the third root of the model's error, by
 * which rounding and curvature count alike, between these two. */
#define STEP_LEAST 1e-4
#define STEP_MOST 0.03

core_medium fit_medium(const struct fit_model *model, struct fit_place place) {
  const double scattering = real_exp_signed(place.ln_scattering);
  return (core_medium){
      .sigma_a_per_mm = scattering * real_exp_signed(place.ln_ratio),
      .sigma_s_per_mm = scattering / (1 - model->g),
      .g = model->g,
      .eta = model->eta,
  };
}

double fit_ln(double x) {
  return real_log(real_max(x, 0x1p-1022), 0);
}

/* error: NULL, or receives the model's numerical error. */
static core_fault evaluate(const struct fit_model *model, const core_medium *medium, size_t n,
                           const double *at, double *value, double *error) {
  core_profile profile;
  const core_fault fault = core_profile_prepare(&profile, model->isa, model->model, model->moments,
                                                CORE_EVALUATOR_F64, medium, &model->parameters);
  if (fault.field == NULL) {
    core_eval_f64(&profile, model->quantity, n, at, value);
    if (error != NULL) {
      *error = profile.numerical_error;
    }
    core_profile_free(&profile);
  }
  return fault;
}

core_fault fit_values_of_medium(const struct fit_model *model, const core_medium *medium, size_t n,
                                const double *at, double *value) {
  return evaluate(model, medium, n, at, value, NULL);
}

static double step_for(double error) {
  double step = STEP_LEAST;
  while (step * step * step < error && step < STEP_MOST) {
    step *= 1.5;
  }
  return step;
}

/* Sets slope[n] to the central difference along a step, and divides it by `width`. */
static core_fault differentiate(const struct fit_model *model, struct fit_place place,
                                struct fit_place step, double width, size_t n, const double *at,
                                double *slope) {
  enum { CHUNK = 128 };
  const core_medium low = fit_medium(model, (struct fit_place){
                                                place.ln_ratio - step.ln_ratio,
                                                place.ln_scattering - step.ln_scattering,
                                            });
  const core_medium high = fit_medium(model, (struct fit_place){
                                                 place.ln_ratio + step.ln_ratio,
                                                 place.ln_scattering + step.ln_scattering,
                                             });
  core_fault fault = evaluate(model, &high, n, at, slope, NULL);
  for (size_t done = 0; fault.field == NULL && done < n; done += CHUNK) {
    const size_t count = n - done < CHUNK ? n - done : CHUNK;
    double before[CHUNK];
    fault = evaluate(model, &low, count, at + done, before, NULL);
    for (size_t i = 0; fault.field == NULL && i < count; i++) {
      slope[done + i] = (slope[done + i] - before[i]) / (2 * width);
    }
  }
  return fault;
}

core_fault fit_values(const struct fit_model *model, struct fit_place place, size_t n,
                      const double *at, double *value, double *by_ratio, double *by_scattering) {
  const core_medium medium = fit_medium(model, place);
  double error;
  core_fault fault = evaluate(model, &medium, n, at, value, &error);
  if (fault.field == NULL && by_ratio != NULL) {
    const double step = step_for(error);
    const struct fit_place along = {step, 0}, across = {0, step};
    fault = differentiate(model, place, along, step, n, at, by_ratio);
    if (fault.field == NULL) {
      fault = differentiate(model, place, across, step, n, at, by_scattering);
    }
  }
  return fault;
}
