/* dipole eval: profiles of a medium over a range of radii. */
#include "clients/cli/eval.h"

#include <stdlib.h>
#include <string.h>

#include "clients/cli/gnuplot.h"

#define PLOT_FILE "dipole.svg"

#define FIELD(name) offsetof(cli_eval_settings, name)

static const cli_option options[] = {
    CLI_MEDIUM_OPTIONS(cli_eval_settings),
    {"table", "FILE",
     "evaluate the tables in a file of `dipole table`, without a daemon;\n"
     "-: standard input",
     CLI_TEXT, FIELD(table)},
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
     "refuse it are named on standard error (default: with --tolerance the\n"
     "cheapest that is so near to radiative transport, else better)",
     CLI_NAMES, FIELD(model)},
    {"moments", "NAME", "Fresnel moments, see `dipole info` (default: exact)", CLI_TEXT,
     FIELD(moments)},
    {"evaluator", "NAME",
     "f64 or f32: double or single precision; lut: single, by a table\n"
     "(default: f64; where the tolerance decides, the cheapest)",
     CLI_TEXT, FIELD(evaluator)},
    {"want", "NAME[,NAME...]",
     "R: 1/mm^2 per unit of power that entered; albedo; cdf: the share of\n"
     "the albedo within r; S: 1/(mm^2 sr); others: see `dipole info`\n"
     "(default: R,albedo)",
     CLI_NAMES, FIELD(want)},
    {"deadline-ms", "N",
     "the daemon shall answer within N ms of each query, or not at all; 0: at\n"
     "any time (default: 0)",
     CLI_COUNT, FIELD(deadline_ms)},
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

/* Everything about the profile is in the file. */
static int check_table(const cli_command *command, const cli_eval_settings *settings) {
  const cli_option *parameter = cli_parameters_given(&settings->profile);
  if (cli_channels_given(&settings->medium) || settings->model.count > 0 ||
      settings->moments != NULL || settings->evaluator != NULL || parameter != NULL ||
      settings->deadline_ms.given || settings->profile.common.connect != NULL) {
    return cli_fail_usage(command, "--table FILE says what is evaluated, and needs no daemon: of "
                                   "the options leave all out but radii, --want and output");
  }
  return CLI_OK;
}

/* What can be seen to be wrong without a daemon. */
static int check(const cli_command *command, const cli_eval_settings *settings) {
  const int status = settings->table != NULL ? check_table(command, settings)
                                             : cli_channels_check(command, &settings->medium);
  if (status != CLI_OK) {
    return status;
  }
  if (settings->r.count > 0 && (settings->from.given || settings->to.given ||
                                settings->count.given || settings->logarithmic)) {
    return cli_fail_usage(command, "--r gives the radii one by one: leave --from, --to, --count "
                                   "and --log out");
  }
  if (settings->logarithmic && !settings->from.given) {
    return cli_fail_usage(command, "--log needs --from, above 0");
  }
  if (settings->deadline_ms.value > UINT32_MAX) {
    return cli_fail_usage(command, "--deadline-ms: at most %lu", (unsigned long)UINT32_MAX);
  }
  for (size_t i = 0; i < settings->plot.count; i++) {
    if (!cli_gnuplot_check(command, settings->plot.items[i])) {
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

static int draw(const cli_command *command, const cli_eval_settings *settings,
                const cli_eval_report *report) {
  int status = CLI_OK;
  for (size_t i = 0; status == CLI_OK && i < settings->plot.count; i++) {
    const char *file = settings->plot.items[i];
    status = cli_plot(command, report, file);
    if (status == CLI_OK && strcmp(file, PLOT_FILE) == 0) { /* which may not have been named */
      fprintf(stderr, "dipole %s: the picture is %s\n", command->name, file);
    }
  }
  return status;
}

/* Takes the report over, and the exit status of what has filled it. */
static int write_and_free(const cli_command *command, const cli_eval_settings *settings,
                          cli_eval_report *report, int status) {
  if (status == CLI_OK && settings->plot.count > 0 && (report->wanted & DIPOLE_R) == 0) {
    status = cli_fail_usage(command, "--plot draws R: add R to --want");
  }
  if (status == CLI_OK) {
    write_report(settings, report);
    status = draw(command, settings, report);
  }
  cli_eval_report_free(report);
  return status;
}

static int run_with_daemon(const cli_command *command, const cli_eval_settings *settings) {
  cli_eval_report report = {0};
  dipole_client *client;
  if (!cli_open(command, &settings->profile.common, &client)) {
    return CLI_FAILED;
  }
  const int asked = cli_eval_ask(command, settings, client, &report);
  const int status = write_and_free(command, settings, &report, asked);
  dipole_close(client);
  return status;
}

static int run_with_table(const cli_command *command, const cli_eval_settings *settings) {
  cli_eval_report report = {0};
  dipole_info *info = NULL;
  const int evaluated = cli_eval_table(command, settings, &report, &info);
  const int status = write_and_free(command, settings, &report, evaluated);
  free(info);
  return status;
}

static int run(const cli_command *command, int argc, char **argv) {
  cli_eval_settings settings = {0};
  const char *operand;
  int status;
  if (cli_options_read(command, argc, argv, &settings, &operand, &status)) {
    status = check(command, &settings);
    if (status == CLI_OK) {
      status = settings.table != NULL ? run_with_table(command, &settings)
                                      : run_with_daemon(command, &settings);
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
        "some models, tables and CSV say inf, JSON \"inf\"; NaN is an empty cell or null.\n"
        "\n"
        "With --tolerance and without --model the daemon takes the cheapest model and evaluator\n"
        "that are measured to be within it of radiative transport, for all channels and radii;\n"
        "below the table it says which and why. With --model, --tolerance is numerical.\n",
    .formats = "table,csv,json",
    .options = options,
    .shared_options = cli_parameter_options,
    .usual_file = PLOT_FILE,
    .examples = "  dipole eval --medium skin1 --model classical,better --plot skin1.svg\n"
                "  dipole eval --sigma-a 0.01,0.1 --sigma-s 10 --g 0.9 --eta 1.4 --r 0,0.5,1,2\n"
                "  dipole eval --medium marble --from 0.01 --to 100 --count 41 --log --format csv\n"
                "  dipole eval --medium skin2 --eta 1 --moments fit --want albedo\n"
                "  dipole eval --medium skin1 --want S --cos-in 0.8 --cos-out 0.5 --r 0.5,1,2\n"
                "  dipole eval --medium skin1 --tolerance 0.01\n"
                "  dipole eval --medium skin1 --model transport --evaluator lut --want R,cdf\n"
                "  dipole eval --medium skin1 --model all --plot\n",
    .run = run,
};
