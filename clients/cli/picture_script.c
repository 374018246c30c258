#include "clients/cli/picture_script.h"

#include <math.h>
#include <string.h>

#include "clients/cli/gnuplot.h"
#include "clients/cli/picture_parts.h"

/* ---- where panels stand -------------------------------------------------------------------- */

enum {
  COLUMNS_MAX = 3,
  WIDE = 580, /* a panel that has its rows to itself, and the gap beside it */
  NARROW = 400,
  HEIGHT = 480,
  LOW_HEIGHT = 220, /* of a deviation, which is read less closely */
  GAP_X = 60,
  GAP_Y = 56,
  LEFT = 90,
  TOP = 64,
  BOTTOM = 60,
  LEGEND_LINE = 20,
  LEGEND_CHARACTER = 8,
  LEGEND_SAMPLE = 70, /* the piece of a line, and the room around it */
};

/* In pixels. Rows of the picture repeat for each block of channels. */
typedef struct grid {
  picture_layout layout;
  size_t columns, blocks;
  double width, height, legend_width, legend_height;
  double stretch; /* of the panels' heights */
} grid;

static double height_of(const cli_picture *picture, size_t row) {
  return picture->rows[row].axes.scale == CLI_PERCENT ? LOW_HEIGHT : HEIGHT;
}

static double legend_width(const cli_picture *picture, const picture_layout *layout) {
  size_t longest = 0;
  for (size_t i = 0; i < layout->curves; i++) {
    const picture_curve curve = picture_curve_of(picture->report, 0, i);
    longest = strlen(curve.title) > longest ? strlen(curve.title) : longest;
  }
  return LEGEND_SAMPLE + LEGEND_CHARACTER * (double)longest;
}

static grid make_grid(const cli_picture *picture) {
  grid g = {.layout = picture_layout_of(picture->report)};
  double heights = 0;
  g.columns = g.layout.panels < COLUMNS_MAX ? g.layout.panels : COLUMNS_MAX;
  g.blocks = (g.layout.panels + g.columns - 1) / g.columns;
  for (size_t row = 0; row < picture->row_count; row++) {
    heights += height_of(picture, row) * (double)g.blocks;
  }
  const double gaps = GAP_Y * ((double)(picture->row_count * g.blocks) - 1);
  g.legend_width = legend_width(picture, &g.layout);
  g.legend_height = LEGEND_LINE * (double)(g.layout.curves + 1);
  g.width = LEFT + (double)g.columns * (g.columns > 1 ? NARROW : WIDE) + g.legend_width;
  g.height = fmax(TOP + BOTTOM + gaps + heights, TOP + g.legend_height);
  if (picture->width_px > 0) {
    g.width = (double)picture->width_px;
    g.height = (double)picture->height_px;
  }
  g.stretch = (g.height - TOP - BOTTOM - gaps) / heights;
  return g;
}

/* Margins of the panel in a row of a block, and a column. */
static void write_place(FILE *script, const cli_picture *picture, const grid *g, size_t block,
                        size_t row, size_t column) {
  const double pitch = (g->width - LEFT - g->legend_width) / (double)g->columns;
  const double left = LEFT + pitch * (double)column;
  double top = TOP;
  for (size_t i = 0; i < block * picture->row_count + row; i++) {
    top += height_of(picture, i % picture->row_count) * g->stretch + GAP_Y;
  }
  const double bottom = top + height_of(picture, row) * g->stretch;
  fprintf(script,
          "set lmargin at screen %.5f\nset rmargin at screen %.5f\n"
          "set tmargin at screen %.5f\nset bmargin at screen %.5f\n",
          left / g->width, (left + pitch - GAP_X) / g->width, 1 - top / g->height,
          1 - bottom / g->height);
}

/* ---- the script ---------------------------------------------------------------------------- */

/* "set WHAT 'text'" */
static void write_set(FILE *script, const char *what, const char *text) {
  fprintf(script, "set %s ", what);
  cli_gnuplot_quote(script, text);
  fputc('\n', script);
}

/* The points of a curve as a named block: the radius, and a column for each row of the picture. */
static void write_data(FILE *script, const cli_picture *picture, size_t panel, size_t index) {
  const picture_curve curve = picture_curve_of(picture->report, panel, index);
  fprintf(script, "$curve%zu_%zu << END\n", panel, index);
  for (size_t i = 0; i < picture->report->radius_count; i++) {
    const double r_mm = picture->report->radii[i];
    fprintf(script, isfinite(r_mm) ? "%.17g" : "NaN", r_mm);
    for (size_t row = 0; row < picture->row_count; row++) {
      const double shown = picture_shown(picture, row, &curve, i);
      fprintf(script, isfinite(shown) ? " %.17g" : " NaN", shown);
    }
    fputc('\n', script);
  }
  fputs("END\n", script);
}

/* A line or, for a single radius, its point. */
static void write_curve(FILE *script, const cli_picture *picture, size_t panel, size_t index,
                        size_t row) {
  const picture_curve curve = picture_curve_of(picture->report, panel, index);
  const bool line = picture->report->radius_count > 1;
  fprintf(script, "%s$curve%zu_%zu using 1:%zu with %s %zu lw 2 lc rgb '%s' title ",
          index > 0 ? ", " : "plot ", panel, index, 2 + row, line ? "lines dt" : "points pt",
          curve.dash, curve.colour);
  cli_gnuplot_quote(script, curve.title);
}

static void write_axes(FILE *script, const cli_axes *axes, picture_range r, picture_range value) {
  fputs("unset logscale\nunset xzeroaxis\n", script);
  if (axes->logarithmic_r) {
    fputs("set logscale x\n", script);
  }
  if (axes->scale == CLI_LOGARITHMIC) {
    fputs("set logscale y\n", script);
  }
  if (value.low < 0 && value.high > 0) {
    fputs("set xzeroaxis lt 1 lc rgb 'black'\n", script);
  }
  fprintf(script, "set format y '%s'\nset xrange [%.17g:%.17g]\nset yrange [%.17g:%.17g]\n",
          axes->scale == CLI_LOGARITHMIC ? "%.0e" : "%g", r.low, r.high, value.low, value.high);
}

/* r is named where no panel with the same radii stands below. */
static bool is_r_named(const cli_picture *picture, const grid *g, size_t panel, size_t row) {
  if (row + 1 < picture->row_count) {
    return picture->rows[row].axes.logarithmic_r != picture->rows[row + 1].axes.logarithmic_r;
  }
  return panel + g->columns >= g->layout.panels;
}

/* One legend for all panels, beside them. */
static void write_legend(FILE *script, const grid *g, bool first) {
  const double room = (g->height - TOP) / g->legend_height;
  if (first) {
    fprintf(script,
            "set key at screen %.5f,%.5f top right vertical maxcols 1 Left reverse spacing %.3f\n",
            1 - 8 / g->width, 1 - TOP / g->height, fmin(room, 1));
  } else {
    fputs("unset key\n", script);
  }
}

static void write_panel(FILE *script, const cli_picture *picture, const grid *g, size_t panel,
                        size_t row) {
  char text[PICTURE_TEXT_BYTES];
  picture_range r, value;
  write_place(script, picture, g, panel / g->columns, row, panel % g->columns);
  write_set(script, "title", row == 0 ? picture_panel_title(picture, panel, text) : "");
  write_set(script, "xlabel", is_r_named(picture, g, panel, row) ? "r (mm)" : "");
  write_set(script, "ylabel",
            panel % g->columns == 0 ? picture_value_label(picture, row, text) : "");
  write_legend(script, g, panel == 0 && row == 0);
  if (picture_ranges(picture, row, &r, &value)) {
    write_axes(script, &picture->rows[row].axes, r, value);
  }
  for (size_t index = 0; index < g->layout.curves; index++) {
    write_curve(script, picture, panel, index, row);
  }
  fputc('\n', script);
}

void picture_size(const cli_picture *picture, size_t *width, size_t *height) {
  const grid g = make_grid(picture);
  *width = (size_t)g.width;
  *height = (size_t)g.height;
}

void picture_write_script(FILE *script, const void *context) {
  const cli_picture *picture = context;
  char text[PICTURE_TEXT_BYTES];
  const grid g = make_grid(picture);
  fputs("set grid\n", script);
  for (size_t panel = 0; panel < g.layout.panels; panel++) {
    for (size_t index = 0; index < g.layout.curves; index++) {
      write_data(script, picture, panel, index);
    }
  }
  write_set(script, "multiplot title", picture_title(picture, text));
  for (size_t panel = 0; panel < g.layout.panels; panel++) {
    for (size_t row = 0; row < picture->row_count; row++) {
      write_panel(script, picture, &g, panel, row);
    }
  }
  fputs("unset multiplot\n", script);
}
