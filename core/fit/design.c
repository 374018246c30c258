/* Checks, prepares and frees designs. */
#include "core/fit/fit.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/diffusion.h"
#include "core/fit/discs.h"
#include "core/fit/search.h"
#include "core/fit/values.h"
#include "core/kernels.h"
#include "core/paths.h"

#define CORE_REAL 64
#include "core/kernel.h"

/* ---- checking -------------------------------------------------------------------------------- */

/* Returns a number of a reading, as the diameter of a disc. numbers NULL: 0. */
static double number_of(const double *numbers, size_t i) {
  return numbers != NULL ? numbers[i] : 0;
}

static core_fault check_readings(const core_fit_design *design) {
  const bool frequency = design->axis == CORE_FIT_AXIS_FREQUENCY;
  for (size_t i = 0; i < design->count; i++) {
    const double source = number_of(design->source_mm, i);
    const double detector = number_of(design->detector_mm, i);
    const double most = frequency ? 0 : 1e12;
    const char *allowed = frequency ? "0 with frequencies" : "0 to 1e12";
    if (!(source >= 0 && source <= most)) { /* also false for NaN */
      return (core_fault){"source", allowed, i};
    }
    if (!(detector >= 0 && detector <= most)) {
      return (core_fault){"detector", allowed, i};
    }
    const double at = design->at[i];
    if (!(at >= 0 && at <= 1e12)) {
      return (core_fault){"at", "0 to 1e12", i};
    }
    if (!frequency && !(at + source + detector > 0)) {
      return (core_fault){"at", "above 0 without fibres", i};
    }
  }
  return (core_fault){0};
}

static bool is_modulated(const core_fit_design *design) {
  bool modulated = false;
  for (size_t i = 0; i < design->count && design->of_spectra; i++) {
    modulated |= design->mhz != NULL && design->mhz[i] != 0;
    modulated |= design->quantity != NULL && design->quantity[i] != 0;
  }
  return modulated;
}

static core_fault check_modulated(const core_fit_design *design) {
  if (design->count > CORE_FIT_MODULATED_MAX) {
    return (core_fault){"count", "up to 512 readings with modulated light", design->count};
  }
  if (design->detector_na != 0) {
    return (core_fault){"detector_na", "0 with modulated light", 0};
  }
  bool scaled = design->scale != CORE_FIT_SCALE_FREE;
  for (size_t i = 0; i < design->count; i++) {
    const double quantity = number_of(design->quantity, i);
    scaled |= quantity == 0;
    core_fault fault = core_parameter_check(CORE_PARAMETER_MHZ, number_of(design->mhz, i));
    fault.index = i;
    if (fault.field != NULL) {
      return fault;
    }
    if (quantity != 0 && quantity != CORE_QUANTITY_PHASE && quantity != CORE_QUANTITY_MODULATION) {
      return (core_fault){"quantity", "0, or the id of phase or modulation", i};
    }
  }
  return scaled ? (core_fault){0}
                : (core_fault){"scale", "absolute: phases and modulations have no factor", 0};
}

/* Returns the g for which transport is evaluated, given g or gamma. */
static double taken_g(const core_fit_design *design, double g) {
  const double gamma =
      design->parameters != NULL ? design->parameters->value[CORE_PARAMETER_GAMMA] : (double)NAN;
  return isnan(gamma) ? g : gamma - 1;
}

static bool has_shares(const core_fit_design *design, double g, double eta) {
  const double taken = taken_g(design, g);
  return taken >= 0 && taken <= FIT_APERTURE_G_MOST && eta >= FIT_APERTURE_ETA_LEAST &&
         eta <= FIT_APERTURE_ETA_MOST;
}

static core_fault check_aperture(const core_fit_design *design) {
  if (design->detector_na == 0) {
    return (core_fault){0};
  }
  const core_fault fault = core_parameter_check(CORE_PARAMETER_DETECTOR_NA, design->detector_na);
  if (fault.field != NULL) {
    return fault;
  }
  if (!core_solves(design->model) || design->axis != CORE_FIT_AXIS_RADIUS) {
    return (core_fault){"detector_na", "nothing but with transport and distances", 0};
  }
  const core_medium *reference = &design->reference;
  return has_shares(design, design->g, design->eta) &&
                 (design->scale != CORE_FIT_SCALE_REFERENCE ||
                  has_shares(design, reference->g, reference->eta))
             ? (core_fault){0}
             : (core_fault){"detector_na", "g from 0 to 0.95 and eta from 0.7 to 2.2 with it", 0};
}

/* Returns a fault if the table of solutions does not cover the media: a fit evaluates too many to
 * solve them. */
static core_fault check_stored(const core_fit_design *design) {
  if (!core_solves(design->model)) {
    return (core_fault){0};
  }
  const core_medium *reference = &design->reference;
  if (design->thickness_mm > 0 || reference->thickness_mm > 0) {
    return (core_fault){"thickness", "0, a half space: fits of transport have no slabs yet", 0};
  }
  const core_fault fault = core_transport_stored_check(taken_g(design, design->g), design->eta);
  return fault.field == NULL && design->scale == CORE_FIT_SCALE_REFERENCE
             ? core_transport_stored_check(taken_g(design, reference->g), reference->eta)
             : fault;
}

/* Returns whether R of a model depends on the medium, and only through its coefficients. */
static bool fits_model(unsigned model) {
  return model != CORE_MODEL_GAUSSIANS && model != CORE_MODEL_SKIN_RED &&
         model != CORE_MODEL_SKIN_GREEN && model != CORE_MODEL_SKIN_BLUE;
}

/* Returns a medium of a design in place of all: a slab is scaled to ten mean free paths or more, as
 * models refuse thin ones. */
static core_medium thick_enough(core_medium medium) {
  const double paths =
      medium.thickness_mm * (medium.sigma_a_per_mm + medium.sigma_s_per_mm * (1 - medium.g));
  const double scale = paths > 0 ? real_max(1, 10 / paths) : 1;
  medium.sigma_a_per_mm *= scale;
  medium.sigma_s_per_mm *= scale;
  return medium;
}

core_fault core_fit_check(const core_fit_design *design) {
  if (core_choice_by_id(core_fit_axes, design->axis) == NULL) {
    return (core_fault){"axis", "an axis of the list", 0};
  }
  if (core_choice_by_id(core_fit_scales, design->scale) == NULL) {
    return (core_fault){"scale", "a scale of the list", 0};
  }
  const size_t least = design->of_spectra ? 1 : design->scale == CORE_FIT_SCALE_FREE ? 3 : 2;
  if (design->count < least || design->count > CORE_FIT_READINGS_MAX) {
    return (core_fault){"count", "2 to 1024 readings, 3 or more with a free factor", design->count};
  }
  if (!(design->g > -1 && design->g < 1)) {
    return (core_fault){"g", "above -1 and below 1", 0};
  }
  const core_medium some = thick_enough(
      (core_medium){0.01, 1 / (1 - design->g), design->g, design->eta, design->thickness_mm});
  core_parameters taken = design->parameters != NULL ? *design->parameters : core_parameters_none();
  taken.value[CORE_PARAMETER_MHZ] = is_modulated(design) ? 0 : (double)NAN;
  core_fault fault =
      core_profile_check(design->model, design->moments, CORE_EVALUATOR_F64, &some, &taken, NULL);
  if (fault.field == NULL && !fits_model(design->model)) {
    fault = (core_fault){"model", "a model whose R depends on the coefficients alone", 0};
  }
  if (fault.field == NULL && design->scale == CORE_FIT_SCALE_REFERENCE) {
    fault = core_profile_check(design->model, design->moments, CORE_EVALUATOR_F64,
                               &design->reference, design->parameters, NULL);
  }
  if (fault.field == NULL) {
    fault = check_aperture(design);
  }
  if (fault.field == NULL) {
    fault = check_stored(design);
  }
  if (fault.field == NULL && is_modulated(design)) {
    fault = check_modulated(design);
  }
  return fault.field == NULL ? check_readings(design) : fault;
}

/* ---- costs ----------------------------------------------------------------------------------- */

/* Measured with 3 to 300 readings and with fibres: with the derivatives of a dipole or a Burley profile
 * an evaluation takes 0.4 us and 0.07 us for each place, and with a table half of that or less. A slab's
 * profiles take some 100 us each, five for an evaluation. */
#define EVALUATION_COST 128
#define PLACE_COST 42
#define SLAB_COST 262144
#define MODULATED_COST 16

/* Returns the number of nodes of all readings. */
static size_t nodes_of(const core_fit_design *design) {
  size_t nodes = 0;
  for (size_t i = 0; i < design->count; i++) {
    nodes += fit_disc_count(design->at[i], number_of(design->source_mm, i),
                            number_of(design->detector_mm, i));
  }
  return nodes;
}

/* Typical numbers of evaluations for a set: with the inverse, with few readings more than unknowns or
 * an unknown factor, and with many. */
enum { BY_INVERSE = 4, SPARSE = 160, PLENTY = 12 };

core_fit_cost core_fit_cost_of(const core_fit_design *design) {
  const bool slab = design->thickness_mm > 0;
  const bool free_factor = design->scale == CORE_FIT_SCALE_FREE;
  const size_t spare = design->count - (free_factor ? 3 : 2);
  const bool inverts = design->count == 2 && core_solves(design->model);
  return (core_fit_cost){.evaluations = inverts                              ? BY_INVERSE
                                        : free_factor || spare <= FIT_SPARSE ? SPARSE
                                                                             : PLENTY,
                         .evaluation = (is_modulated(design) ? MODULATED_COST : 1) *
                                       (EVALUATION_COST + (double)nodes_of(design) * PLACE_COST +
                                        (slab ? SLAB_COST : 0))};
}

/* ---- preparing ------------------------------------------------------------------------------- */

CORE_ISA_TABLE(fit_loops, fit_loops)

/* Makes the model detect the light within the design's aperture alone, of media with this g and
 * eta. */
static void set_aperture(struct fit_model *model, const core_fit_design *design, double g,
                         double eta) {
  model->narrow = design->detector_na > 0 && design->detector_na < real_min(eta, 1);
  if (model->narrow) {
    fit_aperture_prepare(&model->aperture, taken_g(design, g), eta, design->detector_na);
  }
}

static struct fit_model model_of(const core_isa *isa, const core_fit_design *design) {
  struct fit_model model = {
      .isa = isa,
      .loops = fit_loops_of[isa->index],
      .model = design->model,
      .moments = design->moments,
      .quantity =
          design->axis == CORE_FIT_AXIS_FREQUENCY ? CORE_QUANTITY_TRANSFER : CORE_QUANTITY_R,
      .g = design->g,
      .eta = design->eta,
      .thickness_mm = design->thickness_mm,
      .parameters = design->parameters != NULL ? *design->parameters : core_parameters_none(),
  };
  set_aperture(&model, design, design->g, design->eta);
  return model;
}

/* Sets the bounds of the search, from the distances. */
static void set_bounds(core_fit *fit, const core_fit_design *design) {
  double least = 0, most = 0;
  for (size_t i = 0; i < design->count; i++) {
    const double at = design->at[i];
    const bool frequency = design->axis == CORE_FIT_AXIS_FREQUENCY;
    const double radii = number_of(design->source_mm, i) + number_of(design->detector_mm, i);
    const double distance =
        frequency ? (at > 0 ? 1 / (6.28318530717958647693 * at) : 0) : real_max(at, 0.25 * radii);
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

/* Sets the factor of each reading's model: 1, or the inverse of the reading of the reference
 * medium. */
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
  reference.thickness_mm = design->reference.thickness_mm;
  set_aperture(&reference, design, reference.g, reference.eta);
  const core_fault fault = fit_values_of_medium(&reference, &design->reference, &fit->places,
                                                fit->weight, &fit->reference_error);
  for (size_t i = 0; fault.field == NULL && i < fit->count; i++) {
    if (!(fit->weight[i] > 1e-300)) {
      return (core_fault){"reference", "a medium with light at each reading", i};
    }
    fit->weight[i] = 1 / fit->weight[i];
  }
  return fault;
}

/* Evaluates the readings for each medium of the grid. A medium that the model does not cover gets
 * NAN, and is no minimum. */
static core_fault fill_grid(core_fit *fit) {
  double values[CORE_FIT_READINGS_MAX];
  for (size_t i = 0; i < FIT_GRID; i++) {
    const core_fault fault =
        fit_values(&fit->model, fit_grid_place(fit, i), &fit->places, values, NULL, NULL);
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

/* Returns the probability that a sum of the squares of n normal numbers of variance 1 is more than x
 * (Abramowitz and Stegun, 26.4.4 and 26.4.5). */
static double probability(size_t n, double x) {
  const double y = 0.5 * x, half = n % 2 == 1 ? 0.5 : 0;
  double term = n % 2 == 1 ? sqrt(y) * 1.12837916709551257390 : 1; /* 2 / sqrt(pi) */
  double sum = n % 2 == 1 ? core_erfcx(sqrt(y)) : 0;
  for (size_t i = 0; i < n / 2; i++) {
    sum += term;
    term *= y / ((double)(i + 1) + half);
  }
  return sum * real_exp_signed(-y);
}

double fit_chi_squared_most(size_t spare) {
  spare = spare > 0 ? spare : 1;
  double least = 0, most = 30 + (double)spare + 6 * sqrt(2 * (double)spare);
  for (int i = 0; i < 60; i++) {
    const double middle = 0.5 * (least + most);
    const bool plausible = probability(spare, middle) >= CORE_FIT_PROBABILITY_LEAST;
    least = plausible ? middle : least;
    most = plausible ? most : middle;
  }
  return most;
}

static core_fault set_notes(core_fit *fit) {
  const core_medium medium = thick_enough(
      fit_medium(&fit->model, fit_grid_place(fit, FIT_GRID / 2 + FIT_GRID_SCATTERINGS / 2)));
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

/* Sets the nodes of each reading. */
static void set_places(core_fit *fit, const core_fit_design *design) {
  struct fit_places *places = &fit->places;
  places->first[0] = 0;
  places->radii = (core_radii_range){(double)INFINITY, 0};
  for (size_t i = 0; i < places->count; i++) {
    const size_t first = places->first[i];
    places->first[i + 1] = first + fit_disc_nodes(design->at[i], number_of(design->source_mm, i),
                                                  number_of(design->detector_mm, i),
                                                  places->at + first, places->weight + first);
    for (size_t k = first; k < places->first[i + 1]; k++) {
      places->ln_at[k] = fit_ln(places->at[k]);
      if (design->axis == CORE_FIT_AXIS_RADIUS) {
        places->radii.least_mm = real_min(places->radii.least_mm, places->at[k]);
        places->radii.most_mm = real_max(places->radii.most_mm, places->at[k]);
      }
    }
  }
}

/* Sets what readings are, and their frequencies. */
static void set_modulation(struct fit_places *places, const core_fit_design *design,
                           double *quantity) {
  places->modulated = is_modulated(design);
  places->quantity = quantity;
  for (size_t i = 0; i < places->count; i++) {
    quantity[i] = number_of(design->quantity, i);
    places->wavenumber_per_mm[i] = 6.28318530717958647693e-6 * number_of(design->mhz, i) *
                                   design->eta / CORE_LIGHT_SPEED_MM_PER_PS;
    places->wavenumber_most_per_mm =
        real_max(places->wavenumber_most_per_mm, places->wavenumber_per_mm[i]);
  }
}

/* Returns whether the discs of all readings have equal diameters. diameters may be NULL. */
static bool are_alike(const double *diameters, size_t count) {
  for (size_t i = 1; i < count; i++) {
    if (number_of(diameters, i) != number_of(diameters, 0)) {
      return false;
    }
  }
  return true;
}

/* R of all models falls with the distance, and so does its mean over equal discs; ratios to a
 * reference need not, and of a share of R it is not known. */
static void set_falling(core_fit *fit, const core_fit_design *design) {
  size_t *order = fit->places.first + fit->count + 1;
  const bool falls = design->axis == CORE_FIT_AXIS_RADIUS && !fit->model.narrow &&
                     design->scale != CORE_FIT_SCALE_REFERENCE &&
                     are_alike(design->source_mm, fit->count) &&
                     are_alike(design->detector_mm, fit->count);
  for (size_t i = 0; falls && i < fit->count; i++) {
    size_t at = i;
    for (; at > 0 && design->at[order[at - 1]] > design->at[i]; at--) {
      order[at] = order[at - 1];
    }
    order[at] = i;
  }
  fit->falling = falls ? order : NULL;
}

/* Prepares the table or the kernels that evaluate many media. */
static core_fault set_kernels(struct fit_model *model) {
  if (!core_solves(model->model) && model->quantity == CORE_QUANTITY_R) {
    const core_fault fault =
        core_varying_prepare(&model->varying, model->isa, model->model, model->moments,
                             CORE_EVALUATOR_F64, model->g, model->eta, &model->parameters);
    if (fault.field != NULL && strcmp(fault.field, CORE_FIELD_MEMORY) == 0) {
      return fault; /* a fit by the table would have other digits */
    }
    model->varies = fault.field == NULL;
  }
  if (model->varies || model->thickness_mm > 0) {
    return (core_fault){0};
  }
  const struct fit_table_source source = {.isa = model->isa,
                                          .model = model->model,
                                          .moments = model->moments,
                                          .quantity = model->quantity,
                                          .g = model->g,
                                          .eta = model->eta,
                                          .parameters = &model->parameters,
                                          .aperture = model->narrow ? &model->aperture : NULL};
  return fit_table_create(&model->table, &source);
}

static core_fault fill_design(core_fit *fit, const core_fit_design *design) {
  set_places(fit, design);
  set_falling(fit, design);
  set_bounds(fit, design);
  fit->chi_squared_most = fit_chi_squared_most(fit_spare(fit));
  core_fault fault = set_notes(fit);
  if (fault.field == NULL) {
    fault = set_kernels(&fit->model);
  }
  if (fault.field == NULL) {
    fault = set_weights(fit, design);
  }
  if (design->of_spectra) {
    return fault;
  }
  if (fault.field == NULL) {
    fault = fill_grid(fit);
  }
  const bool inverts = fit->count == 2 && !fit->free_factor && fit->model.table != NULL;
  if (fault.field == NULL && inverts &&
      !fit_inverse_create(&fit->inverse, &fit->model, &fit->places, fit->weight, fit->least,
                          fit->most)) {
    fault = CORE_OUT_OF_MEMORY;
  }
  return fault;
}

/* The numbers that a design holds for each reading: its weight, the grid, its wavenumber and what it
 * is; for each node: where it
 * is, the logarithm of that, and its weight. Of each reading it holds besides where its nodes begin
 * and, in the order of distances, its position. */
enum { NUMBERS = 3 + FIT_GRID, NODE_NUMBERS = 3 };

core_fault core_fit_create(core_fit **made, const core_isa *isa, const core_fit_design *design) {
  *made = NULL;
  core_fault fault = core_fit_check(design);
  if (fault.field != NULL) {
    return fault;
  }
  const size_t count = design->count, nodes = nodes_of(design);
  core_fit *fit = malloc(sizeof *fit);
  double *numbers = malloc((NUMBERS * count + NODE_NUMBERS * nodes) * sizeof *numbers);
  size_t *first = malloc((2 * count + 1) * sizeof *first);
  if (fit == NULL || numbers == NULL || first == NULL) {
    free(fit);
    free(numbers);
    free(first);
    return CORE_OUT_OF_MEMORY;
  }
  *fit = (core_fit){
      .model = model_of(isa, design),
      .free_factor = design->scale == CORE_FIT_SCALE_FREE,
      .count = count,
      .nodes = nodes,
      .weight = numbers,
      .grid = numbers + count,
      .places = {.count = count,
                 .first = first,
                 .at = numbers + NUMBERS * count,
                 .ln_at = numbers + NUMBERS * count + nodes,
                 .weight = numbers + NUMBERS * count + 2 * nodes,
                 .wavenumber_per_mm = numbers + (1 + FIT_GRID) * count},
  };
  set_modulation(&fit->places, design, numbers + (2 + FIT_GRID) * count);
  if (core_solves(fit->model.model)) {
    fit->model.parameters.value[CORE_PARAMETER_TOLERANCE] = (double)NAN;
  }
  fault = fill_design(fit, design);
  if (fault.field != NULL) {
    core_fit_free(fit);
  } else {
    *made = fit;
  }
  return fault;
}

void core_fit_free(core_fit *fit) {
  if (fit != NULL) {
    free(fit->inverse);
    free(fit->model.table);
    if (fit->model.varies) {
      core_varying_free(&fit->model.varying);
    }
    free(fit->places.first);
    free(fit->weight);
    free(fit);
  }
}

size_t core_fit_bytes(const core_fit *fit) {
  return sizeof *fit + (NUMBERS * fit->count + NODE_NUMBERS * fit->nodes) * sizeof(double) +
         (2 * fit->count + 1) * sizeof(size_t) +
         (fit->model.table != NULL ? sizeof *fit->model.table : 0) +
         fit_inverse_bytes(fit->inverse) +
         (fit->model.varies ? core_varying_bytes(&fit->model.varying) : 0);
}
