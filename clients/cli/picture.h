/* picture: quantities of a report of `dipole eval` over r, as a file or as characters. */
#ifndef DIPOLE_CLI_PICTURE_H
#define DIPOLE_CLI_PICTURE_H

#include "clients/cli/eval.h"

/* Instead of a file's name: characters on standard output. */
#define CLI_PICTURE_TERMINAL "-"

enum cli_scale {
  CLI_LINEAR,
  CLI_LOGARITHMIC,
  CLI_GAMMA,   /* linear, of a power between 0 and 1: with the faint end lifted */
  CLI_PERCENT, /* linear, of a deviation */
};

/* What a panel's axes are. */
typedef struct cli_axes {
  const char *name; /* of --axes; NULL: the end of a list */
  bool logarithmic_r;
  enum cli_scale scale;
} cli_axes;

/* Those that --axes names; ends with an empty one. */
extern const cli_axes cli_axes_kinds[];

/* The axes of this name; NULL: there are none. */
const cli_axes *cli_axes_find(const char *name);

/* A row of panels that differ in channels alone. */
typedef struct cli_picture_row {
  cli_axes axes;
  size_t quantity;   /* by its position in the report */
  const char *label; /* of its values; NULL: the quantity's name and unit */
} cli_picture_row;

/* Each of the axes, and a deviation. */
enum { CLI_PICTURE_ROWS_MAX = 5 };

typedef struct cli_picture {
  const cli_eval_report *report; /* with a model at least */
  size_t row_count;
  cli_picture_row rows[CLI_PICTURE_ROWS_MAX]; /* from the top */
  size_t width_px, height_px;                 /* of a file; 0: as large as the panels need */
} cli_picture;

/* Whether a picture can have this name; says what is wrong when it cannot. */
bool cli_picture_check(const cli_command *command, const char *path);

/* R on a logarithmic axis, over r on one where the radii are in equal ratios. The report has R. */
cli_picture cli_picture_of_R(const cli_eval_report *report);

/* Draws into files, or for CLI_PICTURE_TERMINAL onto standard output. Says what is wrong, and which
 * file it is where that is the usual one, which may not have been named; an exit status. */
int cli_picture_draw(const cli_command *command, const cli_picture *picture,
                     const cli_texts *paths);

#endif
