/* dipole plot: pictures of profiles over r, and of how far they are from radiative transport. */
#include <math.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/eval.h"
#include "clients/cli/options.h"
#include "clients/cli/plot_report.h"
#include "clients/cli/plot_rings.h"

#define PLOT_FILE "dipole.svg"
#define REFERENCE "transport"
#define AXES_DEFAULT "logarithmic"
#define RINGS_DEFAULT 24 /* so many rings with --mc, without --count */
#define FROM_SHARE 1e-3  /* on a logarithmic axis, --from is this share of --to by default */

enum { SIDE_LEAST_PX = 320, SIDE_MOST_PX = 8192, RINGS_MAX = 4096 };

typedef struct plot_settings {
  cli_eval_settings eval;
  cli_texts axes;
  const char *quantity;
  cli_number gamma;
  cli_number photons; /* for Monte Carlo beside the models */
  bool error;
  const char *size;
} plot_settings;

#define FIELD(name) offsetof(plot_settings, name)

static const cli_option options[] = {
    {"Radii", NULL, NULL, CLI_HEADING, 0, NULL},
    {"r", "X[,X...]", "these radii, mm", CLI_NUMBERS, FIELD(eval.r), NULL},
    CLI_EVAL_F_OPTION(FIELD(eval.f)),
    {"from", "X", "the first radius, mm (default: 0; on a logarithmic axis --to / 1000)",
     CLI_NUMBER, FIELD(eval.from), "0"},
    {"to", "X", "the last radius, mm (default: 10)", CLI_NUMBER, FIELD(eval.to), "10"},
    {"count", "N", "how many radii a curve has (default: 401); with --mc, how many rings (24)",
     CLI_COUNT, FIELD(eval.count), "401"},
    {"log", NULL,
     "make the ratios between radii equal instead of the steps (default: if an\n"
     "axis of r is logarithmic and --from is above 0)",
     CLI_SWITCH, FIELD(eval.logarithmic), NULL},
    {"Picture", NULL, NULL, CLI_HEADING, 0, NULL},
    {"quantity", "NAME",
     "what to draw: R, cdf, pdf, dR_dr, ln_R, 2_pi_r_R, S or, over spatial\n"
     "frequencies, R_f; see `dipole info` (default: R)",
     CLI_TEXT, FIELD(quantity), "R"},
    {"axes", "NAME[,NAME...]",
     "linear, semilog, logarithmic or gamma. Each has a panel. semilog: values\n"
     "are logarithmic; logarithmic: r is, too; gamma: values to the power\n"
     "1/2.2 over linear r (default: " AXES_DEFAULT ")",
     CLI_NAMES, FIELD(axes), NULL},
    {"axes-gamma", "X", "values to the power 1/X on the axes gamma (default: 2.2)", CLI_NUMBER,
     FIELD(gamma), "2.2"},
    {"error", NULL, "add a panel with the relative deviation from " REFERENCE, CLI_SWITCH,
     FIELD(error), NULL},
    {"mc", "PHOTONS",
     "walk so many photons in each channel, such as 1e6, and draw means over\n"
     "rings: of Monte Carlo with standard errors, and of the models",
     CLI_NUMBER, FIELD(photons), NULL},
    {"size", "WxH", "of a picture in a file, in pixels (default: what its panels need)", CLI_TEXT,
     FIELD(size), NULL},
    {"plot", "[FILE]",
     "draw into FILE.svg or FILE.png (without FILE: " PLOT_FILE "); -: as text on\n"
     "standard output. May be repeated (default: -, or no picture with\n"
     "--format)",
     CLI_FILES, FIELD(eval.plot), NULL},
    {0},
};

/* ---- the command line ------------------------------------------------------------------------ */

static int check_axes(const cli_texts *names) {
  for (size_t i = 0; i < names->count; i++) {
    const char *name = names->items[i];
    if (cli_axes_find(name) == NULL) {
      return cli_fail_usage("--axes: '%s' is unknown; they are linear, semilog, "
                            "logarithmic and gamma",
                            name);
    }
    for (size_t k = 0; k < i; k++) {
      if (strcmp(names->items[k], name) == 0) {
        return cli_fail_usage("--axes: name %s only once", name);
      }
    }
  }
  return CLI_OK;
}

/* Reads a size such as "900x600". Without a text, sets both sides to 0. Returns whether the text is
 * good. */
static bool parse_size(const char *text, size_t *width_px, size_t *height_px) {
  int length = 0;
  *width_px = *height_px = 0;
  if (text == NULL) {
    return true;
  }
  return strspn(text, "0123456789x") == strlen(text) &&
         sscanf(text, "%zux%zu%n", width_px, height_px, &length) == 2 && text[length] == '\0' &&
         *width_px >= SIDE_LEAST_PX && *width_px <= SIDE_MOST_PX && *height_px >= SIDE_LEAST_PX &&
         *height_px <= SIDE_MOST_PX;
}

static bool has_logarithmic_x(const plot_settings *settings) {
  for (size_t i = 0; i < settings->axes.count; i++) {
    const cli_axes *axes = cli_axes_find(settings->axes.items[i]);
    if (axes != NULL && axes->logarithmic_x) {
      return true;
    }
  }
  return settings->axes.count == 0; /* the default */
}

/* Sets the defaults that differ from those of `dipole eval`. */
static void set_defaults(plot_settings *settings) {
  cli_eval_settings *eval = &settings->eval;
  if (settings->error) {
    eval->reference = REFERENCE;
  }
  if (settings->photons.given && !eval->count.given) {
    eval->count.value = RINGS_DEFAULT;
  }
  if (eval->r.count == 0 && eval->f.count == 0 && has_logarithmic_x(settings)) {
    if (!eval->from.given && eval->to.value > 0 && isfinite(eval->to.value)) {
      eval->from = (cli_number){true, FROM_SHARE * eval->to.value};
    }
    eval->logarithmic = eval->logarithmic || eval->from.value > 0;
  }
}

static int check_walk(const plot_settings *settings) {
  const double photons = settings->photons.value;
  if (!(photons >= 1 && photons <= 0x1p53 && photons == floor(photons))) {
    return cli_fail_usage("--mc: give a whole number of photons from 1 to 9e15, such as 1e6");
  }
  if (settings->eval.r.count > 0 || settings->eval.f.count > 0) {
    return cli_fail_usage("--mc needs rings, not single radii: give --from, --to and --count in "
                          "place of --r");
  }
  if (strcmp(settings->quantity, "R") != 0) {
    return cli_fail_usage("--mc compares R: leave --quantity out");
  }
  if (settings->eval.count.value < 1 || settings->eval.count.value > RINGS_MAX) {
    return cli_fail_usage("--count: with --mc, give 1 to %d rings", RINGS_MAX);
  }
  if (!(settings->eval.from.value >= 0 && settings->eval.to.value > settings->eval.from.value &&
        isfinite(settings->eval.to.value))) {
    return cli_fail_usage("--mc: rings are from --from, 0 or more, to --to, which is larger");
  }
  return CLI_OK;
}

static int check(void *given) {
  plot_settings *settings = given;
  size_t width_px, height_px;
  set_defaults(settings);
  int status = cli_eval_check(&settings->eval);
  status = status == CLI_OK ? check_axes(&settings->axes) : status;
  if (status != CLI_OK) {
    return status;
  }
  if (settings->gamma.given && !cli_texts_have(&settings->axes, "gamma")) {
    return cli_fail_usage("--axes-gamma changes nothing but the axes gamma: add --axes gamma, or "
                          "leave --axes-gamma out");
  }
  if (!(settings->gamma.value > 0 && isfinite(settings->gamma.value))) {
    return cli_fail_usage("--axes-gamma: give a number above 0");
  }
  if (!parse_size(settings->size, &width_px, &height_px)) {
    return cli_fail_usage("--size %s: write WIDTHxHEIGHT, such as 900x600; each side %d "
                          "to %d pixels",
                          settings->size, SIDE_LEAST_PX, SIDE_MOST_PX);
  }
  if (settings->photons.given && status == CLI_OK) {
    status = check_walk(settings);
  }
  if (status != CLI_OK) {
    return status;
  }
  if (settings->error && settings->eval.profile.thickness.given) {
    return cli_fail_usage("--error compares with " REFERENCE ", which has no slabs: leave "
                          "--thickness out");
  }
  return CLI_OK;
}

/* ---- what is made of the answers: a report draws and writes it like what the daemon has -------- */

static const dipole_choice deviation = {
    .kind = DIPOLE_QUANTITY, .name = "deviation", .about = "relative, from " REFERENCE};
static const dipole_choice of_deviation = {
    .kind = DIPOLE_QUANTITY, .name = "deviation_error", .about = "relative"};

/* Returns whether the reference is radiative transport itself for a channel. It is not where it
 * replaces anisotropic scattering by isotropic scattering. */
static bool holds(const cli_eval_report *report, size_t reference, size_t channel) {
  return cli_eval_values_of(report, reference, channel)->model_error == 0;
}

/* Adds the relative deviation of the first quantity from its value in the reference model, and then
 * if errors are the second quantity, those of the deviation. A deviation is NaN in channels for
 * which the reference does not hold, and where that value is 0 or either value is infinite. */
static void add_deviation(cli_eval_report *report, size_t reference) {
  const size_t channels = report->profile.channel_count;
  const bool errors = report->quantities.count > 1;
  const size_t at = cli_eval_add_quantity(report, &deviation);
  if (errors) {
    cli_eval_add_quantity(report, &of_deviation);
  }
  for (size_t k = 0; k < report->model_count * channels; k++) {
    const double *from = cli_eval_values_of(report, reference, k % channels)->arrays[0];
    const bool comparable = holds(report, reference, k % channels);
    double *const *arrays = report->values[k].arrays;
    for (size_t i = 0; comparable && i < report->radius_count; i++) {
      if (isfinite(arrays[0][i]) && isfinite(from[i]) && from[i] != 0) {
        arrays[at][i] = arrays[0][i] / from[i] - 1;
        if (errors) {
          arrays[at + 1][i] = arrays[1][i] / from[i];
        }
      }
    }
  }
}

/* Names the channels for which the reference does not hold. Fails if these are all. */
static int check_reference(const cli_eval_report *report, size_t reference) {
  size_t held = 0;
  for (size_t i = 0; i < report->profile.channel_count; i++) {
    if (holds(report, reference, i)) {
      held++;
    } else {
      cli_fail("--error: no deviation is shown of %s, because " REFERENCE
               " is not known to hold for its g, eta and absorption",
               report->profile.channels[i].name);
    }
  }
  return held > 0 ? CLI_OK
                  : cli_fail("--error: there is nothing to compare with: leave --error out");
}

/* Finds the reference model and adds the deviations from it. Removes the reference if it was asked
 * for this purpose only. */
static int take_deviation(cli_eval_report *report) {
  size_t reference = 0;
  while (reference < report->model_count &&
         strcmp(report->models[reference].choice->name, REFERENCE) != 0) {
    reference++;
  }
  if (reference == report->model_count) {
    return cli_fail("--error: " REFERENCE " does not answer this, so that there is nothing "
                    "to compare with: leave --error out");
  }
  const int status = check_reference(report, reference);
  if (status != CLI_OK) {
    return status;
  }
  add_deviation(report, reference);
  if (report->models[report->model_count - 1].unlisted) {
    report->model_count--;
  }
  return report->model_count > 0
             ? CLI_OK
             : cli_fail("no model answers but " REFERENCE ", which is to compare with: name "
                        "another --model");
}

/* ---- the picture ----------------------------------------------------------------------------- */

static int write_and_draw(const plot_settings *settings, cli_eval_report *report) {
  static char terminal[] = "-";
  char *terminal_items[] = {terminal};
  const cli_texts onto_terminal = {1, terminal_items};
  const cli_texts *files = &settings->eval.plot, *axes = &settings->axes;
  const enum cli_form form = settings->eval.profile.common.form;
  const size_t measured = report->quantities.count; /* R, and with Monte Carlo its errors */
  cli_picture picture = {0};
  cli_row row = {.gamma = settings->gamma.value};
  const int status = settings->error ? take_deviation(report) : CLI_OK;
  if (status != CLI_OK) {
    return status;
  }
  cli_eval_write(report, form);
  if (form != CLI_NONE && files->count == 0) {
    return CLI_OK;
  }
  parse_size(settings->size, &picture.width_px, &picture.height_px);
  for (size_t i = 0; i < axes->count || i == 0; i++) {
    row.axes = *cli_axes_find(axes->count > 0 ? axes->items[i] : AXES_DEFAULT);
    cli_plot_row(&picture, report, row, 0);
  }
  if (settings->error) {
    row = (cli_row){
        {NULL, row.axes.logarithmic_x, CLI_PERCENT}, 0, "deviation from " REFERENCE " (%)"};
    cli_plot_row(&picture, report, row, measured);
  }
  return cli_plot_report(&picture, report, files->count > 0 ? files : &onto_terminal);
}

/* ---- the command ----------------------------------------------------------------------------- */

/* Checks that a quantity has a value for each radius. */
static int check_quantity(const char *name, dipole_client *client) {
  const dipole_choice *quantity =
      cli_named(dipole_get_info(client), DIPOLE_QUANTITY, "quantity", name);
  if (quantity != NULL && (quantity->id == DIPOLE_ALBEDO || quantity->id == DIPOLE_RADIUS)) {
    return cli_fail_usage("--quantity %s: there is no curve of it over r; name another quantity",
                          name);
  }
  return quantity != NULL ? CLI_OK : CLI_USAGE;
}

/* Asks for one quantity at the radii of `eval`. */
static int ask(cli_eval_settings eval, const char *name, dipole_client *client,
               cli_eval_report *report) {
  char quantity[64];
  char *wanted[] = {quantity};
  snprintf(quantity, sizeof quantity, "%s", name);
  eval.wanted = (cli_texts){1, wanted};
  return cli_eval_ask(&eval, client, report);
}

/* Asks for means over rings, and walks photons beside them. */
static int ask_rings(const plot_settings *settings, dipole_client *client,
                     cli_eval_report *report) {
  const cli_number *thickness = &settings->eval.profile.thickness;
  cli_eval_settings eval = settings->eval;
  cli_rings rings =
      cli_rings_make(eval.from.value, eval.to.value, eval.logarithmic, (size_t)eval.count.value);
  eval.r = (cli_numbers){.count = rings.node_count, .items = rings.nodes_mm};
  int status = ask(eval, "2_pi_r_R", client, report);
  if (status == CLI_OK) {
    cli_rings_take_means(&rings, report);
    status = cli_rings_walk(&rings, settings->photons.value,
                            thickness->given ? thickness->value : (double)INFINITY, client, report);
  }
  cli_rings_free(&rings);
  return status;
}

static int run(void *given, dipole_client *client) {
  const plot_settings *settings = given;
  cli_eval_report report = {0};
  int status = check_quantity(settings->quantity, client);
  if (status == CLI_OK) {
    status = settings->photons.given ? ask_rings(settings, client, &report)
                                     : ask(settings->eval, settings->quantity, client, &report);
  }
  if (status == CLI_OK) {
    status = write_and_draw(settings, &report);
  }
  cli_eval_report_free(&report);
  return status;
}

const cli_command cli_command_plot = {
    .name = "plot",
    .about = "Draw profiles over r, and how far they are from radiative transport",
    .more =
        "\n"
        "Up to four models and eight channels share a panel: each model has a dash, each channel\n"
        "a colour. With more, or with a single channel, each channel has a panel of its own and\n"
        "each model a colour. The axes logarithmic and gamma are those of the figures of d'Eon\n"
        "2012.\n"
        "\n"
        "Three things lie beyond the axes and only show in the numbers, which --format writes. On\n"
        "a linear axis: peaks in the first 2 % of the radii that are more than four times as\n"
        "high as the rest. On a logarithmic axis: values below 1e-12 of the largest. Of\n"
        "deviations: those beyond 200 %.\n"
        "\n"
        "With --mc, a value is the mean over a ring, and stands at the radius that halves the "
        "ring's\n"
        "area. Monte Carlo is drawn as points with their standard errors.\n"
        "\n"
        "gnuplot draws all pictures. Text has colours only on a terminal, unless NO_COLOR is "
        "set.\n",
    .formats = "none,table,csv,json",
    .options = {cli_medium_options, cli_eval_options, options, cli_parameter_options},
    .usual_file = PLOT_FILE,
    .examples =
        "  dipole plot --medium skin1 --model classical,better,transport\n"
        "  dipole plot --medium skin1 --channel red --model all --axes logarithmic,gamma "
        "--error \\\n"
        "    --plot skin1.svg\n"
        "  dipole plot --medium marble,wholemilk --channel green --model better,transport --plot\n"
        "  dipole plot --sigma-a 0.01,0.1,1 --sigma-s 1 --eta 1.4 --quantity 2_pi_r_R \\\n"
        "    --axes linear --to 20 --size 1200x800 --plot a.png --plot a.svg\n"
        "  dipole plot --medium skin1 --quantity cdf --axes linear --format csv\n"
        "  dipole plot --medium skin1 --channel red --model better,transport --mc 1e5 --error\n",
    .settings_bytes = sizeof(plot_settings),
    .check = check,
    .run = run,
};
