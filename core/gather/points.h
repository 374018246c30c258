/* points: a set of points and the octree over it. Internal to core/gather.
 *
 * The points are sorted by Morton codes, so a node's points are contiguous. A node has either no
 * child or at least two. The children of a node are contiguous and have larger indices than their
 * parent. */
#ifndef DIPOLED_CORE_GATHER_POINTS_H
#define DIPOLED_CORE_GATHER_POINTS_H

#include <math.h>

#include "core/gather/gather.h"

/* The largest number of points of a leaf. */
enum { GATHER_LEAF = 24 };

typedef struct gather_node {
  /* corner with the least coordinates of the node's cube, whose octants hold its children */
  double corner[3];
  double edge_mm;
  uint32_t first; /* its points */
  uint32_t count;
  uint32_t child; /* index of its first child; `children` is their number, 0 for a leaf */
  uint32_t children;
} gather_node;

/* Moments of a node's points about their centroid. d is the vector from the centroid to a point,
 * and E the mean weighted by power. All members are doubles in the order of the fields of
 * gather_rows. */
typedef struct gather_moments {
  double at[3];     /* the centroid */
  double radius_mm; /* largest |d| */
  double second[6]; /* E d_a d_b for ab = xx, yy, zz, xy, xz, yz; mm^2 */
  double fourth[6]; /* E |d|^2 d_a d_b in the same order; mm^4 */
  /* E d_a d_b d_c for abc = xxx, yyy, zzz, xxy, xxz, xyy, yyz, xzz, yzz, xyz; mm^3 */
  double third[10];
} gather_moments;

typedef struct gather_build gather_build;

struct core_gather_points {
  size_t n;
  size_t channels;
  double *at[3];                          /* [n] of x, of y and of z, mm */
  float *power[CORE_GATHER_CHANNELS_MAX]; /* [n] of each channel, W */
  gather_node *nodes;
  size_t node_count;
  /* A group is a set of channels whose powers are proportional. They share moments. */
  size_t groups;
  size_t group[CORE_GATHER_CHANNELS_MAX]; /* index of each channel's group */
  /* For each channel: the largest relative error of a sum that uses the moments of the group's
   * first channel. It is not 0 if powers are proportional only up to rounding. */
  double uneven[CORE_GATHER_CHANNELS_MAX];
  gather_moments *moments; /* [node * groups + group] */
  double *node_power;      /* [node * channels + channel] */
  double least[3];         /* bounding box of the points, mm */
  double most[3];
  double reach_mm;     /* largest absolute coordinate */
  double leaf_mm;      /* median over all points of the edge of the leaf's cube */
  gather_build *build; /* NULL once the points are built */
};

/* A cube that contains a query: its centre, an upper bound of the distance from the centre to any
 * point of the cube, and its edge. The edge is 0 if the cell is the query alone. */
typedef struct gather_cell {
  double at[3];
  double radius_mm;
  double edge_mm;
} gather_cell;

static inline double gather_distance(const double a[3], const double b[3]) {
  const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
  return sqrt(x * x + y * y + z * z);
}

/* Returns the cell of a query. It depends only on the points and the query. Inside a small node it
 * is the cube of the largest node with up to 80 points that contains the query. Between small nodes
 * it is a cube of about a leaf's size. Outside the root's cube it is the query alone. *district:
 * the cube of a node with up to 1024 points that contains the cell, or else the cell itself. */
gather_cell gather_cell_of(const core_gather_points *points, const double x[3],
                           gather_cell *district);

/* Returns whether the query x surely has this cell, and with it the same district. A query near a
 * side of the cell gets false. */
bool gather_cell_holds(const gather_cell *cell, const double x[3]);

#endif
