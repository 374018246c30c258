/* Checks points and queries, and builds sets of points. */
#include <assert.h>
#include <math.h>
#include <stdlib.h>

#include "core/gather/points.h"

/* ---- checking -------------------------------------------------------------------------------- */

static core_fault check_coordinates(const char *field, size_t n, const double *xyz) {
  for (size_t i = 0; i < 3 * n; i++) {
    if (!(fabs(xyz[i]) <= CORE_GATHER_MOST_MM)) {
      return (core_fault){field, "coordinates from -1e9 to 1e9 mm", i / 3};
    }
  }
  return (core_fault){0};
}

core_fault core_gather_check_points(size_t n, const double *xyz, size_t channels,
                                    const float *power) {
  const core_fault fault = check_coordinates("points", n, xyz);
  for (size_t i = 0; i < channels * n && fault.field == NULL; i++) {
    if (!(power[i] >= 0 && power[i] <= (float)CORE_GATHER_MOST_POWER)) {
      return (core_fault){"power", "0 to 1e30", i / channels};
    }
  }
  return fault;
}

core_fault core_gather_check_queries(size_t n, const double *xyz) {
  return check_coordinates("queries", n, xyz);
}

/* ---- building -------------------------------------------------------------------------------- */

size_t core_gather_points_bytes_most(size_t n, size_t channels) {
  return sizeof(core_gather_points) + n * (3 * sizeof(double) + channels * sizeof(float));
}

core_gather_points *core_gather_points_create(size_t n, const double *xyz, size_t channels,
                                              const float *power) {
  assert(n >= 1 && n <= CORE_GATHER_POINTS_MAX);
  assert(channels >= 1 && channels <= CORE_GATHER_CHANNELS_MAX);
  core_gather_points *points = calloc(1, sizeof *points);
  double *at = malloc(3 * n * sizeof *at);
  float *powers = malloc(channels * n * sizeof *powers);
  if (points == NULL || at == NULL || powers == NULL) {
    free(points);
    free(at);
    free(powers);
    return NULL;
  }
  *points = (core_gather_points){
      .n = n, .channels = channels, .given_xyz = xyz, .given_power = power};
  for (size_t k = 0; k < 3; k++) {
    points->at[k] = at + k * n;
  }
  for (size_t c = 0; c < channels; c++) {
    points->power[c] = powers + c * n;
  }
  return points;
}

void core_gather_points_free(core_gather_points *points) {
  if (points != NULL) {
    free(points->at[0]);
    free(points->power[0]);
    free(points);
  }
}

bool core_gather_points_build(core_gather_points *points, uint64_t work_ns) {
  (void)work_ns;
  for (size_t i = 0; i < points->n && !points->built; i++) {
    for (size_t k = 0; k < 3; k++) {
      points->at[k][i] = points->given_xyz[3 * i + k];
    }
    for (size_t c = 0; c < points->channels; c++) {
      points->power[c][i] = points->given_power[points->channels * i + c];
    }
  }
  points->built = true;
  points->given_xyz = NULL;
  points->given_power = NULL;
  return true;
}

size_t core_gather_points_count(const core_gather_points *points) {
  return points->n;
}

size_t core_gather_points_channels(const core_gather_points *points) {
  return points->channels;
}

size_t core_gather_points_bytes(const core_gather_points *points) {
  return core_gather_points_bytes_most(points->n, points->channels);
}
