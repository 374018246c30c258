/* canvas: lines on a grid of characters. */
#ifndef DIPOLE_CLI_CANVAS_H
#define DIPOLE_CLI_CANVAS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

/* What has drawn a cell: 0 nothing, else a number that the user of the canvas chose. */
typedef struct cli_canvas {
  size_t columns, rows;
  unsigned *pens; /* row by row from the top */
} cli_canvas;

/* At least 1 by 1, and empty; to be freed. */
cli_canvas canvas_make(size_t columns, size_t rows);
void canvas_free(cli_canvas *canvas);

typedef struct canvas_point {
  double x, y; /* finite; 0 to 1 from left to right and from bottom to top lies on the canvas */
} canvas_point;

/* A straight line, or as much of it as lies on the canvas, over what was there. */
void canvas_line(cli_canvas *canvas, canvas_point from, canvas_point to, unsigned pen);

/* The column or row that a place from 0 to 1 falls into. */
size_t canvas_column(const cli_canvas *canvas, double x);
size_t canvas_row(const cli_canvas *canvas, double y);

#endif
