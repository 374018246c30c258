#include "clients/cli/picture_text.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/axis.h"
#include "clients/cli/canvas.h"
#include "clients/cli/picture_parts.h"
#include "clients/cli/terminal.h"

/* Curve i is drawn with mark i; more curves than these share some. */
static const char marks[] = "*o+x#@%&=$abcdefghijklmnpqrstuvwyzABCDEFGHIJKLMNOPQRSTUVWXYZ";

enum {
  MARKS = sizeof marks - 1,
  LABEL = 10,     /* characters of a value beside the frame */
  FRAME = 3,      /* a blank and its two sides */
  HEADINGS = 5,   /* lines that are no part of the frame's inside, and the prompt below */
  ROWS_LEAST = 8, /* of its inside, */
  COLUMNS_LEAST = 16,
  COLUMNS_PER_TICK = 12,
  ROWS_PER_TICK = 3,
  ZERO_PEN = 1, /* the line at 0 of a deviation; curve i has the pen FIRST_PEN + i */
  FIRST_PEN = 2,
};

typedef struct page {
  FILE *file;
  const cli_picture *picture;
  picture_layout layout;
  bool styled;
  size_t columns; /* of the terminal */
  size_t inside_columns, inside_rows;
} page;

/* ---- colours ------------------------------------------------------------------------------- */

/* "#rrggbb" among a terminal's 6 x 6 x 6 colours; black stays as it is, for the terminal may be. */
static void set_colour(const page *p, const char *colour) {
  const unsigned long rgb = strtoul(colour + 1, NULL, 16);
  const unsigned long red = (rgb >> 16 & 255) * 5 + 127, green = (rgb >> 8 & 255) * 5 + 127,
                      blue = (rgb & 255) * 5 + 127;
  if (p->styled && rgb != 0) {
    fprintf(p->file, "\033[38;5;%lum", 16 + 36 * (red / 255) + 6 * (green / 255) + blue / 255);
  }
}

static void reset(const page *p) {
  if (p->styled) {
    fputs("\033[0m", p->file);
  }
}

static char mark_of(unsigned pen) {
  return pen == 0 ? ' ' : pen == ZERO_PEN ? '.' : marks[(pen - FIRST_PEN) % MARKS];
}

/* A row of cells, those that are drawn alike together. */
static void write_cells(const page *p, size_t panel, const unsigned *pens) {
  for (size_t i = 0, end; i < p->inside_columns; i = end) {
    for (end = i + 1; end < p->inside_columns && pens[end] == pens[i];) {
      end++;
    }
    if (pens[i] >= FIRST_PEN) {
      set_colour(p, picture_curve_of(p->picture->report, panel, pens[i] - FIRST_PEN).colour);
    }
    for (size_t k = i; k < end; k++) {
      fputc(mark_of(pens[k]), p->file);
    }
    if (pens[i] >= FIRST_PEN) {
      reset(p);
    }
  }
}

/* ---- curves -------------------------------------------------------------------------------- */

/* Beyond a linear axis by so many of its lengths a curve looks upright. */
#define FAR 1e6

typedef struct axes {
  cli_axis r, value;
} axes;

static void draw_curve(const page *p, cli_canvas *canvas, const axes *on, size_t row,
                       const picture_curve *curve, unsigned pen) {
  const double *radii = p->picture->report->radii;
  canvas_point before = {0};
  bool is_drawing = false;
  for (size_t i = 0; i < p->picture->report->radius_count; i++) {
    const double shown = picture_shown(p->picture, row, curve, i);
    if (isnan(shown)) {
      is_drawing = false;
      continue;
    }
    const double y = cli_axis_place(&on->value, shown);
    const canvas_point now = {cli_axis_place(&on->r, radii[i]), fmin(fmax(y, -FAR), FAR)};
    canvas_line(canvas, is_drawing ? before : now, now, pen);
    before = now;
    is_drawing = true;
  }
}

/* Those that are named first lie uppermost. */
static void draw_curves(const page *p, cli_canvas *canvas, const axes *on, size_t panel,
                        size_t row) {
  if (p->picture->rows[row].axes.scale == CLI_PERCENT) {
    const double zero = cli_axis_place(&on->value, 0);
    canvas_line(canvas, (canvas_point){0, zero}, (canvas_point){1, zero}, ZERO_PEN);
  }
  for (size_t index = p->layout.curves; index-- > 0;) {
    const picture_curve curve = picture_curve_of(p->picture->report, panel, index);
    draw_curve(p, canvas, on, row, &curve, FIRST_PEN + (unsigned)index);
  }
}

/* ---- the frame ----------------------------------------------------------------------------- */

static void write_title(const page *p, size_t panel, size_t row) {
  char label[PICTURE_TEXT_BYTES], title[PICTURE_TEXT_BYTES], text[3 * PICTURE_TEXT_BYTES];
  const char *medium = p->picture->report->medium;
  picture_panel_title(p->picture, panel, title);
  picture_value_label(p->picture, row, label);
  snprintf(text, sizeof text, "%.*s%s%s%s%s", PICTURE_TEXT_BYTES, medium != NULL ? medium : "",
           medium != NULL && title[0] != '\0' ? ", " : "", title,
           medium != NULL || title[0] != '\0' ? ": " : "", label);
  fprintf(p->file, "%.*s\n", (int)p->columns, text);
}

static void write_rows(const page *p, size_t panel, const cli_canvas *canvas,
                       const cli_axis *value) {
  double ticks[CLI_AXIS_TICKS_MAX];
  size_t most = p->inside_rows / ROWS_PER_TICK;
  most = most < CLI_AXIS_TICKS_MAX ? most : CLI_AXIS_TICKS_MAX;
  const size_t count = cli_axis_ticks(value, most, ticks);
  for (size_t row = 0; row < canvas->rows; row++) {
    char label[32] = "";
    for (size_t i = 0; i < count; i++) {
      if (canvas_row(canvas, cli_axis_place(value, ticks[i])) == row) {
        snprintf(label, sizeof label, "%.4g", ticks[i]);
      }
    }
    fprintf(p->file, "%*.*s %c", LABEL, LABEL, label, label[0] != '\0' ? '+' : '|');
    write_cells(p, panel, canvas->pens + row * canvas->columns);
    fputs("|\n", p->file);
  }
}

/* The lower side of the frame, the radii at its ticks, and what they are. */
static void write_bottom(const page *p, const cli_canvas *canvas, const cli_axis *r) {
  double ticks[CLI_AXIS_TICKS_MAX];
  char *line = cli_allocate(canvas->columns + 1, 1);
  char *labels = cli_allocate(p->columns + 1, 1);
  size_t most = p->inside_columns / COLUMNS_PER_TICK, free_from = 0;
  most = most < 2 ? 2 : most < CLI_AXIS_TICKS_MAX ? most : CLI_AXIS_TICKS_MAX;
  const size_t count = cli_axis_ticks(r, most, ticks);
  memset(line, '-', canvas->columns);
  memset(labels, ' ', p->columns);
  for (size_t i = 0; i < count; i++) {
    char label[32];
    const size_t column = canvas_column(canvas, fmin(fmax(cli_axis_place(r, ticks[i]), 0), 1));
    const size_t length = (size_t)snprintf(label, sizeof label, "%.4g", ticks[i]);
    size_t at = LABEL + 2 + column - length / 2;
    at = at + length > p->columns ? p->columns - length : at;
    line[column] = '+';
    if (at >= free_from) {
      memcpy(labels + at, label, length);
      free_from = at + length + 1;
    }
  }
  for (size_t end = p->columns; end > 0 && labels[end - 1] == ' ';) {
    labels[--end] = '\0';
  }
  fprintf(p->file, "%*s +%s+\n%s\n", LABEL, "", line, labels);
  fprintf(p->file, "%*sr (mm)\n", (int)(LABEL + 2 + canvas->columns / 2 - 3), "");
  free(labels);
  free(line);
}

static void write_panel(const page *p, size_t panel, size_t row) {
  const cli_axes *kind = &p->picture->rows[row].axes;
  picture_range r, value;
  if (!picture_ranges(p->picture, row, &r, &value)) {
    return;
  }
  const axes on = {{r.low, r.high, kind->logarithmic_r},
                   {value.low, value.high, kind->scale == CLI_LOGARITHMIC}};
  cli_canvas canvas = canvas_make(p->inside_columns, p->inside_rows);
  draw_curves(p, &canvas, &on, panel, row);
  write_title(p, panel, row);
  write_rows(p, panel, &canvas, &on.value);
  write_bottom(p, &canvas, &on.r);
  canvas_free(&canvas);
}

/* ---- the legend ---------------------------------------------------------------------------- */

enum { LEGEND_GAP = 5 }; /* around a mark, its title and the next mark */

static size_t title_width(const page *p) {
  size_t longest = 0;
  for (size_t i = 0; i < p->layout.curves; i++) {
    const size_t length = strlen(picture_curve_of(p->picture->report, 0, i).title);
    longest = length > longest ? length : longest;
  }
  return longest;
}

static size_t legend_columns(const page *p) {
  const size_t fit = p->columns / (title_width(p) + LEGEND_GAP);
  return fit > 0 ? fit : 1;
}

static void write_legend(const page *p) {
  const size_t columns = legend_columns(p), width = title_width(p);
  for (size_t i = 0; i < p->layout.curves; i++) {
    const picture_curve curve = picture_curve_of(p->picture->report, 0, i);
    const bool last = (i + 1) % columns == 0 || i + 1 == p->layout.curves;
    fputs("  ", p->file);
    set_colour(p, curve.colour);
    fputc(mark_of(FIRST_PEN + (unsigned)i), p->file);
    reset(p);
    fprintf(p->file, " %-*s%s", last ? 0 : (int)width, curve.title, last ? "\n" : " ");
  }
}

void picture_write_text(const cli_picture *picture, FILE *file) {
  const cli_terminal terminal = cli_terminal_look();
  page p = {.file = file,
            .picture = picture,
            .layout = picture_layout_of(picture->report),
            .styled = terminal.styled};
  const size_t least = LABEL + FRAME + COLUMNS_LEAST;
  p.columns = terminal.columns > least ? terminal.columns : least;
  p.inside_columns = p.columns - LABEL - FRAME;
  const size_t around = HEADINGS + (p.layout.curves - 1) / legend_columns(&p) + 1;
  p.inside_rows = terminal.rows > around + ROWS_LEAST ? terminal.rows - around : ROWS_LEAST;
  for (size_t panel = 0; panel < p.layout.panels; panel++) {
    for (size_t row = 0; row < picture->row_count; row++) {
      write_panel(&p, panel, row);
    }
  }
  write_legend(&p);
}
