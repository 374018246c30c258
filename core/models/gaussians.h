/* gaussians: the table of a sum of Gaussians, which models fill in and the kernels of gaussians.c
 * read. */
#ifndef DIPOLED_CORE_MODELS_GAUSSIANS_H
#define DIPOLED_CORE_MODELS_GAUSSIANS_H

#include "core/kernels.h"

enum { GAUSSIANS_FAR_FIELDS = 11 };

/* Positions in the table. R(r) = e^(-shift) sum weight e^(-slowest r^2) e^(-faster r^2), in 1/mm^2,
 * with r in mm. */
enum gaussians_field {
  GAUSSIANS_COUNT,
  GAUSSIANS_SLOWEST, /* 1/mm^2 */
  GAUSSIANS_SHIFT,
  /* for smaller radii R is continued in proportion to 1 / r; 0 if no radius is smaller */
  GAUSSIANS_LEAST_MM,
  GAUSSIANS_LEAST_CDF, /* cdf at LEAST_MM */
  GAUSSIANS_LIMIT,     /* limit of the cdf at infinity: 1, or 0 if nothing scatters */
  /* for larger radii R is continued in proportion to 1 / r^3; infinity if no radius is larger */
  GAUSSIANS_MOST_MM,
  /* for larger radii core_cloud_ln_R() computes ln R; infinity if the sum always does */
  GAUSSIANS_FAR_MM,
  /* first of GAUSSIANS_FAR_FIELDS numbers, the argument `far` of core_cloud_ln_R() */
  GAUSSIANS_FAR,
  /* first of GAUSSIANS_FIELDS numbers for each term */
  GAUSSIANS_TERMS = GAUSSIANS_FAR + GAUSSIANS_FAR_FIELDS,
  GAUSSIANS_WEIGHT = 0, /* 1/mm^2 */
  GAUSSIANS_FASTER,     /* 1/mm^2 */
  GAUSSIANS_SHARE,      /* the term's energy beyond the least radius, divided by the albedo */
  GAUSSIANS_FIELDS
};

/* One Gaussian, weight e^(-rate r^2): weight in 1/mm^2, 0 or positive; rate in 1/mm^2, positive. */
typedef struct core_gaussian {
  double weight;
  double rate;
} core_gaussian;

/* The radii beyond which the sum is not R. The fields have the meanings of the table's fields of
 * the same names; least_mm, most_mm and far_mm are in mm. */
typedef struct core_gaussian_ends {
  double least_mm;
  double most_mm;
  double shift;
  double far_mm;
  double far[GAUSSIANS_FAR_FIELDS];
} core_gaussian_ends;

/* Makes the table of `count` Gaussians (at least 1) and sets the table, albedo, cost and error per
 * rounding of *preparation, which then owns the table. ends may be NULL for a sum that stands for R
 * at all radii. The fault is CORE_OUT_OF_MEMORY or none. */
core_fault core_gaussians_table(const core_gaussian *gaussians, size_t count,
                                const core_gaussian_ends *ends, core_preparation *preparation);

/* Returns ln R, with R in 1/mm^2, at r mm, for radii where R has underflowed. far: the numbers that
 * core/models/cloud.c put into core_gaussian_ends. */
double core_cloud_ln_R(const double *far, double r);

#endif
