/* loops: the innermost loops of gathering, compiled once for each instruction set. Internal to
 * core/gather.
 *
 * All arrays are aligned to 64 bytes, and n is a multiple of GATHER_LANES. Sums have the same order
 * everywhere: lane l adds the numbers l, l + GATHER_LANES, ..., and the lanes are added at the end.
 */
#ifndef DIPOLED_CORE_GATHER_LOOPS_H
#define DIPOLED_CORE_GATHER_LOOPS_H

#include "core/gather/bounds.h"

enum { GATHER_LANES = 8, GATHER_NODES = 256, GATHER_POINTS = 512 };

/* Nodes side by side: the numbers of gather_moments, each times the number of times that it occurs in
 * a product with a symmetric tensor. The rows are not a power of two apart, so that they do not
 * compete for the same lines of the cache. */
enum { GATHER_FIELDS = 26, GATHER_ROW = GATHER_NODES + GATHER_LANES };
typedef struct gather_rows {
  _Alignas(64) double field[GATHER_FIELDS][GATHER_ROW];
} gather_rows;

/* GATHER_LANES nodes side by side: the first numbers of gather_moments. */
enum { GATHER_SEEN_FIELDS = 16 };
typedef struct gather_seen {
  _Alignas(64) double field[GATHER_SEEN_FIELDS][GATHER_LANES];
} gather_seen;

/* What nodes and all queries of a cell have in common: core/MODELS.md names these. */
typedef struct gather_views {
  _Alignas(64) double nearest[GATHER_LANES]; /* of the distances between points and queries */
  double ratio[GATHER_LANES];                /* of distances, below INFINITY if the rest is known */
  double least[GATHER_LANES];                /* roots of mean squared distances */
  double most[GATHER_LANES];
  double fourth[GATHER_LANES]; /* E y^4 / D^4, at most */
  double second[GATHER_LANES]; /* (E y^2)^2 / D^4, at least */
  double rest[GATHER_LANES];   /* |e| / D, at most */
  double twice[GATHER_LANES];  /* 2 h |e| / D^4, at most */
} gather_views;

typedef struct gather_loops {
  /* Sets the views of nodes from the cell about x. */
  void (*view)(const gather_seen *seen, const double x[3], double radius_mm, gather_views *views);
  /* Returns the largest error that the node of a view causes, for each W of its power. */
  double (*error)(const gather_bounds *bounds, const gather_views *views, size_t node);
  /* For a query at x, sets r[2 n] to the first radii that stand for n nodes and then their second
   * ones, and share[n] to the shares of power at the first ones. */
  void (*pair)(size_t n, const gather_rows *rows, const double x[3], double *r, double *share);
  /* Sets r[n] to the distances of points from x. */
  void (*distances)(size_t n, const double *px, const double *py, const double *pz,
                    const double x[3], double *r);
  void (*narrow)(size_t n, const double *in, float *out);
  void (*widen)(size_t n, const float *in, double *out);
  /* Return the sum of power R, and of power (share R + (1 - share) R') with the R' behind all R,
   * over all powers above 0. */
  double (*sum)(size_t n, const double *power, const double *R);
  double (*sum_pairs)(size_t n, const double *power, const double *share, const double *R);
} gather_loops;

#endif
