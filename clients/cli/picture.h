/* picture: a table of curves, drawn by gnuplot into a file or as text. */
#ifndef DIPOLE_CLI_PICTURE_H
#define DIPOLE_CLI_PICTURE_H

#include "clients/cli/profile.h"

enum cli_scale {
  CLI_LINEAR,
  CLI_LOGARITHMIC,
  CLI_GAMMA,   /* linear, of a power between 0 and 1: with the faint end lifted */
  CLI_PERCENT, /* linear, of a deviation */
};

/* What a panel's axes are. */
typedef struct cli_axes {
  const char *name; /* of --axes; NULL ends a list */
  bool logarithmic_x;
  enum cli_scale scale;
} cli_axes;

enum { CLI_LABEL_BYTES = 160, CLI_PICTURE_ROWS_MAX = 5, CLI_PALETTE = 8 };

/* A row of panels. */
typedef struct cli_row {
  cli_axes axes;
  double gamma; /* for CLI_GAMMA, which shows values to the power 1 / gamma */
  char label[CLI_LABEL_BYTES];
} cli_row;

enum cli_style {
  CLI_LINE,
  CLI_FITTED, /* a line through the points in the order of x */
  CLI_POINTS,
  CLI_ERRORS, /* points with standard errors */
};

typedef struct cli_curve {
  size_t row, column; /* of its panel */
  enum cli_style style;
  size_t dash, mark; /* from 0 on; a mark stands for the curve in text */
  const char *colour;
  char title[CLI_LABEL_BYTES]; /* in the legend; "" if it is not there */
  size_t count;
  const double *x, *y, *error; /* [count]; error: for CLI_ERRORS */
} cli_curve;

/* Zero it first. cli_picture_draw() frees what is allocated. */
typedef struct cli_picture {
  char title[CLI_LABEL_BYTES];
  const char *x_label;
  size_t row_count, column_count;
  cli_row rows[CLI_PICTURE_ROWS_MAX]; /* from the top */
  char (*columns)[CLI_LABEL_BYTES];   /* [column_count] titles, allocated; NULL: there are none */
  size_t curve_count;
  cli_curve *curves;          /* allocated */
  char *caption;              /* lines below the panels, allocated; NULL: there are none */
  size_t width_px, height_px; /* of a file; 0: as large as the panels need */
} cli_picture;

/* Checks what --plot gives. Says what is wrong and returns an exit status. */
int cli_picture_check(const cli_texts *paths, const cli_common *common);

/* Adds a zeroed curve, which lies there until the next is added. */
cli_curve *cli_picture_add(cli_picture *picture);

/* Draws into each of the files, or for "-" onto standard output, and tells which file that is if
 * it is the command's usual one. Says what is wrong and returns an exit status. */
int cli_picture_draw(cli_picture *picture, const cli_texts *paths);

extern const char *const cli_palette[CLI_PALETTE];

#endif
