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
  double reference_error; /* model error of the reference medium's readings; 0 without one */
  size_t count;
  struct fit_place least; /* bounds of the search */
  struct fit_place most;
  size_t nodes; /* of all places */
  struct fit_places places;
  double *weight;       /* [count]: factor of each reading's model */
  double *grid;         /* [count][FIT_GRID]: ln of the model of each medium; NAN if it has none */
  fit_inverse *inverse; /* NULL unless there are two readings, a known factor, and a table */
  /* [count]: the readings' positions in the order of their distances, if those of any medium fall
   * with the distance; else NULL. It points into places.first. */
  const size_t *falling;
};

/* Returns the number of readings minus the number of unknowns. */
size_t fit_spare(const core_fit *fit);

/* Returns medium i of the grid. */
struct fit_place fit_grid_place(const core_fit *fit, size_t i);

_Static_assert(FIT_GRID % FIT_LOOPS_MEDIA == 0, "the loops take all media of the grid");

/* The readings of a set. */
struct fit_readings {
  const double *values;
  const double *errors;
  const double *logarithms; /* of values above 0: others do not count; NULL if none are needed */
};

/* Chi-squared at a medium as far as it is quadratic: information and gradient by (ln_ratio,
 * ln_scattering), with the factor eliminated. */
struct fit_quadratic {
  struct fit_place place;
  bool logarithms; /* whether the residuals are those of logarithms */
  double factor;
  double chi_squared;
  double rr, rs, ss; /* information */
  double to_r, to_s; /* half of the descent of chi-squared by each logarithm */
  double fr, fs, ff; /* information of ln factor with the two and by itself; 0 if it is known */
};

/* A minimum that the search has found, or descends to. */
struct fit_minimum {
  struct fit_quadratic at;
  bool settled;
  bool found;
};

struct fit_descent {
  double damping;
  double end; /* a step that is shorter than this is the last */
  int left;   /* steps that may still be tried */
};

/* What a search does next. */
enum fit_stage {
  FIT_BEGINS,
  FIT_INVERTS,        /* descends from the inverse's medium */
  FIT_BEGINS_ROUND,   /* chooses starts of the grid */
  FIT_BEGINS_START,   /* begins with the next of them */
  FIT_COMES_NEAR,     /* descends with logarithms */
  FIT_BEGINS_MINIMUM, /* begins without logarithms */
  FIT_SETTLES,        /* descends to a minimum */
  FIT_IS_DONE,
};

enum { FIT_STARTS_MAX = 16 };

/* If the readings exceed the unknowns by at most this many, the search for a second solution tries
 * more starts. */
enum { FIT_SPARSE = 3 };

struct core_fit_search {
  const core_fit *fit;
  struct fit_readings readings;
  enum fit_stage stage;
  unsigned evaluations;
  struct fit_minimum best, second; /* of those that were found */
  bool is_careful;                 /* of the two rounds of starts it is the second */
  size_t starts[FIT_STARTS_MAX];   /* positions in the grid */
  size_t start_count;
  size_t next_start;
  struct fit_place place; /* where the descent without logarithms begins */
  struct fit_minimum now;
  struct fit_descent descent;
  double logarithms[CORE_FIT_READINGS_MAX]; /* of the readings */
};

/* Begins a search for readings that have been checked. */
void fit_search_begin(core_fit_search *search, const core_fit *fit, const double *values,
                      const double *errors);

/* Goes on by at most one evaluation of the model. Returns whether the search is done. */
bool fit_search_step(core_fit_search *search);

/* Sets the result of a search that is done. */
void fit_search_result(const core_fit_search *search, core_fit_result *result, double *residuals);

#endif
