/* picture: draws quantities of an evaluation over r, into a file or as text. */
#ifndef DIPOLE_CLI_PICTURE_H
#define DIPOLE_CLI_PICTURE_H

#include "clients/cli/eval_report.h"

/* The name that stands for text on standard output. */
#define CLI_PICTURE_TERMINAL "-"

enum cli_scale {
  CLI_LINEAR,
  CLI_LOGARITHMIC,
  CLI_GAMMA,   /* linear, of a power between 0 and 1: with the faint end lifted */
  CLI_PERCENT, /* linear, of a deviation */
};

/* What a panel's axes are. */
typedef struct cli_axes {
  const char *name; /* of --axes; NULL ends a list */
  bool logarithmic_r;
  enum cli_scale scale;
} cli_axes;

/* Returns the axes of this name; NULL if there are none. */
const cli_axes *cli_axes_find(const char *name);

/* A row of panels, which differ only in their channels. */
typedef struct cli_picture_row {
  cli_axes axes;
  size_t quantity;   /* by its position in the report */
  const char *label; /* of its values; NULL for the quantity's name and unit */
} cli_picture_row;

/* Each of the axes, and a deviation. */
enum { CLI_PICTURE_ROWS_MAX = 5 };

typedef struct cli_picture {
  const cli_eval_report *report; /* with a model at least */
  size_t row_count;
  cli_picture_row rows[CLI_PICTURE_ROWS_MAX]; /* from the top */
  size_t error_quantity;                      /* standard errors; 0: there are none */
  size_t width_px, height_px;                 /* of a file; 0: as large as the panels need */
} cli_picture;

/* Returns whether a picture can have this name. If it cannot, says what is wrong. */
bool cli_picture_check(const char *path);

/* Returns the picture of R, on logarithmic axes if the radii are in equal ratios, else over a
 * linear one. The report must have R. */
cli_picture cli_picture_of_R(const cli_eval_report *report);

/* Draws into files, or for CLI_PICTURE_TERMINAL onto standard output, and tells which file that is.
 * Says what is wrong and returns an exit status. */
int cli_picture_draw(const cli_picture *picture, const cli_texts *paths);

/* Says which file a picture is in if it is the command's usual file, which the user may not have
 * named. */
void cli_picture_tell(const char *path);

/* Returns the colour of a channel's curve, such as "#d62728". */
const char *cli_channel_colour(const cli_profile *profile, size_t channel);

/* Writes what a legend calls a channel, such as "red" or "channel 1". */
void cli_channel_title(const cli_profile *profile, size_t channel, char *text, size_t bytes);

#endif
