#include "core/fit/table.h"

#include <math.h>
#include <stdlib.h>

#include "core/fit/fit.h"
#include "core/kernels.h"
#include "core/model_error.h"
#include "core/transport/decay.h"

#define CORE_REAL 64
#include "core/kernel.h"

enum { RATIOS = FIT_TABLE_RATIOS, PLACES = FIT_TABLE_PLACES };

/* L is constant outside of this range. */
#define RADIUS_LEAST 1e-5
#define RADIUS_MOST 3e3
#define WAVE_LEAST 1e-7
#define WAVE_MOST 1e3

/* The tolerance of all models but transport, which comes from the table of solutions. */
#define TOLERANCE 1e-8

/* ---- making ---------------------------------------------------------------------------------- */

/* Returns the error of R(f), absolute: the errors of R, of each band of radii, times the light there. */
static double error_of_waves(const core_profile *profile) {
  double within[CORE_ERROR_BANDS], sum = 0;
  core_eval_f64(profile, CORE_QUANTITY_CDF, CORE_ERROR_BANDS - 1, core_error_edges_mfp + 1, within);
  within[CORE_ERROR_BANDS - 1] = 1;
  for (size_t i = 0; i < CORE_ERROR_BANDS; i++) {
    sum = fma(profile->numerical_errors[i], within[i] - (i > 0 ? within[i - 1] : 0), sum);
  }
  return sum * profile->albedo;
}

/* Computes row i from the profile of its medium, with sigma_t' = 1 per mm. */
static core_fault fill_row(fit_table *table, size_t i, const struct fit_table_source *source,
                           const core_parameters *parameters) {
  const double ratio = real_exp_signed(table->ratio_least + table->ratio_step * (double)i);
  const double albedo = 1 / (1 + ratio);
  const core_medium medium = {ratio * albedo, albedo / (1 - source->g), source->g, source->eta};
  core_profile profile;
  const core_fault fault =
      core_profile_prepare(&profile, source->isa, source->model, source->moments,
                           CORE_EVALUATOR_F64, &medium, parameters);
  if (fault.field != NULL) {
    return fault;
  }
  double at[PLACES], *L = &table->L[i * PLACES];
  for (size_t k = 0; k < PLACES; k++) {
    const double place = real_exp_signed(table->ln_least + table->ln_step * (double)k);
    at[k] = table->waves ? place / 6.28318530717958647693 : place;
  }
  const double kappa = transport_kappa(albedo);
  fit_aperture_row row;
  if (source->aperture != NULL) {
    fit_aperture_medium(source->aperture, ratio, &row);
  }
  table->kappa[i] = kappa;
  core_eval_f64(&profile, table->waves ? CORE_QUANTITY_TRANSFER : CORE_QUANTITY_LN_R, PLACES, at,
                L);
  const double of_waves = table->waves ? error_of_waves(&profile) : 0;
  for (size_t k = 0; k < PLACES; k += FIT_TABLE_BAND) {
    const size_t end = k + FIT_TABLE_BAND < PLACES ? k + FIT_TABLE_BAND : PLACES - 1;
    const core_radii_range band = {at[k], at[end]};
    const core_stated_errors stated = core_profile_errors(&profile, CORE_QUANTITY_R, band);
    table->errors[i][k / FIT_TABLE_BAND] =
        table->waves ? of_waves / real_max(L[end], 1e-300) + CORE_TRANSFER_ERROR
                     : fma(stated.numerical_per_mm, band.most_mm, stated.numerical);
  }
  for (size_t k = 0; k < PLACES; k++) {
    L[k] = table->waves ? real_log(real_max(L[k], 1e-300), 0)
                        : L[k] + real_log(at[k], 0) + kappa * at[k] -
                              real_log(1 + kappa * at[k], 0) - real_log(albedo, 0);
    if (source->aperture != NULL) {
      L[k] += real_log(fit_aperture_share(&row, real_log(at[k], 0)), 0);
    }
  }
  core_profile_free(&profile);
  return (core_fault){0};
}

core_fault fit_table_create(fit_table **made, const struct fit_table_source *source) {
  *made = NULL;
  fit_table *table = malloc(sizeof *table);
  if (table == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  core_parameters taken = *source->parameters;
  taken.value[CORE_PARAMETER_TOLERANCE] = core_solves(source->model) ? (double)NAN : TOLERANCE;
  table->waves = source->quantity == CORE_QUANTITY_TRANSFER;
  table->ratio_least = real_log(CORE_FIT_RATIO_MIN, 0);
  table->ratio_step = (real_log(CORE_FIT_RATIO_MAX, 0) - table->ratio_least) / (RATIOS - 1);
  table->ln_least = real_log(table->waves ? WAVE_LEAST : RADIUS_LEAST, 0);
  table->ln_step =
      (real_log(table->waves ? WAVE_MOST : RADIUS_MOST, 0) - table->ln_least) / (PLACES - 1);
  core_fault fault = {0};
  for (size_t i = 0; i < RATIOS && fault.field == NULL; i++) {
    fault = fill_row(table, i, source, &taken);
  }
  if (fault.field != NULL) {
    free(table);
    return fault;
  }
  *made = table;
  return fault;
}

/* Returns the index of the node below, which has one above it. */
static size_t node_below(double position, size_t count) {
  return (size_t)real_min(real_max(position, 0), (double)(count - 2));
}

double fit_table_error(const fit_table *table, double ln_ratio, double ln_place) {
  const double place = ln_place + (table->waves ? FIT_LN_2_PI : 0);
  const size_t row = node_below((ln_ratio - table->ratio_least) / table->ratio_step, RATIOS);
  const size_t band =
      node_below((place - table->ln_least) / table->ln_step, PLACES) / FIT_TABLE_BAND;
  return FIT_TABLE_ERROR + real_max(table->errors[row][band], table->errors[row + 1][band]);
}
