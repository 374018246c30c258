/* expansion: the angles of light in a medium, in functions of half of them, and the transport
 * equation in these functions.
 *
 * Lengths are in scaled mean free paths: the part of the phase function that a truncated series
 * cannot tell from unscattered light counts as unscattered (Joseph, Wiscombe, Weinman 1976,
 * delta-M), or as sent straight back. */
#ifndef DIPOLED_CORE_SOLVER_EXPANSION_H
#define DIPOLED_CORE_SOLVER_EXPANSION_H

#include <stddef.h>

#include "core/core.h"

enum {
  EXPANSION_MOMENTS_MAX = 256, /* largest number of moments of a truncated phase function */
  EXPANSION_ORDERS_MAX = 24,
  EXPANSION_DEGREES_MAX = 80,
  EXPANSION_ETAS_MAX = 32, /* largest number of boundaries that are solved together */
  EXPANSION_CONES_MAX = 8, /* largest number of cones of angles for each boundary */
  EXPANSION_PANELS_MAX = 8,
};

/* A medium whose phase function has been truncated. */
typedef struct expansion_medium {
  double albedo;        /* albedo of single scattering, after the truncation */
  size_t moments;       /* 1 to EXPANSION_MOMENTS_MAX */
  const double *moment; /* [moments]; moment[0] = 1 */
  double reversed; /* the albedo of light that is sent straight back, beside the albedo above */
} expansion_medium;

/* The functions: for each hemisphere and each m from 0 to `orders`, cos(m phi) sin^m(theta) times
 * `degrees` - m polynomials of cos(theta), but at least `degrees_least` of them. */
typedef struct expansion_rules {
  size_t orders;
  size_t degrees;
  size_t degrees_least;
  double upright; /* for a stack: a cosine where panels meet, too, or 0 */
} expansion_rules;

/* The polynomials of one order on one panel: alpha and beta of their three-term recurrence, and the
 * norm of the first. */
typedef struct expansion_recurrence {
  double norm;
  double alpha[EXPANSION_DEGREES_MAX];
  double beta[EXPANSION_DEGREES_MAX];
} expansion_recurrence;

/* The boundaries of a medium, with cones of angles; count may be 0. */
typedef struct expansion_boundaries {
  size_t count;
  const double *etas; /* [count] index inside over index outside, each 0.2 to 5 */
  size_t cones;
  /* [cones] the sine of a cone's largest angle to the normal outside, over min(1, eta), the sine of
   * all light; each above 0, up to 1 */
  const double *sines;
  /* Cosines at which light has a kink, ascending, above 0 and below 1: the functions are then
   * piecewise, an equal part of them, and one more, on each panel between two edges. */
  size_t edges; /* 0 to EXPANSION_PANELS_MAX - 1: number of edges */
  const double *edge;
} expansion_boundaries;

/* Matrices are [n][n] and symmetric: their rows of odd orders have the other sign than in the
 * formulas of expansion.c. */
typedef struct expansion {
  const core_isa *isa;
  double albedo, reversed;
  size_t orders, n;
  /* first[m]: index of the first function of order m; then n */
  size_t first[EXPANSION_ORDERS_MAX + 2];
  size_t panels;
  double edge[EXPANSION_PANELS_MAX + 1]; /* ends of the panels of mu, from 0 to 1 */
  expansion_recurrence *recurrence;      /* [order][panel] */
  double *unit;                          /* <psi psi> */
  double *even, *odd;                    /* E - a (P++ + P+-) and E - a (P++ - P+-), for k = 0 */
  double *slant;                         /* C: the matrix whose product with k is added to E */
  double *source[2];                     /* b+ and b-, which exist for m = 0 only */
  /* for the orders above M: [nodes] alpha of orders M + 1 and M + 2 with `even`, and the other way round
   * with `odd`; cosines and weights, [nodes][n] the functions */
  size_t nodes;
  double *alpha[2], *mu, *weight, *psi;
  expansion_boundaries boundaries;
  /* <psi mu F psi> with Fresnel's reflectance F(mu); rows of odd orders have the formulas' sign */
  double *reflection[EXPANSION_ETAS_MAX];
  double *entering; /* [boundary] <mu T>: light that enters */
  /* [boundary][1 + cone] <mu T psi>, m = 0, over all angles, then over those of a cone */
  double *exit[EXPANSION_ETAS_MAX][1 + EXPANSION_CONES_MAX];
} expansion;

/* Returns how many functions of order m there are on each of some panels. */
size_t solver_expansion_degrees(const expansion_rules *rules, size_t m, size_t panels);

/* Returns the integrals for one medium and some boundaries, or NULL if memory runs out. The caller
 * frees them with solver_expansion_free(), which accepts NULL. boundaries: 1 to
 * EXPANSION_ETAS_MAX, with up to EXPANSION_CONES_MAX cones; what it points to has to outlive the
 * result. */
expansion *solver_expansion_new(const core_isa *isa, const expansion_rules *rules,
                                const expansion_medium *medium,
                                const expansion_boundaries *boundaries);
void solver_expansion_free(expansion *of);

/* Sets values[first[m + 1] - first[m]] to the functions of order m at the cosine mu. sine: sqrt(1 -
 * mu^2). */
void solver_expansion_at(const expansion *of, size_t m, double mu, double sine, double *values);

/* Adds factor times the product of a column and a row to a block of a matrix, whose rows are `stride`
 * numbers apart. */
void solver_expansion_add_outer(double *to, size_t stride, double factor, const double *left,
                                size_t rows, const double *right, size_t columns);

#endif
