#include "core/fit/table.h"

#include <math.h>
#include <stdlib.h>

#include "core/fit/fit.h"
#include "core/kernels.h"
#include "core/transport/transport.h"

#define CORE_REAL 64
#include "core/kernel.h"

enum {
  RATIOS = 46, /* steps in ln_ratio, and one */
  PLACES = 220,
  TABLED = RATIOS * PLACES,
  ACROSS = 6, /* points that are interpolated in ln_ratio */
  ALONG = 4,  /* and in the logarithm */
};

/* Below and beyond these, L is taken as constant. */
#define RADIUS_LEAST 1e-5
#define RADIUS_MOST 3e3
#define WAVE_LEAST 1e-7
#define WAVE_MOST 1e3

/* The tolerance by which a profile of transport comes from the table of solutions, wherever it can;
 * and that of other models. */
#define TRANSPORT_TOLERANCE 1e-3
#define OTHER_TOLERANCE 1e-8

#define LN_2_PI 1.83787706640934548356

struct fit_table {
  bool waves;         /* whether the quantity is TRANSFER */
  double ratio_least; /* ln */
  double ratio_step;
  double ln_least;
  double ln_step;
  double kappa[RATIOS];
  double L[TABLED]; /* [RATIOS][PLACES] */
};

/* ---- making ---------------------------------------------------------------------------------- */

/* Sets row i from the profile of its medium with sigma_t' = 1 per mm. */
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
  table->kappa[i] = kappa;
  core_eval_f64(&profile, table->waves ? CORE_QUANTITY_TRANSFER : CORE_QUANTITY_LN_R, PLACES, at,
                L);
  for (size_t k = 0; k < PLACES; k++) {
    L[k] = table->waves ? real_log(real_max(L[k], 1e-300), 0)
                        : L[k] + real_log(at[k], 0) + kappa * at[k] -
                              real_log(1 + kappa * at[k], 0) - real_log(albedo, 0);
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
  taken.value[CORE_PARAMETER_TOLERANCE] =
      source->model == CORE_MODEL_TRANSPORT ? TRANSPORT_TOLERANCE : OTHER_TOLERANCE;
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

void fit_table_free(fit_table *table) {
  free(table);
}

size_t fit_table_bytes(const fit_table *table) {
  return table != NULL ? sizeof *table : 0;
}

/* ---- evaluating ------------------------------------------------------------------------------ */

/* Where a number lies among nodes with equal steps: the first of the `points` nodes to interpolate,
 * and their Lagrange polynomials and the derivatives of these, in steps. */
struct stencil {
  size_t first;
  double value[ACROSS];
  double slope[ACROSS];
};

static struct stencil stencil_at(double position, size_t nodes, int points) {
  static const double per_factorials[2][ACROSS] = {
      {-1.0 / 6, 1.0 / 2, -1.0 / 2, 1.0 / 6},
      {-1.0 / 120, 1.0 / 24, -1.0 / 12, 1.0 / 12, -1.0 / 24, 1.0 / 120}};
  struct stencil stencil;
  const double most = (double)(nodes - (size_t)points);
  const double first = real_min(real_max(position - (points / 2 - 1), 0), most);
  stencil.first = (size_t)first;
  const double t = position - (double)stencil.first;
  for (int j = 0; j < points; j++) {
    double product = per_factorials[points == ACROSS][j], slope = 0;
    for (int k = 0; k < points; k++) {
      slope = k == j ? slope : slope * (t - k) + product;
      product = k == j ? product : product * (t - k);
    }
    stencil.value[j] = product;
    stencil.slope[j] = slope;
  }
  return stencil;
}

/* L and its derivatives by ln_ratio and by the other logarithm, both in steps. */
struct interpolated {
  double value;
  double by_ratio;
  double by_ln;
};

static struct interpolated interpolate(const fit_table *table, const struct stencil *across,
                                       double position) {
  const struct stencil along = stencil_at(position, PLACES, ALONG);
  struct interpolated sum = {0, 0, 0};
  for (size_t i = 0; i < ACROSS; i++) {
    const double *L = &table->L[(across->first + i) * PLACES + along.first];
    double value = 0, slope = 0;
    for (size_t k = 0; k < ALONG; k++) {
      value += along.value[k] * L[k];
      slope += along.slope[k] * L[k];
    }
    sum.value += across->value[i] * value;
    sum.by_ratio += across->slope[i] * value;
    sum.by_ln += across->value[i] * slope;
  }
  return sum;
}

/* What all readings of a medium share. */
struct medium {
  double sigma_t_prime;
  double ln_sigma_t_prime;
  double absorbed; /* sigma_a / sigma_t', which is d ln sigma_t' / d ln_ratio */
  double kappa;
  double kappa_slope; /* by ln_ratio */
  double scale;       /* sigma_t' sigma_s' */
  struct stencil across;
};

static struct medium medium_at(const fit_table *table, double ln_ratio, double ln_scattering) {
  const double ratio = real_exp_signed(ln_ratio), scattering = real_exp_signed(ln_scattering);
  struct medium m = {.sigma_t_prime = scattering * (1 + ratio),
                     .ln_sigma_t_prime = ln_scattering + real_log(1 + ratio, 0),
                     .absorbed = ratio / (1 + ratio)};
  m.scale = m.sigma_t_prime * scattering;
  m.across = stencil_at((ln_ratio - table->ratio_least) / table->ratio_step, RATIOS, ACROSS);
  for (size_t i = 0; i < ACROSS; i++) {
    m.kappa += m.across.value[i] * table->kappa[m.across.first + i];
    m.kappa_slope += m.across.slope[i] * table->kappa[m.across.first + i];
  }
  m.kappa_slope /= table->ratio_step;
  return m;
}

static double kept_exp(double x) {
  return real_exp_signed(real_min(real_max(x, -690), 690));
}

void fit_table_values(const fit_table *table, double ln_ratio, double ln_scattering, size_t n,
                      const double *at, const double *ln_at, double *value, double *by_ratio,
                      double *by_scattering) {
  const struct medium m = medium_at(table, ln_ratio, ln_scattering);
  const double first =
      (table->waves ? LN_2_PI - m.ln_sigma_t_prime : m.ln_sigma_t_prime) - table->ln_least;
  const double per_step = 1 / table->ln_step, per_ratio = 1 / table->ratio_step;
  for (size_t i = 0; i < n; i++) {
    const double asked = (ln_at[i] + first) * per_step;
    const double position = real_min(real_max(asked, 0), PLACES - 1);
    const bool inside = asked >= 0 && asked <= PLACES - 1;
    const struct interpolated L = interpolate(table, &m.across, position);
    const double by_ln = inside ? L.by_ln * per_step : 0;
    double slope_s, slope_u; /* of the logarithm */
    if (table->waves) {
      value[i] = kept_exp(L.value);
      slope_s = -by_ln;
      slope_u = L.by_ratio * per_ratio - by_ln * m.absorbed;
    } else {
      /* ln R = L - ln x - kappa x + ln(1 + kappa x) + ln(sigma_t'^2 sigma_s' / sigma_t') */
      const double x = at[i] * m.sigma_t_prime, kx = m.kappa * x;
      const double bent = kx / (1 + kx); /* of ln(1 + kappa x), by ln x */
      value[i] = m.scale * (1 + kx) * kept_exp(L.value - kx) / (at[i] * m.sigma_t_prime);
      const double by_x = by_ln - 1 - kx + bent;
      slope_s = by_x + 2;
      slope_u = L.by_ratio * per_ratio - m.kappa_slope * x * bent + m.absorbed * (by_x + 1);
    }
    if (by_ratio != NULL) {
      by_ratio[i] = value[i] * slope_u;
      by_scattering[i] = value[i] * slope_s;
    }
  }
}
