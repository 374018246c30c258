/* dipole table: fetches the tables that the evaluator lut uses, so that they can be evaluated
 * without a daemon. */
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/profile.h"
#include "clients/cli/rows.h"
#include "clients/cli/tables_file.h"

static const cli_option options[] = {
    CLI_TITLE("Evaluation"),
    CLI_OPTION(NAME, model, CLI_MODEL_DEFAULT, "see `dipole info`"),
    CLI_MOMENTS_OPTION,
    CLI_TITLE("Output"),
    CLI_OPTION(
        FILE, output, NULL,
        "write the tables into FILE, binary, one behind the other; -: only write them to standard "
        "output"),
    {0},
};

typedef struct report {
  cli_profile profile;
  cli_tables tables; /* one for each channel */
} report;

static bool is_to_standard(const cli_settings *settings) {
  return settings->output != NULL && strcmp(settings->output, "-") == 0;
}

static int check(cli_settings *settings) {
  if (is_to_standard(settings) && settings->format != NULL) {
    return cli_fail_usage("--output - writes binary to standard output: leave --format "
                          "out, or name a file");
  }
  return cli_medium_check(settings);
}

static int fetch(const cli_settings *settings, dipole_client *client, report *of) {
  const cli_profile *profile = &of->profile;
  char place[48] = "";
  for (size_t i = 0; i < profile->channel_count; i++) {
    const dipole_table_query query = {.model = profile->model->id,
                                      .moments = profile->moments->id,
                                      .medium = profile->media[i],
                                      .parameters = profile->parameters.items,
                                      .parameter_count = profile->parameters.count};
    dipole_table *table;
    dipole_error error;
    if (!CLI_ASK(settings, &error, dipole_table_fetch(client, &query, &table, &error))) {
      if (profile->channel_count > 1) {
        snprintf(place, sizeof place, "channel %s: ", profile->channels[i].name);
      }
      return cli_fail_error_of(place, &error);
    }
    cli_tables_add(&of->tables, table);
  }
  return CLI_OK;
}

/* ---- writing --------------------------------------------------------------------------------- */

/* Puts the table of a channel. */
static void put_table(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const dipole_table_info *info = dipole_table_get_info(of->tables.items[index]);
  size_t bytes;
  dipole_table_bytes(of->tables.items[index], &bytes);
  cli_put_text(rows, CLI_COLUMN("channel"), of->profile.channels[index].name);
  cli_put_medium(rows, &info->medium);
  cli_put_number(rows, CLI_COLUMN("albedo"), info->albedo);
  cli_put_number(rows, CLI_COLUMN("pieces_from", "pieces from", "mm", "%.4g"),
                 info->pieces_from_mm);
  cli_put_number(rows, CLI_COLUMN("pieces_to", "to", "mm", "%.4g"), info->pieces_to_mm);
  cli_put_count(rows, CLI_COLUMN("bytes"), bytes);
  cli_put_number(
      rows,
      CLI_COLUMN("numerical_error", "numerical error", NULL, "%.1e", .below = "relative, at most"),
      info->numerical_error);
  cli_put_number(rows, CLI_COLUMN("reach", "holds up to", "mm", "%.4g"), info->reach_mm);
  cli_put_number(
      rows,
      CLI_COLUMN("model_error", "model error", NULL, "%.1e", "by radius", .below = "at all radii"),
      info->model_error);
}

static void put_facts(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  (void)index;
  cli_put_profile(rows, &of->profile);
}

static void write_foot(const void *context) {
  const report *of = context;
  unsigned notes = 0;
  puts("numerical error: of R and cdf against the model's formula, as measured\n"
       "holds up to: the numerical error of R is larger at radii beyond this one\n"
       "model error: of the model against radiative transport\n"
       "`dipole eval --table` states both errors for the radii that it is asked for");
  for (size_t i = 0; i < of->tables.count; i++) {
    notes |= dipole_table_get_info(of->tables.items[i])->notes;
  }
  cli_write_launched(of->profile.media, of->profile.channel_count);
  cli_write_notes(of->profile.info, notes);
}

/* ---- the command ----------------------------------------------------------------------------- */

static int ask_and_write(const cli_settings *settings, dipole_client *client, report *of) {
  int status = cli_profile_take(settings, client, &of->profile);
  status = status == CLI_OK ? fetch(settings, client, of) : status;
  if (status != CLI_OK) {
    return status;
  }
  if (settings->output != NULL && !cli_tables_save(settings->output, &of->tables)) {
    return CLI_FAILED;
  }
  if (is_to_standard(settings)) {
    return CLI_OK;
  }
  const cli_report output = {.facts = put_facts,
                             .rows = of->tables.count,
                             .put_row = put_table,
                             .left = 1,
                             .foot = write_foot};
  cli_write(&output, settings->form, of);
  return CLI_OK;
}

static int run(const cli_settings *settings, dipole_client *client) {
  report of = {0};
  const int status = ask_and_write(settings, client, &of);
  cli_tables_free(&of.tables);
  return status;
}

const cli_command cli_command_table = {
    .name = "table",
    .about = "Fetch tables of a medium, to be evaluated without a daemon",
    .more =
        "Each channel has a table, as the evaluator lut uses it. --tolerance says how exact it "
        "is, from 1e-6 to 1 (default: 1e-4). A value above 0.1 counts as 0.1. `dipole eval "
        "--table`, libdipole and the Python module evaluate a file of --output to the same bits "
        "and errors as the daemon.",
    .formats = "table,csv,json",
    .options = {cli_medium_options, options},
    .parameters = CLI_OF_MODELS,
    .examples = "  dipole table --medium skin1 --output skin1.table\n"
                "  dipole eval --table skin1.table --r 0.1,1,10 --wanted R,cdf\n"
                "  dipole table --sigma-a 0.01 --sigma-s 1 --tolerance 1e-5 --format json\n",
    .check = check,
    .run = run,
};
