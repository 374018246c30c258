/* dipole table: the tables by which the evaluator lut works, fetched to be evaluated elsewhere. */
#include "clients/cli/tables.h"

#include <stdlib.h>
#include <string.h>

#define MODEL_DEFAULT "better"
#define MOMENTS_DEFAULT "exact"
#define STANDARD "-"

typedef struct table_settings {
  cli_profile_settings profile;
  cli_medium_settings medium;
  const char *model, *moments, *output;
} table_settings;

#define FIELD(name) offsetof(table_settings, name)

static const cli_option options[] = {
    CLI_MEDIUM_OPTIONS(table_settings),
    {"Evaluation", NULL, NULL, CLI_HEADING, 0},
    {"model", "NAME", "see `dipole info` (default: better)", CLI_TEXT, FIELD(model)},
    {"moments", "NAME", "Fresnel moments, see `dipole info` (default: exact)", CLI_TEXT,
     FIELD(moments)},
    {"Output", NULL, NULL, CLI_HEADING, 0},
    {"output", "FILE",
     "write the tables into FILE, binary, one behind the other; -: to standard\n"
     "output, and nothing else",
     CLI_TEXT, FIELD(output)},
    {0},
};

static const struct {
  const char *name;
  void (*write)(const cli_tables_report *report, FILE *file);
} formats[] = {
    {"table", cli_tables_write_table},
    {"csv", cli_tables_write_csv},
    {"json", cli_tables_write_json},
};

static bool is_to_standard(const table_settings *settings) {
  return settings->output != NULL && strcmp(settings->output, STANDARD) == 0;
}

/* What can be seen to be wrong without a daemon. */
static int check(const cli_command *command, const table_settings *settings) {
  if (is_to_standard(settings) && settings->profile.common.format != NULL) {
    return cli_fail_usage(command, "--output - writes binary to standard output: leave --format "
                                   "out, or name a file");
  }
  return cli_channels_check(command, &settings->medium);
}

static int fetch(const cli_command *command, const table_settings *settings, dipole_client *client,
                 cli_tables_report *report) {
  char option[64], place[48] = "";
  for (size_t i = 0; i < report->channels.count; i++) {
    const cli_channel *channel = &report->channels.items[i];
    const dipole_table_query query = {.model = report->model->id,
                                      .moments = report->moments->id,
                                      .medium = channel->medium,
                                      .parameters = report->parameters.items,
                                      .parameter_count = report->parameters.count};
    dipole_table *table;
    dipole_error error;
    if (!cli_table_fetch(client, &settings->profile.common, &query, &table, &error)) {
      if (report->channels.count > 1) {
        snprintf(place, sizeof place, "channel %s: ", channel->name);
      }
      return cli_fail(command, "%s%s%s", place, error.text,
                      cli_option_of(command, error.field, option, sizeof option));
    }
    cli_tables_add(&report->tables, table);
  }
  return CLI_OK;
}

static int ask(const cli_command *command, const table_settings *settings, dipole_client *client,
               cli_tables_report *report) {
  const char *model = settings->model != NULL ? settings->model : MODEL_DEFAULT;
  const char *moments = settings->moments != NULL ? settings->moments : MOMENTS_DEFAULT;
  report->info = dipole_get_info(client);
  report->model = cli_named(command, report->info, DIPOLE_MODEL, "model", model);
  if (report->model == NULL) {
    return CLI_USAGE;
  }
  report->moments = cli_named(command, report->info, DIPOLE_MOMENTS, "moments", moments);
  if (report->moments == NULL ||
      !cli_parameters_take(command, report->info, &settings->profile, &report->parameters)) {
    return CLI_USAGE;
  }
  const int status = cli_channels_take(command, &settings->medium, client, &report->channels);
  return status == CLI_OK ? fetch(command, settings, client, report) : status;
}

static int write_out(const cli_command *command, const table_settings *settings,
                     const cli_tables_report *report) {
  if (settings->output != NULL && !cli_tables_save(command, settings->output, &report->tables)) {
    return CLI_FAILED;
  }
  const char *format = settings->profile.common.format;
  format = format != NULL ? format : formats[0].name;
  for (size_t i = 0; i < sizeof formats / sizeof formats[0]; i++) {
    if (!is_to_standard(settings) && strcmp(formats[i].name, format) == 0) {
      formats[i].write(report, stdout);
    }
  }
  return CLI_OK;
}

static int run(const cli_command *command, int argc, char **argv) {
  table_settings settings = {0};
  cli_tables_report report = {0};
  dipole_client *client;
  const char *operand;
  int status;
  if (cli_options_read(command, argc, argv, &settings, &operand, &status)) {
    status = check(command, &settings);
    if (status == CLI_OK && !cli_open(command, &settings.profile.common, &client)) {
      status = CLI_FAILED;
    } else if (status == CLI_OK) {
      status = ask(command, &settings, client, &report);
      if (status == CLI_OK) {
        status = write_out(command, &settings, &report);
      }
      dipole_close(client);
    }
  }
  cli_tables_free(&report.tables);
  free(report.channels.items);
  cli_options_free(command, &settings);
  return status;
}

const cli_command cli_command_table = {
    .name = "table",
    .about = "Fetch tables of a medium, to be evaluated without a daemon",
    .more =
        "\n"
        "One table for each channel, as the evaluator lut uses it, built to --tolerance (1e-6 to\n"
        "0.1; default: 1e-4). A file of --output is for `dipole eval --table`, libdipole and the\n"
        "Python module, which all evaluate it to the same bits as the daemon.\n"
        "\n"
        "CSV has a row for each constant (its value is in c0), then one for each piece of the\n"
        "functions R (times scale; 1/mm^2), cdf, radius_of_u and radius_of_1_minus_u (mm; for u\n"
        "above 1/2): from `from` on and below `to` the value is c0 + w (c1 + w (c2 + w c3)), in\n"
        "single precision, where w goes from 0 to 1, or, where the piece is written from the\n"
        "right, from 1 to 0. JSON has the words themselves, bits as integers. proto/PROTOCOL.md\n"
        "describes them, and what holds outside of the pieces.\n",
    .formats = "table,csv,json",
    .options = options,
    .shared_options = cli_parameter_options,
    .examples = "  dipole table --medium skin1 --model transport --output skin1.table\n"
                "  dipole eval --table skin1.table --r 0.1,1,10 --want R,cdf\n"
                "  dipole table --sigma-a 0.01 --sigma-s 1 --tolerance 1e-5 --format csv\n",
    .run = run,
};
