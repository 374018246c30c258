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

/* Queries of one cell whose sums are under way, and at most so many radii for all of them at once. */
enum { GATHER_QUERIES = 64, GATHER_RADII = 512 };

/* The coefficients of a table of R side by side: those of piece i of the table are [i], [stride + i]
 * and so on. GATHER_CLOSE numbers before the first piece and behind the last one may be read. */
enum { GATHER_CLOSE = 16 };
typedef struct gather_pieces {
  float *memory; /* owned */
  const float *first;
  size_t stride;
} gather_pieces;

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

  /* Returns the sum of a sum's lanes. */
  double (*total)(const double lanes[GATHER_LANES]);

  /* The same for a few nodes or points and all queries of a cell, whose radii are close to each other.
   * queries is a multiple of GATHER_CLOSE, and arrays have queries, or GATHER_QUERIES in x and part,
   * numbers for each node or point. Each adds its products to its own row of part, in which a query
   * has the numbers that the loops above have in their lanes.
   * close_pairs: r has the first radii of a node and then its second ones. */
  void (*close_pairs)(size_t count, const gather_rows *rows, size_t from, size_t queries,
                      const double x[3][GATHER_QUERIES], float *r, double *share);
  void (*close_distances)(size_t count, const double *px, const double *py, const double *pz,
                          size_t queries, const double x[3][GATHER_QUERIES], float *r);
  void (*add_close)(size_t count, const double *power, size_t queries, const float *R,
                    double part[][GATHER_QUERIES]);
  void (*add_close_pairs)(size_t count, const double *power, size_t queries, const double *share,
                          const float *R, double part[][GATHER_QUERIES]);
  /* Sets R[n] to what the kernel of tables finds, with the same bits, for n up to GATHER_RADII.
   * Returns bit i for each GATHER_CLOSE radii, from GATHER_CLOSE i on, that are not close enough to
   * each other, whose R it does not set. NULL where an instruction set would not be faster. */
  uint64_t (*look_up_close)(const float *table, const gather_pieces *pieces, size_t n,
                            const float *r, float *R);
} gather_loops;

#endif
