/* gaussians: the table of a sum of Gaussians, as its makers fill it in and its kernels read it. */
#ifndef DIPOLED_CORE_MODELS_GAUSSIANS_H
#define DIPOLED_CORE_MODELS_GAUSSIANS_H

#include "core/kernels.h"

/* R(r) = sum weight e^(-slowest r^2) e^(-faster r^2), in 1/mm^2. */
enum gaussians_field {
  GAUSSIANS_COUNT,
  GAUSSIANS_SLOWEST,    /* 1/mm^2 */
  GAUSSIANS_LEAST_MM,   /* for smaller radii R is continued like 1 / r; 0: it is not */
  GAUSSIANS_LEAST_CDF,  /* the cdf there */
  GAUSSIANS_LIMIT,      /* of the cdf: 1, or 0 when nothing scatters */
  GAUSSIANS_PER_ALBEDO, /* 1 / albedo, or 0 */
  GAUSSIANS_TERMS,      /* for each term: */
  GAUSSIANS_WEIGHT = 0, /* 1/mm^2 */
  GAUSSIANS_FASTER,     /* 1/mm^2 */
  GAUSSIANS_SHARE,      /* its energy beyond the least radius over the albedo */
  GAUSSIANS_FIELDS
};

/* One Gaussian: weight e^(-rate r^2), in 1/mm^2 both; weight may be 0, not negative. */
typedef struct core_gaussian {
  double weight;
  double rate;
} core_gaussian;

/* Makes the table of `count` Gaussians (at least 1), the albedo and the cost; least_mm: see above.
 */
core_fault core_gaussians_table(const core_gaussian *gaussians, size_t count, double least_mm,
                                core_preparation *preparation);

#endif
