/* spectrum: wavenumbers, the exitance there, and the way back to radii. */
#ifndef DIPOLED_CORE_TRANSPORT_SPECTRUM_H
#define DIPOLED_CORE_TRANSPORT_SPECTRUM_H

#include <complex.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/transport/equation.h"
#include "core/transport/nodes.h"

enum {
  SPECTRUM_POINTS_MAX = 640,
  SPECTRUM_LEVEL_MAX = 120, /* kappa down to 2^-30 */
};

/* The rules of one eta. Small wavenumbers, of which there are few, are treated more accurately:
 * they are all that reaches far, where most of their sum cancels. */
typedef struct spectrum_rules {
  double accuracy;
  double reach_decays; /* R is accurate to that many decay lengths, 1 / kappa */
  nodes_rules near;
  nodes_rules far;
} spectrum_rules;

void transport_spectrum_rules(spectrum_rules *rules, double eta, double accuracy,
                              double reach_decays);

/* The wavenumbers of a path, each with its equation for one eta and accuracy. */
typedef struct spectrum_grid {
  double lambda; /* k = lambda sinh(y + i mu) */
  double mu;
  double step; /* of y, from 0 on */
  size_t n;
  equation equations[SPECTRUM_POINTS_MAX];
} spectrum_grid;

/* The level of media with this kappa (transport_kappa()), 0 to SPECTRUM_LEVEL_MAX. */
size_t transport_spectrum_level(double kappa);

/* The lambda of a level. shrink: 0.5 to 1, another path for another value. */
double transport_spectrum_lambda(size_t level, double shrink);

/* lambda: up to kappa; the nearer to it, the fewer digits are lost far away. Freed by
 * transport_grid_free(). NULL: no memory. */
spectrum_grid *transport_grid_new(const spectrum_rules *rules, double lambda);
void transport_grid_free(spectrum_grid *of);

/* The exitance of light scattered more than once, at the grid's wavenumbers and beyond. */
typedef struct spectrum {
  double lambda;
  double far; /* exitance times k^2 as k goes to infinity */
  size_t n;
  double complex k[SPECTRUM_POINTS_MAX];
  double complex weighted[SPECTRUM_POINTS_MAX]; /* exitance times dk of the rule */
} spectrum;

/* albedo in (0, 1], its kappa, which is of the grid's level. False: no memory. */
bool transport_spectrum_make(spectrum *to, const spectrum_grid *grid, transport_work *work,
                             double albedo, double kappa);

/* Light scattered more than once, at the radius r, 1e-300 to 1e60. */
typedef struct spectrum_values {
  double r;          /* R */
  double r_rounding; /* what R may be off by for the rounding of its terms */
  double within;     /* energy within r, of which no digits are lost for small r, */
  double beyond;     /* and beyond r, for large r */
} spectrum_values;

spectrum_values transport_spectrum_at(const spectrum *of, double r);

#endif
