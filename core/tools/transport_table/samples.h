/* samples: solves media at many radii on all cores and keeps the solutions in files. A later run
 * reads those files, so that an interrupted run continues where it stopped. For g other than 0 they hold
 * the exitances (solver.h), so that other radii need no new solutions. */
#ifndef DIPOLED_TOOLS_SAMPLES_H
#define DIPOLED_TOOLS_SAMPLES_H

#include <stddef.h>
#include <stdint.h>

#include "core/solver/solver.h"

/* Media that are solved together: of one eta with several albedos for isotropic scattering (g = 0),
 * or of one albedo and g with several eta. The sample owns all arrays. */
typedef struct table_sample {
  double g;
  size_t level; /* level of the solver's grid; not used for isotropic scattering */
  size_t media, radii;
  double *albedo;  /* [media] */
  double *eta;     /* [media] */
  double *x;       /* [media][radii], reduced mean free paths */
  double *total;   /* [media]: energy that leaves, for isotropic scattering; set by solving */
  double *R;       /* [media][radii], solved */
  double *numbers; /* the memory of the five arrays */
} table_sample;

/* Levels of the solver's grids. */
enum { SAMPLE_NORMAL = 3, SAMPLE_FINEST = 4 };

/* Returns the level that a medium with g other than 0 needs: SAMPLE_FINEST for g from 0.85 on, else
 * SAMPLE_NORMAL. */
size_t sample_level(double g);

/* Allocates the arrays. The level is SAMPLE_NORMAL. If no memory is left, the program ends
 * with a message. */
void sample_make(table_sample *sample, double g, size_t media, size_t radii);
void sample_free(table_sample *sample);

/* Fills in total and R of all samples. The files are in the folder, which is made if necessary. A
 * file is used only if it was written for the same inputs and solver. */
void samples_solve(const char *folder, table_sample *samples, size_t count);

#endif
