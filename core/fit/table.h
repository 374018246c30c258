/* table: a model for media that a fit tries, of one g and eta. Internal to core/fit.
 *
 * In mean free paths 1 / sigma_t' the profile depends on the ratio sigma_a / sigma_s' and on x = r
 * sigma_t', or on q = 2 pi f / sigma_t', alone, unless a parameter is a length. The table holds
 *
 *   L = ln(x R) + kappa x - ln(1 + kappa x) - ln(sigma_s' / sigma_t')   or   ln R(f)
 *
 * at equal steps of ln(sigma_a / sigma_s') and of ln x or ln q. kappa is that of transport.
 * L is smooth: six points along the one and four along the other are interpolated by polynomials. */
#ifndef DIPOLED_CORE_FIT_TABLE_H
#define DIPOLED_CORE_FIT_TABLE_H

#include "core/core.h"
#include "core/fit/aperture.h"

/* Number of steps in ln_ratio, and in ln x or ln q, plus one; and the steps of a band of errors. */
enum { FIT_TABLE_RATIOS = 46, FIT_TABLE_PLACES = 220, FIT_TABLE_BAND = 10 };

/* What interpolation adds to the numerical error, relative. */
#define FIT_TABLE_ERROR 1e-4

#define FIT_LN_2_PI 1.83787706640934548356

typedef struct fit_table {
  bool waves;         /* whether the table is of TRANSFER */
  double ratio_least; /* ln */
  double ratio_step;
  double ln_least;
  double ln_step;
  double kappa[FIT_TABLE_RATIOS];
  double L[FIT_TABLE_RATIOS * FIT_TABLE_PLACES]; /* [FIT_TABLE_RATIOS][FIT_TABLE_PLACES] */
  double errors[FIT_TABLE_RATIOS][FIT_TABLE_PLACES / FIT_TABLE_BAND]; /* numerical, of profiles */
} fit_table;

/* What a table is made from: a model whose parameters have no length (`tolerance` is not used), and
 * R or TRANSFER. */
struct fit_table_source {
  const core_isa *isa;
  unsigned model;
  unsigned moments;
  enum core_quantity quantity;
  double g;
  double eta;
  const core_parameters *parameters;
  /* NULL, or an aperture of `g` and `eta`: R is then multiplied by its share */
  const fit_aperture *aperture;
};

/* Returns the numerical error of a value, relative. ln_place: ln x, or ln f over sigma_t'. */
double fit_table_error(const fit_table *table, double ln_ratio, double ln_place);

/* Makes a table. Faults are those of core_profile_prepare(). On a fault *table is NULL, else the
 * caller frees it with free(). */
core_fault fit_table_create(fit_table **table, const struct fit_table_source *source);

#endif
