/* vectors: rows of the dipole family's true values, from CSV files. */
#ifndef DIPOLED_TESTS_VECTORS_H
#define DIPOLED_TESTS_VECTORS_H

#include "core/core.h"

/* Columns: model,moments,sigma_a,sigma_s,g,eta,r,R,albedo,cdf (model and moments by name). */
typedef struct vector {
  unsigned model;
  unsigned moments;
  core_medium medium;
  double r_mm;
  double R;
  double albedo;
  double cdf;
} vector;

/* From the repository's top: 200 rows over the whole domain, and the 3,000 that they are from,
 * which only a checkout beside its shared folder has. */
#define VECTORS_FILE "tests/accuracy/dipole_vectors.csv"
#define VECTORS_FILE_ALL "../shared/vectors/dipole.csv"

/* Returns all rows of a file, which the caller frees, and sets *count to their number. Returns NULL
 * if there is no such file. A malformed file fails the test. */
vector *vectors_read(const char *path, size_t *count);

#endif
