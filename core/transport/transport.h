/* transport: radiative transport without noise. A pencil beam enters a half space of isotropic
 * scatterers at right angles through a smooth boundary with Fresnel's reflectance. The solver keeps
 * the tolerance that it is given and returns an error estimate with every number.
 *
 * Method: Fourier transform over the plane, Laplace transform over depth, H functions, a low-rank
 * system for each wavenumber (equation.c), wavenumbers on a hyperbola in the complex plane
 * (spectrum.c). Light scattered once is computed in real space (single.c).
 *
 * Units: lengths are in mean free paths, 1 / (sigma_a + sigma_s). R is per squared mean free path.
 * All energies are per power that has entered, which excludes the specular reflection of the beam.
 *
 * The same input gives the same bits on every machine. These functions allocate and do not log.
 * Threads wait for each other only while one of them prepares a boundary that they share.
 */
#ifndef DIPOLED_CORE_TRANSPORT_TRANSPORT_H
#define DIPOLED_CORE_TRANSPORT_TRANSPORT_H

#include "core/core.h"

#define TRANSPORT_ETA_MIN 0.25
#define TRANSPORT_ETA_MAX 4.0
#define TRANSPORT_TOLERANCE_MIN 1e-9
#define TRANSPORT_TOLERANCE_MAX 1e-3

/* The part of the solution that depends on eta, the wavenumbers and the tolerance alone. Albedos
 * with nearly the same decay rate share a set of wavenumbers. The boundary makes a set when the
 * first of these albedos is solved, and keeps it. A set takes up to 5 MB, and there are 4 sets for
 * every factor 2 of the decay rate. Any number of threads may solve with one boundary at the same
 * time. */
typedef struct transport_boundary transport_boundary;

/* The solution for one medium, about 60 kB. It is immutable, so any number of threads may read it.
 * It does not need its boundary any more. */
typedef struct transport_solution transport_solution;

/* Creates a boundary. eta: index inside over index outside, TRANSPORT_ETA_MIN to TRANSPORT_ETA_MAX.
 * tolerance: relative, of R, TRANSPORT_TOLERANCE_MIN to TRANSPORT_TOLERANCE_MAX. Faults: `eta`,
 * `tolerance`, and `memory` if memory runs out. On a fault *boundary is NULL. Otherwise the caller
 * owns it and frees it with transport_boundary_free(), which accepts NULL. */
core_fault transport_boundary_create(transport_boundary **boundary, double eta, double tolerance);
void transport_boundary_free(transport_boundary *boundary);

/* Creates a boundary whose solutions keep the tolerance of R up to where e^(-kappa r) is e^-110,
 * instead of e^-30. They take three times as long to compute and share no wavenumbers. Albedos may
 * be up to 1 - 1e-12. Arguments and faults are those of transport_boundary_create(). */
#define TRANSPORT_REACH_DECAYS 30.0
#define TRANSPORT_REACH_DECAYS_FAR 110.0
core_fault transport_boundary_create_far(transport_boundary **boundary, double eta,
                                         double tolerance);

/* Solves one medium. albedo: of single scattering, sigma_s / (sigma_a + sigma_s), 0 to 1, both
 * included. Faults: `albedo`, `memory`. On a fault *solution is NULL. Otherwise the caller owns it
 * and frees it with transport_solution_free(), which accepts NULL. */
core_fault transport_solve(transport_solution **solution, transport_boundary *boundary,
                           double albedo);
void transport_solution_free(transport_solution *solution);

/* A number and the estimate of its absolute error. */
typedef struct transport_number {
  double value;
  double error;
} transport_number;

/* The values at one radius. R = single + multiple, where single is of light scattered once and
 * multiple of light scattered more often. */
typedef struct transport_values {
  transport_number R;
  transport_number single;
  transport_number multiple;
  transport_number within; /* energy that leaves within r, from 0 to the total */
} transport_values;

/* Returns the values at the radius r, from 0 to infinity (asserted). R keeps the tolerance from r =
 * 0 to where e^(-kappa r) is e^-30 (TRANSPORT_REACH_DECAYS), which is 30 mean free paths or more
 * for every albedo. Beyond, the error grows up to the size of R itself, and the error estimate with
 * it. No value is negative. For r below 1e-290, R and its parts are infinite, or 0 without
 * scattering. For r = infinity they are 0. */
transport_values transport_at(const transport_solution *solution, double r);

/* Returns the total energy that leaves. Its relative error is below 1e-10, whatever the tolerance.
 */
transport_number transport_total(const transport_solution *solution);

#endif
