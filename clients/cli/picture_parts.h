/* picture_parts: what is in a picture and where it lies on the axes, however it is drawn. */
#ifndef DIPOLE_CLI_PICTURE_PARTS_H
#define DIPOLE_CLI_PICTURE_PARTS_H

#include "clients/cli/picture.h"

enum { PICTURE_TEXT_BYTES = 160 };

/* Few models: one panel side by side has all curves, a dash for each model and a colour for each
 * channel. Many, or many channels, or one: a panel for each channel, a colour for each model. */
typedef struct picture_layout {
  bool by_channel;
  size_t panels; /* side by side */
  size_t curves; /* in each of them */
} picture_layout;

picture_layout picture_layout_of(const cli_eval_report *report);

typedef struct picture_curve {
  size_t model, channel;
  size_t dash;                    /* from 1, a solid line */
  const char *colour;             /* "#rrggbb" */
  char title[PICTURE_TEXT_BYTES]; /* the same in all panels when each has a channel of its own */
} picture_curve;

picture_curve picture_curve_of(const cli_eval_report *report, size_t panel, size_t index);

/* "skin1", or else "R(r)". */
const char *picture_title(const cli_picture *picture, char text[PICTURE_TEXT_BYTES]);

/* The channel that a panel has to itself; "" when it has all. */
const char *picture_panel_title(const cli_picture *picture, size_t panel,
                                char text[PICTURE_TEXT_BYTES]);

/* "R (1/mm^2 ...)" */
const char *picture_value_label(const cli_picture *picture, size_t row,
                                char text[PICTURE_TEXT_BYTES]);

/* What stands at a radius, in the numbers of the axis's labels; NaN: nothing can. */
double picture_shown(const cli_picture *picture, size_t row, const picture_curve *curve,
                     size_t radius);

/* Ends of an axis, low < high. Logarithmic ones are above 0. */
typedef struct picture_range {
  double low, high;
} picture_range;

/* The same for all panels of a row, so that they compare. False: there is nothing to draw. */
bool picture_ranges(const cli_picture *picture, size_t row, picture_range *r, picture_range *value);

#endif
