/* exitance: X(k), the exitance of light that was scattered more than once, Fourier transformed
 * over the plane, between and beyond the wavenumbers at which it is known, and the way back to
 * R(r). See solver.c for the formulas. Lengths are in any unit, and k is per this unit. */
#ifndef DIPOLED_CORE_SOLVER_EXITANCE_H
#define DIPOLED_CORE_SOLVER_EXITANCE_H

#include <complex.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/core.h"

enum {
  EXITANCE_TIERS = 4,
  EXITANCE_NODES_MAX = 16,
  EXITANCE_PANELS_MAX = 40,
  EXITANCE_PANELS_SPARE = 4, /* at least so many less one are left when a path is laid */
  EXITANCE_TAIL_TERMS = 4
};

/* The wavenumbers: Chebyshev's nodes on the straight pieces of a path. Each tier of them, up to
 * some |k|, is solved in one way, and has its own errors. */
typedef struct exitance_grid {
  const core_isa *isa;
  double tier_end
      [EXITANCE_TIERS]; /* largest |k| of each tier; the last is K, the path's largest Re k */
  size_t nodes;         /* number of nodes on each panel */
  size_t panels;
  double complex point[EXITANCE_PANELS_MAX + 1]; /* start of the path, and end of each panel */
} exitance_grid;

/* Lays the path of wavenumbers k over which the inverse Hankel transform of X integrates: panels
 * that double in width, the first one not below 2^-36 K, with the same number of nodes on each (8 to
 * EXITANCE_NODES_MAX). The path
 * begins at Im k = share kappa, where kappa (0, or at least 1e-9) is the decay rate of R far away
 * and share is from 0 to less than 1. `scale`, the least scaled extinction that light meets, limits
 * Im k. tier_end is ascending. */
void solver_exitance_place(exitance_grid *to, const core_isa *isa, double kappa, double share,
                           double scale, size_t nodes, const double tier_end[EXITANCE_TIERS]);

/* Returns the wavenumber k of a node. Nodes are numbered in ascending order over all panels. */
double complex solver_exitance_wavenumber(const exitance_grid *of, size_t node);

/* Returns the number of nodes in tiers 0 to `tier`. */
size_t solver_exitance_end(const exitance_grid *of, size_t tier);

/* X, the Hankel transform of R, as a function of k: a Chebyshev series on each panel, and beyond K,
 * the end of the path, a sum of powers of 1 / k (the tail). */
typedef struct exitance_series {
  double complex term[EXITANCE_PANELS_MAX][EXITANCE_NODES_MAX];
  double far, peak, tail[EXITANCE_TAIL_TERMS];
  /* X minus the tail at K: its value, and its slope as a multiple of k^-5 */
  double complex step, bend;
} exitance_series;

/* Sets *to from X at all nodes. far: the limit of k^2 X. peak: 0, or the wavenumber of a narrow peak of
 * light that is scattered back. smooth: X itself, or the part of it that does not fall exponentially,
 * from which the tail is found. Returns false if an equation is singular. */
bool solver_exitance_make(exitance_series *to, const exitance_grid *of, double far, double peak,
                          const double complex *smooth, const double complex *values);

/* Returns R at the radius r, above 0, per squared unit of length. *size is set to the same integral
 * over the modulus of the integrand: an error of X counts in proportion to it. */
double solver_exitance_at(const exitance_series *at, const exitance_grid *of, double r,
                          double *size);

#endif
