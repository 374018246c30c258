/* spectrum: the wavenumbers of a path, the exitance at them, and the transform back to radii. */
#ifndef DIPOLED_TESTS_ISOTROPIC_SPECTRUM_H
#define DIPOLED_TESTS_ISOTROPIC_SPECTRUM_H

#include <complex.h>
#include <stdbool.h>
#include <stddef.h>

#include "tests/accuracy/isotropic/equation.h"
#include "tests/accuracy/isotropic/nodes.h"

enum {
  SPECTRUM_POINTS_MAX = 640,
  SPECTRUM_LEVEL_MAX = 120, /* lambda is about 2^-30 at this level */
};

/* The rules for one eta. Few wavenumbers are small, and these are treated more accurately: they
 * alone determine R at large radii, where most of their sum cancels. */
typedef struct spectrum_rules {
  double accuracy;
  double reach_decays; /* R is accurate up to this many decay lengths 1 / kappa */
  nodes_rules near;
  nodes_rules far;
} spectrum_rules;

void isotropic_spectrum_rules(spectrum_rules *rules, double eta, double accuracy,
                              double reach_decays);

/* The wavenumbers of a path, each with its equation for one eta and accuracy. */
typedef struct spectrum_grid {
  double lambda; /* k = lambda sinh(y + i mu) */
  double mu;
  double step; /* step of y, which starts at 0 */
  size_t n;
  equation equations[SPECTRUM_POINTS_MAX];
} spectrum_grid;

/* Returns the level of media with this kappa (see transport_kappa()), 0 to SPECTRUM_LEVEL_MAX. */
size_t isotropic_spectrum_level(double kappa);

/* Returns lambda for a level, times shrink, 0.5 to 1: another value gives another path, to compare
 * with. */
double isotropic_spectrum_lambda(size_t level, double shrink);

/* Makes a grid, which the caller frees with isotropic_grid_free(), or returns NULL if memory runs
 * out. lambda: at most the kappa of the media; the nearer it is to kappa, the more digits R keeps
 * far away. */
spectrum_grid *isotropic_grid_new(const spectrum_rules *rules, double lambda);
void isotropic_grid_free(spectrum_grid *of);

/* The exitance of light scattered more than once, at the grid's wavenumbers and beyond. */
typedef struct spectrum {
  double lambda;
  double far; /* limit of exitance times k^2 as k goes to infinity */
  size_t n;
  double complex k[SPECTRUM_POINTS_MAX];
  double complex weighted[SPECTRUM_POINTS_MAX]; /* exitance times the rule's weight dk */
} spectrum;

/* Sets *to to the spectrum of one medium. albedo: in (0, 1]; kappa: transport_kappa(albedo), which
 * is of the level that the grid was made for. Returns false if memory runs out. */
bool isotropic_spectrum_make(spectrum *to, const spectrum_grid *grid, isotropic_work *work,
                             double albedo, double kappa);

/* Light scattered more than once, at a radius r: R per squared mean free path, and energies per
 * power that has entered. */
typedef struct spectrum_values {
  double r;          /* R per squared mean free path */
  double r_rounding; /* bound of the error of R that comes from rounding its terms */
  double within;     /* energy within r, accurate for small r */
  double beyond;     /* energy beyond r, accurate for large r */
} spectrum_values;

spectrum_values isotropic_spectrum_at(const spectrum *of, double r);

#endif
