/* A histogram of drawn radii, and over it the density that they were drawn from. */
#include <math.h>
#include <stdlib.h>

#include "clients/cli/gnuplot.h"
#include "clients/cli/sample.h"

enum { BINS = 60, WIDTH = 900, HEIGHT = 600 };

/* Of the radii, so many are shown: the last ones would leave the others no room. */
#define SHOWN_SHARE 0.99

/* A radius and its density. */
typedef struct point {
  double r_mm;
  double pdf_per_mm;
} point;

typedef struct picture {
  const cli_sample_report *report;
  point *points; /* [channel_count][count], each channel's by radius */
  double most_mm;
} picture;

static int compare(const void *a, const void *b) {
  const double x = ((const point *)a)->r_mm, y = ((const point *)b)->r_mm;
  return (x > y) - (x < y);
}

static const char *colour_of(const cli_sample_report *report, size_t channel) {
  static const char *const rgb[] = {"#d62728", "#2ca02c", "#1f4fd8"};
  static const char *const palette[] = {"#000000", "#e69f00", "#56b4e9", "#009e73",
                                        "#cc79a7", "#d55e00", "#0072b2", "#999999"};
  return report->channel_count == 3 ? rgb[channel]
                                    : palette[channel % (sizeof palette / sizeof palette[0])];
}

static const point *points_of(const picture *of, size_t channel) {
  return of->points + channel * of->report->count;
}

/* $hist0: the middles of the bins, and how many radii are in them, as a density. */
static void write_histogram(FILE *script, const picture *of, size_t channel) {
  const point *points = points_of(of, channel);
  const size_t count = of->report->count;
  size_t bins[BINS] = {0};
  for (size_t i = 0; i < count && points[i].r_mm < of->most_mm; i++) {
    const size_t bin = (size_t)(points[i].r_mm / of->most_mm * BINS);
    bins[bin < BINS ? bin : BINS - 1]++;
  }
  const double width_mm = of->most_mm / BINS;
  fprintf(script, "$hist%zu << END\n", channel);
  for (size_t i = 0; i < BINS; i++) {
    fprintf(script, "%.9g %.9g\n", ((double)i + 0.5) * width_mm,
            (double)bins[i] / ((double)count * width_mm));
  }
  fputs("END\n", script);
}

/* $pdf0: the density at the radii that were drawn. */
static void write_density(FILE *script, const picture *of, size_t channel) {
  const point *points = points_of(of, channel);
  fprintf(script, "$pdf%zu << END\n", channel);
  for (size_t i = 0; i < of->report->count && points[i].r_mm <= of->most_mm; i++) {
    fprintf(script, "%.9g %.9g\n", points[i].r_mm, points[i].pdf_per_mm);
  }
  fputs("NaN NaN\n", script); /* a line has a point, if only an undefined one */
  fputs("END\n", script);
}

static void write_script(FILE *script, const void *context) {
  const picture *of = context;
  const cli_sample_report *report = of->report;
  char title[128];
  for (size_t channel = 0; channel < report->channel_count; channel++) {
    write_histogram(script, of, channel);
    write_density(script, of, channel);
  }
  snprintf(title, sizeof title, "%s%s%s: %zu radii, %s",
           report->medium != NULL ? report->medium : "", report->medium != NULL ? ", " : "",
           report->model->name, report->count, report->draw->name);
  fputs("set grid\nset style fill transparent solid 0.25 noborder\nset xlabel 'r (mm)'\n"
        "set ylabel 'density (1/mm)'\nset title ",
        script);
  cli_gnuplot_quote(script, title);
  fprintf(script, "\nset xrange [0:%.9g]\nset yrange [0:*]\nplot ", of->most_mm);
  for (size_t i = 0; i < report->channel_count; i++) {
    const char *colour = colour_of(report, i);
    snprintf(title, sizeof title, "%s%s", report->medium != NULL ? "" : "channel ",
             report->channels[i].name);
    fprintf(script, "%s$hist%zu using 1:2 with boxes lc rgb '%s' notitle, ", i > 0 ? ", " : "", i,
            colour);
    fprintf(script, "$pdf%zu using 1:2 with lines lw 2 lc rgb '%s' title ", i, colour);
    cli_gnuplot_quote(script, title);
  }
  fputc('\n', script);
}

int cli_sample_plot(const cli_command *command, const cli_sample_report *report, const char *path) {
  picture of = {.report = report,
                .points = cli_allocate(report->channel_count * report->count, sizeof *of.points)};
  for (size_t channel = 0; channel < report->channel_count; channel++) {
    point *points = of.points + channel * report->count;
    for (size_t i = 0; i < report->count; i++) {
      points[i] = (point){cli_sample_value(report, channel, DIPOLE_RADIUS, i),
                          cli_sample_value(report, channel, DIPOLE_PDF, i)};
    }
    qsort(points, report->count, sizeof *points, compare);
    const double last_mm = points[(size_t)(SHOWN_SHARE * (double)(report->count - 1))].r_mm;
    of.most_mm = isfinite(last_mm) ? fmax(of.most_mm, last_mm) : of.most_mm;
  }
  char error[CLI_GNUPLOT_ERROR_BYTES];
  int status = CLI_OK;
  if (!(of.most_mm > 0)) {
    status =
        cli_fail(command, "--plot %s: all radii are 0 or infinite: there is nothing to show", path);
  } else if (!cli_gnuplot(path, WIDTH, HEIGHT, write_script, &of, error)) {
    status = cli_fail(command, "--plot %s: %s", path, error);
  }
  free(of.points);
  return status;
}
