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
  double chi_squared_most; /* chi-squared above this is implausible */
  unsigned notes;
  /* model error of the readings of the reference medium; 0: there is none */
  double reference_error;
  size_t count;
  struct fit_place least; /* bounds of the search, with `most` */
  struct fit_place most;
  size_t nodes; /* number of nodes of all readings */
  struct fit_places places;
  double *weight; /* [count]: the factor of each reading's model */
  /* [count][FIT_GRID]: ln of the reading of each medium of the grid; NAN: the model does not cover
   * it */
  double *grid;
  /* NULL unless the set has two readings and a known factor, and the model a table */
  fit_inverse *inverse;
  /* [count]: the readings' positions in the order of their distances, if those of any medium fall
   * with the distance; else NULL. It points into places.first. */
  const size_t *falling;
};

/* Returns the number of readings minus the number of unknowns, or 0. */
size_t fit_spare(const core_fit *fit);

/* Returns medium i of the grid. */
struct fit_place fit_grid_place(const core_fit *fit, size_t i);

_Static_assert(FIT_GRID % FIT_LOOPS_MEDIA == 0, "the loops take all media of the grid");

/* A set of readings. */
struct fit_readings {
  const double *values;
  const double *errors;
  /* ln of the values above 0; other values are not used; NULL if not needed */
  const double *logarithms;
};

/* Chi-squared at a medium as far as it is quadratic: information and gradient by (ln_ratio,
 * ln_scattering), with the factor eliminated. */
struct fit_quadratic {
  struct fit_place place;
  bool logarithms; /* whether the residuals are logarithmic */
  double factor;
  double chi_squared;
  double rr, rs, ss; /* information */
  /* minus half the derivatives of chi-squared by ln_ratio and by ln_scattering */
  double to_r, to_s;
  /* information of ln factor: with the two, and with itself; 0 if the factor is known */
  double fr, fs, ff;
};

/* A minimum that the search has found, or descends to. */
struct fit_minimum {
  struct fit_quadratic at;
  bool settled;
  bool found;
};

struct fit_descent {
  double damping;
  double end; /* a step shorter than this is the last one */
  int left;   /* number of steps that are left */
};

/* What a search does next. */
enum fit_stage {
  FIT_BEGINS,
  FIT_INVERTS,        /* descends from the medium of the inverse */
  FIT_BEGINS_ROUND,   /* selects starts from the grid */
  FIT_BEGINS_START,   /* begins with the next start */
  FIT_COMES_NEAR,     /* descends with logarithmic residuals */
  FIT_BEGINS_MINIMUM, /* begins with linear residuals */
  FIT_SETTLES,        /* descends to a minimum with linear residuals */
  FIT_IS_DONE,
};

enum { FIT_STARTS_MAX = 24 };

/* If the readings exceed the unknowns by at most this many, the search for a second solution tries
 * more starts. */
enum { FIT_SPARSE = 3 };

struct core_fit_search {
  const core_fit *fit;
  struct fit_readings readings;
  enum fit_stage stage;
  unsigned evaluations;
  struct fit_minimum best, second; /* the best two minima found */
  int round;                       /* of starts, from 0: usual, careful, around the best */
  struct fit_place starts[FIT_STARTS_MAX];
  size_t start_count;
  size_t next_start;
  struct fit_place place; /* where the descent with linear residuals begins */
  struct fit_minimum now;
  struct fit_descent descent;
  double logarithms[CORE_FIT_READINGS_MAX]; /* ln of the readings */
};

/* The first invalid reading. field: 1 its value, 2 its error; 0: all are valid. */
struct fit_wrong {
  uint16_t field;
  uint32_t index;
};
struct fit_wrong fit_check_set(size_t count, const double *values, const double *errors);

/* Returns the chi-squared above which a fit is implausible. spare: readings less unknowns. */
double fit_chi_squared_most(size_t spare);

/* Returns the status of a fit of which these are true. */
enum core_fit_status fit_status(bool bound, bool implausible, bool vague, bool settled,
                                bool second);

#endif
