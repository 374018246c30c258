/* dipole table: fetches the tables that the evaluator lut uses, so that they can be evaluated
 * without a daemon. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/profile.h"
#include "clients/cli/rows.h"
#include "clients/cli/tables_file.h"

typedef struct table_settings {
  cli_profile_settings profile;
  const char *output;
} table_settings;

static const cli_option options[] = {
    {"Evaluation", NULL, NULL, CLI_HEADING, 0, NULL},
    {"model", "NAME", "see `dipole info` (default: transport)", CLI_TEXT,
     offsetof(cli_profile_settings, model), CLI_MODEL_DEFAULT},
    {CLI_MOMENTS_OPTION, "exact"},
    {"Output", NULL, NULL, CLI_HEADING, 0, NULL},
    {"output", "FILE",
     "write the tables into FILE, binary, one behind the other; -: only write\n"
     "them to standard output",
     CLI_TEXT, offsetof(table_settings, output), NULL},
    {0},
};

typedef struct report {
  cli_profile profile;
  cli_tables tables; /* one for each channel */
} report;

static bool is_to_standard(const table_settings *settings) {
  return settings->output != NULL && strcmp(settings->output, "-") == 0;
}

static int check(void *given) {
  const table_settings *settings = given;
  if (is_to_standard(settings) && settings->profile.common.format != NULL) {
    return cli_fail_usage("--output - writes binary to standard output: leave --format "
                          "out, or name a file");
  }
  return cli_medium_check(&settings->profile);
}

static int fetch(const table_settings *settings, dipole_client *client, report *of) {
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
    if (!CLI_ASK(&settings->profile.common, &error,
                 dipole_table_fetch(client, &query, &table, &error))) {
      if (profile->channel_count > 1) {
        snprintf(place, sizeof place, "channel %s: ", profile->channels[i].name);
      }
      return cli_fail_error_of(place, &error);
    }
    cli_tables_add(&of->tables, table);
  }
  return CLI_OK;
}

/* ---- the words of a table, as proto/PROTOCOL.md has them ------------------------------------- */

enum { WORDS_BEFORE_PIECES = 784, PIECE_WORDS = 4, SAMPLE_WORDS = 1856, MANTISSA_BITS = 23 };

/* The entry of an octave that has no pieces. */
enum { ENTRY_OUTSIDE = MANTISSA_BITS };

static const char *const constants[] = {
    "pieces_from", "pieces_to", "scale",    "ring_scale",  "pdf_scale",
    "near_power",  "near_R",    "near_log", "near_cdf",    "near_cdf_log",
    "far",         "limit",     "first_u",  "near_radius",
};

/* The functions that are stored in pieces. Each has `count` entries, one for each exponent of its
 * argument, from word number `entries` on. */
static const struct {
  const char *name;
  size_t entries, count;
} functions[] = {{"R", 16, 256},
                 {"cdf", 272, 256},
                 {"radius_of_u", 528, 128},
                 {"radius_of_1_minus_u", 656, 128}};

static size_t count_pieces(const dipole_table_info *info) {
  return (info->word_count - WORDS_BEFORE_PIECES - SAMPLE_WORDS) / PIECE_WORDS;
}

static double number_of(uint32_t word) {
  float number;
  memcpy(&number, &word, sizeof number);
  return (double)number;
}

/* ---- writing --------------------------------------------------------------------------------- */

/* Writes the table of a channel, for people and in JSON. */
static void put_table(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const dipole_table_info *info = dipole_table_get_info(of->tables.items[index]);
  size_t bytes;
  dipole_table_bytes(of->tables.items[index], &bytes);
  cli_put_text(rows, CLI_COLUMN("channel"), of->profile.channels[index].name);
  cli_put_medium(rows, &info->medium);
  cli_put_number(rows, CLI_COLUMN("albedo"), info->albedo);
  if (rows->form == CLI_JSON) {
    cli_json_number(rows->json, "numerical_error", info->numerical_error);
    cli_json_number(rows->json, "numerical_error_per_mm", info->numerical_error_per_mm);
    cli_json_number(rows->json, "reach", info->reach_mm);
    cli_json_number(rows->json, "model_error", info->model_error);
    cli_json_notes(rows->json, of->profile.info, info->notes);
  }
  cli_put_number(rows, CLI_COLUMN("pieces_from", "pieces from", "mm", "%.4g"),
                 info->pieces_from_mm);
  cli_put_number(rows, CLI_COLUMN("pieces_to", "to", "mm", "%.4g"), info->pieces_to_mm);
  if (rows->form == CLI_JSON) {
    cli_json_number(rows->json, "radius_least", info->radius_least_mm);
    cli_json_number(rows->json, "radius_most", info->radius_most_mm);
  }
  cli_put_count(rows, CLI_COLUMN("pieces"), count_pieces(info));
  if (rows->form == CLI_JSON) {
    cli_json_count(rows->json, "layout", info->layout);
    cli_json_counts(rows->json, "words", info->words, info->word_count);
    return;
  }
  cli_put_count(rows, CLI_COLUMN("bytes"), bytes);
  cli_put_number(rows, CLI_COLUMN("numerical error", NULL, "relative, at most", "%.1e"),
                 info->numerical_error);
  cli_put_number(rows, CLI_COLUMN("reach", "holds up to", "mm", "%.4g"), info->reach_mm);
  cli_put_number(rows, CLI_COLUMN("model error", NULL, "at all radii", "%.1e", "not measured"),
                 info->model_error);
}

static void write_table(const void *context) {
  const report *of = context;
  const cli_profile *profile = &of->profile;
  unsigned notes = 0;
  cli_write_medium(profile, stdout);
  printf("tables of %s, moments %s", profile->model->name, profile->moments->name);
  cli_write_parameters(profile, stdout);
  fputs("\n\n", stdout);
  cli_rows_print(stdout, 1, of->tables.count, put_table, of);
  puts("numerical error: of R and cdf against the model's formula, as measured\n"
       "holds up to: the numerical error of R is larger at radii beyond this one\n"
       "model error: of the model against radiative transport, at all radii\n"
       "`dipole eval --table` states both errors for the radii that it is asked for");
  for (size_t i = 0; i < of->tables.count; i++) {
    notes |= dipole_table_get_info(of->tables.items[i])->notes;
  }
  cli_write_launched(profile->media, profile->channel_count, stdout);
  cli_write_notes(profile->info, notes, stdout);
}

static void write_csv_piece(const char *channel, const char *function, double from, double to,
                            const uint32_t *words) {
  const double c0 = number_of(words[0]);
  /* Nine digits are enough to read back a number in single precision. */
  printf("%s,%s,%.9g,%.9g,%s,%.9g,%.9g,%.9g,%.9g\n", channel, function, from, to,
         signbit(c0) ? "right" : "left", fabs(c0), number_of(words[1]), number_of(words[2]),
         number_of(words[3]));
}

/* Writes the pieces of an octave, which lie side by side. */
static void write_csv_octave(const char *channel, const char *function,
                             const dipole_table_info *info, uint32_t entry, int exponent) {
  const uint32_t pieces = UINT32_C(1) << (MANTISSA_BITS - (entry & 31));
  const uint32_t *words = info->words + WORDS_BEFORE_PIECES + (size_t)(entry >> 5) * PIECE_WORDS;
  const double step = ldexp(1, exponent) / pieces;
  for (uint32_t i = 0; i < pieces; i++) {
    const double from = ldexp(1, exponent) + i * step;
    write_csv_piece(channel, function, from, from + step, words + (size_t)i * PIECE_WORDS);
  }
}

static void write_csv_table(const char *channel, const dipole_table_info *info) {
  for (size_t i = 0; i < sizeof constants / sizeof constants[0]; i++) {
    printf("%s,%s,,,,%.9g,,,\n", channel, constants[i], number_of(info->words[i]));
  }
  for (size_t f = 0; f < sizeof functions / sizeof functions[0]; f++) {
    for (size_t i = 0; i < functions[f].count; i++) {
      const uint32_t entry = info->words[functions[f].entries + i];
      if (entry != ENTRY_OUTSIDE) {
        write_csv_octave(channel, functions[f].name, info, entry, (int)i - 127);
      }
    }
  }
}

static void write_csv(const void *context) {
  const report *of = context;
  puts("channel,function,from,to,written_from,c0,c1,c2,c3");
  for (size_t i = 0; i < of->tables.count; i++) {
    write_csv_table(of->profile.channels[i].name, dipole_table_get_info(of->tables.items[i]));
  }
}

static void put_members(cli_json *json, const void *context) {
  const report *of = context;
  const cli_profile *profile = &of->profile;
  cli_json_head(json, profile);
  cli_json_text(json, "model", profile->model->name);
  cli_json_text(json, "source", profile->model->about);
  cli_json_text(json, "moments", profile->moments->name);
  cli_json_parameters(json, profile);
  cli_json_texts(json, "units", "sigma_a", "1/mm", "sigma_s", "1/mm", "pieces_from", "mm",
                 "pieces_to", "mm", "radius_least", "mm", "radius_most", "mm", "reach", "mm", NULL);
  cli_rows_json(json, "tables", of->tables.count, put_table, of);
}

/* ---- the command ----------------------------------------------------------------------------- */

static int ask_and_write(const table_settings *settings, dipole_client *client, report *of) {
  int status = cli_profile_take(&settings->profile, client, &of->profile);
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
  const cli_output output = {.table = write_table, .csv = write_csv, .members = put_members};
  cli_write(&output, settings->profile.common.form, of);
  return CLI_OK;
}

static int run(void *settings, dipole_client *client) {
  report of = {0};
  const int status = ask_and_write(settings, client, &of);
  cli_profile_free(&of.profile);
  cli_tables_free(&of.tables);
  return status;
}

const cli_command cli_command_table = {
    .name = "table",
    .about = "Fetch tables of a medium, to be evaluated without a daemon",
    .more =
        "\n"
        "Each channel has a table, as the evaluator lut uses it. --tolerance says how exact it\n"
        "is, from 1e-6 to 1 (default: 1e-4). A value above 0.1 counts as 0.1. `dipole eval\n"
        "--table`, libdipole and the Python module evaluate a file of --output to the same bits\n"
        "and errors as the daemon.\n"
        "\n"
        "CSV has a row for each constant, with its value in c0. Then it has a row for each piece\n"
        "of the functions R (times scale; 1/mm^2), cdf, radius_of_u (mm) and radius_of_1_minus_u\n"
        "(mm; for u above 1/2). From `from` on and below `to`, the value is\n"
        "c0 + w (c1 + w (c2 + w c3)) in single precision. w goes from 0 to 1 if the piece is\n"
        "written from the left, and from 1 to 0 if it is written from the right. JSON has the\n"
        "words as integers. proto/PROTOCOL.md describes them, and what holds outside of the\n"
        "pieces.\n",
    .formats = "table,csv,json",
    .options = {cli_medium_options, options, cli_parameter_options},
    .examples = "  dipole table --medium skin1 --output skin1.table\n"
                "  dipole eval --table skin1.table --r 0.1,1,10 --wanted R,cdf\n"
                "  dipole table --sigma-a 0.01 --sigma-s 1 --tolerance 1e-5 --format csv\n",
    .settings_bytes = sizeof(table_settings),
    .check = check,
    .run = run,
};
