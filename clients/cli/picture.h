/* picture: curves in one panel, or in two below each other, drawn by gnuplot into a file or as
 * text. */
#ifndef DIPOLE_CLI_PICTURE_H
#define DIPOLE_CLI_PICTURE_H

#include "clients/cli/cli.h"

typedef struct cli_curve {
  char title[80]; /* in the legend; "" if it is not there */
  unsigned colour, dash;
  size_t count;
  const double *x, *y;       /* [count]; a line, or points if there are errors */
  const double *error;       /* [count] standard errors; NULL for a line */
  const double *lower;       /* [count] what the lower panel shows; NULL for nothing */
  const double *lower_error; /* the same of its errors; NULL for none */
} cli_curve;

enum { CLI_COLOUR_RED = 8 }; /* the colours from 0 on can be told apart; red, green, blue follow */

/* Zero it first. */
typedef struct cli_picture {
  char title[160], y_label[160];
  const char *x_label, *lower_label; /* NULL: there is no lower panel */
  bool logarithmic_x, logarithmic_y;
  double lower_most; /* the lower panel shows -lower_most to lower_most; 0: all its values */
  size_t count;
  cli_curve *curves; /* allocated: first the lines, then the points */
} cli_picture;

/* Checks what --plot gives. Says what is wrong and returns an exit status. */
int cli_picture_check(const cli_texts *paths, const cli_settings *settings);

/* Adds a zeroed curve, which lies there until the next is added. */
cli_curve *cli_picture_add(cli_picture *picture);

/* Draws into each of the files, or for "-" onto standard output. Says what is wrong and returns an
 * exit status. */
int cli_picture_draw(cli_picture *picture, const cli_texts *paths);

#endif
