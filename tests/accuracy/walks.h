/* walks: Monte Carlo beside the solver of core/solver/solver.h, in reduced mean free paths,
 * for Henyey and Greenstein's phase function and mixtures with it. Rings are logarithmic, from
 * 10^-2.05 to 10^1.35 reduced mean free paths. */
#ifndef DIPOLED_TESTS_WALKS_H
#define DIPOLED_TESTS_WALKS_H

#include "core/montecarlo/montecarlo.h"
#include "core/solver/solver.h"

/* With WALKS_TENTHS rings, a radius of a whole tenth of a decade lies in the middle of its ring. */
enum { WALKS_RINGS_MAX = 170, WALKS_TENTHS = 34 };

/* What is walked. */
typedef struct walks_medium {
  double ratio, g, eta; /* ratio: sigma_a / (sigma_s (1 - g)) */
  unsigned phase;       /* enum core_phase and its parameters, as in core_mc_request */
  double phase_share, phase_g;
} walks_medium;

typedef struct walks_result {
  core_mc_value total; /* light that left, per power that entered */
  size_t count;
  core_mc_ring rings[WALKS_RINGS_MAX]; /* in reduced mean free paths in place of mm */
} walks_result;

/* Walks photons, a multiple of CORE_MC_BATCH_PHOTONS, through a half space. rings: 1 to
 * WALKS_RINGS_MAX. */
void walks_run(walks_result *result, const walks_medium *medium, size_t rings, uint64_t photons,
               uint64_t seed);

/* Returns the solver's mean of R over one of the rings, for boundary `eta` of the solution. If
 * error is not NULL, sets *error to the mean of the error that the solver states. */
double walks_mean(const solver_solution *solution, size_t eta, size_t rings, size_t ring,
                  double *error);

/* Sets *phase to the medium's phase function. The moments of a mixture go to the array `moment` of
 * SOLVER_MOMENTS_MAX numbers, which must live as long as *phase. */
void walks_phase(const walks_medium *medium, double *moment, solver_phase *phase);

#endif
