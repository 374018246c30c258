/* dipole table: fetches the tables of the evaluator lut, and writes them one by one into a file. */
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "clients/cli/daemon.h"
#include "clients/cli/eval.h"

/* ---- files ----------------------------------------------------------------------------------- */

typedef struct report {
  cli_profile profile;
  dipole_table **tables; /* [profile.channel_count] */
} report;

static bool is_standard(const char *path) {
  return path != NULL && strcmp(path, "-") == 0;
}

/* Writes a file, but not onto a terminal. Says what is wrong and returns false. */
static bool save_tables(const char *path, const report *of) {
  FILE *to = is_standard(path) ? stdout : fopen(path, "wbe");
  if (to == NULL) {
    return cli_fails("cannot write %s: %s", path, strerror(errno));
  }
  const bool terminal = isatty(fileno(to)) == 1;
  bool written = !terminal;
  for (size_t i = 0; written && i < of->profile.channel_count; i++) {
    size_t count;
    const void *bytes = dipole_table_bytes(of->tables[i], &count);
    written = fwrite(bytes, 1, count, to) == count;
  }
  written = cli_file_end(to, path, written);
  return terminal
             ? cli_fails("--output %s: a terminal cannot show binary tables; name a file", path)
             : written || cli_fails("cannot write %s: %s", path, strerror(errno));
}

/* ---- fetching -------------------------------------------------------------------------------- */

static const cli_option options[] = {
    CLI_TITLE("Evaluation"),
    CLI_OPTION(NAME, model, CLI_MODEL_DEFAULT, "see `dipole info`"),
    CLI_MOMENTS_OPTION,
    CLI_TITLE("Output"),
    CLI_OPTION(FILE, output, NULL,
               "write the tables into FILE, binary, one behind the other; -: only write them to "
               "standard output"),
    {0},
};

static int check(cli_settings *settings) {
  if (is_standard(settings->output) && settings->format != NULL) {
    return cli_fail_usage(
        "--output - writes binary to standard output: leave --format out, or name a file");
  }
  return cli_medium_check(settings);
}

static int fetch(const cli_settings *settings, dipole_client *client, report *of) {
  const cli_profile *profile = &of->profile;
  char place[48] = "";
  of->tables = cli_allocate(profile->channel_count, sizeof(dipole_table *));
  for (size_t i = 0; i < profile->channel_count; i++) {
    const dipole_table_query query = {.model = profile->model->id,
                                      CLI_QUERY_OF(profile),
                                      .layers = cli_profile_layers(profile, i),
                                      .layer_count = profile->layer_count};
    dipole_error error;
    if (!CLI_RETRY(settings, &error, dipole_table_fetch(client, &query, &of->tables[i], &error))) {
      if (profile->channel_count > 1) {
        snprintf(place, sizeof place, "channel %s: ", profile->names[i]);
      }
      return cli_fail_error_of(place, &error);
    }
  }
  return CLI_OK;
}

/* ---- writing --------------------------------------------------------------------------------- */

/* Writes the table of a channel. */
static void put_table(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const dipole_table_info *info = dipole_table_get_info(of->tables[index]);
  size_t bytes;
  dipole_table_bytes(of->tables[index], &bytes);
  cli_put_text(rows, of->profile.names[index], "channel");
  cli_put_medium(rows, info->layers, info->layer_count);
  cli_put_number(rows, info->albedo, "albedo");
  cli_put_number(rows, info->pieces_from_mm, "pieces_from", "pieces from", "mm", "%.4g");
  cli_put_number(rows, info->pieces_to_mm, "pieces_to", "to", "mm", "%.4g");
  cli_put_count(rows, bytes, "bytes");
  cli_put_number(rows, info->numerical_error, "numerical_error", "numerical error", NULL, "%.1e",
                 .below = "relative, at most");
  cli_put_number(rows, info->reach_mm, "reach", "holds up to", "mm", "%.4g");
  cli_put_number(rows, info->model_error, "model_error", "model error", NULL, "%.1e", "by radius",
                 .below = "at all radii");
}

static void put_facts(cli_rows *rows, const void *context) {
  const report *of = context;
  cli_put_profile(rows, &of->profile);
}

static void write_foot(const void *context) {
  const report *of = context;
  unsigned notes = 0;
  puts("numerical error: of R and cdf against the model's formula, as measured\n"
       "holds up to: the numerical error of R is larger at radii beyond this one\n"
       "model error: of the model against radiative transport\n"
       "libdipole and the Python module state both errors for the radii that they evaluate");
  for (size_t i = 0; i < of->profile.channel_count; i++) {
    notes |= dipole_table_get_info(of->tables[i])->notes;
  }
  cli_write_launched(of->profile.media, of->profile.channel_count, of->profile.layer_count);
  cli_write_notes(of->profile.info, notes);
}

/* ---- the command ----------------------------------------------------------------------------- */

static int request_and_write(const cli_settings *settings, dipole_client *client, report *of) {
  int status = cli_profile_take(settings, client, &of->profile);
  status = status == CLI_OK ? fetch(settings, client, of) : status;
  if (status != CLI_OK) {
    return status;
  }
  if (settings->output != NULL && !save_tables(settings->output, of)) {
    return CLI_FAILED;
  }
  if (is_standard(settings->output)) {
    return CLI_OK;
  }
  const cli_report output = {.facts = put_facts,
                             .rows = of->profile.channel_count,
                             .put_row = put_table,
                             .left = 1,
                             .foot = write_foot};
  cli_write(&output, settings->form, of);
  return CLI_OK;
}

static int run_table(const cli_settings *settings, dipole_client *client) {
  report of = {0};
  const int status = request_and_write(settings, client, &of);
  for (size_t i = 0; of.tables != NULL && i < of.profile.channel_count; i++) {
    dipole_table_free(of.tables[i]);
  }
  return status;
}

const cli_command cli_command_table = {
    .name = "table",
    .about = "Fetch tables of a medium, to be evaluated without a daemon",
    .more =
        "Each channel has a table, as the evaluator lut uses it. --tolerance says how exact it "
        "is, from 1e-6 to 1 (default: 1e-4). A value above 0.1 counts as 0.1. libdipole and the "
        "Python module evaluate a file of --output to the same bits as the daemon.",
    .formats = "table,csv,json",
    .options = {cli_medium_options, cli_layer_options, options},
    .parameters = CLI_OF_MODELS,
    .examples = "  dipole table --medium skin1 --output skin1.table\n"
                "  dipole table --sigma-a 0.01 --sigma-s 1 --tolerance 1e-5 --format json\n",
    .check = check,
    .run = run_table,
};
