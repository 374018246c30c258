/* points: what a set of points consists of. Internal to core/gather. */
#ifndef DIPOLED_CORE_GATHER_POINTS_H
#define DIPOLED_CORE_GATHER_POINTS_H

#include "core/gather/gather.h"

struct core_gather_points {
  size_t n;
  size_t channels;
  bool built;
  double *at[3];                          /* coordinates of each point */
  float *power[CORE_GATHER_CHANNELS_MAX]; /* of each point, by channel */
  const double *given_xyz;                /* the caller's, until the points are built */
  const float *given_power;
};

#endif
