/* dipole gather: the light that points leave at other positions. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/csv.h"
#include "clients/cli/daemon.h"
#include "clients/cli/profile.h"

static const cli_option options[] = {
    CLI_TITLE("Evaluation"),
    CLI_OPTION(NAME, model, CLI_MODEL_DEFAULT, "the model; `dipole info` lists them"),
    CLI_OPTION(TEXT, evaluator, "lut",
               "f64 or f32: double or single precision; lut: single, by a table"),
    CLI_MOMENTS_OPTION,
    CLI_OPTION(NUMBER, tolerance, "0.01",
               "largest relative error, at each query, that groups of points may cause which stand "
               "for their points: 1e-9 to .5, or 0 for none"),
    CLI_DEADLINE_OPTION,
    {0},
};

static int check(cli_settings *settings) {
  if (settings->operand == NULL || settings->second_operand == NULL) {
    return cli_fail_usage("name two files: the points, and the queries");
  }
  return cli_medium_check(settings);
}

/* ---- files ----------------------------------------------------------------------------------- */

enum { X, Y, Z, POWER, FIRST_POWER, POWERS_MAX = 8, COLUMNS = FIRST_POWER + POWERS_MAX };

static const char *const names[COLUMNS] = {"x",       "y",       "z",       "power",
                                           "power_1", "power_2", "power_3", "power_4",
                                           "power_5", "power_6", "power_7", "power_8"};

/* Points or queries. */
typedef struct cloud {
  cli_sheet sheet;
  uint64_t count;
  uint32_t channels; /* number of powers of each point */
  double *xyz_mm;    /* [count][3] */
  float *power_W;    /* [count][channels] */
} cloud;

static bool has_places(const cli_sheet *sheet, const cli_csv_record *header) {
  size_t i = X;
  while (i <= Z && sheet->at[i] != CLI_CSV_ABSENT) {
    i++;
  }
  return i > Z ||
         cli_csv_fail_missing(sheet->source, header, names[i],
                              "x, y and z in mm, and points power, or power_1 and so on, in W");
}

static bool has_powers(const cli_sheet *sheet, const cli_csv_record *header) {
  return has_places(sheet, header) &&
         (sheet->at[POWER] != CLI_CSV_ABSENT || sheet->at[FIRST_POWER] != CLI_CSV_ABSENT ||
          cli_csv_fail_missing(sheet->source, header, "power or power_1", "it for each point"));
}

/* Reads the number of a row. If there is none, says so and returns false. */
static bool read_number(const cli_sheet *sheet, size_t row, size_t column, double *number) {
  *number = cli_sheet_number(sheet, row, column);
  return !isnan(*number) || cli_fails("%s: line %llu: %s: there is no number", sheet->source,
                                      (unsigned long long)sheet->lines[row], names[column]);
}

/* Reads a file. Says what is wrong and returns false. */
static bool read_cloud(const char *path, bool with_power, cloud *of) {
  cli_sheet *sheet = &of->sheet;
  bool good =
      cli_sheet_read(path, NULL, names, COLUMNS, with_power ? has_powers : has_places, sheet);
  const size_t power = good && sheet->at[POWER] != CLI_CSV_ABSENT ? POWER : FIRST_POWER;
  const size_t most = !good || !with_power ? 0 : power == POWER ? 1 : POWERS_MAX;
  while (of->channels < most && sheet->at[power + of->channels] != CLI_CSV_ABSENT) {
    of->channels++;
  }
  for (size_t i = power + of->channels; good && with_power && i < COLUMNS; i++) {
    good = sheet->at[i] == CLI_CSV_ABSENT ||
           cli_fails("%s: the column %s: give power alone, or power_1 and so on without a gap",
                     sheet->source, names[i]);
  }
  of->count = sheet->count;
  of->xyz_mm = cli_allocate(of->count, 3 * sizeof(double));
  of->power_W = cli_allocate(of->count, (of->channels + 1) * sizeof(float));
  for (size_t i = 0; good && i < of->count; i++) {
    double W = 0;
    for (size_t k = 0; good && k < 3; k++) {
      good = read_number(sheet, i, k, &of->xyz_mm[3 * i + k]);
    }
    for (size_t c = 0; good && c < of->channels; c++) {
      good = read_number(sheet, i, power + c, &W);
      of->power_W[of->channels * i + c] = (float)W;
    }
  }
  cli_free(sheet->numbers); /* freed now, because there may be millions of points */
  return good;
}

/* ---- requests ---------------------------------------------------------------------------------- */

static bool show_queries(void *context, uint64_t done, uint64_t count) {
  cli_progress_show(context, (double)done / (double)count, (double)done);
  return !cli_interrupted();
}

/* The request, and the sums at the queries. */
typedef struct work {
  const cli_settings *settings;
  dipole_client *client;
  cli_profile profile;
  dipole_gather_query query;
  cloud points, queries;
  double *M; /* [queries][channels] */
  dipole_gather_result result;
  cli_progress progress;
} work;

/* Says what was refused, and where the point or query at fault stands. */
static int fail_at(const work *of, const dipole_error *error) {
  char place[512];
  const bool of_queries = strcmp(error->field, "queries") == 0;
  const bool of_points = strcmp(error->field, "points") == 0 || strcmp(error->field, "power") == 0;
  if (error->kind != DIPOLE_ERROR_REFUSED || (!of_queries && !of_points)) {
    return cli_fail_error(error);
  }
  const cli_sheet *sheet = of_queries ? &of->queries.sheet : &of->points.sheet;
  snprintf(place, sizeof place, "%s: line %llu: ", sheet->source,
           (unsigned long long)(error->index < sheet->count ? sheet->lines[error->index] : 0));
  return cli_fail_error_of(place, error);
}

/* Sets M to the sums. Returns an exit status. */
static int request_sums(work *of) {
  dipole_error error;
  dipole_points *set;
  const cloud *points = &of->points;
  if (points->count == 0) {
    return cli_fail("%s: it has no points", points->sheet.source);
  }
  if (!dipole_points_make(points->count, points->channels, points->xyz_mm, points->power_W, &set,
                          &error)) {
    return cli_fail("%s: %s", points->sheet.source, error.text);
  }
  of->query = (dipole_gather_query){
      .model = of->profile.model->id,
      .evaluator = of->profile.evaluator->id,
      .moments = of->profile.moments->id,
      .media = of->profile.media,
      .layer_count = of->profile.layer_count,
      .points = set,
      .queries_mm = of->queries.xyz_mm,
      .query_count = of->queries.count,
      .tolerance = of->settings->tolerance.value,
      CLI_DEADLINE_OF(of->settings),
  };
  cli_catch_interrupt();
  cli_progress_start(&of->progress, "queries");
  const bool good = CLI_RETRY(of->settings, &error,
                              dipole_gather(of->client, &of->query, show_queries, &of->progress,
                                            of->M, &of->result, &error));
  cli_progress_wipe(&of->progress);
  dipole_points_free(set);
  return !good               ? fail_at(of, &error)
         : cli_interrupted() ? cli_fail("interrupted; nothing was written")
                             : CLI_OK;
}

/* Reports how many sums are infinite, and how to avoid it. */
static void report_infinite(const work *of) {
  const uint32_t channels = of->points.channels;
  uint64_t found = 0;
  for (uint64_t q = 0; q < of->queries.count; q++) {
    bool infinite = false;
    for (uint32_t c = 0; c < channels; c++) {
      infinite = infinite || isinf(of->M[q * channels + c]);
    }
    found += infinite;
  }
  if (found > 0) {
    cli_say(CLI_OK,
            "%llu of %llu queries are at a point, where R of %s is infinite: M is inf there; move "
            "them off the points by half the radius of a disc of a point's area",
            (unsigned long long)found, (unsigned long long)of->queries.count,
            of->profile.model->name);
  }
}

/* ---- the command ----------------------------------------------------------------------------- */

/* Writes the relative errors of all sums: in CSV in each row, else before the rows. */
static void put_errors(cli_rows *rows, const work *of) {
  cli_put_number(rows, of->result.bound, "bound", "error by grouping", NULL, "%.1e");
  for (uint32_t c = 0; c < of->points.channels; c++) {
    char numerical[32], model[32];
    snprintf(numerical, sizeof numerical, "numerical_error_%u", c + 1);
    snprintf(model, sizeof model, "model_error_%u", c + 1);
    cli_put_number(rows, of->result.numerical_error[c], numerical, .format = "%.1e");
    cli_put_number(rows, of->result.model_error[c], model, NULL, NULL, "%.1e", "not solved");
  }
}

static void put_facts(cli_rows *rows, const void *context) {
  const work *of = context;
  cli_put_profile(rows, &of->profile);
  put_errors(rows, of);
  if (rows->form == CLI_JSON || of->result.notes != 0) {
    cli_put_notes(rows, of->profile.info, of->result.notes);
  }
}

static void put_query(cli_rows *rows, const void *context, size_t index) {
  const work *of = context;
  const bool any = index < of->queries.count;
  for (size_t k = 0; k < 3; k++) {
    cli_put_number(rows, any ? of->queries.xyz_mm[3 * index + k] : 0, names[k], .unit = "mm");
  }
  for (uint32_t c = 0; c < of->points.channels; c++) {
    char name[16];
    snprintf(name, sizeof name, "M_%u", c + 1);
    cli_put_number(rows, any ? of->M[index * of->points.channels + c] : 0, name, NULL, "W/mm^2",
                   "%.5e");
  }
  if (rows->form == CLI_CSV) {
    put_errors(rows, of);
  }
}

static int run_gather(const cli_settings *settings, dipole_client *client) {
  work of = {.settings = settings, .client = client};
  int status = cli_profile_take(settings, client, &of.profile);
  if (status != CLI_OK) {
    return status;
  }
  if (!read_cloud(settings->operand, true, &of.points) ||
      !read_cloud(settings->second_operand, false, &of.queries)) {
    return CLI_FAILED;
  }
  if (of.profile.channel_count != of.points.channels) {
    return cli_fail_usage("%s: powers of each point: %u, channels of the medium: %zu: give as "
                          "many media as powers, or choose a channel with --channel",
                          of.points.sheet.source, of.points.channels, of.profile.channel_count);
  }
  of.M = cli_allocate((size_t)of.queries.count * of.points.channels + 1, sizeof *of.M);
  status = request_sums(&of);
  if (status == CLI_OK) {
    report_infinite(&of);
    const cli_report output = {.facts = put_facts, .rows = of.queries.count, .put_row = put_query};
    cli_write(&output, settings->form, &of);
  }
  return status;
}

const cli_command cli_command_gather = {
    .name = "gather",
    .operand = "POINTS",
    .second_operand = "QUERIES",
    .about = "Sum the light that points leave at other positions",
    .more =
        "Each point holds power that entered the medium there: irradiance times area. Each "
        "query gets the sum of R(distance) times power over all points, in W/mm^2, for each "
        "channel (Jensen and Buhler 2002). POINTS and QUERIES are CSV with the columns x, y, z "
        "in mm, and power, or power_1, power_2 and so on, in W; - is standard input. What is "
        "written has M_1, M_2 and so on, and how far all may be off, relative to M: bound by "
        "grouping, numerical_error_1 and so on by arithmetic, model_error_1 and so on by the "
        "model, whose R is compared at 0.01 to 20 mean free paths. At a point's own position R is "
        "infinite for most models, and so is the sum: move such queries off the points, along the "
        "normal, by half the radius of a disc of a point's area." CLI_CSV_TEXT,
    .formats = "csv,table,json",
    .options = {cli_medium_options, cli_layer_options, options},
    .examples = "  dipole gather points.csv queries.csv --medium skin1 --channel red > M.csv\n"
                "  dipole gather points.csv queries.csv --medium marble --model better\n",
    .check = check,
    .run = run_gather,
};
