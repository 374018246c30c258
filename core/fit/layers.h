/* layers: finds coefficients and thicknesses of the two upper layers of a stack from readings of R
 * under transport. The rest of the stack is known.
 *
 * Method: chi-squared is minimized in the logarithms of the unknowns by Levenberg's and Marquardt's
 * method (More 1978), from the best of some media: half spaces that were fitted to the near and to
 * the far readings stand for the layers. R comes from the solver's coarsest grid, then from the
 * next one (solver_layers_solve_level()); derivatives are differences of solutions. Each search
 * takes its start for an estimate whose logarithms have the standard error 3, which pulls an
 * unknown of the standard error s by s^2/9 of the way; the last search starts where the first ones
 * ended. It takes some 5 to 40 s of a processor. The same request gives the same bits on every
 * machine. */
#ifndef DIPOLED_CORE_FIT_LAYERS_H
#define DIPOLED_CORE_FIT_LAYERS_H

#include "core/fit/fit.h"

enum { CORE_UNKNOWNS = 6 };

typedef struct core_layers_fit_request {
  unsigned scale;           /* ABSOLUTE or FREE */
  unsigned unknowns;        /* bits of enum core_unknown */
  const core_medium *layer; /* [layer_count]; what is given of an unknown has no meaning */
  size_t layer_count;       /* 1 to CORE_LAYERS_MAX */
  size_t count;             /* of readings: as many as unknowns, to CORE_FIT_READINGS_MAX */
  const double *at;         /* [count] distances in mm, above 0, finite */
  const double *values;     /* [count] R in 1/mm^2, which noise may make negative */
  const double *errors;     /* [count] their standard errors, above 0, finite */
} core_layers_fit_request;

/* What was found of one unknown: AT_BOUND (the value is the edge of the search range), UNDETERMINED
 * (the standard error of its logarithm is CORE_FIT_LN_ERROR_MAX or more; the value is NAN), or else
 * FITTED, IMPLAUSIBLE, UNFINISHED or AMBIGUOUS, as the readings together. The errors are INFINITY but of
 * FITTED ones. */
typedef struct core_estimate {
  uint16_t unknown; /* enum core_unknown */
  uint16_t status;  /* enum core_fit_status */
  uint32_t zero;
  double value;
  double error; /* standard error, if all other unknowns are free */
} core_estimate;

/* The layout is that of the wire as far as numerical_error. */
typedef struct core_layers_fit {
  /* As of a fit; FITTED only if all unknowns are. UNFINISHED, too, if numerical errors of R may
   * shift an unknown by more than its standard error. */
  uint16_t status;
  uint16_t unknowns;      /* of the request */
  uint32_t reading_count; /* likewise */
  uint64_t evaluations;   /* of layers for all readings */
  double factor;          /* of all readings, as an unknown; 1 unless the scale is FREE */
  double factor_error;    /* its standard error; 0 unless the scale is FREE */
  double chi_squared;
  double reduced_chi_squared; /* over readings less unknowns; NAN if they are as many */
  double numerical_error;     /* largest of R at the readings, relative; in no standard error */
  size_t unknown_count;
  core_estimate unknown[CORE_UNKNOWNS]; /* in the order of their bits */
} core_layers_fit;

/* Returns the fault of a request. Fields: `scale`, `unknowns`, `reading_count`; `at`, `values` and
 * `errors` with the index of the reading; those of core_profile_check() with that of the layer. */
core_fault core_layers_fit_check(const core_layers_fit_request *request);

/* Fits a request without a fault. residuals: [count] set to (value - factor R) / error. Gives up
 * within a tenth of a second of `stop` being true (CORE_FIELD_STOPPED). Other faults: `memory`, and
 * those of solver_layers_solve() if the solver takes none of the media that are tried first. */
core_fault core_layers_fit_run(core_layers_fit *fit, const core_isa *isa,
                               const core_layers_fit_request *request, double *residuals,
                               const atomic_bool *stop);

#endif
