/* points: a set of points and the octree over it. Internal to core/gather.
 *
 * The points are sorted by Morton codes, so that the points of each node follow each other. Nodes
 * with one child do not exist. The children of a node follow each other, behind their parent.
 */
#ifndef DIPOLED_CORE_GATHER_POINTS_H
#define DIPOLED_CORE_GATHER_POINTS_H

#include "core/gather/gather.h"

/* Nodes of this many points or fewer have no children. */
enum { GATHER_LEAF = 24 };

typedef struct gather_node {
  double corner[3]; /* the least corner of the cube whose octants its children are in */
  double edge_mm;
  uint32_t first; /* its points */
  uint32_t count;
  uint32_t child; /* its children; a leaf has none */
  uint32_t children;
} gather_node;

/* The moments of a node's points about their centroid, weighted with their power: with d the vector
 * from the centroid, and E the mean. All are doubles, in the order of gather_rows. */
typedef struct gather_moments {
  double at[3];     /* the centroid */
  double radius_mm; /* the largest |d| */
  double second[6]; /* E d_a d_b, for xx, yy, zz, xy, xz, yz */
  double fourth[6]; /* E |d|^2 d_a d_b */
  double third[10]; /* E d_a d_b d_c, for xxx, yyy, zzz, xxy, xxz, xyy, yyz, xzz, yzz, xyz */
} gather_moments;

typedef struct gather_build gather_build;

struct core_gather_points {
  size_t n;
  size_t channels;
  double *at[3];                          /* coordinates of each point */
  float *power[CORE_GATHER_CHANNELS_MAX]; /* of each point, by channel */
  gather_node *nodes;
  size_t node_count;
  /* Channels whose powers are proportional share their moments: they are a group. */
  size_t groups;
  size_t group[CORE_GATHER_CHANNELS_MAX]; /* of each channel */
  /* Channels whose powers are only proportional up to rounding: the largest relative error of a sum
   * of one that takes another's moments. */
  double uneven[CORE_GATHER_CHANNELS_MAX];
  gather_moments *moments; /* [node * groups + group] */
  double *node_power;      /* [node * channels + channel] */
  double least[3];         /* the box around the points */
  double most[3];
  double reach_mm;     /* the largest absolute coordinate */
  double leaf_mm;      /* the median over points of the edge of their leaf's cube */
  gather_build *build; /* NULL once the points are built */
};

/* A cube that holds a query: its centre, an upper bound of how far a point of it is from there, and its
 * edge, or 0 if it is the query alone. */
typedef struct gather_cell {
  double at[3];
  double radius_mm;
  double edge_mm;
} gather_cell;

/* Returns the cell of a query, which depends on the points and the query alone: the cube of the
 * largest node with few points that it is in, or a cube of about a leaf's size between nodes. Outside
 * of the root's cube the cell is the query itself. *district is a larger cell that holds the cell and
 * many others, or the cell itself if it is in no such one. */
gather_cell gather_cell_of(const core_gather_points *points, const double x[3],
                           gather_cell *district);

/* Returns true only if gather_cell_of() returns this cell, and the same district as for the query that
 * the cell was returned for: it does not for a query near its sides. */
bool gather_cell_holds(const gather_cell *cell, const double x[3]);

#endif
