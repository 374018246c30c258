/* search: finds the medium with the least chi-squared. Internal to core/fit. */
#ifndef DIPOLED_CORE_FIT_SEARCH_H
#define DIPOLED_CORE_FIT_SEARCH_H

#include "core/fit/fit.h"
#include "core/fit/inverse.h"
#include "core/fit/values.h"

/* The grid of media that gives the starts: equal steps in ln(sigma_a / sigma_s') and ln(sigma_s').
 */
enum {
  FIT_GRID_RATIOS = 16,
  FIT_GRID_SCATTERINGS = 24,
  FIT_GRID = FIT_GRID_RATIOS * FIT_GRID_SCATTERINGS,
};

struct core_fit {
  struct fit_model model;
  bool free_factor;
  double chi_squared_most; /* the largest that is plausible */
  unsigned notes;
  size_t count;
  struct fit_place least; /* bounds of the search */
  struct fit_place most;
  size_t nodes_most; /* nodes that the places have room for */
  struct fit_places places;
  double *weight;       /* [count]: what the model of each reading is multiplied by */
  double *grid;         /* [count][FIT_GRID]: ln of the model of each medium; NAN if it has none */
  fit_inverse *inverse; /* NULL unless there are two readings, a known factor, and a table */
};

/* Returns the number of readings less that of unknowns. */
size_t fit_spare(const core_fit *fit);

/* Returns medium i of the grid. */
struct fit_place fit_grid_place(const core_fit *fit, size_t i);

/* Does what core_fit_run() does for readings that have been checked. */
void fit_search(const core_fit *fit, const double *values, const double *errors,
                core_fit_result *result, double *residuals);

#endif
