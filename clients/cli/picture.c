#include "clients/cli/picture.h"

#include <math.h>
#include <string.h>

#include "clients/cli/gnuplot.h"
#include "clients/cli/picture_parts.h"
#include "clients/cli/picture_script.h"
#include "clients/cli/picture_text.h"

const cli_axes cli_axes_kinds[] = {
    {"linear", false, CLI_LINEAR},
    {"semilog", false, CLI_LOGARITHMIC},
    {"logarithmic", true, CLI_LOGARITHMIC},
    {"gamma", false, CLI_GAMMA},
    {0},
};

const cli_axes *cli_axes_find(const char *name) {
  for (const cli_axes *axes = cli_axes_kinds; axes->name != NULL; axes++) {
    if (strcmp(axes->name, name) == 0) {
      return axes;
    }
  }
  return NULL;
}

static bool is_terminal(const char *path) {
  return strcmp(path, CLI_PICTURE_TERMINAL) == 0;
}

bool cli_picture_check(const cli_command *command, const char *path) {
  if (!is_terminal(path) && !cli_gnuplot_draws(path)) {
    cli_fail_usage(command, "--plot %s: the name must end in .svg or .png; - is the terminal",
                   path);
    return false;
  }
  return true;
}

static bool has_negative(const cli_picture *picture, size_t row) {
  const cli_eval_report *report = picture->report;
  for (size_t p = 0; p < report->model_count * report->channel_count; p++) {
    for (size_t i = 0; i < report->radius_count; i++) {
      if (report->values[p].arrays[picture->rows[row].quantity][i] < 0) {
        return true;
      }
    }
  }
  return false;
}

static int fail_empty(const cli_command *command, const cli_picture *picture, size_t row,
                      const char *path) {
  const cli_picture_row *empty = &picture->rows[row];
  const char *name = picture->report->quantities[empty->quantity]->name;
  if (empty->axes.scale == CLI_LOGARITHMIC) {
    return cli_fail(command,
                    "--plot %s: %s is %s0 or infinite at every radius: a logarithmic axis shows "
                    "nothing",
                    path, name, has_negative(picture, row) ? "negative, " : "");
  }
  return cli_fail(command, "--plot %s: %s is not a finite number at any radius: nothing to draw",
                  path, name);
}

static int draw(const cli_command *command, const cli_picture *picture, const char *path) {
  picture_range r, value;
  for (size_t row = 0; row < picture->row_count; row++) {
    if (!picture_ranges(picture, row, &r, &value)) {
      return fail_empty(command, picture, row, path);
    }
  }
  if (is_terminal(path)) {
    picture_write_text(picture, stdout);
    return CLI_OK;
  }
  size_t width_px, height_px;
  picture_size(picture, &width_px, &height_px);
  char error[CLI_GNUPLOT_ERROR_BYTES];
  return cli_gnuplot(path, width_px, height_px, picture_write_script, picture, error)
             ? CLI_OK
             : cli_fail(command,
                        "--plot %s: %s (`dipole plot` and `dipole eval` draw in the "
                        "terminal with --plot -)",
                        path, error);
}

int cli_picture_draw(const cli_command *command, const cli_picture *picture,
                     const cli_texts *paths) {
  int status = CLI_OK;
  for (size_t i = 0; status == CLI_OK && i < paths->count; i++) {
    status = draw(command, picture, paths->items[i]);
    if (status == CLI_OK && strcmp(paths->items[i], command->usual_file) == 0) {
      fprintf(stderr, "dipole %s: the picture is %s\n", command->name, paths->items[i]);
    }
  }
  return status;
}

/* ---- the picture of R ---------------------------------------------------------------------- */

/* Radii in equal ratios are evenly spread on a logarithmic axis only. */
static bool has_equal_ratios(const cli_eval_report *report) {
  const double *r = report->radii;
  const size_t n = report->radius_count;
  return n > 2 && r[0] > 0 && isfinite(r[n - 1]) && r[n - 1] > r[0] &&
         fabs(r[1] / r[0] / (r[n - 1] / r[n - 2]) - 1) < 1e-3;
}

cli_picture cli_picture_of_R(const cli_eval_report *report) {
  cli_picture picture = {.report = report, .row_count = 1};
  picture.rows[0].axes = *cli_axes_find(has_equal_ratios(report) ? "logarithmic" : "semilog");
  while (report->quantities[picture.rows[0].quantity]->id != DIPOLE_R) {
    picture.rows[0].quantity++;
  }
  return picture;
}
