/* dipole sample: radii drawn in proportion to the light that leaves there. */
#include "clients/cli/sample.h"

#include <string.h>

#include "clients/cli/gnuplot.h"

#define PLOT_FILE "dipole.svg"

#define FIELD(name) offsetof(cli_sample_settings, name)

static const cli_option options[] = {
    CLI_MEDIUM_OPTIONS(cli_sample_settings),
    {"Numbers", NULL, NULL, CLI_HEADING, 0},
    {"u", "X[,X...]", "these numbers, from 0 (0 mm) to 1 (infinity)", CLI_NUMBERS, FIELD(u)},
    {"count", "N", "how many numbers are drawn (default: 10)", CLI_COUNT, FIELD(count)},
    {"draw", "NAME",
     "random; stratified: one in each of N equal intervals; regular: the\n"
     "middles of these (default: random)",
     CLI_TEXT, FIELD(draw)},
    {"seed", "N", "of random and stratified: the same seed gives the same bits (default: 1)",
     CLI_COUNT, FIELD(seed)},
    {"first", "N", "of random: which number of the seed is the first (default: 0)", CLI_COUNT,
     FIELD(first)},
    {"Evaluation", NULL, NULL, CLI_HEADING, 0},
    {"model", "NAME", "see `dipole info`; one that covers all radii (default: better)", CLI_TEXT,
     FIELD(model)},
    {"moments", "NAME", "Fresnel moments, see `dipole info` (default: exact)", CLI_TEXT,
     FIELD(moments)},
    {"evaluator", "NAME",
     "f64 or f32: double or single precision; lut: single, by a table, which\n"
     "draws fastest (default: f64)",
     CLI_TEXT, FIELD(evaluator)},
    {"want", "NAME[,NAME...]",
     "r: the radii; pdf: their density, 1/mm (over 2 pi r: that of points on\n"
     "the surface); others, at these radii: see `dipole info` (default: r,pdf)",
     CLI_NAMES, FIELD(want)},
    {"deadline-ms", "N",
     "the daemon shall answer within N ms, or not at all; 0: at any time\n"
     "(default: 0)",
     CLI_COUNT, FIELD(deadline_ms)},
    {"Output", NULL, NULL, CLI_HEADING, 0},
    {"plot", "[FILE]",
     "also draw a histogram of the radii, and their density, into FILE.svg or\n"
     "FILE.png (default: " PLOT_FILE "); may be repeated",
     CLI_FILES, FIELD(plot)},
    {0},
};

static const struct {
  const char *name;
  void (*write)(const cli_sample_report *report, FILE *file);
} formats[] = {
    {"table", cli_sample_write_table},
    {"csv", cli_sample_write_csv},
    {"json", cli_sample_write_json},
};

/* What can be seen to be wrong without a daemon. */
static int check(const cli_command *command, const cli_sample_settings *settings) {
  const int status = cli_channels_check(command, &settings->medium);
  if (status != CLI_OK) {
    return status;
  }
  if (settings->u.count > 0 && (settings->count.given || settings->draw != NULL ||
                                settings->seed.given || settings->first.given)) {
    return cli_fail_usage(command, "--u gives the numbers one by one: leave --count, --draw, "
                                   "--seed and --first out");
  }
  if (settings->deadline_ms.value > UINT32_MAX) {
    return cli_fail_usage(command, "--deadline-ms: at most %lu", (unsigned long)UINT32_MAX);
  }
  for (size_t i = 0; i < settings->plot.count; i++) {
    if (!cli_gnuplot_draws(settings->plot.items[i])) {
      return cli_fail_usage(command, "--plot %s: the name must end in .svg or .png",
                            settings->plot.items[i]);
    }
  }
  return CLI_OK;
}

static int write_report(const cli_command *command, const cli_sample_settings *settings,
                        const cli_sample_report *report) {
  const char *format =
      settings->profile.common.format != NULL ? settings->profile.common.format : formats[0].name;
  for (size_t i = 0; i < sizeof formats / sizeof formats[0]; i++) {
    if (strcmp(formats[i].name, format) == 0) {
      formats[i].write(report, stdout);
    }
  }
  int status = CLI_OK;
  for (size_t i = 0; status == CLI_OK && i < settings->plot.count; i++) {
    const char *file = settings->plot.items[i];
    status = cli_sample_plot(command, report, file);
    if (status == CLI_OK && strcmp(file, PLOT_FILE) == 0) { /* which may not have been named */
      fprintf(stderr, "dipole %s: the picture is %s\n", command->name, file);
    }
  }
  return status;
}

static int run(const cli_command *command, int argc, char **argv) {
  cli_sample_settings settings = {0};
  cli_sample_report report = {0};
  dipole_client *client;
  const char *operand;
  int status;
  if (cli_options_read(command, argc, argv, &settings, &operand, &status)) {
    status = check(command, &settings);
    if (status == CLI_OK && !cli_open(command, &settings.profile.common, &client)) {
      status = CLI_FAILED;
    } else if (status == CLI_OK) {
      status = cli_sample_ask(command, &settings, client, &report);
      status = status == CLI_OK ? write_report(command, &settings, &report) : status;
      cli_sample_report_free(&report);
      dipole_close(client);
    }
  }
  cli_options_free(command, &settings);
  return status;
}

const cli_command cli_command_sample = {
    .name = "sample",
    .about = "Draw radii in proportion to the light that leaves there",
    .more = "\n"
            "For each number u the radius within which the share u of the light leaves: uniform\n"
            "numbers give radii in proportion to r R(r). All channels get the same numbers.\n",
    .formats = "table,csv,json",
    .options = options,
    .shared_options = cli_parameter_options,
    .usual_file = PLOT_FILE,
    .examples = "  dipole sample --medium skin1\n"
                "  dipole sample --medium skin1 --u 0.1,0.5,0.9 --want r,pdf,R,cdf\n"
                "  dipole sample --sigma-a 0.01 --sigma-s 1 --count 1000 --draw stratified "
                "--seed 7 --format csv\n"
                "  dipole sample --medium marble --model burley --count 10000 --plot marble.svg\n"
                "  dipole sample --medium skin1 --model transport --evaluator lut --count 1000\n",
    .run = run,
};
