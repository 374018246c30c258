/* solver: radiative transport without noise for any phase function. A pencil beam enters a half
 * space at right angles through a smooth boundary with Fresnel's reflectance.
 *
 * Method: Fourier transform over the plane, half-range expansion in angle with the beam as one
 * more direction (expansion.c), the half space's reflection by doubling (layer.c), wavenumbers on
 * a path in the complex plane (exitance.c). Light scattered once is computed in real space with
 * the true phase function. Every solution is computed on two grids or more, and the error estimate
 * is a multiple of the last two's difference.
 *
 * Units: lengths are in reduced mean free paths, 1 / (sigma_a + sigma_s (1 - g)) with g the mean
 * cosine of scattering. R is per squared reduced mean free path. All energies are per power that
 * has entered, which excludes the specular reflection of the beam.
 *
 * The same input gives the same bits on every machine and for every instruction set `isa`. These
 * functions allocate and do not log. They have no state: threads may call them at the same time.
 */
#ifndef DIPOLED_CORE_SOLVER_H
#define DIPOLED_CORE_SOLVER_H

#include <complex.h>
#include <stdatomic.h>
#include <stdbool.h>

#include "core/core.h"
#include "core/solver/level.h"
#include "core/transport/transport.h"

enum { SOLVER_ETAS_MAX = 32, SOLVER_CONES_MAX = 8, SOLVER_WAVENUMBERS_MAX = 640 };

/* The radii, in reduced mean free paths, at which a tolerance holds. */
#define SOLVER_RADIUS_LEAST 0.01
#define SOLVER_RADIUS_MOST 20.0

typedef struct solver_solution solver_solution;

/* Solves one medium for some boundaries together, which takes little longer than for one. Finer and
 * finer grids are solved until the relative error that two of them show, and the least that their
 * values can have beyond SOLVER_NEAR, is at most the tolerance, at radii from SOLVER_RADIUS_LEAST
 * to SOLVER_RADIUS_MOST as far as R has not decayed by e^-20, but at most four of them, and the
 * finest only if it promises to reach the tolerance or that is CORE_TOLERANCE_FINEST or less. What
 * holds is the error that is stated beside each value, which is larger than requested where |g| is
 * above 0.95 or g is below -0.8. With AVX-512, one boundary and g up to 0.9 take some 0.1 s of a
 * processor for a tolerance of 1e-2, 0.3 to 1 s for 1e-3 and 3.5 s or more for 1e-4; the most that
 * they take is 2.5, 6.5 (g below -0.6) and 14 s. sigma_a_ratio: sigma_a / (sigma_s (1 - g)), 0 to
 * 1000. etas: index inside over index outside, TRANSPORT_ETA_MIN to TRANSPORT_ETA_MAX, 1 to
 * SOLVER_ETAS_MAX of them. tolerance: not negative, finite. Faults: `sigma_a_ratio`, `phase`, `eta`,
 * `tolerance`, `memory`. On a fault *solution is NULL. Otherwise the caller owns it and frees it with
 * solver_free(), which accepts NULL. */
core_fault solver_solve(solver_solution **solution, const core_isa *isa, double sigma_a_ratio,
                        const solver_phase *phase, const double *etas, size_t count,
                        double tolerance);

/* The same, and gives up within one wavenumber (up to a tenth of a second) of `stop` being true:
 * fault CORE_FIELD_STOPPED. stop: NULL, or set by any thread. */
core_fault solver_solve_until(solver_solution **solution, const core_isa *isa, double sigma_a_ratio,
                              const solver_phase *phase, double eta, double tolerance,
                              const atomic_bool *stop);

/* The same as solver_solve() with the light that leaves within cones of angles, too. sines: that of
 * the largest angle to the normal outside that a cone has, over min(1, eta), which is that of all
 * light; each above 0 and up to 1, 0 to SOLVER_CONES_MAX of them. Fault: `sine`. */
core_fault solver_solve_cones(solver_solution **solution, const core_isa *isa, double sigma_a_ratio,
                              const solver_phase *phase, const double *etas, size_t count,
                              const double *sines, size_t cones, double tolerance);

/* The same as solver_solve() on the grid number `level` alone, 0 (the coarsest) to SOLVER_LEVELS -
 * 1: the errors of the values are NAN. exitances: NULL, or memory for the exitance at each
 * wavenumber, which takes nearly all of the time, [count][SOLVER_WAVENUMBERS_MAX]. If not `known`,
 * it is set; the rest of it stays. If `known`, it must be what a call with the same other arguments
 * has set, and the solution is made from it in milliseconds, with the same bits. */
core_fault solver_solve_level(solver_solution **solution, const core_isa *isa, double sigma_a_ratio,
                              const solver_phase *phase, const double *etas, size_t count,
                              size_t level, double complex *exitances, bool known);
void solver_free(solver_solution *solution);

/* Returns the level of the finest grid. */
size_t solver_level(const solver_solution *solution);

/* Returns R at the radius r for the boundary etas[eta], with an estimate of its absolute error. r:
 * 0 (where R is infinite) to infinity; beyond 1e4 R continues as diffusion, (1 + kappa r) e^(-kappa
 * r) / r^3. Where the grids do not find a digit of R, the error is what bounds R at a smaller
 * radius, where R is larger. */
transport_number solver_at(const solver_solution *solution, size_t eta, double r);

/* Returns the share of R that leaves within the cone sines[cone], with an estimate of its absolute
 * error, the same multiple of the grids' difference as that of R. r: above 0 and finite. */
transport_number solver_share_at(const solver_solution *solution, size_t eta, size_t cone,
                                 double r);

/* Returns the part of R that was scattered once. It does not depend on the grids. */
double solver_single_at(const solver_solution *solution, size_t eta, double r);

/* The energy that leaves per power that has entered, specular reflection excluded, with estimates
 * of the absolute errors. */
typedef struct solver_total {
  transport_number normal;  /* a beam at normal incidence */
  transport_number diffuse; /* incident light with the same radiance from all directions */
} solver_total;

/* Sets totals[i] for the boundary etas[i]. Arguments and faults are those of solver_solve(). It
 * takes some 10 ms for one boundary and 40 ms for 16. With sigma_a = 0.1 sigma_s (1 - g) and eta
 * 1.4 the stated errors are 1.5e-8 to 6.5e-8 for g up to 0.9, and 1.3e-7 for g = 0.95; those of
 * diffuse light are twice as large. */
core_fault solver_totals(solver_total *totals, const core_isa *isa, double sigma_a_ratio,
                         const solver_phase *phase, const double *etas, size_t count);

/* ---- layers -------------------------------------------------------------------------------- */

enum { SOLVER_SIDES = 2 };

/* A layer, or the half space below all layers. */
typedef struct solver_layer {
  double sigma_a_per_mm; /* not negative */
  double sigma_s_per_mm; /* at least 0; one of the two is positive */
  double g;              /* -0.99 to 0.99, Henyey and Greenstein's function */
  double eta;            /* index over that above the layers, TRANSPORT_ETA_MIN to _MAX */
  double thickness_mm;   /* above 0; infinite for the last layer if it is a half space */
} solver_layer;

/* What becomes of the power that has entered. Side 0 is above the layers, side 1 is below. */
typedef struct solver_balance {
  transport_number out[SOLVER_SIDES]; /* light that was scattered and leaves on each side */
  double unscattered[SOLVER_SIDES];   /* light that leaves on each side without being scattered */
  transport_number absorbed[SOLVER_LAYERS_MAX]; /* light that each layer absorbs */
} solver_balance;

typedef struct solver_layers solver_layers;

/* Returns what solver_layers_solve() refuses of layers, without solving: `layer_count`, with the
 * index of the layer `sigma_a`, `sigma_s`, `g`, `eta` and `thickness`, and `eta_below`. A layer above
 * the last one has a fiftieth or more of the largest sigma_a + sigma_s. */
core_fault solver_layers_check(const solver_layer *layer, size_t count, double eta_below);

/* Solves layers, from the top down, on which a pencil beam falls at right angles. Finer and finer
 * grids, at most four, are solved until two of them agree within the tolerance, relative, from 0.05
 * reduced mean free paths of the first layer on, or do not promise to. What holds is the error
 * beside each value: it is large for slabs thinner than a mean free path that scatter forwards, and
 * for T near the axis behind layers of many mean free paths. With AVX-512, two layers of skin take some
 * 0.25 s of a processor for a tolerance of 1e-2 and 1.3 s for 1e-3. count: 1 to SOLVER_LAYERS_MAX.
 * eta_below: the index below a last layer of finite thickness over that above all,
 * in the range of eta. stop: NULL, or set by any thread, which ends it within a tenth of a second or
 * so. Faults: those of solver_layers_check(),
 * `tolerance`, `memory`, CORE_FIELD_STOPPED. On a fault *solution is NULL. Otherwise the caller owns
 * it and frees it with solver_layers_free(), which accepts NULL. */
core_fault solver_layers_solve(solver_layers **solution, const core_isa *isa,
                               const solver_layer *layer, size_t count, double eta_below,
                               double tolerance, const atomic_bool *stop);

/* The same on the grid number `level` alone, from 0, the coarsest, to 4: without a second grid the
 * errors of its values are not known. Solutions of nearly the same layers on one grid share its error,
 * which their difference does not have. */
core_fault solver_layers_solve_level(solver_layers **solution, const core_isa *isa,
                                     const solver_layer *layer, size_t count, double eta_below,
                                     size_t level, const atomic_bool *stop);
void solver_layers_free(solver_layers *solution);

/* Returns R (side 0) or T (side 1) at the radius r in mm, per mm^2 and per power that has entered,
 * of light that was scattered, with an estimate of its absolute error. r: 0 (where both are
 * infinite) to infinity. */
transport_number solver_layers_at(const solver_layers *solution, size_t side, double r_mm);

/* Sets *balance for the layers of a solution. It takes milliseconds. Fault: `memory`. */
core_fault solver_layers_balance(const solver_layers *solution, const core_isa *isa,
                                 solver_balance *balance);

#endif
