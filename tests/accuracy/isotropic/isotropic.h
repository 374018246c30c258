/* isotropic: radiative transport without noise, by another way than core/solver/, which it checks, as
 * it checks the table, whose part for g = 0 is made with it. A pencil beam enters a half space of
 * isotropic scatterers at right angles through a smooth boundary with Fresnel's reflectance. The
 * solver keeps the tolerance that it is given and returns an error estimate with every number.
 *
 * Method: Fourier transform over the plane, Laplace transform over depth, H functions, a low-rank
 * system for each wavenumber (equation.c), wavenumbers on a hyperbola in the complex plane
 * (spectrum.c). Light scattered once is computed in real space (core/transport/single.c).
 *
 * Units: lengths are in mean free paths, 1 / (sigma_a + sigma_s). R is per squared mean free path.
 * All energies are per power that has entered, which excludes the specular reflection of the beam.
 *
 * The same input gives the same bits on every machine. These functions allocate and do not log.
 * Threads wait for each other only while one of them prepares a boundary that they share.
 */
#ifndef DIPOLED_TESTS_ISOTROPIC_ISOTROPIC_H
#define DIPOLED_TESTS_ISOTROPIC_ISOTROPIC_H

#include "core/core.h"
#include "core/transport/transport.h"

#define ISOTROPIC_TOLERANCE_MIN 1e-9
#define ISOTROPIC_TOLERANCE_MAX 1e-3

/* The part of the solution that depends on eta, the wavenumbers and the tolerance alone. Albedos
 * with nearly the same decay rate share a set of wavenumbers. The boundary makes a set when the
 * first of these albedos is solved, and keeps it. A set takes up to 5 MB, and there are 4 sets for
 * every factor 2 of the decay rate. Any number of threads may solve with one boundary at the same
 * time. */
typedef struct isotropic_boundary isotropic_boundary;

/* The solution for one medium, about 60 kB. It is immutable, so any number of threads may read it.
 * It does not need its boundary any more. */
typedef struct isotropic_solution isotropic_solution;

/* Creates a boundary. eta: index inside over index outside, TRANSPORT_ETA_MIN to TRANSPORT_ETA_MAX.
 * tolerance: relative, of R, ISOTROPIC_TOLERANCE_MIN to ISOTROPIC_TOLERANCE_MAX. Faults: `eta`,
 * `tolerance`, and `memory` if memory runs out. On a fault *boundary is NULL. Otherwise the caller
 * owns it and frees it with isotropic_boundary_free(), which accepts NULL. */
core_fault isotropic_boundary_create(isotropic_boundary **boundary, double eta, double tolerance);
void isotropic_boundary_free(isotropic_boundary *boundary);

/* Creates a boundary whose solutions keep the tolerance of R up to where e^(-kappa r) is e^-110,
 * instead of e^-30. They take three times as long to compute and share no wavenumbers. Albedos may
 * be up to 1 - 1e-12. Arguments and faults are those of isotropic_boundary_create(). */
#define ISOTROPIC_REACH_DECAYS 30.0
#define ISOTROPIC_REACH_DECAYS_FAR 110.0
core_fault isotropic_boundary_create_far(isotropic_boundary **boundary, double eta,
                                         double tolerance);

/* Solves one medium. albedo: of single scattering, sigma_s / (sigma_a + sigma_s), 0 to 1, both
 * included. Faults: `albedo`, `memory`. On a fault *solution is NULL. Otherwise the caller owns it
 * and frees it with isotropic_solution_free(), which accepts NULL. */
core_fault isotropic_solve(isotropic_solution **solution, isotropic_boundary *boundary,
                           double albedo);
void isotropic_solution_free(isotropic_solution *solution);

/* The values at one radius. R = single + multiple, where single is of light scattered once and
 * multiple of light scattered more often. */
typedef struct isotropic_values {
  transport_number R;
  transport_number single;
  transport_number multiple;
  transport_number within; /* energy that leaves within r, from 0 to the total */
} isotropic_values;

/* Returns the values at the radius r, from 0 to infinity (asserted). R keeps the tolerance from r =
 * 0 to where e^(-kappa r) is e^-30 (ISOTROPIC_REACH_DECAYS), which is 30 mean free paths or more
 * for every albedo. Beyond, the error grows up to the size of R itself, and the error estimate with
 * it. No value is negative. For r below 1e-290, R and its parts are infinite, or 0 without
 * scattering. For r = infinity they are 0. */
isotropic_values isotropic_at(const isotropic_solution *solution, double r);

/* Returns the total energy that leaves. Its relative error is below 1e-10, whatever the tolerance.
 */
transport_number isotropic_total(const isotropic_solution *solution);

#endif
