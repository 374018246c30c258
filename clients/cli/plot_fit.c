#include "clients/cli/plot_fit.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/gnuplot.h"
#include "clients/cli/picture.h"

enum { WIDTH_PX = 900, HEIGHT_PX = 700 };

static const char *const colours[CLI_FIT_DRAWN_MAX] = {"#1f77b4", "#d62728", "#2ca02c", "#9467bd",
                                                       "#ff7f0e", "#17becf", "#8c564b", "#7f7f7f"};

static size_t drawn_count(const cli_fit_picture *picture) {
  const size_t count = picture->readings->sample_count;
  return count < CLI_FIT_DRAWN_MAX ? count : CLI_FIT_DRAWN_MAX;
}

/* Writes a data block for each sample: the place, the reading, its error, what the fit has there,
 * and the residual; gnuplot skips NaN. The lines are in the order of the places. */
static void write_data(FILE *script, const cli_fit_picture *picture) {
  const cli_readings *readings = picture->readings;
  for (size_t s = 0; s < drawn_count(picture); s++) {
    const cli_sample *sample = &readings->samples[s];
    fprintf(script, "$unsorted << END\n");
    for (size_t i = sample->first; i < sample->first + sample->count; i++) {
      const double value = readings->values[i], error = readings->errors[i];
      const double residual = picture->residuals[i];
      const double numbers[] = {readings->at[i], value, error, value - residual * error, residual};
      for (size_t k = 0; k < sizeof numbers / sizeof numbers[0]; k++) {
        fprintf(script, isfinite(numbers[k]) ? " %.17g" : " NaN", numbers[k]);
      }
      fputc('\n', script);
    }
    fprintf(script,
            "END\nset table $sample%zu\nplot $unsorted using 1:2:3:4:5 smooth unique with "
            "table\nunset table\n",
            s);
  }
}

/* Writes one element of a plot for each sample: `what` stands between the data and the colour. */
static void write_elements(FILE *script, const cli_fit_picture *picture, const char *what,
                           bool titled) {
  for (size_t s = 0; s < drawn_count(picture); s++) {
    fprintf(script, "  $sample%zu %s lc rgb '%s' ", s, what, colours[s]);
    if (titled) {
      fputs("title ", script);
      cli_gnuplot_quote(script, picture->readings->samples[s].name);
    } else {
      fputs("notitle", script);
    }
    fputs(", \\\n", script);
  }
}

static bool spans_decades(const cli_readings *readings) {
  double least = (double)INFINITY, most = 0;
  for (size_t i = 0; i < readings->count; i++) {
    least = fmin(least, readings->at[i]);
    most = fmax(most, readings->at[i]);
  }
  return least > 0 && most >= 10 * least;
}

static void write_script(FILE *script, const void *context) {
  const cli_fit_picture *picture = context;
  const cli_readings *readings = picture->readings;
  write_data(script, picture);
  fputs("set multiplot\nset lmargin 12\nset rmargin 3\nset grid\n"
        "set offsets graph 0.02, 0.02, 0, 0\nset title ",
        script);
  cli_gnuplot_quote(script, picture->title);
  fprintf(script, "\n%sset logscale y\nset format y '%%.0e'\nset ylabel '%s'\n",
          spans_decades(readings) ? "set logscale x\n" : "",
          readings->frequency ? "R(f)" : "R (1/mm^2)");
  fputs("set size 1,0.66\nset origin 0,0.34\nset format x ''\nplot \\\n", script);
  write_elements(script, picture, "using 1:2:3 with yerrorbars pt 7 ps 0.6", true);
  write_elements(script, picture, "using 1:4 with lines lw 1.5", false);
  fprintf(script,
          "  NaN notitle\nunset logscale y\nunset title\nset format x\nset format y '%%g'\n"
          "set size 1,0.36\nset origin 0,0\nset xlabel '%s'\nset ylabel 'residual / error'\n"
          "set xzeroaxis lt 1 lc rgb 'black'\nset autoscale y\nplot \\\n",
          readings->frequency ? "spatial frequency f (1/mm)" : "distance r (mm)");
  write_elements(script, picture, "using 1:5 with points pt 7 ps 0.6", false);
  fputs("  NaN notitle\nunset multiplot\n", script);
}

/* Text shows one plot below the other. */
static bool draw_text(const cli_fit_picture *picture, char error[CLI_GNUPLOT_ERROR_BYTES]) {
  const cli_terminal terminal = cli_terminal_look();
  return cli_gnuplot_text(stdout, terminal.styled, terminal.columns > 60 ? terminal.columns : 60,
                          terminal.rows > 30 ? terminal.rows - 2 : 30, write_script, picture,
                          error);
}

int cli_fit_draw(const cli_fit_picture *picture, const cli_texts *paths) {
  char error[CLI_GNUPLOT_ERROR_BYTES];
  for (size_t i = 0; i < paths->count; i++) {
    const char *path = paths->items[i];
    const bool good = strcmp(path, CLI_PICTURE_TERMINAL) == 0
                          ? draw_text(picture, error)
                          : cli_gnuplot(path, WIDTH_PX, HEIGHT_PX, write_script, picture, error);
    if (!good) {
      return cli_fail("--plot %s: %s", path, error);
    }
    cli_picture_tell(path);
  }
  if (drawn_count(picture) < picture->readings->sample_count) {
    cli_say(CLI_OK, "the picture shows the first %d of %zu samples", CLI_FIT_DRAWN_MAX,
            picture->readings->sample_count);
  }
  return CLI_OK;
}
