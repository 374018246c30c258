/* dipole table: fetches the tables that the evaluator lut uses, and writes them one behind the
 * other into a file, which `dipole eval` evaluates without a daemon. */
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "clients/cli/daemon.h"
#include "clients/cli/eval.h"

/* ---- files ----------------------------------------------------------------------------------- */

typedef struct tables {
  size_t count;
  dipole_table **items; /* [count], one for each channel */
} tables;

static void add_table(tables *of, dipole_table *table) {
  of->items = cli_resize(of->items, of->count + 1, sizeof(dipole_table *));
  of->items[of->count++] = table;
}

static void free_tables(tables *of) {
  for (size_t i = 0; i < of->count; i++) {
    dipole_table_free(of->items[i]);
  }
}

static bool is_standard(const char *path) {
  return path != NULL && strcmp(path, "-") == 0;
}

/* Returns the whole of a file; NULL if it cannot be read. */
static char *read_whole(FILE *from, size_t *count) {
  size_t capacity = 1 << 16, got;
  char *bytes = cli_allocate(capacity, 1);
  *count = 0;
  while ((got = fread(bytes + *count, 1, capacity - *count, from)) > 0) {
    *count += got;
    if (*count == capacity) {
      capacity *= 2;
      bytes = cli_resize(bytes, capacity, 1);
    }
  }
  return ferror(from) ? NULL : bytes;
}

static bool take_tables(const char *path, const char *bytes, size_t count, tables *of) {
  size_t done = 0;
  do {
    dipole_table *table;
    dipole_error error;
    size_t table_bytes;
    if (!dipole_table_load(bytes + done, count - done, &table, &error)) {
      return cli_fails("%s: table %zu: %s", path, of->count + 1, error.text);
    }
    add_table(of, table);
    dipole_table_bytes(table, &table_bytes);
    done += table_bytes;
  } while (done < count);
  return true;
}

/* Reads a file of one table or more. Says what is wrong and returns false. */
static bool read_tables(const char *path, tables *of) {
  FILE *from = is_standard(path) ? stdin : fopen(path, "rbe");
  size_t count = 0;
  char *bytes = from != NULL ? read_whole(from, &count) : NULL;
  const int read_errno = errno;
  if (from != NULL && from != stdin) {
    fclose(from);
  }
  if (bytes == NULL) {
    cli_fail("cannot read %s: %s", path, strerror(read_errno));
  }
  return bytes != NULL && take_tables(path, bytes, count, of);
}

/* Writes a file, but not onto a terminal. Says what is wrong and returns false. */
static bool save_tables(const char *path, const tables *of) {
  FILE *to = is_standard(path) ? stdout : fopen(path, "wbe");
  if (to == NULL) {
    return cli_fails("cannot write %s: %s", path, strerror(errno));
  }
  const bool terminal = isatty(fileno(to)) == 1;
  bool written = !terminal;
  for (size_t i = 0; written && i < of->count; i++) {
    size_t count;
    const void *bytes = dipole_table_bytes(of->items[i], &count);
    written = fwrite(bytes, 1, count, to) == count;
  }
  written = written && fflush(to) == 0;
  const int write_errno = errno;
  if (to != stdout && fclose(to) != 0) {
    written = false;
  }
  if (terminal) {
    cli_fail("--output %s: a terminal cannot show binary tables; name a file", path);
  } else if (!written) {
    cli_fail("cannot write %s: %s", path, strerror(write_errno));
  }
  return written;
}

/* ---- evaluating ------------------------------------------------------------------------------ */

/* Returns whether two tables are of the same model, moments, parameters and number of layers. */
static bool is_same_profile(const dipole_table_info *a, const dipole_table_info *b) {
  bool same = a->model == b->model && a->moments == b->moments &&
              a->layer_count == b->layer_count && a->parameter_count == b->parameter_count;
  for (size_t i = 0; same && i < a->parameter_count; i++) {
    same = a->parameters[i].id == b->parameters[i].id &&
           a->parameters[i].value == b->parameters[i].value;
  }
  return same;
}

/* Takes the model and the channels from the tables: that of a measured medium has its name. */
static int describe(const char *path, const tables *of, cli_eval_report *report) {
  const dipole_table_info *first = dipole_table_get_info(of->items[0]);
  const dipole_choice *model = cli_choice_of_id(report->profile.info, DIPOLE_MODEL, first->model);
  report->profile.moments = cli_choice_of_id(report->profile.info, DIPOLE_MOMENTS, first->moments);
  if (model == NULL || report->profile.moments == NULL) {
    return cli_fail(
        "%s: model %u or moments %u are not known to this program: use the version that wrote it",
        path, first->model, first->moments);
  }
  cli_eval_add_model(report, model, true);
  report->models[0].evaluator =
      cli_choice_of_id(report->profile.info, DIPOLE_EVALUATOR, DIPOLE_LUT);
  for (size_t i = 0; i < first->parameter_count; i++) {
    cli_parameters_set(&report->profile.parameters, first->parameters[i].id,
                       first->parameters[i].value);
  }
  cli_profile_set_channels(&report->profile, of->count, first->layer_count);
  for (size_t i = 0; i < of->count; i++) {
    const dipole_table_info *info = dipole_table_get_info(of->items[i]);
    if (!is_same_profile(first, info)) {
      return cli_fail("%s: tables 1 and %zu differ in model, moments, parameters or number of "
                      "layers: put them into separate files",
                      path, i + 1);
    }
    snprintf(report->profile.names[i], CLI_CHANNEL_BYTES, "%zu", i + 1);
    for (size_t k = 0; k < core_measured_media_count * CLI_COLOURS; k++) {
      const core_measured_medium *known = &core_measured_media[k / CLI_COLOURS];
      if (known->layer_count == info->layer_count &&
          memcmp(&known->channel[k % CLI_COLOURS * known->layer_count], info->layers,
                 info->layer_count * sizeof *info->layers) == 0) {
        snprintf(report->profile.names[i], CLI_CHANNEL_BYTES, "%s %s", known->name,
                 cli_colours[k % CLI_COLOURS]);
      }
    }
    memcpy(&report->profile.media[i * info->layer_count], info->layers,
           info->layer_count * sizeof *info->layers);
    report->models[0].notes |= info->notes;
  }
  return CLI_OK;
}

/* Takes the radii. Returns them in single precision; says what is wrong and returns NULL if it
 * cannot. */
static const float *take_radii(const cli_settings *settings, cli_eval_report *report) {
  dipole_query query = {0};
  dipole_error error;
  cli_eval_set_radii(settings, report, true, &query);
  const size_t count = report->place_count = (size_t)query.radius_count;
  const float *r = query.radii;
  if (query.radii == NULL) {
    float *grid = cli_allocate(count, sizeof *grid);
    if (count > 0 && !dipole_grid_radii((enum dipole_spacing)query.spacing, query.radius_start_mm,
                                        query.radius_stop_mm, count, grid, &error)) {
      cli_fail("%s", error.text);
      return NULL;
    }
    r = grid;
  }
  report->places = cli_allocate(count, sizeof *report->places);
  for (size_t i = 0; i < count; i++) {
    report->places[i] = cli_number_of_single(r[i]);
  }
  return r;
}

/* Reports the first radius that a table does not cover. */
static int fail_radius(const dipole_table_info *info, const cli_eval_report *report) {
  size_t at = 0;
  while (at + 1 < report->place_count && report->places[at] >= info->radius_least_mm &&
         report->places[at] <= info->radius_most_mm) {
    at++;
  }
  return cli_fail("r number %zu of %zu: allowed: %.6g to %.6g mm, which the model covers", at + 1,
                  report->place_count, info->radius_least_mm, info->radius_most_mm);
}

/* Sets the values of one table. */
static int evaluate_table(const dipole_table *table, const float *r, const cli_eval_report *report,
                          cli_eval_values *values) {
  const dipole_table_info *info = dipole_table_get_info(table);
  const size_t n = report->place_count;
  const unsigned wanted = report->quantities.wanted;
  float probe = 0, *out = cli_allocate(n, sizeof *out);
  values->albedo = (wanted & DIPOLE_ALBEDO) != 0 ? info->albedo : (double)NAN;
  for (size_t q = 0; q < report->quantities.count; q++) {
    const dipole_choice *quantity = report->quantities.items[q];
    const enum dipole_quantity id = (enum dipole_quantity)quantity->id;
    dipole_table_errors(table, id, n, r, &values->of_each[q]);
    if (id == DIPOLE_ALBEDO) {
      continue;
    }
    if (!dipole_table_values(table, id, 0, &probe, &probe)) {
      return cli_fail("--wanted %s: a table does not hold it; it holds R, albedo, cdf, pdf, "
                      "2_pi_r_R and S",
                      quantity->name);
    }
    if (!dipole_table_values(table, id, n, r, out)) {
      return fail_radius(info, report);
    }
    values->arrays[q] = cli_allocate(n, sizeof(double));
    for (size_t i = 0; i < n; i++) {
      values->arrays[q][i] = cli_number_of_single(out[i]);
    }
  }
  return dipole_table_errors(table, wanted & ~(unsigned)DIPOLE_RADIUS, n, r, &values->errors)
             ? CLI_OK
             : fail_radius(info, report);
}

int cli_eval_table(const cli_settings *settings, cli_eval_report *report, dipole_info **info) {
  tables of = {0};
  dipole_error error;
  if (!dipole_local_info(info, &error)) {
    return cli_fail("%s", error.text);
  }
  report->profile.info = *info;
  if (!cli_eval_take_quantities(settings, report)) {
    return CLI_USAGE;
  }
  int status = read_tables(settings->table, &of) ? CLI_OK : CLI_FAILED;
  status = status == CLI_OK ? describe(settings->table, &of, report) : status;
  if (status == CLI_OK) {
    const float *r = take_radii(settings, report);
    cli_eval_make_values(report);
    status = r != NULL ? CLI_OK : CLI_FAILED;
    for (size_t i = 0; status == CLI_OK && i < of.count; i++) {
      status = evaluate_table(of.items[i], r, report, &report->values[i]);
    }
  }
  free_tables(&of);
  return status;
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

typedef struct report {
  cli_profile profile;
  tables tables;
} report;

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
  for (size_t i = 0; i < profile->channel_count; i++) {
    const dipole_table_query query = {.model = profile->model->id,
                                      CLI_QUERY_OF(profile),
                                      .layers = cli_profile_layers(profile, i),
                                      .layer_count = profile->layer_count};
    dipole_table *table;
    dipole_error error;
    if (!CLI_RETRY(settings, &error, dipole_table_fetch(client, &query, &table, &error))) {
      if (profile->channel_count > 1) {
        snprintf(place, sizeof place, "channel %s: ", profile->names[i]);
      }
      return cli_fail_error_of(place, &error);
    }
    add_table(&of->tables, table);
  }
  return CLI_OK;
}

/* ---- writing --------------------------------------------------------------------------------- */

/* Writes the table of a channel. */
static void put_table(cli_rows *rows, const void *context, size_t index) {
  const report *of = context;
  const dipole_table_info *info = dipole_table_get_info(of->tables.items[index]);
  size_t bytes;
  dipole_table_bytes(of->tables.items[index], &bytes);
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
       "`dipole eval --table` states both errors for the requested radii");
  for (size_t i = 0; i < of->tables.count; i++) {
    notes |= dipole_table_get_info(of->tables.items[i])->notes;
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
  if (settings->output != NULL && !save_tables(settings->output, &of->tables)) {
    return CLI_FAILED;
  }
  if (is_standard(settings->output)) {
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

static int run_table(const cli_settings *settings, dipole_client *client) {
  report of = {0};
  const int status = request_and_write(settings, client, &of);
  free_tables(&of.tables);
  return status;
}

const cli_command cli_command_table = {
    .name = "table",
    .about = "Fetch tables of a medium, to be evaluated without a daemon",
    .more = "Each channel has a table, as the evaluator lut uses it. --tolerance says how exact it "
            "is, from 1e-6 to 1 (default: 1e-4). A value above 0.1 counts as 0.1. `dipole eval "
            "--table`, libdipole and the Python module evaluate a file of --output to the same "
            "bits and errors as the daemon.",
    .formats = "table,csv,json",
    .options = {cli_medium_options, cli_layer_options, options},
    .parameters = CLI_OF_MODELS,
    .examples = "  dipole table --medium skin1 --output skin1.table\n"
                "  dipole eval --table skin1.table --r 0.1,1,10 --wanted R,cdf\n"
                "  dipole table --sigma-a 0.01 --sigma-s 1 --tolerance 1e-5 --format json\n",
    .check = check,
    .run = run_table,
};
