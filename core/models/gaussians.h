/* gaussians: the table of a sum of Gaussians, as its makers fill it in and its kernels read it. */
#ifndef DIPOLED_CORE_MODELS_GAUSSIANS_H
#define DIPOLED_CORE_MODELS_GAUSSIANS_H

#include "core/kernels.h"

enum { GAUSSIANS_FAR_FIELDS = 11 };

/* R(r) = e^(-shift) sum weight e^(-slowest r^2) e^(-faster r^2), in 1/mm^2. */
enum gaussians_field {
  GAUSSIANS_COUNT,
  GAUSSIANS_SLOWEST, /* 1/mm^2 */
  GAUSSIANS_SHIFT,
  GAUSSIANS_LEAST_MM,   /* for smaller radii R is continued like 1 / r; 0: it is not */
  GAUSSIANS_LEAST_CDF,  /* the cdf there */
  GAUSSIANS_LIMIT,      /* of the cdf: 1, or 0 when nothing scatters */
  GAUSSIANS_PER_ALBEDO, /* e^-shift / albedo, or 0 */
  GAUSSIANS_MOST_MM,    /* for larger radii R is continued like 1 / r^3; infinity: it is not */
  GAUSSIANS_FAR_MM,     /* for larger radii core_cloud_ln_R() gives ln R; infinity: the sum does */
  GAUSSIANS_FAR,        /* what that is told */
  GAUSSIANS_TERMS = GAUSSIANS_FAR + GAUSSIANS_FAR_FIELDS, /* for each term: */
  GAUSSIANS_WEIGHT = 0,                                   /* 1/mm^2 */
  GAUSSIANS_FASTER,                                       /* 1/mm^2 */
  GAUSSIANS_SHARE, /* its energy beyond the least radius over the albedo */
  GAUSSIANS_FIELDS
};

/* One Gaussian: weight e^(-rate r^2), in 1/mm^2 both; weight may be 0, not negative. */
typedef struct core_gaussian {
  double weight;
  double rate;
} core_gaussian;

/* Where the sum does not stand for R alone: see the fields above. */
typedef struct core_gaussian_ends {
  double least_mm;
  double most_mm;
  double shift;
  double far_mm;
  double far[GAUSSIANS_FAR_FIELDS];
} core_gaussian_ends;

/* Makes the table of `count` Gaussians (at least 1), the albedo and the cost; ends: NULL for a sum
 * that stands for R at all radii. */
core_fault core_gaussians_table(const core_gaussian *gaussians, size_t count,
                                const core_gaussian_ends *ends, core_preparation *preparation);

/* ln R, with R in 1/mm^2, at r mm, where R has underflowed; far: as core/models/cloud.c left it. */
double core_cloud_ln_R(const double *far, double r);

#endif
