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

/* GATHER_NODES nodes in structure-of-arrays layout. A field is a number of gather_moments times its
 * multiplicity: the number of times that it occurs in a product with a symmetric tensor. GATHER_ROW
 * is not a power of two, so that rows do not compete for the same cache lines. */
enum { GATHER_FIELDS = 26, GATHER_ROW = GATHER_NODES + GATHER_LANES };
typedef struct gather_rows {
  _Alignas(64) double field[GATHER_FIELDS][GATHER_ROW];
} gather_rows;

/* GATHER_LANES nodes in the same layout, with the first GATHER_SEEN_FIELDS numbers of
 * gather_moments. */
enum { GATHER_SEEN_FIELDS = 16 };
typedef struct gather_seen {
  _Alignas(64) double field[GATHER_SEEN_FIELDS][GATHER_LANES];
} gather_seen;

/* Bounds for each of GATHER_LANES nodes that hold for all queries of one cell. The comment at the
 * head of this file defines the symbols. D is here the root of the mean squared distance. */
typedef struct gather_views {
  /* least distance between a point of the node and a query, mm */
  _Alignas(64) double nearest[GATHER_LANES];
  /* largest relative difference between a point's distance and D; INFINITY: no bounds, use the
   * largest R */
  double ratio[GATHER_LANES];
  double least[GATHER_LANES];  /* lower bound of D for the queries of the cell, mm */
  double most[GATHER_LANES];   /* upper bound of it, mm */
  double fourth[GATHER_LANES]; /* upper bound of E y^4 / D^4 */
  double second[GATHER_LANES]; /* lower bound of (E y^2)^2 / D^4 */
  double rest[GATHER_LANES];   /* upper bound of |e| / D */
  double twice[GATHER_LANES];  /* upper bound of 2 h |e| / D^4 */
} gather_views;

/* The largest number of queries of one cell that are summed at once, and of radii that are
 * evaluated at once. */
enum { GATHER_QUERIES = 64, GATHER_RADII = 512 };

/* A table of R whose coefficients are in structure-of-arrays layout: piece i has its coefficients
 * at first[i], first[stride + i] and so on. GATHER_CLOSE numbers before the first piece and after
 * the last one are readable. */
enum { GATHER_CLOSE = 16 };
typedef struct gather_pieces {
  float *memory; /* owned */
  const float *first;
  size_t stride;
} gather_pieces;

typedef struct gather_loops {
  /* Computes the views of GATHER_LANES nodes from the cell: the ball with centre x and this
   * radius. */
  void (*view)(const gather_seen *seen, const double x[3], double radius_mm, gather_views *views);
  /* Returns an upper bound of the error of R that node number `node` of the views causes for each W
   * of its power, 1/mm^2. */
  double (*error)(const gather_bounds *bounds, const gather_views *views, size_t node);
  /* Computes the pairs that replace n nodes for a query at x. r[2 n]: the first distances of all
   * nodes, then the second ones, in mm. share[n]: the share of the node's power at its first
   * distance. */
  void (*pair)(size_t n, const gather_rows *rows, const double x[3], double *r, double *share);
  /* Sets r[n] to the distances in mm between x and the points (px, py, pz)[n]. */
  void (*distances)(size_t n, const double *px, const double *py, const double *pz,
                    const double x[3], double *r);
  void (*narrow)(size_t n, const double *in, float *out);
  void (*widen)(size_t n, const float *in, double *out);
  /* Return sums over all entries with power above 0. sum: of power R, with R[n]. sum_pairs: of
   * power (share R[i] + (1 - share) R[n + i]), with R[2 n]. */
  double (*sum)(size_t n, const double *power, const double *R);
  double (*sum_pairs)(size_t n, const double *power, const double *share, const double *R);

  /* Adds up the lanes of a sum in a fixed order. */
  double (*total)(const double lanes[GATHER_LANES]);

  /* Variants for a few nodes or points and all queries of a cell at once. queries: a multiple of
   * GATHER_CLOSE. Arrays hold one row for each node or point, of `queries` numbers, or of
   * GATHER_QUERIES in x and part. The add functions add each product to part[lane][query], so that
   * a query gets the same lane sums as by sum() and sum_pairs(). close_pairs: r holds a node's
   * first distances, then its second ones. */
  void (*close_pairs)(size_t count, const gather_rows *rows, size_t from, size_t queries,
                      const double x[3][GATHER_QUERIES], float *r, double *share);
  void (*close_distances)(size_t count, const double *px, const double *py, const double *pz,
                          size_t queries, const double x[3][GATHER_QUERIES], float *r);
  void (*add_close)(size_t count, const double *power, size_t queries, const float *R,
                    double part[][GATHER_QUERIES]);
  void (*add_close_pairs)(size_t count, const double *power, size_t queries, const double *share,
                          const float *R, double part[][GATHER_QUERIES]);
  /* Looks up R[n] at the radii r[n] with the bits of the lut kernel; n is at most GATHER_RADII.
   * Works on groups of GATHER_CLOSE radii. Returns a mask: bit i is set if the radii of group i are
   * not close enough to each other; their R is not set. NULL on instruction sets where it would not
   * be faster. */
  uint64_t (*look_up_close)(const float *table, const gather_pieces *pieces, size_t n,
                            const float *r, float *R);
} gather_loops;

#endif
