/* samples: solves media at many radii on all cores and keeps the results in files. A later run
 * reads those files, so that an interrupted run continues where it stopped. */
#ifndef DIPOLED_TOOLS_SAMPLES_H
#define DIPOLED_TOOLS_SAMPLES_H

#include <stddef.h>
#include <stdint.h>

/* Media of one eta with several albedos. The sample owns all arrays. */
typedef struct table_sample {
  double eta;
  size_t albedos, radii;
  double *albedo;  /* [albedos] */
  double *x;       /* [albedos][radii], mean free paths */
  double *total;   /* [albedos], solved: the energy that leaves in all */
  double *R;       /* [albedos][radii], solved */
  size_t bytes;    /* size of numbers */
  double *numbers; /* memory that holds the four arrays */
} table_sample;

/* Allocates the arrays. If no memory is left, the program ends with a message. */
void sample_make(table_sample *sample, double eta, size_t albedos, size_t radii);
void sample_free(table_sample *sample);

/* Fills in total and R of all samples. The files are in the folder, which is made if necessary. A
 * file is used only if it was written for the same inputs and solver. */
void samples_solve(const char *folder, double tolerance, table_sample *samples, size_t count);

#endif
