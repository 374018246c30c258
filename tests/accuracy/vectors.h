/* vectors: true values of the dipole family and of transport, from CSV files. */
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

/* R of transport with anisotropic scattering by another implementation, with its error bound. */
typedef struct anisotropic_vector {
  double ratio; /* sigma_a / sigma_s' */
  double g;
  double eta;
  double x; /* radius in mean free paths 1 / sigma_t' */
  double R; /* per squared mean free path */
  double error;
} anisotropic_vector;

/* The file's rows stand medium by medium: six media of twelve radii each. */
enum { ANISOTROPIC_MEDIA = 6, ANISOTROPIC_RADII = 12 };

/* Reads all rows. A file that is missing or malformed fails the test. */
void vectors_read_anisotropic(anisotropic_vector rows[ANISOTROPIC_MEDIA][ANISOTROPIC_RADII]);

#endif
