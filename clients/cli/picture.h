/* picture: curves in one panel or two below each other, drawn by gnuplot into a file or as text. */
#ifndef DIPOLE_CLI_PICTURE_H
#define DIPOLE_CLI_PICTURE_H

#include "clients/cli/cli.h"

typedef struct cli_curve {
  char title[80]; /* text in the legend; "": none */
  unsigned colour, dash;
  size_t count;
  const double *x, *y;       /* [count]; a line, or points if there are errors */
  const double *error;       /* [count] standard errors, drawn as bars; NULL: a line */
  const double *lower;       /* [count] values in the lower panel; NULL: none */
  const double *lower_error; /* [count] their standard errors; NULL: none */
} cli_curve;

enum { CLI_COLOUR_RED = 8 }; /* Colours 0 to 7 are distinct; then come red, green and blue. */

/* Set all to zero first. */
typedef struct cli_picture {
  char title[160], y_label[160];
  const char *x_label, *lower_label; /* NULL: there is no lower panel */
  bool logarithmic_x, logarithmic_y;
  double lower_most; /* the lower panel shows -lower_most to lower_most; 0: all its values */
  size_t count;
  cli_curve *curves; /* [count], owned; lines first, then points */
} cli_picture;

/* Checks what --plot gives. Says what is wrong and returns an exit status. */
int cli_picture_check(const cli_texts *paths, const cli_settings *settings);

/* Adds a zeroed curve, which lies there until the next is added. */
cli_curve *cli_picture_add(cli_picture *picture);

/* Draws into each of the files; "-" is standard output. Returns an exit status. */
int cli_picture_draw(cli_picture *picture, const cli_texts *paths);

#endif
