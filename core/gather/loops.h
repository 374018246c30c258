/* loops: the innermost loops of gathering, compiled once for each instruction set. Internal to
 * core/gather.
 *
 * **A node by two distances.** Let D be the vector from a node's centroid to x, d that to one of its
 * points, E the mean weighted with power, and s = |D - d|^2 the squared distance, of which R is a
 * function f. The mean of s is |D|^2 + E |d|^2, and with y = s - E s
 *
 *   E y^2 = 4 D.C.D - 4 D.t + tr F - (tr C)^2         C = E d d, F = E |d|^2 d d, t = E |d|^2 d
 *   E y^3 = -8 E (D.d)^3 + 12 (D.F.D - D.C.D tr C) + e
 *
 * A node keeps its power, its centroid, C, F, the third moments and its radius a, the largest |d|.
 * The pair s-, s+ and its weights (Gauss's rule of two points) have the mean, E y^2 and E y^3
 * without e. Both lie between (|D| - a)^2 and (|D| + a)^2, as s does. With z = |d|^2 - tr C, whose
 * E z^2 is tr F - (tr C)^2, and Z the larger of a^2 - tr C and tr C,
 * |e| = |-6 E (D.d) z^2 + E z^3| <= E z^2 (6 |D| a + Z).
 *
 * **Its bound.** Write f = p + g y^4 with p cubic in s and leading coefficient c. Between (|D| - a)^2
 * and (|D| + a)^2 let G be the largest |g|, G' the smallest (0 if the sign of g varies), and let g
 * vary by v. Points and pair agree on p but for c e. The pair's mean Q y^4 is at least (E y^2)^2
 * and, since the pair lies within h = 2 |D| a + a^2 of the mean, at most E y^4 + 2 h |e|. So the node
 * is off by at most
 *
 *   P min(v E y^4 + max(G' (E y^4 - (E y^2)^2), 2 h (G' + v) |e|) + |c e|, the largest R from |D| - a)
 *
 * By Minkowski's inequality (E y^4)^(1/4) <= 2 (E (D.d)^4)^(1/4) + (Z^2 E z^2)^(1/4) and
 * (E y^2)^(1/2) >= 2 (D.C.D)^(1/2) - (E z^2)^(1/2); and E (D.d)^4 <= |D|^2 D.F.D. For all x in a ball
 * the roots of n.F.n and n.C.n, n = D / |D|, differ from those at its centre by at most the sine of
 * the angle times the root of the tensor's norm. bounds.c finds G, G' and c once for each profile.
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

/* What nodes and all queries of a cell have in common: the comment at the head names these. */
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

/* Queries of one cell whose sums are under way, and at most this many radii for all of them at
 * once. */
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
  /* Return the sum over all powers above 0 of power R, or of power (share R + (1 - share) R'). All
   * R' follow all R in the array. */
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
