#include "clients/cli/canvas.h"

#include <math.h>
#include <stdlib.h>

#include "clients/cli/cli.h"

cli_canvas canvas_make(size_t columns, size_t rows) {
  return (cli_canvas){columns, rows, cli_allocate(columns * rows, sizeof(unsigned))};
}

void canvas_free(cli_canvas *canvas) {
  free(canvas->pens);
  canvas->pens = NULL;
}

size_t canvas_column(const cli_canvas *canvas, double x) {
  return (size_t)lround(x * (double)(canvas->columns - 1));
}

size_t canvas_row(const cli_canvas *canvas, double y) {
  return (size_t)lround((1 - y) * (double)(canvas->rows - 1));
}

/* The part, from *first to *last of a line's length, where one coordinate is within 0 and 1. */
static void clip(double from, double to, double *first, double *last) {
  if (from == to) {
    *last = from >= 0 && from <= 1 ? *last : -1;
    return;
  }
  const double at_0 = (0 - from) / (to - from), at_1 = (1 - from) / (to - from);
  *first = fmax(*first, fmin(at_0, at_1));
  *last = fmin(*last, fmax(at_0, at_1));
}

static double between(double from, double to, double share) {
  return fmin(fmax(from + (to - from) * share, 0), 1);
}

void canvas_line(cli_canvas *canvas, canvas_point from, canvas_point to, unsigned pen) {
  double first = 0, last = 1;
  clip(from.x, to.x, &first, &last);
  clip(from.y, to.y, &first, &last);
  if (first > last) {
    return;
  }
  /* Two steps for each cell that the line crosses; what is clipped crosses each at most once. */
  const double wide = fabs(to.x - from.x) * (last - first) * (double)canvas->columns;
  const double high = fabs(to.y - from.y) * (last - first) * (double)canvas->rows;
  const size_t steps = 1 + (size_t)(2 * fmax(wide, high));
  for (size_t i = 0; i <= steps; i++) {
    const double share = first + (last - first) * (double)i / (double)steps;
    const size_t column = canvas_column(canvas, between(from.x, to.x, share));
    const size_t row = canvas_row(canvas, between(from.y, to.y, share));
    canvas->pens[row * canvas->columns + column] = pen;
  }
}
