/* dipole eval: profiles of a medium over a range of radii. */
#include "clients/cli/eval.h"

#include <string.h>

#define PLOT_FILE "dipole.svg"

#define FIELD(name) offsetof(cli_eval_settings, name)

static const cli_option options[] = {
    {"Medium", NULL, NULL, CLI_HEADING, 0},
    {"medium", "NAME", "a measured medium, see `dipole media`: red, green and blue", CLI_TEXT,
     FIELD(medium)},
    {"sigma-a", "X[,X...]", "absorption coefficient, 1/mm; one value for each channel", CLI_NUMBERS,
     FIELD(sigma_a)},
    {"sigma-s", "X[,X...]", "scattering coefficient, 1/mm; a single value holds for all channels",
     CLI_NUMBERS, FIELD(sigma_s)},
    {"g", "X[,X...]", "mean cosine of the scattering angle (default: 0)", CLI_NUMBERS, FIELD(g)},
    {"eta", "X[,X...]",
     "refractive index inside over outside (default: the measured\nmedium's, else 1.3)",
     CLI_NUMBERS, FIELD(eta)},
    {"Radii", NULL, NULL, CLI_HEADING, 0},
    {"r", "X[,X...]", "these radii, mm; inf is one too", CLI_NUMBERS, FIELD(r)},
    {"from", "X", "the first radius of a grid, mm (default: 0)", CLI_NUMBER, FIELD(from)},
    {"to", "X", "its last radius, mm (default: 10)", CLI_NUMBER, FIELD(to)},
    {"count", "N", "how many radii it has (default: 21)", CLI_COUNT, FIELD(count)},
    {"log", NULL, "equal ratios from radius to radius instead of equal steps; needs --from",
     CLI_SWITCH, FIELD(logarithmic)},
    {"Evaluation", NULL, NULL, CLI_HEADING, 0},
    {"model", "NAME[,NAME...]",
     "see `dipole info`; all: every model that takes what is asked, those that\n"
     "refuse it are named on standard error (default: better)",
     CLI_NAMES, FIELD(model)},
    {"moments", "NAME", "Fresnel moments, see `dipole info` (default: exact)", CLI_TEXT,
     FIELD(moments)},
    {"evaluator", "NAME", "f64, f32 (single precision) or lut (a table; default: f64)", CLI_TEXT,
     FIELD(evaluator)},
    {"want", "NAME[,NAME...]",
     "R: 1/mm^2 per unit of power that entered; albedo; cdf: the share of\n"
     "the albedo within r; S: 1/(mm^2 sr); others: see `dipole info`\n"
     "(default: R,albedo)",
     CLI_NAMES, FIELD(want)},
    {"Output", NULL, NULL, CLI_HEADING, 0},
    {"plot", "[FILE]",
     "also draw R over r into FILE.svg or FILE.png (default: " PLOT_FILE "); may be\n"
     "repeated",
     CLI_FILES, FIELD(plot)},
    {0},
};

static const struct {
  const char *name;
  void (*write)(const cli_eval_report *report, FILE *file);
} formats[] = {
    {"table", cli_eval_write_table},
    {"csv", cli_eval_write_csv},
    {"json", cli_eval_write_json},
};

/* What can be seen to be wrong without a daemon. */
static int check(const cli_command *command, const cli_eval_settings *settings) {
  const bool coefficients = settings->sigma_a.count > 0 || settings->sigma_s.count > 0;
  if (settings->medium == NULL && (settings->sigma_a.count == 0 || settings->sigma_s.count == 0)) {
    return cli_fail_usage(command, "give --medium NAME, or --sigma-a and --sigma-s");
  }
  if (settings->medium != NULL && (coefficients || settings->g.count > 0)) {
    return cli_fail_usage(command, "--medium NAME stands for --sigma-a, --sigma-s and --g: leave "
                                   "these out; --eta may stay");
  }
  if (settings->r.count > 0 && (settings->from.given || settings->to.given ||
                                settings->count.given || settings->logarithmic)) {
    return cli_fail_usage(command, "--r gives the radii one by one: leave --from, --to, --count "
                                   "and --log out");
  }
  if (settings->logarithmic && !settings->from.given) {
    return cli_fail_usage(command, "--log needs --from, above 0");
  }
  for (size_t i = 0; i < settings->plot.count; i++) {
    if (!cli_plot_check(command, settings->plot.items[i])) {
      return CLI_USAGE;
    }
  }
  return CLI_OK;
}

static void write_report(const cli_eval_settings *settings, const cli_eval_report *report) {
  const char *format =
      settings->profile.common.format != NULL ? settings->profile.common.format : formats[0].name;
  for (size_t i = 0; i < sizeof formats / sizeof formats[0]; i++) {
    if (strcmp(formats[i].name, format) == 0) {
      formats[i].write(report, stdout);
    }
  }
}

static int ask_and_write(const cli_command *command, const cli_eval_settings *settings,
                         dipole_client *client) {
  cli_eval_report report = {0};
  int status = cli_eval_ask(command, settings, client, &report);
  if (status == CLI_OK && settings->plot.count > 0 && (report.wanted & DIPOLE_R) == 0) {
    status = cli_fail_usage(command, "--plot draws R: add R to --want");
  }
  if (status == CLI_OK) {
    write_report(settings, &report);
  }
  for (size_t i = 0; status == CLI_OK && i < settings->plot.count; i++) {
    const char *file = settings->plot.items[i];
    status = cli_plot(command, &report, file);
    if (status == CLI_OK && strcmp(file, PLOT_FILE) == 0) { /* which may not have been named */
      fprintf(stderr, "dipole %s: the picture is %s\n", command->name, file);
    }
  }
  cli_eval_report_free(&report);
  return status;
}

static int run(const cli_command *command, int argc, char **argv) {
  cli_eval_settings settings = {0};
  dipole_client *client;
  const char *operand;
  int status;
  if (cli_options_read(command, argc, argv, &settings, &operand, &status)) {
    status = check(command, &settings);
    if (status == CLI_OK && !cli_open(command, &settings.profile.common, &client)) {
      status = CLI_FAILED;
    } else if (status == CLI_OK) {
      status = ask_and_write(command, &settings, client);
      dipole_close(client);
    }
  }
  cli_options_free(command, &settings);
  return status;
}

const cli_command cli_command_eval = {
    .name = "eval",
    .about = "Evaluate a medium over a range of radii, as a table or a picture",
    .more =
        "\n"
        "Beside the values stand their numerical error, the model's own error where it has been\n"
        "measured, and notes on what the model does not do. Where R is infinite, at r = 0 of\n"
        "some models, tables and CSV say inf, JSON \"inf\"; NaN is an empty cell or null.\n",
    .formats = "table,csv,json",
    .options = options,
    .shared_options = cli_parameter_options,
    .usual_file = PLOT_FILE,
    .examples = "  dipole eval --medium skin1 --model classical,better --plot skin1.svg\n"
                "  dipole eval --sigma-a 0.01,0.1 --sigma-s 10 --g 0.9 --eta 1.4 --r 0,0.5,1,2\n"
                "  dipole eval --medium marble --from 0.01 --to 100 --count 41 --log --format csv\n"
                "  dipole eval --medium skin2 --eta 1 --moments fit --want albedo\n"
                "  dipole eval --medium skin1 --want S --cos-in 0.8 --cos-out 0.5 --r 0.5,1,2\n"
                "  dipole eval --medium skin1 --model all --plot\n",
    .run = run,
};
