#include "core/fit/values.h"

#include "core/kernels.h"
#include "core/model_error.h"
#include "core/paths.h"
#include "core/transport/functions.h"

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

static core_fault constant_values(const struct fit_model *model, struct fit_place place,
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

static core_fault constant_errors(const struct fit_model *model, struct fit_place place,
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

/* ---- modulated light ------------------------------------------------------------------------- */

enum { NODES = CORE_MODULATION_NODES_MAX, READINGS = CORE_FIT_MODULATED_MAX };

/* R and its derivatives, by ln_ratio and ln_scattering, for more or less absorption. */
struct at_nodes {
  core_nodes nodes;
  double sigma_a_per_mm;
  struct fit_place place[NODES];
  double ln_R[NODES][READINGS], by_ratio[NODES][READINGS], by_scattering[NODES][READINGS];
};

/* Sets the nodes of a medium. Those for the fastest modulation serve the slower ones. */
static core_fault set_nodes(const struct fit_model *model, struct fit_place place,
                            const struct fit_places *places, struct at_nodes *at) {
  const double ln_least = real_log(CORE_FIT_RATIO_MIN, 0),
               ln_most = real_log(CORE_FIT_RATIO_MAX, 0);
  at->sigma_a_per_mm = fit_medium(model, place).sigma_a_per_mm;
  at->nodes = core_nodes_around(
      model->table != NULL, real_exp_signed(0.5 * (ln_least + place.ln_scattering)),
      core_modulated_u(at->sigma_a_per_mm, places->wavenumber_most_per_mm));
  for (unsigned j = 0; j < at->nodes.count; j++) {
    at->place[j] = place;
    at->place[j].ln_ratio = 2 * fit_ln(at->nodes.u[j]) - place.ln_scattering;
  }
  return at->place[0].ln_ratio > ln_most
             ? (core_fault){"mhz", "less: the model does not cover as much absorption", 0}
             : (core_fault){0};
}

/* Evaluates R at the nodes, and its derivatives if `slopes`. */
static core_fault fill_nodes(const struct fit_model *model, struct fit_place place,
                             const struct fit_places *places, bool slopes, struct at_nodes *at) {
  core_fault fault = set_nodes(model, place, places, at);
  for (unsigned j = 0; j < at->nodes.count && fault.field == NULL; j++) {
    double *by_ratio = at->by_ratio[j], *by_scattering = at->by_scattering[j];
    fault = constant_values(model, at->place[j], places, at->ln_R[j], slopes ? by_ratio : NULL,
                            slopes ? by_scattering : NULL);
    for (size_t i = 0; i < places->count && fault.field == NULL; i++) {
      const double R = real_max(at->ln_R[j][i], 0x1p-1022);
      by_ratio[i] = slopes ? by_ratio[i] / R : 0;
      by_scattering[i] = slopes ? by_scattering[i] / R : 0;
      at->ln_R[j][i] = fit_ln(R);
    }
  }
  return fault;
}

/* A reading, continued to its frequency, and to none. */
struct modulated {
  core_continuation to[2];
  core_continued at[2];
};

/* Returns whether R is known. `to` is kept while the frequency is the same. */
static bool continue_reading(const struct fit_places *places, const struct at_nodes *nodes,
                             size_t i, struct modulated *one) {
  const double *wavenumber = places->wavenumber_per_mm;
  if (i == 0 || wavenumber[i] < wavenumber[i - 1] || wavenumber[i] > wavenumber[i - 1]) {
    const double complex u = core_modulated_u(nodes->sigma_a_per_mm, wavenumber[i]);
    one->to[0] = core_continue_to(&nodes->nodes, u);
  }
  core_continue(&nodes->nodes, one->to, &nodes->ln_R[0][i], READINGS, one->at);
  return one->at[0].is_known && one->at[1].is_known;
}

/* Returns the logarithm whose real part is ln of the reading, or whose imaginary part is its angle;
 * from the logarithms at both ends. */
static double part_of(unsigned quantity, double complex there, double complex here) {
  return quantity == CORE_QUANTITY_PHASE        ? -(180 / FN_PI) * cimag(there)
         : quantity == CORE_QUANTITY_MODULATION ? creal(there - here)
                                                : creal(there);
}

core_fault fit_values(const struct fit_model *model, struct fit_place place,
                      const struct fit_places *places, double *value, double *by_ratio,
                      double *by_scattering) {
  if (!places->modulated) {
    return constant_values(model, place, places, value, by_ratio, by_scattering);
  }
  struct at_nodes nodes;
  struct modulated one;
  core_fault fault = fill_nodes(model, place, places, by_ratio != NULL, &nodes);
  one.to[1] = core_continue_to(&nodes.nodes, sqrt(nodes.sigma_a_per_mm));
  for (size_t i = 0; i < places->count && fault.field == NULL; i++) {
    const unsigned quantity = fit_quantity_of(places, i);
    double complex by_a[2] = {0, 0}, by_s[2] = {0, 0}; /* by ln sigma_a, and ln sigma_s' */
    if (!continue_reading(places, &nodes, i, &one)) {
      return (core_fault){"mhz", "less: R is not known for so much", i};
    }
    for (int k = 0; k < 2; k++) {
      for (unsigned j = 0; j < nodes.nodes.count; j++) {
        const double complex share = one.to[k].weight[j] * one.at[k].relative[j];
        const double u = nodes.nodes.u[j];
        by_a[k] += share * (nodes.by_ratio[j][i] * (nodes.sigma_a_per_mm / (u * u)));
        by_s[k] += share * (nodes.by_scattering[j][i] - nodes.by_ratio[j][i]);
      }
    }
    const double part = part_of(quantity, one.at[0].ln_R, one.at[1].ln_R);
    const bool is_phase = quantity == CORE_QUANTITY_PHASE;
    value[i] = is_phase ? part : real_exp_signed(part);
    if (by_ratio != NULL) {
      const double unit = is_phase ? 1 : value[i];
      by_ratio[i] = unit * part_of(quantity, by_a[0], by_a[1]);
      by_scattering[i] = by_ratio[i] + unit * part_of(quantity, by_s[0], by_s[1]);
    }
  }
  return fault;
}

core_fault fit_numerical_errors(const struct fit_model *model, struct fit_place place,
                                const struct fit_places *places, double *errors) {
  if (!places->modulated) {
    return constant_errors(model, place, places, errors);
  }
  struct at_nodes nodes;
  struct modulated one;
  core_fault fault = fill_nodes(model, place, places, false, &nodes);
  for (unsigned j = 0; j < nodes.nodes.count && fault.field == NULL; j++) {
    fault = constant_errors(model, nodes.place[j], places, nodes.by_ratio[j]);
  }
  one.to[1] = core_continue_to(&nodes.nodes, sqrt(nodes.sigma_a_per_mm));
  for (size_t i = 0; i < places->count && fault.field == NULL; i++) {
    const unsigned quantity = fit_quantity_of(places, i);
    const core_continuation *const to[2] = {&one.to[0], quantity == 0 ? NULL : &one.to[1]};
    double error[NODES];
    continue_reading(places, &nodes, i, &one);
    for (unsigned j = 0; j < nodes.nodes.count; j++) {
      error[j] = nodes.by_ratio[j][i];
    }
    errors[i] =
        core_continued_error(&nodes.nodes, quantity == CORE_QUANTITY_PHASE, to, one.at, error);
  }
  return fault;
}
