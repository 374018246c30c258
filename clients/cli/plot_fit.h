/* plot_fit: draws readings, what was fitted to them, and residuals. */
#ifndef DIPOLE_CLI_PLOT_FIT_H
#define DIPOLE_CLI_PLOT_FIT_H

#include "clients/cli/readings.h"

/* Samples in a picture; the first ones of a file. */
enum { CLI_FIT_DRAWN_MAX = 8 };

/* What is drawn. residuals: [readings->count], NAN where there is no fit. */
typedef struct cli_fit_picture {
  const cli_readings *readings;
  const double *residuals;
  const char *title;
} cli_fit_picture;

/* Draws into each of the files, or for "-" onto standard output. Says what is wrong and returns an
 * exit status. */
int cli_fit_draw(const cli_fit_picture *picture, const cli_texts *paths);

#endif
