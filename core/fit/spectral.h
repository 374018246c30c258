/* spectral: finds amounts of chromophores and scattering from readings at several wavelengths.
 *
 * At the wavelength l, in nm, a medium has
 *
 *   sigma_a = sum over i of amount_i absorption_i(l)
 *   sigma_s' = a (f (l / 500)^-4 + (1 - f) (l / 500)^-b)
 *
 * (Jacques 2013, Eqs. 12, 1 and 2), where haemoglobin in vessels absorbs less (core_tissue_packaging()).
 * f and the vessels are given; amounts, a and b are given or sought. g and eta are those of the
 * places, whose design (core/fit/fit.h, with of_spectra) evaluates R for all wavelengths.
 *
 * Method: chi-squared = sum ((value - factor R) / error)^2 is minimized by Levenberg's and
 * Marquardt's method in the amounts, ln a and b between their limits, from the best amounts for each of five a,
 * first with logarithmic residuals; an unknown factor is eliminated. The same readings give the same
 * bits on every machine. */
#ifndef DIPOLED_CORE_FIT_SPECTRAL_H
#define DIPOLED_CORE_FIT_SPECTRAL_H

#include "core/fit/fit.h"
#include "core/tissue/tissue.h"

enum {
  CORE_SPECTRAL_UNKNOWNS_MAX = 16,   /* the factor aside */
  CORE_SPECTRAL_READINGS_MAX = 4096, /* in a set: wavelengths times places */
};

/* An unknown is UNDETERMINED if its standard error is at least this share of the range between its
 * limits: half of the standard deviation of a number that may be anywhere between them. */
#define CORE_SPECTRAL_SHARE_MOST 0.144

/* What is sought of a tissue: an amount, CORE_PROPERTY_A or CORE_PROPERTY_B, and its limits; both 0: 0
 * (a .2, b -.5) to the property's most (haemoglobin that of whole blood, a 10, b 4). */
typedef struct core_sought {
  uint32_t property;
  uint32_t zero;
  double low, high;
} core_sought;

typedef struct core_spectral_design {
  core_tissue
      tissue; /* what is known; of what is sought, where the search starts, if within limits */
  size_t sought_count;       /* 1 to CORE_SPECTRAL_UNKNOWNS_MAX */
  const core_sought *sought; /* [sought_count] */
  size_t wavelength_count;
  const double *wavelength_nm; /* [wavelength_count] */
} core_spectral_design;

/* What was found of a property, of the saturation or of the total: FITTED; UNDETERMINED (the value is
 * NAN); AT_BOUND (the value is a limit, or depends on one that is); AMBIGUOUS (another solution fits as well); IMPLAUSIBLE (as all of the set);
 * these have no error; or UNFINISHED (numerical errors of
 * R may shift it by more than its standard error, or the search did not settle). */
typedef struct core_spectral_estimate {
  uint16_t property; /* 0: of several */
  uint16_t status;   /* enum core_fit_status */
  uint32_t zero;
  double value;
  double error;     /* standard, with all other unknowns free; INFINITY if it has none */
  double numerical; /* how far numerical errors of R may shift the value */
} core_spectral_estimate;

/* The layout is that of the wire as far as model_error. */
typedef struct core_spectral_result {
  uint16_t status; /* as of a fit; FITTED only if all unknowns are */
  uint16_t field;  /* REFUSED: as of a fit, with the index of the reading */
  uint16_t saturation_status, total_status;
  uint32_t index;
  uint32_t evaluations; /* of the model for all readings */
  /* Oxyhaemoglobin's share of both, and their sum, by their covariance; NAN, and so are the errors,
   * unless both are there and one of them is sought. */
  double saturation, saturation_error, total, total_error;
  double factor, factor_error; /* of all readings; 1 and 0 unless the scale is FREE */
  double chi_squared;
  double reduced_chi_squared; /* over readings less unknowns; NAN if they are as many */
  /* The largest over the least standard error along directions of the unknowns, each in units of
   * its standard error with all others known; INFINITY if a direction changes nothing. */
  double condition;
  double numerical_error; /* largest of R at the readings, relative */
  double model_error;     /* largest of R against radiative transport; NAN: not known */
  size_t unknown_count;
  core_spectral_estimate unknown[CORE_SPECTRAL_UNKNOWNS_MAX]; /* by their ids */
  /* [unknown_count][unknown_count] as the readings' errors have it, of UNDETERMINED ones, too; a
   * variance is INFINITY without information */
  double covariance[CORE_SPECTRAL_UNKNOWNS_MAX * CORE_SPECTRAL_UNKNOWNS_MAX];
} core_spectral_result;

/* A design with what a search needs; one thread uses it at a time. */
typedef struct core_spectral core_spectral;

/* Prepares a design for this many places; it is copied. On a fault *made is NULL, else the caller frees
 * it with core_spectral_free(), which accepts NULL. Fields: `property`, `low` and `high` with the index
 * of what is sought; those of core_tissue_medium() with that of the wavelength; `wavelength_count`,
 * `memory`. */
core_fault core_spectral_create(core_spectral **made, const core_spectral_design *design,
                                size_t places, unsigned scale);
void core_spectral_free(core_spectral *spectral);

/* Begins with a set, at places that have been prepared: values and errors [wavelength][place], as of
 * core_fit_run(). All have to stay. Returns whether the search continues; if not, the readings are refused. core_spectral_step()
 * does about one evaluation of all readings and returns whether the search continues. What returns
 * false has set the result and the residuals, as of core_fit_run(), which may be NULL. */
bool core_spectral_begin(core_spectral *spectral, const core_fit *places, const double *values,
                         const double *errors, core_spectral_result *result, double *residuals);
bool core_spectral_step(core_spectral *spectral, core_spectral_result *result, double *residuals);

#endif
