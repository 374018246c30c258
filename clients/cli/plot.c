/* dipole plot: pictures of profiles over r, and of how far they are from radiative transport. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/eval.h"
#include "clients/cli/number.h"
#include "clients/cli/picture.h"
#include "clients/cli/plot_derive.h"

#define PLOT_FILE "dipole.svg"
#define REFERENCE "transport"
#define AXES_DEFAULT "logarithmic"
#define QUANTITY_DEFAULT "R"
#define GAMMA_DEFAULT 2.2
#define TO_DEFAULT_MM 10.0
#define FROM_SHARE 1e-3 /* of --to, where a logarithmic axis needs a radius above 0 */
#define FORMAT_NONE "none"

enum { COUNT_DEFAULT = 401, SIDE_LEAST_PX = 320, SIDE_MOST_PX = 8192 };

typedef struct plot_settings {
  cli_eval_settings eval;
  cli_texts axes;
  const char *quantity;
  cli_number gamma;
  bool error;
  const char *size;
} plot_settings;

#define FIELD(name) offsetof(plot_settings, name)

static const cli_option options[] = {
    CLI_MEDIUM_OPTIONS(cli_eval_settings),
    CLI_EVAL_OPTIONS,
    {"Radii", NULL, NULL, CLI_HEADING, 0},
    {"r", "X[,X...]", "these radii, mm", CLI_NUMBERS, FIELD(eval.r)},
    {"from", "X", "the first radius, mm (default: 0; with a logarithmic axis of r --to / 1000)",
     CLI_NUMBER, FIELD(eval.from)},
    {"to", "X", "the last radius, mm (default: 10)", CLI_NUMBER, FIELD(eval.to)},
    {"count", "N", "how many radii a curve has (default: 401)", CLI_COUNT, FIELD(eval.count)},
    {"log", NULL,
     "equal ratios from radius to radius instead of equal steps (default: so\n"
     "where an axis of r is logarithmic and --from is above 0)",
     CLI_SWITCH, FIELD(eval.logarithmic)},
    {"Picture", NULL, NULL, CLI_HEADING, 0},
    {"quantity", "NAME",
     "what is drawn: R, cdf, pdf, dR_dr, ln_R, 2_pi_r_R or S, see `dipole info`\n"
     "(default: " QUANTITY_DEFAULT ")",
     CLI_TEXT, FIELD(quantity)},
    {"axes", "NAME[,NAME...]",
     "linear, semilog, logarithmic or gamma. A panel for each. semilog:\n"
     "values logarithmic; logarithmic: r too; gamma: values to the power\n"
     "1/2.2 over linear r (default: " AXES_DEFAULT ")",
     CLI_NAMES, FIELD(axes)},
    {"gamma", "X", "values to the power 1/X on the axes gamma (default: 2.2)", CLI_NUMBER,
     FIELD(gamma)},
    {"error", NULL, "a further panel: deviation from " REFERENCE ", relative, at the same radii",
     CLI_SWITCH, FIELD(error)},
    {"size", "WxH", "of a picture in a file, in pixels (default: what its panels need)", CLI_TEXT,
     FIELD(size)},
    {"plot", "[FILE]",
     "FILE.svg or FILE.png (without FILE: " PLOT_FILE "); -: as characters on\n"
     "standard output; may be repeated (default: -, or no picture with\n"
     "--format)",
     CLI_FILES, FIELD(eval.plot)},
    {0},
};

/* ---- the command line ---------------------------------------------------------------------- */

static int check_axes(const cli_command *command, const cli_texts *names) {
  for (size_t i = 0; i < names->count; i++) {
    const char *name = names->items[i];
    if (cli_axes_find(name) == NULL) {
      return cli_fail_usage(command,
                            "--axes: '%s' is unknown; they are linear, semilog, "
                            "logarithmic and gamma",
                            name);
    }
    for (size_t k = 0; k < i; k++) {
      if (strcmp(names->items[k], name) == 0) {
        return cli_fail_usage(command, "--axes: name %s once", name);
      }
    }
  }
  return CLI_OK;
}

static bool is_named(const cli_texts *names, const char *name) {
  for (size_t i = 0; i < names->count; i++) {
    if (strcmp(names->items[i], name) == 0) {
      return true;
    }
  }
  return false;
}

/* "900x600"; nothing where there is no text. */
static bool parse_size(const char *text, size_t *width_px, size_t *height_px) {
  char first[16];
  uint64_t width, height;
  if (text == NULL) {
    *width_px = *height_px = 0;
    return true;
  }
  const size_t length = strcspn(text, "x");
  if (length >= sizeof first || text[length] == '\0') {
    return false;
  }
  snprintf(first, sizeof first, "%.*s", (int)length, text);
  if (!cli_count_parse(first, &width) || !cli_count_parse(text + length + 1, &height) ||
      width < SIDE_LEAST_PX || width > SIDE_MOST_PX || height < SIDE_LEAST_PX ||
      height > SIDE_MOST_PX) {
    return false;
  }
  *width_px = (size_t)width;
  *height_px = (size_t)height;
  return true;
}

static int check(const cli_command *command, const plot_settings *settings) {
  size_t width_px, height_px;
  int status = cli_eval_check(command, &settings->eval);
  if (status == CLI_OK) {
    status = check_axes(command, &settings->axes);
  }
  if (status != CLI_OK) {
    return status;
  }
  if (settings->gamma.given && !is_named(&settings->axes, "gamma")) {
    return cli_fail_usage(command, "--gamma is of the axes gamma: add --axes gamma");
  }
  if (settings->gamma.given && !(settings->gamma.value > 0 && isfinite(settings->gamma.value))) {
    return cli_fail_usage(command, "--gamma: above 0");
  }
  if (!parse_size(settings->size, &width_px, &height_px)) {
    return cli_fail_usage(command,
                          "--size %s: write WIDTHxHEIGHT, such as 900x600; each side %d "
                          "to %d pixels",
                          settings->size, SIDE_LEAST_PX, SIDE_MOST_PX);
  }
  if (settings->error && settings->eval.profile.thickness.given) {
    return cli_fail_usage(command, "--error compares with " REFERENCE ", which has no slabs: leave "
                                   "--thickness out");
  }
  return CLI_OK;
}

static bool has_logarithmic_r(const plot_settings *settings) {
  for (size_t i = 0; i < settings->axes.count; i++) {
    const cli_axes *axes = cli_axes_find(settings->axes.items[i]);
    if (axes != NULL && axes->logarithmic_r) {
      return true;
    }
  }
  return settings->axes.count == 0; /* the default */
}

/* What is not given, where it differs from `dipole eval`. */
static void set_defaults(plot_settings *settings) {
  cli_eval_settings *eval = &settings->eval;
  if (settings->error) {
    eval->reference = REFERENCE;
  }
  if (eval->r.count > 0) {
    return;
  }
  if (!eval->count.given) {
    eval->count = (cli_count){true, COUNT_DEFAULT};
  }
  if (has_logarithmic_r(settings)) {
    const double to_mm = eval->to.given ? eval->to.value : TO_DEFAULT_MM;
    if (!eval->from.given && to_mm > 0 && isfinite(to_mm)) {
      eval->from = (cli_number){true, FROM_SHARE * to_mm};
    }
    eval->logarithmic = eval->logarithmic || eval->from.value > 0;
  }
}

/* ---- the picture --------------------------------------------------------------------------- */

/* The model that others are compared with; where it was asked for as that only, it goes. */
static int take_deviation(const cli_command *command, size_t quantity, cli_eval_report *report,
                          plot_derived *derived, size_t *position) {
  size_t reference = 0;
  while (reference < report->model_count &&
         strcmp(report->models[reference].choice->name, REFERENCE) != 0) {
    reference++;
  }
  if (reference == report->model_count) {
    return cli_fail(command,
                    "--error: " REFERENCE " does not answer this, so that there is nothing "
                    "to compare with: leave --error out");
  }
  *position = plot_add_deviation(report, quantity, reference, derived);
  if (report->models[report->model_count - 1].unlisted) {
    report->model_count--;
  }
  return report->model_count > 0
             ? CLI_OK
             : cli_fail(command, "no model answers but " REFERENCE ", which is to compare with");
}

enum { DERIVED_GAMMA, DERIVED_DEVIATION, DERIVED };

/* The panels, and in the report what they show. */
static int make_picture(const cli_command *command, const plot_settings *settings,
                        cli_eval_report *report, plot_derived derived[DERIVED],
                        cli_picture *picture) {
  static char usual[] = AXES_DEFAULT;
  char *usual_items[] = {usual};
  const cli_texts usual_axes = {1, usual_items};
  const cli_texts *names = settings->axes.count > 0 ? &settings->axes : &usual_axes;
  *picture = (cli_picture){.report = report};
  parse_size(settings->size, &picture->width_px, &picture->height_px);
  for (size_t i = 0; i < names->count; i++) {
    cli_picture_row *row = &picture->rows[picture->row_count++];
    row->axes = *cli_axes_find(names->items[i]);
    if (row->axes.scale == CLI_GAMMA) {
      const double gamma = settings->gamma.given ? settings->gamma.value : GAMMA_DEFAULT;
      row->quantity = plot_add_gamma(report, 0, gamma, &derived[DERIVED_GAMMA]);
    }
  }
  if (!settings->error) {
    return CLI_OK;
  }
  cli_picture_row *row = &picture->rows[picture->row_count];
  row->axes = (cli_axes){"deviation", row[-1].axes.logarithmic_r, CLI_PERCENT};
  row->label = "deviation from " REFERENCE " (%)";
  picture->row_count++;
  return take_deviation(command, 0, report, &derived[DERIVED_DEVIATION], &row->quantity);
}

static int write_and_draw(const cli_command *command, const plot_settings *settings,
                          cli_eval_report *report) {
  static char terminal[] = CLI_PICTURE_TERMINAL;
  char *terminal_items[] = {terminal};
  const cli_texts onto_terminal = {1, terminal_items};
  const char *format = settings->eval.profile.common.format;
  const bool writes = format != NULL && strcmp(format, FORMAT_NONE) != 0;
  plot_derived derived[DERIVED];
  cli_picture picture;
  int status = make_picture(command, settings, report, derived, &picture);
  if (status == CLI_OK && writes) {
    cli_eval_write(report, format);
  }
  if (status == CLI_OK && (!writes || settings->eval.plot.count > 0)) {
    status = cli_picture_draw(
        command, &picture, settings->eval.plot.count > 0 ? &settings->eval.plot : &onto_terminal);
  }
  cli_eval_report_free(report);
  return status;
}

/* ---- the command --------------------------------------------------------------------------- */

/* A quantity that has a value for each radius. */
static bool check_quantity(const cli_command *command, const char *name, dipole_client *client) {
  const dipole_choice *quantity =
      cli_named(command, dipole_get_info(client), DIPOLE_QUANTITY, "quantity", name);
  if (quantity != NULL && (quantity->id == DIPOLE_ALBEDO || quantity->id == DIPOLE_RADIUS)) {
    cli_fail_usage(command, "--quantity %s: there is no curve of it over r", name);
    return false;
  }
  return quantity != NULL;
}

static int ask(const cli_command *command, const plot_settings *settings, dipole_client *client) {
  char quantity[64];
  char *wanted[] = {quantity};
  cli_eval_settings eval = settings->eval;
  cli_eval_report report = {0};
  const char *name = settings->quantity != NULL ? settings->quantity : QUANTITY_DEFAULT;
  if (!check_quantity(command, name, client)) {
    return CLI_USAGE;
  }
  snprintf(quantity, sizeof quantity, "%s", name);
  eval.want = (cli_texts){1, wanted};
  const int status = cli_eval_ask(command, &eval, client, &report);
  if (status != CLI_OK) {
    cli_eval_report_free(&report);
    return status;
  }
  return write_and_draw(command, settings, &report);
}

static int run(const cli_command *command, int argc, char **argv) {
  plot_settings settings = {0};
  dipole_client *client;
  const char *operand;
  int status;
  if (cli_options_read(command, argc, argv, &settings, &operand, &status)) {
    set_defaults(&settings);
    status = check(command, &settings);
    if (status == CLI_OK && !cli_open(command, &settings.eval.profile.common, &client)) {
      status = CLI_FAILED;
    } else if (status == CLI_OK) {
      status = ask(command, &settings, client);
      dipole_close(client);
    }
  }
  cli_options_free(command, &settings);
  return status;
}

const cli_command cli_command_plot = {
    .name = "plot",
    .about = "Draw profiles over r, and how far they are from radiative transport",
    .more =
        "\n"
        "Curves of up to four models and eight channels share a panel (a dash for each model, a\n"
        "colour for each channel); of more, and of a single channel, each channel has panels of\n"
        "its own, with a colour for each model. The axes logarithmic and gamma are those of the\n"
        "figures of d'Eon 2012. What lies beyond an axis is in the numbers only, which --format\n"
        "gives: on a linear one peaks in the first 2 % of the radii that are more than four\n"
        "times the rest, on a logarithmic one what is 4 decades below the least value of the\n"
        "middle curve, and deviations beyond 200 %. Files are drawn by gnuplot; characters need\n"
        "nothing, have colours on a terminal only, and none where NO_COLOR is set.\n",
    .formats = FORMAT_NONE ",table,csv,json",
    .options = options,
    .shared_options = cli_parameter_options,
    .usual_file = PLOT_FILE,
    .examples =
        "  dipole plot --medium skin1 --model classical,better,transport\n"
        "  dipole plot --medium skin1 --channel red --model all --axes logarithmic,gamma "
        "--error \\\n"
        "    --plot skin1.svg\n"
        "  dipole plot --medium marble,wholemilk --channel green --model better,transport --plot\n"
        "  dipole plot --sigma-a 0.01,0.1,1 --sigma-s 1 --eta 1.4 --quantity 2_pi_r_R \\\n"
        "    --axes linear --to 20 --size 1200x800 --plot a.png --plot a.svg\n"
        "  dipole plot --medium skin1 --quantity cdf --axes linear --format csv\n",
    .run = run,
};
