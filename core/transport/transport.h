/* transport: radiative transport without noise. A pencil beam enters a half space of isotropic
 * scatterers at right angles through a smooth boundary with Fresnel's reflectance; solved to an
 * asked tolerance, with an error estimate for every number.
 *
 * Method: Fourier transform over the plane, Laplace transform over depth, H functions, a low-rank
 * system for each wavenumber (equation.c), wavenumbers on a hyperbola in the complex plane
 * (spectrum.c); light scattered once in real space (single.c).
 *
 * Units: lengths in mean free paths, 1 / (sigma_a + sigma_s); R per squared mean free path; all
 * energies per power that has entered (specular reflection is no part of them).
 *
 * The same input gives the same bits on every machine. This allocates; nothing here logs, and
 * threads wait for each other only where they share a boundary that one of them prepares.
 */
#ifndef DIPOLED_CORE_TRANSPORT_TRANSPORT_H
#define DIPOLED_CORE_TRANSPORT_TRANSPORT_H

#include "core/core.h"

#define TRANSPORT_ETA_MIN 0.25
#define TRANSPORT_ETA_MAX 4.0
#define TRANSPORT_TOLERANCE_MIN 1e-9
#define TRANSPORT_TOLERANCE_MAX 1e-3

/* What depends on eta and the wavenumbers alone, for a tolerance. Albedos with nearly the same
 * decay rate share a set of wavenumbers, which is made when the first of them is solved, and kept:
 * up to 5 MB each, of which there are 4 in every factor 2 of the decay rate. Any number of threads
 * may solve with one boundary at a time. */
typedef struct transport_boundary transport_boundary;

/* One medium, solved; about 60 kB. Immutable: any number of threads may read it; it needs its
 * boundary no more. */
typedef struct transport_solution transport_solution;

/* eta: index inside over index outside; tolerance: relative, of R. Faults: `eta`, `tolerance`, and
 * `memory` when there is none. On a fault *boundary is NULL; else it belongs to the caller, who
 * frees it with transport_boundary_free(), NULL allowed. */
core_fault transport_boundary_create(transport_boundary **boundary, double eta, double tolerance);
void transport_boundary_free(transport_boundary *boundary);

/* The same with R that keeps the tolerance to where e^(-kappa r) is e^-110. Its solutions take three
 * times as long and share nothing. Albedos up to 1 - 1e-12. */
#define TRANSPORT_REACH_DECAYS 30.0
#define TRANSPORT_REACH_DECAYS_FAR 110.0
core_fault transport_boundary_create_far(transport_boundary **boundary, double eta,
                                         double tolerance);

/* albedo: of single scattering, sigma_s / (sigma_a + sigma_s), 0 to 1, both included. Faults:
 * `albedo`, `memory`. On a fault *solution is NULL; else it belongs to the caller, who frees it
 * with transport_solution_free(), NULL allowed. */
core_fault transport_solve(transport_solution **solution, transport_boundary *boundary,
                           double albedo);
void transport_solution_free(transport_solution *solution);

/* A number and how far it may be off, absolute. */
typedef struct transport_number {
  double value;
  double error;
} transport_number;

/* At one radius. R = single + multiple: light scattered once, and more often. */
typedef struct transport_values {
  transport_number R;
  transport_number single;
  transport_number multiple;
  transport_number within; /* the energy that leaves within r, from 0 to the total */
} transport_values;

/* r: 0 to infinity (asserted). R keeps the tolerance from r = 0 to where e^(-kappa r) is e^-30,
 * that is for every albedo to 30 mean free paths, TRANSPORT_REACH_DECAYS; beyond, the error grows to the size of R itself
 * and says so. No value is negative. r below 1e-290: R is infinite, as are its parts (0 without
 * scattering); r = infinity: 0. */
transport_values transport_at(const transport_solution *solution, double r);

/* The energy that leaves anywhere; the error is below 1e-10, relative, whatever the tolerance. */
transport_number transport_total(const transport_solution *solution);

/* kappa, the rate at which diffuse light decays far away, per mean free path: 0 for albedo 1 to 1
 * for albedo 0, within 1e-11, relative. albedo: 0 to 1. */
double transport_kappa(double albedo);

#endif
