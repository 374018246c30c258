/* loops: the innermost loops of gathering, compiled once for each instruction set. Internal to
 * core/gather.
 *
 * All arrays are aligned to 64 bytes, and n is a multiple of GATHER_LANES. Sums have the same order
 * everywhere: lane l adds the numbers l, l + GATHER_LANES, ..., and the lanes are added at the end.
 */
#ifndef DIPOLED_CORE_GATHER_LOOPS_H
#define DIPOLED_CORE_GATHER_LOOPS_H

#include <stddef.h>

enum { GATHER_LANES = 8, GATHER_NODES = 256, GATHER_POINTS = 512 };

/* Nodes side by side: the numbers of gather_moments, each times the number of times that it occurs in
 * a product with a symmetric tensor. The rows are not a power of two apart, so that they do not
 * compete for the same lines of the cache. */
enum { GATHER_FIELDS = 21, GATHER_ROW = GATHER_NODES + GATHER_LANES };
typedef struct gather_rows {
  _Alignas(64) double field[GATHER_FIELDS][GATHER_ROW];
} gather_rows;

/* The two radii that stand for a node, and the share of its power at the first one. */
typedef struct gather_pairs {
  _Alignas(64) double r[2][GATHER_ROW];
  double share[GATHER_ROW];
} gather_pairs;

typedef struct gather_loops {
  /* Sets the pairs of n nodes for a query at x. */
  void (*pair)(size_t n, const gather_rows *rows, const double x[3], gather_pairs *pairs);
  /* Sets r[n] to the distances of points from x. */
  void (*distances)(size_t n, const double *px, const double *py, const double *pz,
                    const double x[3], double *r);
  void (*narrow)(size_t n, const double *in, float *out);
  void (*widen)(size_t n, const float *in, double *out);
  /* Return the sum of power R, and of power (share R[0] + (1 - share) R[1]), over all powers above
   * 0. */
  double (*sum)(size_t n, const double *power, const double *R);
  double (*sum_pairs)(size_t n, const double *power, const double *share, const double *first,
                      const double *second);
} gather_loops;

#endif
