/* anisotropic: radiative transport without noise for any phase function. A pencil beam enters a
 * half space at right angles through a smooth boundary with Fresnel's reflectance.
 *
 * Method: Fourier transform over the plane, half-range expansion in angle, the half space's
 * reflection by doubling (halfspace.c), wavenumbers on a line in the complex plane. Light scattered
 * once is computed in real space with the true phase function. Every solution is computed on two
 * grids, and the error estimate is a multiple of their difference.
 *
 * Units: lengths are in reduced mean free paths, 1 / (sigma_a + sigma_s (1 - g)) with g the mean
 * cosine of scattering. R is per squared reduced mean free path. All energies are per power that
 * has entered, which excludes the specular reflection of the beam.
 *
 * The same input gives the same bits on every machine and for every instruction set `isa`. These
 * functions allocate and do not log. They have no state: threads may call them at the same time.
 */
#ifndef DIPOLED_CORE_TRANSPORT_ANISOTROPIC_H
#define DIPOLED_CORE_TRANSPORT_ANISOTROPIC_H

#include <complex.h>
#include <stdbool.h>

#include "core/core.h"
#include "core/transport/transport.h"

/* How light is scattered. Either Henyey and Greenstein's function (1941) with the mean cosine g,
 * then moments is 0; or a function that is given by its Legendre moments: moment[l] is the mean of
 * P_l over directions, moment[0] is 1, and the moments from `moments` on are 0. */
typedef struct transport_phase {
  double g;       /* -0.99 to 0.99; without meaning if moments is not 0 */
  size_t moments; /* 0, or 2 to TRANSPORT_PHASE_MOMENTS_MAX */
  const double *moment;
} transport_phase;

enum {
  TRANSPORT_PHASE_MOMENTS_MAX = 4096,
  TRANSPORT_ANISOTROPIC_ETAS_MAX = 32,
  TRANSPORT_ANISOTROPIC_CONES_MAX = 8,
  TRANSPORT_ANISOTROPIC_WAVENUMBERS_MAX = 640
};

/* How finely a solution is computed, with the relative error of R that was found from 0.01 to 20
 * reduced mean free paths, for sigma_a up to sigma_s (1 - g) and eta up to 2.2. The larger numbers
 * are for g = 0.95 and radii below 0.2. For g = 0.95, eta = 2.2 and sigma_a of 30 times
 * sigma_s (1 - g), the error is 1e-1, 1e-2 and 6e-4. What holds is the error that is stated beside
 * each value. */
typedef enum transport_effort {
  TRANSPORT_EFFORT_QUICK,  /* 2e-4 to 2e-3 */
  TRANSPORT_EFFORT_NORMAL, /* 1e-4 to 3e-3 */
  TRANSPORT_EFFORT_FINEST  /* 3e-5 to 2e-4 */
} transport_effort;

typedef struct transport_anisotropic transport_anisotropic;

/* Solves one medium for some boundaries together, which takes little longer than for one.
 * sigma_a_ratio: sigma_a / (sigma_s (1 - g)), 1e-6 to 100. etas: index inside over index outside,
 * TRANSPORT_ETA_MIN to TRANSPORT_ETA_MAX, 1 to TRANSPORT_ANISOTROPIC_ETAS_MAX of them. Faults:
 * `sigma_a_ratio`, `phase`, `eta`, `memory`. On a fault *solution is NULL. Otherwise the caller
 * owns it and frees it with transport_anisotropic_free(), which accepts NULL. */
core_fault transport_anisotropic_solve(transport_anisotropic **solution, const core_isa *isa,
                                       double sigma_a_ratio, const transport_phase *phase,
                                       const double *etas, size_t count, transport_effort effort);

/* The same without the coarser grid, in two thirds of the time: the errors of the values are
 * NAN. */
core_fault transport_anisotropic_solve_once(transport_anisotropic **solution, const core_isa *isa,
                                            double sigma_a_ratio, const transport_phase *phase,
                                            const double *etas, size_t count,
                                            transport_effort effort);

/* The same as transport_anisotropic_solve_once(), with the exitance at each wavenumber, which takes
 * nearly all of its time, in memory that the caller owns: [count][TRANSPORT_ANISOTROPIC_WAVENUMBERS_MAX].
 * If not `known`, it is set; the rest of it stays. If `known`, it must be what a call with the same other
 * arguments has set, and the solution is made from it in milliseconds, with the same bits. */
core_fault transport_anisotropic_solve_kept(transport_anisotropic **solution, const core_isa *isa,
                                            double sigma_a_ratio, const transport_phase *phase,
                                            const double *etas, size_t count,
                                            transport_effort effort, double complex *exitances,
                                            bool known);

/* The same as transport_anisotropic_solve(), or as transport_anisotropic_solve_once() with the errors
 * NAN if `once`, with the light that leaves within cones of angles, too.
 * sines: that of the largest angle to the normal outside that a cone has, over min(1, eta), which is
 * that of all light; each above 0 and up to 1, 0 to TRANSPORT_ANISOTROPIC_CONES_MAX of them. Fault:
 * `sine`. */
core_fault transport_anisotropic_solve_cones(transport_anisotropic **solution, const core_isa *isa,
                                             double sigma_a_ratio, const transport_phase *phase,
                                             const double *etas, size_t count, const double *sines,
                                             size_t cones, transport_effort effort, bool once);
void transport_anisotropic_free(transport_anisotropic *solution);

/* Returns R at the radius r for the boundary etas[eta], with an estimate of its absolute error. r:
 * 0 (where R is infinite) to infinity. Beyond 30 decay lengths the error grows up to the size of
 * R. */
transport_number transport_anisotropic_at(const transport_anisotropic *solution, size_t eta,
                                          double r);

/* Returns the share of R that leaves within the cone sines[cone], with an estimate of its absolute
 * error. r: above 0 and finite. */
transport_number transport_anisotropic_share_at(const transport_anisotropic *solution, size_t eta,
                                                size_t cone, double r);

/* Returns the part of R that was scattered once. It has no error of the grids. */
double transport_anisotropic_single_at(const transport_anisotropic *solution, size_t eta, double r);

/* The energy that leaves per power that has entered, specular reflection excluded, with estimates
 * of the absolute errors. */
typedef struct transport_totals {
  transport_number normal;  /* of a beam that enters at right angles */
  transport_number diffuse; /* of light that strikes the surface with the same radiance from all
                             * directions */
} transport_totals;

/* Sets totals[i] for the boundary etas[i]. Arguments and faults are those of
 * transport_anisotropic_solve(). It takes some 10 ms for one boundary and 40 ms for 16. With sigma_a =
 * 0.1 sigma_s (1 - g) and eta 1.4 the stated errors are 1.5e-8 to 6.5e-8 for g up to 0.9, and 1.3e-7
 * for g = 0.95; those of diffuse light are twice as large. */
core_fault transport_anisotropic_totals(transport_totals *totals, const core_isa *isa,
                                        double sigma_a_ratio, const transport_phase *phase,
                                        const double *etas, size_t count);

#endif
