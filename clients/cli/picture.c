#include "clients/cli/picture.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/gnuplot.h"

/* ---- curves ---------------------------------------------------------------------------------- */

const char *const cli_palette[CLI_PALETTE] = {"#0072b2", "#d55e00", "#009e73", "#cc79a7",
                                              "#e69f00", "#56b4e9", "#7f7f7f", "#8c564b"};

cli_curve *cli_picture_add(cli_picture *picture) {
  picture->curves = cli_resize(picture->curves, picture->curve_count + 1, sizeof(cli_curve));
  cli_curve *curve = &picture->curves[picture->curve_count++];
  *curve = (cli_curve){0};
  return curve;
}

/* Returns what the axis shows of a value; NaN if it cannot show it. */
static double shown(const cli_row *row, double x, double y) {
  const enum cli_scale scale = row->axes.scale;
  if (!isfinite(x) || !isfinite(y) || (row->axes.logarithmic_x && x <= 0) ||
      (scale == CLI_LOGARITHMIC && y <= 0) || (scale == CLI_GAMMA && y < 0)) {
    return (double)NAN;
  }
  return scale == CLI_GAMMA ? pow(y, 1 / row->gamma) : scale == CLI_PERCENT ? 100 * y : y;
}

/* Returns the error of what the axis shows of y, by its derivative. */
static double shown_error(const cli_row *row, double y, double error) {
  const double power = 1 / row->gamma;
  return row->axes.scale == CLI_GAMMA     ? error * power * pow(y, power - 1)
         : row->axes.scale == CLI_PERCENT ? 100 * error
                                          : error;
}

/* ---- what lies beyond an axis ---------------------------------------------------------------- */

/* A deviation by more than this, in percent. */
#define PERCENT_MAX 200.0

/* Values on a logarithmic axis that are less than this share of the largest. Some models fall off so
 * fast that an axis with all of their values would show little of the others. */
#define LEAST_SHARE 1e-12

/* Near 0 some quantities rise without bound. So a linear axis leaves out a peak in the first
 * PEAK_SHARE of the places that is more than PEAK_RATIO times as high as the rest. */
#define PEAK_SHARE 0.02
#define PEAK_RATIO 4.0

#define ROOM 1.1 /* the axis ends so much above what it shows */

/* Finds the limits of what a panel shows. Returns false if it shows nothing. */
static bool find_limits(const cli_picture *picture, size_t at, size_t column, double *low,
                        double *high) {
  const cli_row *row = &picture->rows[at];
  const bool logarithmic = row->axes.scale == CLI_LOGARITHMIC;
  double first = (double)INFINITY, last = -(double)INFINITY, whole = 0, most = 0;
  for (int pass = 0; pass < 2; pass++) {
    const double from = first + PEAK_SHARE * (last - first);
    for (size_t c = 0; c < picture->curve_count; c++) {
      const cli_curve *curve = &picture->curves[c];
      for (size_t i = 0; curve->row == at && curve->column == column && i < curve->count; i++) {
        const double x = curve->x[i], y = shown(row, x, curve->y[i]);
        first = isnan(y) ? first : fmin(first, x);
        last = isnan(y) ? last : fmax(last, x);
        whole = isnan(y) ? whole : fmax(whole, fabs(y));
        most = pass == 0 || isnan(y) || x < from ? most : fmax(most, fabs(y));
      }
    }
  }
  *high = row->axes.scale == CLI_PERCENT              ? PERCENT_MAX
          : logarithmic || whole <= PEAK_RATIO * most ? ROOM * whole
                                                      : ROOM * most;
  *low = logarithmic ? LEAST_SHARE * whole : -*high;
  return first <= last;
}

/* ---- the script ------------------------------------------------------------------------------ */

static bool is_terminal(const char *path) {
  return strcmp(path, CLI_PICTURE_TERMINAL) == 0;
}

/* Writes "set WHAT 'text'". */
static void write_set(FILE *script, const char *what, const char *text) {
  fprintf(script, "set %s ", what);
  cli_gnuplot_quote(script, text);
  fputc('\n', script);
}

/* Writes a block of data for each curve: places, what is shown there, and its errors. */
static void write_data(FILE *script, const cli_picture *picture) {
  for (size_t c = 0; c < picture->curve_count; c++) {
    const cli_curve *curve = &picture->curves[c];
    const cli_row *row = &picture->rows[curve->row];
    fprintf(script, "$curve%zu << END\n", c);
    for (size_t i = 0; i < curve->count; i++) {
      const double y = shown(row, curve->x[i], curve->y[i]);
      if (!isnan(y)) {
        const double error =
            curve->error != NULL ? shown_error(row, curve->y[i], curve->error[i]) : 0;
        fprintf(script, isfinite(error) ? "%.17g %.17g %.17g\n" : "%.17g %.17g NaN\n", curve->x[i],
                y, error);
      } else if (curve->style == CLI_LINE) {
        fputs("NaN NaN NaN\n", script); /* a gap */
      }
    }
    fputs("NaN NaN NaN\nEND\n", script); /* gnuplot wants one point at least */
  }
}

/* Curve i is drawn in text with mark i. If there are more than marks, some share a mark. */
static const char marks[] = "*o+x#@%&=$abcdefghijklmnpqrstuvwyzABCDEFGHIJKLMNOPQRSTUVWXYZ";

static void write_curve(FILE *script, const cli_curve *curve, size_t number, bool text) {
  static const char *const styles[][2] = {
      [CLI_LINE] = {"1:2", "lines lw 2"},
      [CLI_FITTED] = {"1:2 smooth unique", "lines lw 1.5"},
      [CLI_POINTS] = {"1:2", "points pt 7 ps 0.6"},
      [CLI_ERRORS] = {"1:2:3", "yerrorbars pt 7 ps 0.5"},
  };
  const enum cli_style style = curve->style;
  const bool dot = style == CLI_LINE && curve->count == 1;
  fprintf(script, "$curve%zu using ", number);
  fputs(text && style == CLI_ERRORS ? "1:2" : styles[style][0], script);
  if (!text) {
    fprintf(script, " with %s dt %zu", styles[dot ? CLI_POINTS : style][1], 1 + curve->dash);
  } else if (style == CLI_FITTED) {
    fputs(" with lines lt 0", script);
  } else {
    fprintf(script, " with %s pt '%c'", style == CLI_LINE ? "linespoints lt 0" : "points",
            marks[curve->mark % (sizeof marks - 1)]);
  }
  fprintf(script, " lc rgb '%s' title ", curve->colour);
  cli_gnuplot_quote(script, curve->title);
}

/* Returns whether the panel shows anything. */
static bool write_panel(FILE *script, const cli_picture *picture, size_t column, size_t at,
                        bool text) {
  const cli_row *row = &picture->rows[at];
  const bool logarithmic = row->axes.scale == CLI_LOGARITHMIC;
  const char *column_title = picture->columns != NULL ? picture->columns[column] : "";
  char title[3 * CLI_LABEL_BYTES + 8];
  double low, high;
  const bool shows = find_limits(picture, at, column, &low, &high);
  if (text && !shows) {
    return false; /* of points alone, gnuplot cannot draw an empty text */
  }
  snprintf(title, sizeof title, "%s%s%s: %s", picture->title, column_title[0] != '\0' ? ", " : "",
           column_title, row->label);
  write_set(script, "title", text ? title : column_title);
  write_set(script, "ylabel", text ? "" : row->label);
  fprintf(script, "unset logscale\n%s%s", row->axes.logarithmic_x ? "set logscale x\n" : "",
          logarithmic ? "set logscale y\n" : "");
  fprintf(script, "set format y '%s'\n", logarithmic ? "%.0e" : "%g");
  if (shows) {
    fprintf(script, "set xrange [*:*] noextend\nset yrange [%.9g<*:*<%.9g]\n", low, high);
  } else {
    fputs("set xrange [1:2]\nset yrange [1:2]\n", script);
  }
  const char *before = "plot ";
  for (size_t c = 0; c < picture->curve_count; c++) {
    if (picture->curves[c].row == at && picture->curves[c].column == column) {
      fputs(before, script);
      write_curve(script, &picture->curves[c], c, text);
      before = ", ";
    }
  }
  fputs(text ? "\n" : "\nunset key\nunset label\n", script); /* once in a file */
  return shows;
}

/* The points at the ends lie within the frame. */
#define COMMON "set offsets graph 0.02, graph 0.02, 0, 0\nset xzeroaxis "

/* Sizes in pixels. */
enum {
  COLUMNS_MAX = 3,
  WIDE = 580, /* width of a panel that is alone in its row, with the gap beside it */
  NARROW = 400,
  HEIGHT = 480,
  HEIGHT_OF_SEVERAL = 380, /* where there is more than one row of panels */
  GAP_X = 84,
  GAP_Y = 84,
  LEFT = 90,
  TOP = 64,
  BOTTOM = 60,
  LEGEND_LINE = 20,
  LEGEND_CHARACTER = 8,
  LEGEND_SAMPLE = 70, /* width of the sample line in the legend, with the room around it */
  CAPTION_LINE = 15,
};

static size_t count_lines(const char *text, size_t columns) {
  size_t count = 0;
  for (const char *end; text != NULL && (end = strchr(text, '\n')) != NULL; text = end + 1) {
    count += (size_t)(end - text + (end == text)) / columns + 1;
  }
  return count;
}

/* Writes lines as one text. */
static void write_lines(FILE *script, const char *lines) {
  char *copy = cli_allocate(strlen(lines) + 1, 1), *rest = copy;
  memcpy(copy, lines, strlen(lines));
  for (const char *line; (line = strsep(&rest, "\n")) != NULL;) {
    cli_gnuplot_quote(script, line);
    fputs(rest != NULL ? " . \"\\n\" . " : "", script);
  }
  free(copy);
}

/* Writes what stands before the panels of a file: its size, and how they are laid out. The columns
 * of panels are cut into blocks below each other, of COLUMNS_MAX panels side by side. One legend
 * is to the right of all panels, and the caption below them. */
static void write_layout(FILE *script, const cli_picture *picture, const char *path) {
  const size_t columns = picture->column_count < COLUMNS_MAX ? picture->column_count : COLUMNS_MAX;
  const size_t rows = picture->row_count * ((picture->column_count + columns - 1) / columns);
  size_t longest = 0, titles = 0;
  for (size_t c = 0; c < picture->curve_count; c++) {
    const cli_curve *curve = &picture->curves[c];
    if (curve->row == 0 && curve->column == 0 && curve->title[0] != '\0') {
      titles++;
      longest = strlen(curve->title) > longest ? strlen(curve->title) : longest;
    }
  }
  const double legend_width = LEGEND_SAMPLE + LEGEND_CHARACTER * (double)longest;
  const double legend_height = LEGEND_LINE * (double)(titles + 1);
  const double bottom =
      BOTTOM + CAPTION_LINE * (double)(count_lines(picture->caption, SIZE_MAX) + 1);
  const double panels = (double)rows * ((rows > 1 ? HEIGHT_OF_SEVERAL : HEIGHT) + GAP_Y) - GAP_Y;
  double width = LEFT + (double)columns * (columns > 1 ? NARROW : WIDE) + legend_width;
  double height = TOP + panels + bottom;
  if (picture->width_px > 0) {
    width = (double)picture->width_px;
    height = (double)picture->height_px;
  }
  const double panel_height = (height - TOP - bottom + GAP_Y) / (double)rows - GAP_Y;
  const bool png = strcmp(path + strlen(path) - 4, ".png") == 0;
  fprintf(script,
          "set terminal %s size %.0f,%.0f background rgb 'white' font 'sans,%d' noenhanced\n",
          png ? "pngcairo" : "svg dynamic", width, height, png ? 11 : 14);
  write_set(script,
            "encoding utf8\n" COMMON "lt 1 lc rgb 'black'\nset grid\nset xlabel offset 0,0.5",
            picture->x_label);
  fprintf(script,
          "set key at screen %.5f,%.5f top right vertical maxcols 1 Left reverse spacing %.3f\n",
          1 - 8 / width, 1 - TOP / height, fmin(panel_height / legend_height, 1));
  if (picture->caption != NULL) {
    fputs("set label ", script);
    write_lines(script, picture->caption);
    fprintf(script, " at screen %.5f,%.5f left noenhanced font ',9'\n", 8 / width,
            (bottom - BOTTOM) / height);
  }
  fprintf(script,
          "set multiplot layout %zu,%zu columnsfirst margins %.5f,%.5f,%.5f,%.5f spacing %.5f,%.5f "
          "title ",
          rows, columns, LEFT / width, 1 - (legend_width + GAP_X) / width, bottom / height,
          1 - TOP / height, GAP_X / width, GAP_Y / height);
  cli_gnuplot_quote(script, picture->title);
  fputc('\n', script);
}

enum { TEXT_COLUMNS_LEAST = 32, TEXT_ROWS_LEAST = 13 };

/* Writes what stands before the panels of a text, which are below each other, each as large as the
 * terminal but for the caption, an empty line and the prompt. */
static void write_text_layout(FILE *script, const cli_picture *picture) {
  const cli_terminal terminal = cli_terminal_look();
  const size_t columns =
      terminal.columns > TEXT_COLUMNS_LEAST ? terminal.columns : TEXT_COLUMNS_LEAST;
  const size_t others = 2 + count_lines(picture->caption, columns);
  const bool fits = terminal.rows >= others + TEXT_ROWS_LEAST;
  fprintf(script, "set terminal dumb nofeed size %zu,%zu %s noenhanced\n", columns,
          fits ? terminal.rows - others : TEXT_ROWS_LEAST, terminal.styled ? "ansi256" : "mono");
  write_set(script,
            "encoding utf8\n" COMMON "lt 0\nset tmargin 1\nset key below Left reverse\nset xlabel",
            picture->x_label);
}

/* ---- drawing --------------------------------------------------------------------------------- */

int cli_picture_check(const cli_texts *paths, const cli_common *common) {
  for (size_t i = 0; i < paths->count; i++) {
    const char *path = paths->items[i];
    const size_t length = strlen(path);
    if (is_terminal(path) && common->form >= CLI_CSV) {
      return cli_fail_usage("--plot - draws onto standard output, where the %s goes: name a file, "
                            "or leave --format out",
                            common->format);
    }
    if (!is_terminal(path) && (length < 5 || (strcmp(path + length - 4, ".svg") != 0 &&
                                              strcmp(path + length - 4, ".png") != 0))) {
      return cli_fail_usage("--plot %s: the name must end in .svg or .png; - is the terminal",
                            path);
    }
  }
  return CLI_OK;
}

static int draw(const cli_picture *picture, const char *path) {
  const bool text = is_terminal(path);
  const cli_row *first = &picture->rows[0];
  bool shows = false;
  FILE *script = tmpfile();
  if (script == NULL) {
    return cli_fail("--plot %s: cannot make a temporary file: %s", path, strerror(errno));
  }
  if (text) {
    write_text_layout(script, picture);
  } else {
    write_layout(script, picture, path);
  }
  write_data(script, picture);
  for (size_t column = 0; column < picture->column_count; column++) {
    for (size_t row = 0; row < picture->row_count; row++) {
      shows = write_panel(script, picture, column, row, text) || shows;
    }
  }
  fputs(text ? "" : "unset multiplot\n", script);
  const int status =
      shows ? cli_gnuplot(script, path)
            : cli_fail("--plot %s: %s is 0, negative or infinite everywhere, which these axes do "
                       "not show: try other radii%s",
                       path, first->label,
                       first->axes.scale == CLI_LOGARITHMIC ? ", or `dipole plot --axes linear`"
                                                            : "");
  fclose(script);
  if (status == CLI_OK && text && picture->caption != NULL) {
    printf("%s%s", cli_terminal_look().styled ? "" : "\n", picture->caption);
  }
  return status;
}

int cli_picture_draw(cli_picture *picture, const cli_texts *paths) {
  int status = CLI_OK;
  for (size_t i = 0; status == CLI_OK && i < paths->count; i++) {
    status = draw(picture, paths->items[i]);
    if (status == CLI_OK && strcmp(paths->items[i], cli_running()->usual_file) == 0) {
      cli_say(CLI_OK, "the picture is %s", paths->items[i]);
    }
  }
  free(picture->curves);
  free(picture->columns);
  free(picture->caption);
  return status;
}
