#include "clients/cli/picture.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/gnuplot.h"

enum { TEXT_BYTES = 160, CAPTION_BYTES = 200 };

static const cli_axes axes_kinds[] = {
    {"linear", false, CLI_LINEAR},
    {"semilog", false, CLI_LOGARITHMIC},
    {"logarithmic", true, CLI_LOGARITHMIC},
    {"gamma", false, CLI_GAMMA},
    {0},
};

const cli_axes *cli_axes_find(const char *name) {
  for (const cli_axes *axes = axes_kinds; axes->name != NULL; axes++) {
    if (strcmp(axes->name, name) == 0) {
      return axes;
    }
  }
  return NULL;
}

/* ---- curves ---------------------------------------------------------------------------------- */

static const char *const palette[] = {"#000000", "#e69f00", "#56b4e9", "#009e73",
                                      "#cc79a7", "#d55e00", "#0072b2", "#999999"};

enum { PALETTE = sizeof palette / sizeof palette[0], FEW_MODELS = 4, FEW_CHANNELS = PALETTE };

/* With few models and channels, one panel has all curves: each model has a dash and each channel
 * has a colour. With many of either, or with one channel, each channel has a panel and each model
 * has a colour. */
typedef struct layout {
  bool by_channel;
  size_t panels; /* side by side */
  size_t curves; /* in each of them */
} layout;

static layout layout_of(const cli_eval_report *report) {
  const size_t models = report->model_count, channels = report->profile.channel_count;
  if (models > FEW_MODELS || channels > FEW_CHANNELS || channels == 1) {
    return (layout){.by_channel = true, .panels = channels, .curves = models};
  }
  return (layout){.panels = 1, .curves = models * channels};
}

void cli_channel_title(const cli_profile *profile, size_t channel, char *text, size_t bytes) {
  snprintf(text, bytes, "%s%s", profile->medium != NULL ? "" : "channel ",
           profile->channels[channel].name);
}

const char *cli_channel_colour(const cli_profile *profile, size_t channel) {
  static const char *const rgb[CLI_COLOURS] = {"#d62728", "#2ca02c", "#1f4fd8"};
  const size_t colour = cli_colour(profile->channels[channel].name);
  if (colour < CLI_COLOURS) {
    return rgb[colour];
  }
  return profile->channel_count == CLI_COLOURS ? rgb[channel] : palette[channel % PALETTE];
}

typedef struct curve {
  size_t model, channel;
  size_t dash;            /* gnuplot's number of it; 1 is a solid line */
  const char *colour;     /* "#rrggbb" */
  char title[TEXT_BYTES]; /* names the channel, too, unless each channel has a panel */
} curve;

static curve curve_of(const cli_eval_report *report, size_t panel, size_t index) {
  char channel[TEXT_BYTES];
  curve one = {.model = index, .channel = panel};
  if (layout_of(report).by_channel) {
    one.dash = 1 + index / PALETTE;
    one.colour = palette[index % PALETTE];
    snprintf(one.title, sizeof one.title, "%s", report->models[index].choice->name);
    return one;
  }
  one.model = index / report->profile.channel_count;
  one.channel = index % report->profile.channel_count;
  one.dash = 1 + one.model;
  one.colour = cli_channel_colour(&report->profile, one.channel);
  cli_channel_title(&report->profile, one.channel, channel, sizeof channel);
  snprintf(one.title, sizeof one.title, "%.64s, %.64s", report->models[one.model].choice->name,
           channel);
  return one;
}

/* Returns the value that the axis shows at a radius, deviations in percent. Returns NaN if the axis
 * cannot show it. */
static double shown_at(const cli_picture *picture, size_t row, const curve *of, size_t radius) {
  const cli_eval_report *report = picture->report;
  const cli_axes *axes = &picture->rows[row].axes;
  const cli_eval_values *values = cli_eval_values_of(report, of->model, of->channel);
  const double r_mm = report->radii[radius];
  const double value = values->arrays[picture->rows[row].quantity][radius];
  if (!isfinite(r_mm) || !isfinite(value) || (axes->logarithmic_r && r_mm <= 0) ||
      (axes->scale == CLI_LOGARITHMIC && value <= 0)) {
    return (double)NAN;
  }
  return axes->scale == CLI_PERCENT ? 100 * value : value;
}

/* Returns the standard error of the value that the axis shows, by the derivative of what is shown;
 * NaN if there is none. */
static double shown_error_at(const cli_picture *picture, size_t row, const curve *of,
                             size_t radius) {
  const cli_eval_values *values = cli_eval_values_of(picture->report, of->model, of->channel);
  const double relative =
      values->arrays[picture->error_quantity][radius] / values->arrays[0][radius];
  const double shown = shown_at(picture, row, of, radius);
  switch (picture->rows[row].axes.scale) {
  case CLI_PERCENT: /* 100 (R / reference - 1) */
    return relative * (100 + shown);
  case CLI_GAMMA: /* R to a power, which is the ratio of the logarithms' derivatives */
    return relative * shown * log(shown) / log(values->arrays[0][radius]);
  default:
    return relative * shown;
  }
}

/* ---- ranges, which all panels of a row share ------------------------------------------------- */

/* The ends of an axis, or the extent of curves. If low > high, the extent is empty. */
typedef struct range {
  double low, high;
} range;

static const range nothing = {(double)INFINITY, -(double)INFINITY};

static void widen(range *all, double low, double high) {
  all->low = fmin(all->low, low);
  all->high = fmax(all->high, high);
}

/* Finds the extent of each curve of a row at radii from r_mm on, of all of them together, and of
 * the radii at which they have values. Leaves out curves without values. Returns how many are left.
 */
static size_t extents_from(const cli_picture *picture, size_t row, double r_mm, range *each,
                           range *all, range *radii) {
  const layout places = layout_of(picture->report);
  size_t count = 0;
  *all = *radii = nothing;
  for (size_t c = 0; c < places.panels * places.curves; c++) {
    const curve one = curve_of(picture->report, c / places.curves, c % places.curves);
    range extent = nothing;
    for (size_t i = 0; i < picture->report->radius_count; i++) {
      const double shown = shown_at(picture, row, &one, i), at_mm = picture->report->radii[i];
      if (!isnan(shown) && at_mm >= r_mm) {
        widen(&extent, shown, shown);
        widen(radii, at_mm, at_mm);
      }
    }
    if (extent.low <= extent.high) {
      each[count++] = extent;
      widen(all, extent.low, extent.high);
    }
  }
  return count;
}

/* If less than this share of an axis lies before its first radius, the axis starts at 0. */
#define TO_ZERO_SHARE 0.1

static range r_range(range extent_mm, bool logarithmic) {
  range ends = extent_mm;
  if (!logarithmic && ends.low < TO_ZERO_SHARE * ends.high) {
    ends.low = 0;
  }
  if (ends.low < ends.high) {
    return ends;
  }
  /* A single radius. */
  if (logarithmic) {
    return (range){ends.low / 2, ends.high * 2};
  }
  return (range){0, ends.high > 0 ? 2 * ends.high : 1};
}

static int compare(const void *a, const void *b) {
  const double x = ((const range *)a)->low, y = ((const range *)b)->low;
  return (x > y) - (x < y);
}

/* A logarithmic axis ends at most so many decades below the least value of the middle curve. Some
 * models fall off so fast that an axis with all of their values would show little of the others. */
enum { TAIL_DECADES = 4 };

static range logarithmic_range(range *extents, size_t count, double most) {
  qsort(extents, count, sizeof *extents, compare);
  const double tail =
      fmax(floor(log10(extents[0].low)), floor(log10(extents[count / 2].low)) - TAIL_DECADES);
  const double low = fmax(tail, DBL_MIN_10_EXP);
  const double high = fmin(fmax(ceil(log10(most)), low + 1), DBL_MAX_10_EXP);
  return (range){pow(10, low), pow(10, high)};
}

/* A deviation by more than this, in percent, is beyond the axis. */
#define PERCENT_MAX 200.0

/* An axis extends beyond its curves by this share of their extent. */
#define ROOM 0.05

static range linear_range(range all, enum cli_scale scale) {
  if (scale == CLI_PERCENT) {
    all.low = fmin(fmax(all.low, -PERCENT_MAX), 0);
    all.high = fmax(fmin(all.high, PERCENT_MAX), 0);
  }
  if (scale == CLI_GAMMA || (scale == CLI_LINEAR && all.low >= 0)) {
    return (range){0, all.high > 0 ? (1 + ROOM) * all.high : 1};
  }
  const double room = all.low < all.high ? ROOM * (all.high - all.low) : 1;
  return (range){all.low - room, all.high + room};
}

/* Near r = 0 some quantities rise without bound. So a linear axis leaves out a peak in the first
 * PEAK_SHARE of the radii that is more than PEAK_RATIO times as high as the rest. */
#define PEAK_SHARE 0.02
#define PEAK_RATIO 4.0

/* Returns an end of a linear axis: `whole`, that of all values, or `inner`, that without peaks. */
static double end_of(double inner, double whole) {
  return fabs(whole) <= PEAK_RATIO * fabs(inner) ? whole : inner;
}

/* Finds the ends of a row's axes. Returns false if there is nothing to draw. */
static bool find_ranges(const cli_picture *picture, size_t row, range *r, range *value) {
  const cli_axes *axes = &picture->rows[row].axes;
  const layout places = layout_of(picture->report);
  range *each = cli_allocate(places.panels * places.curves, sizeof *each);
  range whole, inner, r_mm, inner_mm;
  const size_t count = extents_from(picture, row, -(double)INFINITY, each, &whole, &r_mm);
  if (count > 0) {
    *r = r_range(r_mm, axes->logarithmic_r);
    if (axes->scale == CLI_LOGARITHMIC) {
      *value = logarithmic_range(each, count, whole.high);
    } else if (axes->scale == CLI_PERCENT) {
      *value = linear_range(whole, axes->scale);
    } else {
      extents_from(picture, row, r_mm.low + PEAK_SHARE * (r_mm.high - r_mm.low), each, &inner,
                   &inner_mm);
      *value = linear_range((range){end_of(inner.low, whole.low), end_of(inner.high, whole.high)},
                            axes->scale);
    }
  }
  free(each);
  return count > 0;
}

/* ---- parts of a script ----------------------------------------------------------------------- */

static const dipole_choice *quantity_of(const cli_picture *picture, size_t row) {
  return picture->report->quantities.items[picture->rows[row].quantity];
}

/* Writes the label of the axis of values, such as "R (1/mm^2 ...)". */
static void value_label(const cli_picture *picture, size_t row, char text[TEXT_BYTES]) {
  const dipole_choice *quantity = quantity_of(picture, row);
  const char *unit =
      quantity->id == DIPOLE_R ? picture->report->profile.info->R_unit : quantity->about;
  if (picture->rows[row].label != NULL) {
    snprintf(text, TEXT_BYTES, "%s", picture->rows[row].label);
  } else if (strcmp(unit, "1") == 0) {
    snprintf(text, TEXT_BYTES, "%s", quantity->name);
  } else {
    snprintf(text, TEXT_BYTES, "%s (%s)", quantity->name, unit);
  }
}

/* Writes the name of the channel that a panel shows; "" if the panel shows all channels. */
static void panel_title(const cli_picture *picture, size_t panel, char text[TEXT_BYTES]) {
  text[0] = '\0';
  if (layout_of(picture->report).by_channel) {
    cli_channel_title(&picture->report->profile, panel, text, TEXT_BYTES);
  }
}

/* Writes "set WHAT 'text'". */
static void write_set(FILE *script, const char *what, const char *text) {
  fprintf(script, "set %s ", what);
  cli_gnuplot_quote(script, text);
  fputc('\n', script);
}

/* Writes a block of data for each curve. Its columns are the radius, for each row of the picture
 * the value that is shown there and, if there are standard errors, for each row that of the
 * value. */
static void write_data(FILE *script, const cli_picture *picture) {
  const layout places = layout_of(picture->report);
  for (size_t c = 0; c < places.panels * places.curves; c++) {
    const size_t panel = c / places.curves, index = c % places.curves;
    const curve one = curve_of(picture->report, panel, index);
    fprintf(script, "$curve%zu_%zu << END\n", panel, index);
    for (size_t i = 0; i < picture->report->radius_count; i++) {
      const double r_mm = picture->report->radii[i];
      fprintf(script, isfinite(r_mm) ? "%.17g" : "NaN", r_mm);
      for (size_t row = 0; row < picture->row_count; row++) {
        const double shown = shown_at(picture, row, &one, i);
        fprintf(script, isfinite(shown) ? " %.17g" : " NaN", shown);
      }
      for (size_t row = 0; picture->error_quantity > 0 && row < picture->row_count; row++) {
        const double error = shown_error_at(picture, row, &one, i);
        fprintf(script, isfinite(error) ? " %.17g" : " NaN", error);
      }
      fputc('\n', script);
    }
    fputs("END\n", script);
  }
}

static void write_axes(FILE *script, const cli_picture *picture, size_t row) {
  const cli_axes *axes = &picture->rows[row].axes;
  range r, value;
  if (!find_ranges(picture, row, &r, &value)) {
    return;
  }
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

/* ---- files: all panels in one picture -------------------------------------------------------- */

/* Sizes in pixels. */
enum {
  COLUMNS_MAX = 3,
  WIDE = 580, /* width of a panel that is alone in its row, with the gap beside it */
  NARROW = 400,
  HEIGHT = 480,
  HEIGHT_OF_SEVERAL = 380, /* where there is more than one row of panels */
  GAP_X = 60,
  GAP_Y = 84,
  LEFT = 90,
  TOP = 64,
  BOTTOM = 60,
  LEGEND_LINE = 20,
  LEGEND_CHARACTER = 8,
  LEGEND_SAMPLE = 70, /* width of the sample line in the legend, with the room around it */
};

/* How panels are laid out. A block has the panels of up to COLUMNS_MAX channels; all rows of the
 * picture repeat in each block. */
typedef struct grid {
  layout places;
  size_t columns, blocks, rows;
  double width, height, legend_width, legend_height, caption_height;
} grid;

/* ---- the caption: what was evaluated --------------------------------------------------------- */

/* More channels than this are counted, not listed. */
enum { CAPTION_CHANNELS = 6, CAPTION_LINE = 15 };

/* Writes line number `line` of the caption: a channel's medium, or a note that holds for a model.
 * Returns false if there is no such line. */
static bool caption_line(const cli_eval_report *report, size_t line, char text[CAPTION_BYTES]) {
  const cli_profile *profile = &report->profile;
  const size_t count = profile->channel_count;
  const size_t listed = count > CAPTION_CHANNELS ? CAPTION_CHANNELS : count;
  if (line < listed) {
    const dipole_medium *medium = &profile->channels[line].medium;
    char name[TEXT_BYTES], more[32] = "";
    cli_channel_title(profile, line, name, sizeof name);
    if (line + 1 == listed && count > listed) {
      snprintf(more, sizeof more, "; and %zu more", count - listed);
    }
    snprintf(text, CAPTION_BYTES, "%.64s: sigma_a %.6g/mm, sigma_s %.6g/mm, g %.6g, eta %.6g%s",
             name, medium->sigma_a_per_mm, medium->sigma_s_per_mm, medium->g, medium->eta, more);
    return true;
  }
  unsigned notes = 0;
  for (size_t i = 0; i < report->model_count; i++) {
    notes |= report->models[i].notes;
  }
  const dipole_choice *note = NULL;
  size_t from = 0;
  for (size_t i = listed; i <= line; i++) {
    note = cli_next_note(profile->info, notes, &from);
    if (note == NULL) {
      return false;
    }
  }
  snprintf(text, CAPTION_BYTES, "%s: %s", note->name, note->about);
  return true;
}

static size_t caption_lines(const cli_eval_report *report) {
  char text[CAPTION_BYTES];
  size_t count = 0;
  while (caption_line(report, count, text)) {
    count++;
  }
  return count;
}

/* Writes the caption of a file: below all panels, from the lower left corner of it upwards. */
static void write_caption(FILE *script, const cli_eval_report *report, const grid *g) {
  char text[CAPTION_BYTES];
  const size_t count = caption_lines(report);
  for (size_t i = 0; i < count; i++) {
    caption_line(report, i, text);
    fputs("set label ", script);
    cli_gnuplot_quote(script, text);
    fprintf(script, " at screen %.5f,%.5f left noenhanced font ',9'\n", 8 / g->width,
            (double)(count - i) * CAPTION_LINE / g->height);
  }
}

static grid make_grid(const cli_picture *picture) {
  grid g = {.places = layout_of(picture->report)};
  size_t longest = 0;
  for (size_t i = 0; i < g.places.curves; i++) {
    const curve one = curve_of(picture->report, 0, i);
    longest = strlen(one.title) > longest ? strlen(one.title) : longest;
  }
  g.columns = g.places.panels < COLUMNS_MAX ? g.places.panels : COLUMNS_MAX;
  g.blocks = (g.places.panels + g.columns - 1) / g.columns;
  g.rows = g.blocks * picture->row_count;
  g.legend_width = LEGEND_SAMPLE + LEGEND_CHARACTER * (double)longest;
  g.legend_height = LEGEND_LINE * (double)(g.places.curves + 1);
  g.width = LEFT + (double)g.columns * (g.columns > 1 ? NARROW : WIDE) + g.legend_width;
  g.height = (double)g.rows * ((g.rows > 1 ? HEIGHT_OF_SEVERAL : HEIGHT) + GAP_Y) - GAP_Y;
  g.caption_height = CAPTION_LINE * (double)(caption_lines(picture->report) + 1);
  g.height = TOP + fmax(g.height + BOTTOM + g.caption_height, g.legend_height);
  if (picture->width_px > 0) {
    g.width = (double)picture->width_px;
    g.height = (double)picture->height_px;
  }
  return g;
}

/* Writes one legend for all panels, to their right, with the first panel. */
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
  char text[TEXT_BYTES];
  const bool line = picture->report->radius_count > 1; /* else a point */
  panel_title(picture, panel, text);
  write_set(script, "title", row == 0 ? text : "");
  value_label(picture, row, text);
  write_set(script, "ylabel", panel % g->columns == 0 ? text : "");
  write_legend(script, g, panel == 0 && row == 0);
  write_axes(script, picture, row);
  for (size_t index = 0; index < g->places.curves; index++) {
    const curve one = curve_of(picture->report, panel, index);
    fprintf(script, "%s$curve%zu_%zu using 1:%zu", index > 0 ? ", " : "plot ", panel, index,
            2 + row);
    if (cli_is_walked(&picture->report->models[one.model])) {
      fprintf(script, ":%zu with yerrorbars pt 7 ps 0.4 lw 1 lc rgb '%s' title ",
              2 + picture->row_count + row, one.colour);
    } else {
      fprintf(script, " with %s %zu lw 2 lc rgb '%s' title ", line ? "lines dt" : "points pt",
              one.dash, one.colour);
    }
    cli_gnuplot_quote(script, one.title);
  }
  fputc('\n', script);
}

static const char *radius_label(const cli_picture *picture) {
  return cli_eval_is_by_f(picture->report) ? "f (1/mm)" : "r (mm)";
}

static void write_file_script(FILE *script, const void *context) {
  const cli_picture *picture = context;
  const char *medium = picture->report->profile.medium;
  const grid g = make_grid(picture);
  char text[TEXT_BYTES];
  snprintf(text, sizeof text, "%s%s", medium != NULL ? medium : quantity_of(picture, 0)->name,
           medium != NULL                      ? ""
           : cli_eval_is_by_f(picture->report) ? "(f)"
                                               : "(r)");
  fprintf(script, "set grid\nset xlabel '%s' offset 0,0.5\n", radius_label(picture));
  write_data(script, picture);
  fprintf(script,
          "set multiplot layout %zu,%zu margins %.5f,%.5f,%.5f,%.5f spacing %.5f,%.5f title ",
          g.rows, g.columns, LEFT / g.width, 1 - (g.legend_width + GAP_X) / g.width,
          (BOTTOM + g.caption_height) / g.height, 1 - TOP / g.height, GAP_X / g.width,
          GAP_Y / g.height);
  cli_gnuplot_quote(script, text);
  fputc('\n', script);
  for (size_t place = 0; place < g.rows * g.columns; place++) {
    const size_t row = place / g.columns;
    const size_t panel = row / picture->row_count * g.columns + place % g.columns;
    if (panel < g.places.panels) {
      if (place == 0) {
        write_caption(script, picture->report, &g);
      }
      write_panel(script, picture, &g, panel, row % picture->row_count);
      fputs("unset label\n", script);
    } else {
      fputs("set multiplot next\n", script);
    }
  }
  fputs("unset multiplot\n", script);
}

/* ---- text: panel below panel, each as large as the terminal ---------------------------------- */

enum { TEXT_COLUMNS_LEAST = 32, TEXT_ROWS_LEAST = 13 };

/* Curve i is drawn with mark i. If there are more curves than marks, some curves share a mark. */
static const char marks[] = "*o+x#@%&=$abcdefghijklmnpqrstuvwyzABCDEFGHIJKLMNOPQRSTUVWXYZ";

/* Draws the curves that are named first last, so that no other curve covers them. The legend lists
 * them first. */
static void write_text_panel(FILE *script, const cli_picture *picture, size_t panel, size_t row) {
  const cli_eval_report *report = picture->report;
  const char *medium = report->profile.medium;
  const size_t curves = layout_of(report).curves;
  char title[TEXT_BYTES], label[TEXT_BYTES], text[3 * TEXT_BYTES];
  panel_title(picture, panel, title);
  value_label(picture, row, label);
  snprintf(text, sizeof text, "%.*s%s%s%s%s", TEXT_BYTES, medium != NULL ? medium : "",
           medium != NULL && title[0] != '\0' ? ", " : "", title,
           medium != NULL || title[0] != '\0' ? ": " : "", label);
  write_set(script, "title", text);
  write_axes(script, picture, row);
  for (size_t i = 0; i < 2 * curves; i++) {
    const bool in_legend = i >= curves;
    const size_t index = in_legend ? i - curves : curves - 1 - i;
    const curve one = curve_of(report, panel, index);
    const bool black = strcmp(one.colour, "#000000") == 0; /* the terminal may be black, too */
    if (in_legend) {
      fputs(", keyentry", script);
    } else {
      fprintf(script, "%s$curve%zu_%zu using 1:%zu", i > 0 ? ", " : "plot ", panel, index, 2 + row);
    }
    fprintf(script, " with linespoints lt 0 pt '%c' lc %s'%s' title ",
            marks[index % (sizeof marks - 1)], black ? "" : "rgb ", black ? "black" : one.colour);
    cli_gnuplot_quote(script, in_legend ? one.title : "");
  }
  fputc('\n', script);
}

static void write_text_script(FILE *script, const void *context) {
  const cli_picture *picture = context;
  fprintf(script, "set xlabel '%s'\nset tmargin 1\nset key below Left reverse\n",
          radius_label(picture));
  write_data(script, picture);
  for (size_t panel = 0; panel < layout_of(picture->report).panels; panel++) {
    for (size_t row = 0; row < picture->row_count; row++) {
      write_text_panel(script, picture, panel, row);
    }
  }
}

/* Writes the caption in lines of at most `columns` characters, broken at blanks. Returns how many
 * lines it has. file: NULL if the lines are only to be counted. */
static size_t write_text_caption(FILE *file, const cli_eval_report *report, size_t columns) {
  char text[CAPTION_BYTES];
  size_t lines = 0;
  for (size_t i = 0; caption_line(report, i, text); i++) {
    for (const char *at = text; *at != '\0'; lines++) {
      size_t length = strlen(at);
      if (length > columns) {
        length = columns;
        while (length > 0 && at[length] != ' ') {
          length--;
        }
        length = length > 0 ? length : columns;
      }
      if (file != NULL) {
        fprintf(file, "%.*s\n", (int)length, at);
      }
      at += length + strspn(at + length, " ");
    }
  }
  return lines;
}

/* One row of the terminal is for the prompt, and some are for the caption. An empty line is above
 * the caption if there is room; gnuplot ends a coloured text with such a line itself. */
static bool draw_text(const cli_picture *picture, char error[CLI_GNUPLOT_ERROR_BYTES]) {
  const cli_terminal terminal = cli_terminal_look();
  const size_t columns =
      terminal.columns > TEXT_COLUMNS_LEAST ? terminal.columns : TEXT_COLUMNS_LEAST;
  const size_t others = 2 + write_text_caption(NULL, picture->report, columns);
  const bool fits = terminal.rows >= others + TEXT_ROWS_LEAST;
  if (!cli_gnuplot_text(stdout, terminal.styled, columns,
                        fits ? terminal.rows - others : TEXT_ROWS_LEAST, write_text_script, picture,
                        error)) {
    return false;
  }
  fputs(fits && !terminal.styled ? "\n" : "", stdout);
  write_text_caption(stdout, picture->report, columns);
  return true;
}

/* ---- drawing --------------------------------------------------------------------------------- */

static bool is_terminal(const char *path) {
  return strcmp(path, CLI_PICTURE_TERMINAL) == 0;
}

bool cli_picture_check(const char *path) {
  if (!is_terminal(path) && !cli_gnuplot_draws(path)) {
    cli_fail_usage("--plot %s: the name must end in .svg or .png; - is the terminal", path);
    return false;
  }
  return true;
}

static bool has_negative(const cli_picture *picture, size_t row) {
  const cli_eval_report *report = picture->report;
  for (size_t p = 0; p < report->model_count * report->profile.channel_count; p++) {
    for (size_t i = 0; i < report->radius_count; i++) {
      if (report->values[p].arrays[picture->rows[row].quantity][i] < 0) {
        return true;
      }
    }
  }
  return false;
}

static int fail_empty(const cli_picture *picture, size_t row, const char *path) {
  const char *name = quantity_of(picture, row)->name;
  if (picture->rows[row].axes.scale == CLI_LOGARITHMIC) {
    return cli_fail("--plot %s: %s is %s0 or infinite at every radius: a logarithmic axis shows "
                    "nothing of that; try other radii, or `dipole plot --axes linear`",
                    path, name, has_negative(picture, row) ? "negative, " : "");
  }
  return cli_fail("--plot %s: %s is not a finite number at any radius: give other radii", path,
                  name);
}

static int draw(const cli_picture *picture, const char *path) {
  char error[CLI_GNUPLOT_ERROR_BYTES];
  range r, value;
  for (size_t row = 0; row < picture->row_count; row++) {
    if (!find_ranges(picture, row, &r, &value)) {
      return fail_empty(picture, row, path);
    }
  }
  const grid g = make_grid(picture);
  const bool good = is_terminal(path) ? draw_text(picture, error)
                                      : cli_gnuplot(path, (size_t)g.width, (size_t)g.height,
                                                    write_file_script, picture, error);
  return good ? CLI_OK : cli_fail("--plot %s: %s", path, error);
}

int cli_picture_draw(const cli_picture *picture, const cli_texts *paths) {
  int status = CLI_OK;
  for (size_t i = 0; status == CLI_OK && i < paths->count; i++) {
    status = draw(picture, paths->items[i]);
    if (status == CLI_OK) {
      cli_picture_tell(paths->items[i]);
    }
  }
  return status;
}

void cli_picture_tell(const char *path) {
  if (strcmp(path, cli_running()->usual_file) == 0) {
    cli_say(CLI_OK, "the picture is %s", path);
  }
}

/* ---- the picture of R ------------------------------------------------------------------------ */

/* Returns whether the ratios between radii are equal, so that a logarithmic axis spreads them
 * evenly. */
static bool has_equal_ratios(const cli_eval_report *report) {
  const double *r = report->radii;
  const size_t n = report->radius_count;
  return n > 2 && r[0] > 0 && isfinite(r[n - 1]) && r[n - 1] > r[0] &&
         fabs(r[1] / r[0] / (r[n - 1] / r[n - 2]) - 1) < 1e-3;
}

cli_picture cli_picture_of_R(const cli_eval_report *report) {
  cli_picture picture = {.report = report, .row_count = 1};
  picture.rows[0].axes = *cli_axes_find(has_equal_ratios(report) ? "logarithmic" : "semilog");
  while (report->quantities.items[picture.rows[0].quantity]->id != DIPOLE_R) {
    picture.rows[0].quantity++;
  }
  return picture;
}
