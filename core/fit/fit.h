/* fit: finds sigma_a and sigma_s' of a medium from readings of its reflectance.
 *
 * core_fit_create() takes what an instrument is: its places (distances or spatial frequencies), its
 * fibres, the model, g, eta, and what is known about the scale. core_fit_run() then takes one set
 * of readings after the other; it allocates nothing, keeps no state, and may be called from any
 * number of threads with the same core_fit. The same readings give the same bits on every machine,
 * whatever was fitted before.
 *
 * Method: chi-squared = sum ((value - factor model) / error)^2 is minimized by Levenberg's and
 * Marquardt's method (Marquardt 1963) in ln sigma_a and ln sigma_s'; an unknown factor is
 * eliminated, because the model is linear in it (Golub, Pereyra 1973). A grid of media, which the
 * design keeps, gives the starts: each of its local minima is one, so that a second solution is
 * found. Two readings of known scale under `transport` start from a table of the inverse instead,
 * where it is shown that no second medium fits them (core/fit/inverse.h).
 */
#ifndef DIPOLED_CORE_FIT_H
#define DIPOLED_CORE_FIT_H

#include "core/core.h"

/* The largest number of readings in a set. */
#define CORE_FIT_READINGS_MAX 1024

/* Media that are tried: sigma_a / sigma_s' between these two, and sigma_s' from CORE_FIT_NEAR_MIN
 * over the largest distance to CORE_FIT_NEAR_MAX over the least. A frequency f counts as the
 * distance 1 / (2 pi f), a distance that is shorter than the fibres' mean radius as that radius,
 * and without any positive distance 1 mm counts. */
#define CORE_FIT_RATIO_MIN 1e-6
#define CORE_FIT_RATIO_MAX 50.0
#define CORE_FIT_NEAR_MIN 1e-3
#define CORE_FIT_NEAR_MAX 1e3

/* A fit is `undetermined` if its condition number is at least CORE_FIT_CONDITION_MAX, or if the
 * standard error of ln sigma_a or ln sigma_s' is at least CORE_FIT_LN_ERROR_MAX. It is `ambiguous`
 * if the chi-squared of a second solution is less than CORE_FIT_AMBIGUOUS above that of the
 * first. */
#define CORE_FIT_CONDITION_MAX 1e6
#define CORE_FIT_LN_ERROR_MAX 1.0
#define CORE_FIT_AMBIGUOUS 9.0

/* A fit is `implausible` if noise with the stated errors would make chi-squared as large with less
 * than this probability, under the chi-squared distribution of readings less unknowns, or of one if
 * there are as many. A fit is also `implausible`, even if the search does not settle or ends at a
 * bound, if the readings rise with the distance so much that any values that do not rise would have
 * a chi-squared as large. */
#define CORE_FIT_PROBABILITY_LEAST 1e-6

/* Models that take more than some microseconds for a medium are fitted by a table, which is up to some
 * 1e-5 off. If all errors of a set are below this share of its readings, the table is refined with
 * profiles of the model. */
#define CORE_FIT_EXACT_BELOW 3e-4

/* The largest number of steps of refining that are useful. */
#define CORE_FIT_REFINE_MOST 6

/* The largest number of readings in a set with modulated light. */
#define CORE_FIT_MODULATED_MAX 512

/* What does not change from one set of readings to the next. Arrays have `count` values. */
typedef struct core_fit_design {
  unsigned model;
  unsigned moments;
  double g;
  double eta;
  double thickness_mm;               /* mm, thickness of the media; 0: half spaces */
  const core_parameters *parameters; /* parameters of the model; NULL: none */
  unsigned axis;                     /* enum core_fit_axis */
  size_t count;                      /* number of readings: at least 2, or 3 with a free factor */
  /* Axis RADIUS: distances in mm, above 0 without fibres. FREQUENCY: frequencies in 1/mm, at least
   * 0. */
  const double *at;
  /* Diameters of the light's disc and of the detector's disc, at least 0; NULL: all are 0. Each
   * disc is uniform. */
  const double *source_mm;
  const double *detector_mm;
  /* 0, or the sine of the largest angle to the normal outside at which light is detected, 0.01 to 1:
   * the detector's numerical aperture over the refractive index outside. Readings are then of this
   * light alone, and each is a share of R that depends on the distance and the medium. 0 and
   * min(1, eta) and more: light of all angles. For axis RADIUS, model TRANSPORT, g (or gamma - 1)
   * from 0 to 0.95 and eta from 0.7 to 2.2. The share's error is
   * part of the result's model_error. */
  double detector_na;
  unsigned scale;        /* enum core_fit_scale */
  core_medium reference; /* the known medium, if scale is REFERENCE */
  /* Whether the places serve spectra (core/fit/spectral.h) alone: any count from 1 on. */
  bool of_spectra;
  /* Of spectra: the light's modulation, 0 to 1e5 MHz, and what a reading is: 0 the amplitude |R~|, or
   * CORE_QUANTITY_PHASE, its lag in degrees and not reduced to a circle, or CORE_QUANTITY_MODULATION,
   * |R~| / R, as core/paths.h has them with the index eta. With axis FREQUENCY they are of R(f). NULL:
   * all are 0. */
  const double *mhz;
  const double *quantity;
} core_fit_design;

/* A design, prepared. It is immutable. */
typedef struct core_fit core_fit;

/* Returns the fault that core_fit_create() would return, except `memory`. Fields: those of
 * core_profile_check(); `axis`, `scale`, `count`; `detector_na`; `at`, `source`, `detector`,
 * `quantity`, `mhz` with the index of the reading; and `reference` if the model gives no light for it at the reading of
 * that index. */
core_fault core_fit_check(const core_fit_design *design);

/* Prepares a design; the arrays are copied. For most models this makes a table of ratios and
 * distances: `transport` takes 30 to 200 ms, others 2 to 50 ms, and seconds where the shipped table of
 * transport does not reach. A dipole at distances needs no table. Each fibre's disc takes about a
 * millisecond more. On a fault *fit is NULL, else the caller owns it and frees it with
 * core_fit_free(), which accepts NULL. */
core_fault core_fit_create(core_fit **fit, const core_isa *isa, const core_fit_design *design);
void core_fit_free(core_fit *fit);

/* What sets of a design cost, before it is prepared: evaluations of the model for a set, on average,
 * and the time of one in kernel evaluations of a dipole (as core_profile's `cost`). core_fit_check()
 * must have accepted the design. */
typedef struct core_fit_cost {
  unsigned evaluations;
  double evaluation;
} core_fit_cost;
core_fit_cost core_fit_cost_of(const core_fit_design *design);

/* Returns the memory in bytes of a prepared design. */
size_t core_fit_bytes(const core_fit *fit);

/* Bits for the bounds of the search at which a solution lies. */
enum core_fit_bound {
  CORE_FIT_RATIO_LEAST = 1,
  CORE_FIT_RATIO_MOST = 2,
  CORE_FIT_SCATTERING_LEAST = 4,
  CORE_FIT_SCATTERING_MOST = 8,
};

/* A medium that the fit found. */
typedef struct core_fit_solution {
  double sigma_a_per_mm;
  double sigma_s_prime_per_mm; /* sigma_s (1 - g) */
  double factor;               /* of all readings; 1 unless the scale is FREE */
  double chi_squared;
} core_fit_solution;

/* Variances of sigma_a, sigma_s' and the factor and their covariances, in the units of their
 * products. They follow from the readings' errors as stated and from the derivatives at the best
 * medium. Those of the factor are 0 unless the scale is FREE. Without information they are
 * infinite. */
typedef struct core_fit_covariance {
  double a_a;
  double a_s;
  double s_s;
  double a_factor;
  double s_factor;
  double factor_factor;
} core_fit_covariance;

/* The layout is that of the wire as far as model_error. */
typedef struct core_fit_result {
  uint16_t status; /* enum core_fit_status */
  uint16_t bounds; /* bits of enum core_fit_bound */
  /* Status REFUSED: 1 if the value of a reading is wrong, 2 if its error is, and which reading; else
   * 0. The members that follow are then NAN or 0. */
  uint16_t field, zero;
  uint32_t index;
  uint32_t evaluations; /* of the model for all readings */
  core_fit_solution best;
  double reduced_chi_squared; /* chi-squared over (readings - unknowns); NAN if they are as many */
  /* The largest over the least standard error along any direction of (ln sigma_a, ln sigma_s'), the
   * factor being free if it is unknown: the square root of the condition of the information matrix.
   * INFINITY if a direction changes nothing. */
  double condition;
  core_fit_covariance covariance;
  /* Another local minimum whose chi-squared is less than CORE_FIT_AMBIGUOUS above that of the best;
   * all NAN if none was found. */
  core_fit_solution second;
  /* The relative error of R of the best medium against radiative transport, at the distances of the
   * readings and between them. For TRANSPORT without gamma it is 0, or with detector_na the error
   * of the share that is detected. For all other models it is NAN: not known. With scale REFERENCE
   * it is the error of the ratio. The covariance does not include it. Neither of them includes the
   * numerical error of R (core_profile_errors()): for TRANSPORT with g other than 0 that may be
   * 1e-3, and more with sigma_a above sigma_s'. */
  double model_error;
  unsigned notes; /* bits of enum core_note, of the model */
} core_fit_result;

/* Fits one set: values[count], which may be negative by noise, in 1/mm^2 (axis RADIUS) or 1 (FREQUENCY), or 1 for
 * ratios; errors[count] are their standard errors, above 0 and finite. residuals: NULL, or room for
 * count numbers (value - factor model) / error at the best medium. */
void core_fit_run(const core_fit *fit, const double *values, const double *errors,
                  core_fit_result *result, double *residuals);

/* The same in steps, for a caller that has other work beside: a set of 1024 readings takes up to 20
 * ms. core_fit_begin() returns whether the search continues; if not, it has set the result of
 * readings that are refused. core_fit_step() does at most one evaluation of the model; it sets the
 * result and returns false when the search is done. Until then values and errors have to stay
 * valid. core_fit_search_new() returns NULL if memory runs out; a search serves one set after
 * the other. */
typedef struct core_fit_search core_fit_search;
core_fit_search *core_fit_search_new(void);
void core_fit_search_free(core_fit_search *search); /* accepts NULL */
bool core_fit_begin(core_fit_search *search, const core_fit *fit, const double *values,
                    const double *errors, core_fit_result *result, double *residuals);
bool core_fit_step(core_fit_search *search, core_fit_result *result, double *residuals);

/* Refining is for readings whose errors are so small that the table's count. The caller prepares
 * the profile of a medium by the design's model, moments and parameters and the evaluator f64, and passes
 * it on, step by step. That is left to the caller because a profile may take long.
 *
 * core_fit_wants_exact() returns whether a set that was fitted should be refined, and sets the first
 * medium. core_fit_refine() does one step: it sets the result by the profile of the last medium. It
 * returns true if the result should be refined further, with the medium that it sets then. */
bool core_fit_wants_exact(const core_fit *fit, const double *values, const double *errors,
                          const core_fit_result *result, core_medium *medium);
bool core_fit_refine(const core_fit *fit, const core_profile *profile, const double *values,
                     const double *errors, core_fit_result *result, double *residuals,
                     core_medium *medium);

#endif
