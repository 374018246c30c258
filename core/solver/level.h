/* level: how finely the equations are solved, and light that is scattered twice next to the source.
 * For half spaces (solver.c) and layers (layers.c). */
#ifndef DIPOLED_CORE_SOLVER_LEVEL_H
#define DIPOLED_CORE_SOLVER_LEVEL_H

#include "core/solver/exitance.h"
#include "core/solver/expansion.h"

enum { SOLVER_LEVELS = 6, SOLVER_MOMENTS_MAX = 4096 };

/* How light is scattered. Either Henyey and Greenstein's function (1941) with the mean cosine g,
 * then moments is 0; or a function that is given by its Legendre moments: moment[l] is the mean of
 * P_l over directions, moment[0] is 1, and the moments from `moments` on are 0. */
typedef struct solver_phase {
  double g;       /* -0.99 to 0.99; without meaning if moments is not 0 */
  size_t moments; /* 0, or 2 to SOLVER_MOMENTS_MAX */
  const double *moment;
} solver_phase;

/* Returns the mean of P_l over directions. */
double solver_moment_at(const solver_phase *phase, size_t l);

/* Returns the phase function, normalized to 1 over the sphere, times 4 pi. */
double solver_phase_at(const solver_phase *phase, double cosine);

enum { TIERS = EXITANCE_TIERS };

/* How wavenumbers up to k_most are solved. */
struct tier {
  double k_most;
  expansion_rules rules;
};

/* A basis resolves a phase function of at most some three moments for each degree. */
struct level {
  double moment_least; /* the series of the phase function ends at a moment as small as this */
  size_t moments_most;
  double floor[2];         /* least relative error that is stated: next to the source, far away */
  double share;            /* Im k / kappa where the path of wavenumbers starts */
  size_t nodes;            /* on each panel */
  struct tier tier[TIERS]; /* the last one's k_most is K */
};

/* The least relative errors that any solution states: somewhere below SOLVER_NEAR, and beyond. Those of
 * one solution are about SOLVER_NEAR_FACTOR apart. */
#define SOLVER_NEAR 2
#define SOLVER_LEAST_NEAR 1e-4
#define SOLVER_LEAST 2e-5
#define SOLVER_NEAR_FACTOR 5

extern const struct level solver_levels[SOLVER_LEVELS];

/* Returns the limit of k^2 X for large k, see solver.c. single: the albedo by which light scattered once
 * is in proportion. edge: the sine of the cone's edge outside, 1 for light of all angles. */
double solver_far(double single, const solver_phase *phase, double eta, double edge);

#endif
