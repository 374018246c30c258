/* R over r as a picture. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/eval.h"
#include "clients/cli/gnuplot.h"

/* A radius and value that a logarithmic axis can show: not where R is 0 or infinite. */
static bool is_drawn(double r_mm, double R) {
  return isfinite(r_mm) && isfinite(R) && R > 0;
}

static size_t count_drawn(const cli_eval_report *report) {
  size_t drawn = 0;
  for (size_t p = 0; p < report->model_count * report->channel_count; p++) {
    const double *R = cli_eval_array(report, &report->values[p], DIPOLE_R);
    for (size_t i = 0; i < report->radius_count; i++) {
      drawn += is_drawn(report->radii[i], R[i]);
    }
  }
  return drawn;
}

/* The points of each line as a named block. A line has at least one, if only an undefined one. */
static void write_data(FILE *script, const cli_eval_report *report) {
  for (size_t p = 0; p < report->model_count * report->channel_count; p++) {
    const double *R = cli_eval_array(report, &report->values[p], DIPOLE_R);
    fprintf(script, "$line%zu << END\n", p);
    for (size_t i = 0; i < report->radius_count; i++) {
      if (is_drawn(report->radii[i], R[i])) {
        fprintf(script, "%.17g %.17g\n", report->radii[i], R[i]);
      } else {
        fputs("NaN NaN\n", script);
      }
    }
    fputs("END\n", script);
  }
}

static const char *const palette[] = {"#000000", "#e69f00", "#56b4e9", "#009e73",
                                      "#cc79a7", "#d55e00", "#0072b2", "#999999"};

enum { PALETTE = sizeof palette / sizeof palette[0] };

/* A line or, for a single radius, its point. dash: from 1, a solid line. */
static void write_line(FILE *script, const cli_eval_report *report, size_t profile, size_t dash,
                       const char *colour, const char *title) {
  fprintf(script, "$line%zu using 1:2 with ", profile);
  fprintf(script, report->radius_count > 1 ? "lines dt %zu" : "points pt %zu", dash);
  fprintf(script, " lw 2 lc rgb '%s' title ", colour);
  cli_gnuplot_text(script, title);
}

static void write_labels(FILE *script, const cli_eval_report *report, bool r, bool R) {
  char label[96];
  snprintf(label, sizeof label, "R (%s)", report->info->R_unit);
  fprintf(script, "set xlabel '%s'\nset ylabel ", r ? "r (mm)" : "");
  cli_gnuplot_text(script, R ? label : "");
  fputc('\n', script);
}

static void channel_title(const cli_eval_report *report, size_t channel, char *title,
                          size_t bytes) {
  snprintf(title, bytes, "%s%s", report->medium != NULL ? "" : "channel ",
           report->channels[channel].name);
}

/* ---- few models: one diagram, a dash for each model and a colour for each channel ---------- */

enum { FEW_MODELS = 4, WIDTH = 900, HEIGHT = 600 };

static const char *colour_of(const cli_eval_report *report, size_t channel) {
  static const char *const rgb[] = {"#d62728", "#2ca02c", "#1f4fd8"};
  return report->channel_count == 3 ? rgb[channel] : palette[channel % PALETTE];
}

static void write_diagram(FILE *script, const cli_eval_report *report) {
  char title[128], channel[64];
  fputs("set key top right\nset title ", script);
  cli_gnuplot_text(script, report->medium != NULL ? report->medium : "R(r)");
  fputc('\n', script);
  write_labels(script, report, true, true);
  for (size_t p = 0; p < report->model_count * report->channel_count; p++) {
    const size_t model = p / report->channel_count, index = p % report->channel_count;
    channel_title(report, index, channel, sizeof channel);
    snprintf(title, sizeof title, "%s, %s", report->models[model].choice->name, channel);
    fputs(p > 0 ? ", " : "plot ", script);
    write_line(script, report, p, model + 1, colour_of(report, index), title);
  }
  fputc('\n', script);
}

/* ---- many models: a panel for each channel, a colour and dash for each model, one legend --- */

enum {
  PANEL_COLUMNS = 3,
  PANEL_WIDTH = 400,
  PANEL_HEIGHT = 540,
  LEGEND_WIDTH = 230,
  LEGEND_LINE_HEIGHT = 20,
  MARGIN_LEFT = 90,
  MARGIN = 60,
};

typedef struct panels {
  size_t columns, rows, width, height;
} panels;

static panels panels_of(const cli_eval_report *report) {
  const size_t count = report->channel_count;
  panels p = {.columns = count < PANEL_COLUMNS ? count : PANEL_COLUMNS};
  const size_t legend = MARGIN + LEGEND_LINE_HEIGHT * (report->model_count + 2);
  p.rows = (count + p.columns - 1) / p.columns;
  p.width = MARGIN_LEFT + PANEL_WIDTH * p.columns + LEGEND_WIDTH;
  p.height = 2 * MARGIN + PANEL_HEIGHT * p.rows;
  p.height = p.height < legend ? legend : p.height;
  return p;
}

static int compare(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

/* Decades of R below the least value of the middle line: some models fall off so much faster than
 * others that a diagram with all of a line shows nothing of the rest. */
enum { TAIL_DECADES = 4 };

/* The same decades in every panel, so that they compare. */
static void write_range(FILE *script, const cli_eval_report *report) {
  const size_t lines = report->model_count * report->channel_count;
  double *least = cli_allocate(lines, sizeof *least);
  double most = 0;
  size_t drawn = 0;
  for (size_t p = 0; p < lines; p++) {
    const double *R = cli_eval_array(report, &report->values[p], DIPOLE_R);
    double line_least = INFINITY;
    for (size_t i = 0; i < report->radius_count; i++) {
      if (is_drawn(report->radii[i], R[i])) {
        line_least = fmin(line_least, R[i]);
        most = fmax(most, R[i]);
      }
    }
    if (isfinite(line_least)) {
      least[drawn++] = line_least;
    }
  }
  qsort(least, drawn, sizeof *least, compare);
  const double low = fmax(floor(log10(least[0])), floor(log10(least[drawn / 2])) - TAIL_DECADES);
  fprintf(script, "set yrange [1e%.0f:1e%.0f]\n", low, fmax(ceil(log10(most)), low + 1));
  free(least);
}

static void write_panel(FILE *script, const cli_eval_report *report, const panels *p,
                        size_t channel) {
  char title[64];
  channel_title(report, channel, title, sizeof title);
  fputs("set title ", script);
  cli_gnuplot_text(script, title);
  fputc('\n', script);
  write_labels(script, report, channel + p->columns >= report->channel_count,
               channel % p->columns == 0);
  fputs(channel == 0 ? "set key at screen 0.99,0.94 top right vertical maxcols 1 Left reverse\n"
                     : "unset key\n",
        script);
  for (size_t model = 0; model < report->model_count; model++) {
    fputs(model > 0 ? ", " : "plot ", script);
    write_line(script, report, model * report->channel_count + channel, 1 + model / PALETTE,
               palette[model % PALETTE], report->models[model].choice->name);
  }
  fputc('\n', script);
}

static void write_panels(FILE *script, const cli_eval_report *report, const panels *p) {
  const double width = (double)p->width, height = (double)p->height;
  fprintf(script, "set multiplot layout %zu,%zu margins %.4f,%.4f,%.4f,%.4f spacing %.4f,%.4f",
          p->rows, p->columns, MARGIN_LEFT / width, 1 - LEGEND_WIDTH / width, MARGIN / height,
          1 - MARGIN / height, MARGIN / width, 1.5 * MARGIN / height);
  fputs(" title ", script);
  cli_gnuplot_text(script, report->medium != NULL ? report->medium : "R(r)");
  fputc('\n', script);
  write_range(script, report);
  for (size_t channel = 0; channel < report->channel_count; channel++) {
    write_panel(script, report, p, channel);
  }
  fputs("unset multiplot\n", script);
}

typedef struct picture {
  const cli_eval_report *report;
  panels panels;
  bool many;
  bool logarithmic_r;
} picture;

static void write_script(FILE *script, const void *context) {
  const picture *of = context;
  fputs("set logscale y\nset format y '%.0e'\nset grid\n", script);
  fputs(of->logarithmic_r ? "set logscale x\n" : "", script);
  write_data(script, of->report);
  if (of->many) {
    write_panels(script, of->report, &of->panels);
  } else {
    write_diagram(script, of->report);
  }
}

/* ---- drawing ------------------------------------------------------------------------------- */

/* Radii in equal ratios are evenly spread on a logarithmic axis only. */
static bool has_equal_ratios(const cli_eval_report *report) {
  const double *r = report->radii;
  const size_t n = report->radius_count;
  return n > 2 && r[0] > 0 && isfinite(r[n - 1]) && r[n - 1] > r[0] &&
         fabs(r[1] / r[0] / (r[n - 1] / r[n - 2]) - 1) < 1e-3;
}

int cli_plot(const cli_command *command, const cli_eval_report *report, const char *path) {
  if (count_drawn(report) == 0) {
    return cli_fail(
        command, "--plot %s: R is 0 or infinite at every radius: a logarithmic axis shows nothing",
        path);
  }
  const picture of = {.report = report,
                      .panels = panels_of(report),
                      .many = report->model_count > FEW_MODELS,
                      .logarithmic_r = has_equal_ratios(report)};
  return cli_gnuplot(command, path, of.many ? of.panels.width : WIDTH,
                     of.many ? of.panels.height : HEIGHT, write_script, &of);
}
