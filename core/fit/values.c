#include "core/fit/values.h"

#include "core/fit/fit.h"
#include "core/kernels.h"
#include "core/model_error.h"

#define CORE_REAL 64
#include "core/kernel.h"

/* Limits of the step in a logarithm for differences. The step is the third root of the model's
 * error, where rounding and curvature contribute equally. */
#define STEP_LEAST 1e-4
#define STEP_MOST 0.03

core_medium fit_medium(const struct fit_model *model, struct fit_place place) {
  const double scattering = real_exp_signed(place.ln_scattering);
  return (core_medium){
      .sigma_a_per_mm = scattering * real_exp_signed(place.ln_ratio),
      .sigma_s_per_mm = scattering / (1 - model->g),
      .g = model->g,
      .eta = model->eta,
      .thickness_mm = model->thickness_mm,
  };
}

double fit_ln(double x) {
  return real_log(real_max(x, 0x1p-1022), 0);
}

enum { CHUNK = 256 }; /* number of nodes that are evaluated together */

/* Adds the values of nodes `start` to start + n - 1, times their weights, to their readings.
 * *reading: that of node `start`. */
static void add_up(const struct fit_places *places, size_t start, size_t n, const double *values,
                   size_t *reading, double *sums) {
  for (size_t k = 0; k < n; k++) {
    while (start + k >= places->first[*reading + 1]) {
      sums[++*reading] = 0;
    }
    sums[*reading] += places->weight[start + k] * values[k];
  }
}

/* Multiplies R by the share of light within the aperture. */
static void take_shares(const struct fit_model *model, const core_medium *medium, size_t n,
                        const double *ln_at, double *R) {
  const double scattering = medium->sigma_s_per_mm * (1 - medium->g);
  const double ln_sigma_t_prime = fit_ln(medium->sigma_a_per_mm + scattering);
  fit_aperture_row row;
  fit_aperture_medium(&model->aperture, medium->sigma_a_per_mm / scattering, &row);
  for (size_t i = 0; i < n; i++) {
    R[i] *= fit_aperture_share(&row, ln_at[i] + ln_sigma_t_prime);
  }
}

void fit_values_of_profile(const struct fit_model *model, const core_profile *profile,
                           const struct fit_places *places, double *value) {
  const size_t nodes = places->first[places->count];
  size_t reading = 0;
  value[0] = 0;
  for (size_t start = 0; start < nodes; start += CHUNK) {
    const size_t n = nodes - start < CHUNK ? nodes - start : CHUNK;
    double values[CHUNK];
    core_eval_f64(profile, model->quantity, n, places->at + start, values);
    if (model->narrow) {
      take_shares(model, &profile->medium, n, places->ln_at + start, values);
    }
    add_up(places, start, n, values, &reading, value);
  }
}

double fit_model_error(const struct fit_model *model, const core_medium *medium,
                       const struct fit_places *places) {
  const double sigma_t_prime = core_sigma_t_prime(medium);
  if (!core_is_exact(model->model, !isnan(model->parameters.value[CORE_PARAMETER_GAMMA]))) {
    return (double)NAN;
  }
  return model->narrow ? fit_aperture_error(&model->aperture, core_ratio_of(medium),
                                            places->radii.least_mm * sigma_t_prime,
                                            places->radii.most_mm * sigma_t_prime)
                       : 0;
}

/* error: NULL, or set to the numerical error. */
static core_fault evaluate_readings(const struct fit_model *model, const core_medium *medium,
                                    const struct fit_places *places, double *value, double *error) {
  core_profile profile;
  const core_fault fault = core_profile_prepare(&profile, model->isa, model->model, model->moments,
                                                CORE_EVALUATOR_F64, medium, &model->parameters);
  if (fault.field != NULL) {
    return fault;
  }
  fit_values_of_profile(model, &profile, places, value);
  if (error != NULL) {
    *error = profile.numerical_error;
  }
  core_profile_free(&profile);
  return fault;
}

/* Does the same as fit_values(), from the table. */
static void look_up(const struct fit_model *model, struct fit_place place,
                    const struct fit_places *places, double *value, double *by_ratio,
                    double *by_scattering) {
  const size_t nodes = places->first[places->count];
  const bool slopes = by_ratio != NULL;
  if (slopes && nodes == places->count) { /* each reading has one node, whose weight is 1 */
    model->loops->look_up(model->table, place.ln_ratio, place.ln_scattering, nodes, places->at,
                          places->ln_at, value, by_ratio, by_scattering);
    return;
  }
  double R[CHUNK], r[CHUNK], s[CHUNK];
  size_t reading[3] = {0, 0, 0};
  value[0] = 0;
  if (slopes) {
    by_ratio[0] = by_scattering[0] = 0;
  }
  for (size_t start = 0; start < nodes; start += CHUNK) {
    const size_t n = nodes - start < CHUNK ? nodes - start : CHUNK;
    model->loops->look_up(model->table, place.ln_ratio, place.ln_scattering, n, places->at + start,
                          places->ln_at + start, R, r, s);
    add_up(places, start, n, R, &reading[0], value);
    if (slopes) {
      add_up(places, start, n, r, &reading[1], by_ratio);
      add_up(places, start, n, s, &reading[2], by_scattering);
    }
  }
}

/* Does the same as fit_values(), by kernels for media that vary. */
static void vary(const struct fit_model *model, struct fit_place place,
                 const struct fit_places *places, double *value, double *by_ratio,
                 double *by_scattering) {
  const size_t nodes = places->first[places->count];
  const core_medium medium = fit_medium(model, place);
  double *const sums[] = {value, by_ratio, by_scattering};
  size_t reading[3] = {0, 0, 0};
  for (int q = 0; q < 3 && sums[q] != NULL; q++) {
    sums[q][0] = 0;
  }
  for (size_t start = 0; start < nodes; start += CHUNK) {
    const size_t n = nodes - start < CHUNK ? nodes - start : CHUNK;
    double a[CHUNK], s[CHUNK], R[3][CHUNK];
    for (size_t i = 0; i < n; i++) {
      a[i] = medium.sigma_a_per_mm;
      s[i] = medium.sigma_s_per_mm;
    }
    core_varying_gradient_f64(&model->varying, n, a, s, places->at + start,
                              &(core_gradient){R[0], R[1], R[2]});
    for (size_t i = 0; i < n; i++) {
      R[0][i] = real_exp_signed(real_max(R[0][i], -690));
      R[1][i] *= R[0][i]; /* sigma_a alone changes with the ratio, both with the scattering */
      R[2][i] = fma(R[2][i], R[0][i], R[1][i]);
    }
    for (int q = 0; q < 3 && sums[q] != NULL; q++) {
      add_up(places, start, n, R[q], &reading[q], sums[q]);
    }
  }
}

core_fault fit_values_of_medium(const struct fit_model *model, const core_medium *medium,
                                const struct fit_places *places, double *value,
                                double *model_error) {
  *model_error = fit_model_error(model, medium, places);
  return evaluate_readings(model, medium, places, value, NULL);
}

static double step_for(double error) {
  double step = STEP_LEAST;
  while (step * step * step < error && step < STEP_MOST) {
    step *= 1.5;
  }
  return step;
}

/* Sets slope[count] to the central difference along a step, and divides it by `width`. */
static core_fault differentiate(const struct fit_model *model, struct fit_place place,
                                struct fit_place step, double width,
                                const struct fit_places *places, double *slope) {
  double before[CORE_FIT_READINGS_MAX];
  const struct fit_place down = {place.ln_ratio - step.ln_ratio,
                                 place.ln_scattering - step.ln_scattering};
  const struct fit_place up = {place.ln_ratio + step.ln_ratio,
                               place.ln_scattering + step.ln_scattering};
  const core_medium low = fit_medium(model, down), high = fit_medium(model, up);
  core_fault fault = evaluate_readings(model, &high, places, slope, NULL);
  if (fault.field == NULL) {
    fault = evaluate_readings(model, &low, places, before, NULL);
  }
  for (size_t i = 0; fault.field == NULL && i < places->count; i++) {
    slope[i] = (slope[i] - before[i]) / (2 * width);
  }
  return fault;
}

core_fault fit_values(const struct fit_model *model, struct fit_place place,
                      const struct fit_places *places, double *value, double *by_ratio,
                      double *by_scattering) {
  if (model->table != NULL) {
    look_up(model, place, places, value, by_ratio, by_scattering);
    return (core_fault){0};
  }
  if (model->varies) {
    vary(model, place, places, value, by_ratio, by_scattering);
    return (core_fault){0};
  }
  const core_medium medium = fit_medium(model, place);
  double error;
  core_fault fault = evaluate_readings(model, &medium, places, value, &error);
  if (fault.field == NULL && by_ratio != NULL) {
    const double step = step_for(error);
    const struct fit_place along = {step, 0}, across = {0, step};
    fault = differentiate(model, place, along, step, places, by_ratio);
    if (fault.field == NULL) {
      fault = differentiate(model, place, across, step, places, by_scattering);
    }
  }
  return fault;
}

core_fault fit_numerical_errors(const struct fit_model *model, struct fit_place place,
                                const struct fit_places *places, double *errors) {
  const core_medium medium = fit_medium(model, place);
  const double ln_sigma_t_prime = fit_ln(core_sigma_t_prime(&medium));
  core_profile profile = {0};
  core_fault fault = {0};
  if (model->table == NULL) {
    fault = core_profile_prepare(&profile, model->isa, model->model, model->moments,
                                 CORE_EVALUATOR_F64, &medium, &model->parameters);
  }
  for (size_t i = 0; i < places->count && fault.field == NULL; i++) {
    errors[i] = 0;
    for (size_t k = places->first[i]; k < places->first[i + 1]; k++) {
      double error;
      if (model->table != NULL) {
        error = fit_table_error(model->table, place.ln_ratio,
                                model->table->waves ? places->ln_at[k] - ln_sigma_t_prime
                                                    : places->ln_at[k] + ln_sigma_t_prime);
      } else {
        const core_stated_errors stated = core_profile_errors(
            &profile, (unsigned)model->quantity, (core_radii_range){places->at[k], places->at[k]});
        error = fma(stated.numerical_per_mm, places->at[k], stated.numerical);
      }
      errors[i] = real_max(errors[i], error);
    }
  }
  if (model->table == NULL && fault.field == NULL) {
    core_profile_free(&profile);
  }
  return fault;
}
