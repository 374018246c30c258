/* samples: media solved at many radii, on all cores, and kept in files: what has been solved once
 * is read the next time, so that an interrupted run goes on where it was.
 */
#ifndef DIPOLED_TOOLS_SAMPLES_H
#define DIPOLED_TOOLS_SAMPLES_H

#include <stddef.h>
#include <stdint.h>

/* Some albedos of one eta. All arrays belong to the sample. */
typedef struct table_sample {
  double eta;
  size_t albedos, radii;
  double *albedo; /* [albedos] */
  double *x;      /* [albedos][radii], mean free paths */
  double *total;  /* [albedos], solved */
  double *R;      /* [albedos][radii], solved */
  size_t bytes;   /* of numbers */
  double *numbers;
} table_sample;

/* Room for all arrays. Never fails: the program ends with a message. */
void sample_make(table_sample *sample, double eta, size_t albedos, size_t radii);
void sample_free(table_sample *sample);

/* Fills in total and R of all samples. folder: for the files; made when it is not there. A file
 * counts only for the same inputs and the same solver. */
void samples_solve(const char *folder, double tolerance, table_sample *samples, size_t count);

#endif
