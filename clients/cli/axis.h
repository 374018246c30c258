/* axis: places and labels on an axis from a low to a high end. */
#ifndef DIPOLE_CLI_AXIS_H
#define DIPOLE_CLI_AXIS_H

#include <stdbool.h>
#include <stddef.h>

typedef struct cli_axis {
  double low, high; /* finite, low < high */
  bool logarithmic; /* then low > 0 */
} cli_axis;

/* 0 at the low end, 1 at the high one. */
double cli_axis_place(const cli_axis *axis, double value);

enum { CLI_AXIS_TICKS_MAX = 16 };

/* Round numbers on the axis, rising: at least one, at most `most` (2 to CLI_AXIS_TICKS_MAX). */
size_t cli_axis_ticks(const cli_axis *axis, size_t most, double ticks[CLI_AXIS_TICKS_MAX]);

#endif
