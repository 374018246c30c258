/* level: how finely the equations are solved, and light that is scattered twice next to the source.
 * For half spaces (solver.c) and layers (layers.c). */
#ifndef DIPOLED_CORE_SOLVER_LEVEL_H
#define DIPOLED_CORE_SOLVER_LEVEL_H

#include <stdatomic.h>
#include <stdbool.h>

#include "core/solver/exitance.h"
#include "core/solver/expansion.h"

enum { SOLVER_LEVELS = 6, SOLVER_MOMENTS_MAX = 4096, SOLVER_LAYERS_MAX = 8 };

/* How light is scattered. Either Henyey and Greenstein's function (1941) with the mean cosine g,
 * then moments is 0; or a function that is given by its Legendre moments: moment[l] is the mean of
 * P_l over directions, moment[0] is 1, and the moments from `moments` on are 0. */
typedef struct solver_phase {
  double g;       /* -0.99 to 0.99; without meaning if moments is not 0 */
  size_t moments; /* 0, or 2 to SOLVER_MOMENTS_MAX: number of moments */
  const double *moment;
} solver_phase;

/* Returns the mean of P_l over directions. */
double solver_moment_at(const solver_phase *phase, size_t l);

/* Returns the phase function, normalized to 1 over the sphere, times 4 pi. */
double solver_phase_at(const solver_phase *phase, double cosine);

enum { TIERS = EXITANCE_TIERS };

/* How wavenumbers up to k_most are solved: the size of the expansion. */
struct tier {
  double k_most;
  expansion_rules rules;
};

/* Numbers of one grid. A basis resolves at most about three moments of the phase function for each
 * degree. */
struct level {
  double moment_least; /* the phase function is cut off from the first moment as small as this */
  size_t moments_most;
  double floor[2]; /* least relative errors that are stated: next to the source, and far away */
  double share;    /* Im k / kappa at the start of the path of wavenumbers */
  size_t nodes;    /* number of nodes on each panel */
  struct tier tier[TIERS]; /* in ascending order; k_most of the last is K */
};

/* The least relative errors that any solution states: somewhere below SOLVER_NEAR, and beyond.
 * Those of one solution are about SOLVER_NEAR_FACTOR apart. */
#define SOLVER_NEAR 2
#define SOLVER_LEAST_NEAR 1e-4
#define SOLVER_LEAST 2e-5
#define SOLVER_NEAR_FACTOR 5
#define SOLVER_NOT_FINEST 4e-5 /* the least that the grid before the finest states */

extern const struct level solver_levels[SOLVER_LEVELS];

/* Returns the level that a solution for this tolerance starts from. */
size_t solver_first_level(double tolerance);

/* Returns whether the grid `level` is to be solved, too. worst, before: what the last grid states,
 * and the one before it; infinite if it states nothing. The finest grid takes three times as
 * long as the one before: it has to promise the tolerance, unless CORE_TOLERANCE_FINEST or less is
 * requested. */
bool solver_goes_on(size_t level, double worst, double before, double tolerance);

/* Returns whether *stop is true; stop may be NULL. */
bool solver_stops(const atomic_bool *stop);

/* Returns whether so much light is scattered back that each tier needs as many degrees as the last. */
bool solver_is_backward(const solver_phase *phase);

/* Returns the rules of a tier. backward: whether light is scattered back, in any layer. */
expansion_rules solver_rules_at(const struct level *level, size_t tier, bool backward);

/* Returns exitance_series.peak, per scaled mean free path. */
double solver_peak_at(const solver_phase *phase);

/* Returns how many moments of a phase function are kept: at most `most`, or where light is scattered
 * back what functions of so many degrees resolve, without the last ones of size up to `least`,
 * but 2 or more. */
size_t solver_moments_kept(const solver_phase *phase, double least, size_t most, size_t degrees);

/* Truncates a phase function to `count` moments (delta-M): sets moment[count], and *to for a medium
 * with this albedo. Returns scaled extinction / sigma_t. */
double solver_truncate(expansion_medium *to, double *moment, const solver_phase *phase,
                       size_t count, double albedo);

/* Returns Fresnel's reflectance at normal incidence between media of two indices. */
double solver_beam_reflectance(double one, double other);

/* The reduced mean free paths at which two grids are compared: the least one, and how many there
 * are, each of which is SOLVER_ERROR_RATIO times the one before. */
enum { SOLVER_ERROR_RADII = 36 };
#define SOLVER_ERROR_LEAST 0.004
#define SOLVER_ERROR_RATIO 1.45

/* Where this much of the light has decayed, by e to this power, no tolerance is kept. */
#define SOLVER_DECAYS_MOST 20

/* Returns the finer grid's error over the grids' difference, as far as moments of a phase function are
 * cut off: at least 1. fine, coarse: the number of moments of each grid. */
double solver_shared_by_cuts(const solver_phase *phase, size_t fine, size_t coarse);

/* Returns the relative error of a value from its difference to that of the next coarser grid.
 * margin: error / difference. */
double solver_error_between(double margin, double fine, double coarse);

/* Returns the largest of the errors at five radii around r, because the difference of two grids is
 * 0 at some radii. last: index of the last radius that counts for smaller ones. */
double solver_error_near(const double error[SOLVER_ERROR_RADII], double r, size_t last);

/* Returns the least relative error that is stated at the radius r, in reduced mean free paths. All
 * grids lack the waves beyond K, so that their difference does not show this error: it falls as r
 * grows, and rises with eta. Of 120 media against finer grids, R was off by up to 1.1e-3 at r =
 * 0.024 (g 0.9, eta 3.3) and 5.8e-4 at 0.7 (g 0.84, eta 2.3, 16 sigma_s' absorbed), where two grids
 * agreed within 2e-4. unit: the scaled mean free path over the reduced one. */
double solver_floor_at(const double floor[2], double unit, double eta, double r);

/* Returns the limit of k^2 X for large k, see solver.c. single: the albedo by which light scattered
 * once is in proportion. edge: the sine of the cone's edge outside, 1 for light of all angles.
 * onwards: for light that leaves where the beam arrives, not where it enters. */
double solver_far(double single, const solver_phase *phase, double eta, double edge, bool onwards);

#endif
