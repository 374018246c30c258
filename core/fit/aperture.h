/* aperture: the share of R that leaves within a cone of angles around the normal, which is the light
 * that a fibre of limited numerical aperture takes. Internal to core/fit.
 *
 * The share of a cone whose largest angle to the normal outside has the sine NA is u^2 e^F, where u =
 * NA / min(1, eta): u^2 is the share of light whose radiance outside is the same in all directions. F
 * comes from a table that is part of the program (aperture.table, made by `make apertures` with the
 * solver of core/solver/solver.h), for Henyey and Greenstein's function. It is a Chebyshev
 * series in five coordinates, each mapped to -1 to 1:
 *
 *   y = ln x                                       x the radius in reduced mean free paths 1 /
 *                                                  sigma_t', from FIT_APERTURE_X_LEAST to the reach
 *                                                  1 / (kappa / 20 + 1 / 100)
 *   s = sqrt(1 - a)                                a = sigma_s' / sigma_t', for sigma_a / sigma_s'
 *                                                  from 1e-6 to FIT_APERTURE_RATIO_MOST
 *   v = sqrt(1 - eta^2) or sqrt(1 - 1 / eta^2)     one side for eta below 1, one from 1 on, as
 *                                                  Fresnel's reflectance is not smooth there
 *   g
 *   ln u
 *
 * Beyond the ends of y, s and ln u, F is that of the end. aperture_errors.def has the errors that `make
 * apertures` has found.
 */
#ifndef DIPOLED_CORE_FIT_APERTURE_H
#define DIPOLED_CORE_FIT_APERTURE_H

#include <stddef.h>

#define FIT_APERTURE_X_LEAST 0.02
#define FIT_APERTURE_RATIO_MOST 10.0
#define FIT_APERTURE_ETA_LEAST 0.7
#define FIT_APERTURE_ETA_MOST 2.2
#define FIT_APERTURE_G_MOST 0.95
#define FIT_APERTURE_U_LEAST 0.1
#define FIT_APERTURE_QUANTUM 2e-5 /* unit of the table's integers */

/* Number of terms in each coordinate, for each side of eta = 1. */
enum {
  FIT_APERTURE_PLACES = 32,
  FIT_APERTURE_RATIOS = 9,
  FIT_APERTURE_ETAS_BELOW = 4,
  FIT_APERTURE_ETAS_FROM = 6,
  FIT_APERTURE_GS = 5,
  FIT_APERTURE_CONES = 7,
};

/* F for one g, eta and numerical aperture. */
typedef struct fit_aperture {
  double u2;
  double term[FIT_APERTURE_RATIOS][FIT_APERTURE_PLACES];
} fit_aperture;

/* Sets *aperture up. g: 0 to FIT_APERTURE_G_MOST; eta: FIT_APERTURE_ETA_LEAST to
 * FIT_APERTURE_ETA_MOST; NA: above 0, up to 1 (all asserted). */
void fit_aperture_prepare(fit_aperture *aperture, double g, double eta, double NA);

/* F for one medium, as a function of ln x. */
typedef struct fit_aperture_row {
  double u2;
  double ln_reach;
  double term[FIT_APERTURE_PLACES];
} fit_aperture_row;

/* Sets *row for the medium with this ratio sigma_a / sigma_s', at least 0. */
void fit_aperture_medium(const fit_aperture *aperture, double ratio, fit_aperture_row *row);

/* Returns the share of R that leaves within the aperture, at ln x. */
double fit_aperture_share(const fit_aperture_row *row, double ln_x);

/* Returns the relative error of shares from x_least to x_most, as `make apertures` has measured it. It
 * is NAN beyond the ends of y and where ln u and s are beyond theirs, u below and s above. */
double fit_aperture_error(const fit_aperture *aperture, double ratio, double x_least,
                          double x_most);

/* ---- for what makes the table ------------------------------------------------------------------ */

/* Returns the ratio, eta (i from 0, those below 1 first, from FIT_APERTURE_ETA_LEAST to 1, then those
 * from 1 on), g or u of node i, which are Chebyshev's extrema; and x of node i of a medium. */
double fit_aperture_ratio(size_t i);
double fit_aperture_eta(size_t i);
double fit_aperture_g(size_t i);
double fit_aperture_u(size_t i);
double fit_aperture_x(size_t i, double ratio);

#endif
