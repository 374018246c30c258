/* dipole points: evaluates the rows of a CSV file. The rows that wait for an answer are kept in a
 * window of bounded size. So many queries are under way at a time, and rows are written in their
 * order. */
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "clients/cli/daemon.h"
#include "clients/cli/points_row.h"
#include "clients/cli/progress.h"
#include "clients/cli/sheet.h"

static const cli_option options[] = {
    CLI_TITLE("Evaluation"),
    CLI_OPTION(NAME, model, NULL,
               "the model of the rows whose cell is empty or absent (default: transport; with a "
               "tolerance, "
               "the cheapest that is so near to radiative transport)"),
    CLI_OPTION(TEXT, evaluator, NULL,
               "f64 or f32: double or single precision; lut: single, by a table (default: f64; for "
               "transport "
               "lut where many rows share g and eta, else f32)"),
    CLI_OPTION(
        NUMBERS, r, NULL,
        "for files without a column r: each row is written once for each of these radii, mm"),
    CLI_OPTION(NUMBERS, f, NULL,
               "in place of radii: these spatial frequencies, 1/mm, for R_f, whose column is f in "
               "place of r"),
    CLI_OPTION(NAMES, wanted, NULL,
               "the quantities to write; `dipole info` lists all (default: R,albedo,cdf; with "
               "--tolerance in "
               "place of --model R,albedo, which keep more tolerances)"),
    CLI_OPTION(
        SWITCH, errors, NULL,
        "write numerical_error and model_error, too: how far the values may be from the model's "
        "formula, and the model from radiative transport (empty: not solved). Rows that are "
        "answered "
        "together have the largest error of all"),
    {0},
};

/* ---- asking ---------------------------------------------------------------------------------- */

static unsigned wanted_of(const points_usual *usual) {
  return usual->quantities.wanted | (usual->settings->errors ? (unsigned)DIPOLE_MODEL_ERROR : 0);
}

/* Whether a row of transport takes f32 in place of a table of its own, which would cost 6 ms. Its values
 * are those of stored solutions as well, whatever tolerance a table would have had. */
static bool takes_f32(const points_usual *usual, const points_row *row) {
  return row->model == usual->transport && row->evaluator == DIPOLE_LUT &&
         usual->settings->evaluator == NULL;
}

/* Sends the row's query; the row then waits for the answer. */
static bool submit_row(const points_usual *usual, dipole_client *client, points_row *row,
                       dipole_error *error) {
  const float r_f32_mm = (float)row->r_mm;
  const void *f64 = points_has_radii(usual) ? usual->radii->items : &row->r_mm;
  const void *f32 = points_has_radii(usual) ? usual->r_f32 : &r_f32_mm;
  cli_parameters parameters = row->parameters;
  unsigned evaluator = row->evaluator;
  if (takes_f32(usual, row)) {
    evaluator = DIPOLE_F32;
    cli_parameters_remove(&parameters, usual->tolerance);
  }
  const dipole_query query = {.model = row->model,
                              .evaluator = evaluator,
                              .moments = row->moments,
                              .wanted = wanted_of(usual),
                              .media = &row->medium,
                              .medium_count = 1,
                              .spacing = DIPOLE_LIST,
                              .radii = evaluator == DIPOLE_F64 ? f64 : f32,
                              .radius_count = usual->radius_count,
                              .parameters = parameters.items,
                              .parameter_count = parameters.count};
  row->state = POINTS_WAITING;
  return dipole_submit(client, &query, &row->id, error);
}

static double *make_good(const points_usual *usual, points_row *row) {
  row->state = POINTS_GOOD;
  if (row->values == NULL) {
    row->values = cli_allocate(usual->radius_count * usual->quantities.count, sizeof *row->values);
  }
  return row->values;
}

/* Takes the answer; the row is then good. */
static void take_answer(const points_usual *usual, points_row *row, const dipole_result *result) {
  const size_t count = usual->quantities.count;
  double *values = make_good(usual, row);
  row->numerical_error = result->channels[0].numerical_error;
  row->numerical_error_per_mm = result->channels[0].numerical_error_per_mm;
  row->model_error = result->channels[0].model_error;
  for (size_t q = 0; q < count; q++) {
    const unsigned id = usual->quantities.items[q]->id;
    const double *f64 = dipole_values_f64(result, 0, id);
    const float *f32 = dipole_values_f32(result, 0, id);
    for (size_t i = 0; i < usual->radius_count; i++) {
      values[i * count + q] = f64 != NULL   ? f64[i]
                              : f32 != NULL ? cli_number_of_single(f32[i])
                                            : result->channels[0].albedo;
    }
  }
}

/* ---- the work -------------------------------------------------------------------------------- */

/* When the window is full, half of its rows are written before more are read. So many queries are
 * sent together. */
enum { WINDOW_ROWS = 8192 };

/* Ids of models are below this; the values of a group, unless one row has more. */
enum { MODELS = 256, GROUP_VALUES = 65536 };

/* How many bytes of text the rows of the window may hold together. */
#define WINDOW_BYTES ((size_t)4 << 20)

/* Media that share a model, g and eta. A surface for all of them takes the daemon as long as profiles
 * of the first SURFACE_MEDIA, which are asked for one by one. So neither a file of few media nor
 * one of many takes more than twice the time of the better way, and a row's values depend on
 * nothing but the rows above it. */
enum { SURFACE_MEDIA = 256, FAMILIES = 512 };

typedef struct points_family {
  uint64_t hash; /* of what the media share; 0 if there are none */
  size_t count;
  uint64_t media[SURFACE_MEDIA]; /* hashes of the first ones */
} points_family;

typedef struct points_run {
  points_usual usual;
  const char *source; /* name of the input, for messages */
  dipole_client *client;
  cli_csv_reader reader;
  points_columns columns;
  cli_progress progress;
  uint64_t input_bytes; /* size of the input; 0 if it is unknown */
  uint64_t rows_written, rows_bad;
  uint64_t rows_done, bytes_done; /* of the rows that have been answered, and of the comments */
  int64_t answer_ms;              /* when the last answer came */
  bool failed;
  size_t first, count; /* row i of the window is rows[(first + i) % WINDOW_ROWS] */
  size_t window_bytes;
  size_t read_count;    /* how many rows of the window wait to be asked for in a group */
  bool refused[MODELS]; /* models, by id, whose media cannot vary */
  double *arrays[3];    /* sigma_a, sigma_s and radii of a group */
  points_row *group[WINDOW_ROWS];
  points_family families[FAMILIES]; /* by their hash; one takes the place of another */
  points_row rows[WINDOW_ROWS];
} points_run;

static points_row *row_at(points_run *points, size_t index) {
  return &points->rows[(points->first + index) % WINDOW_ROWS];
}

/* Says what is wrong with the input or the connection, and ends the work. Returns false. */
__attribute__((format(printf, 2, 3))) static bool fail(points_run *points, const char *format,
                                                       ...) {
  char text[512];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  cli_progress_wipe(&points->progress);
  cli_fail("%s: %s", points->source, text);
  points->failed = true;
  return false;
}

/* Counts a row that has been answered, refused or copied. */
static void count_done(points_run *points, const points_row *row) {
  const double input_bytes = (double)points->input_bytes; /* 0 if it is unknown */
  points->rows_done += row->state != POINTS_COPIED;
  points->bytes_done += row->record.length;
  cli_progress_show(&points->progress,
                    input_bytes > 0 ? (double)points->bytes_done / input_bytes : (double)NAN,
                    (double)points->rows_done);
}

/* ---- answers --------------------------------------------------------------------------------- */

static points_row *find_row(points_run *points, uint64_t id) {
  for (size_t i = 0; i < points->count; i++) {
    points_row *row = row_at(points, i);
    if (row->state == POINTS_WAITING && row->id == id) {
      return row;
    }
  }
  return NULL;
}

static bool collect(points_run *points);

/* Asks for the row by itself. Takes answers first if as many queries are outstanding as may be. */
static bool submit(points_run *points, points_row *row) {
  dipole_error error;
  while (dipole_outstanding(points->client) >= DIPOLE_IN_FLIGHT_MAX) {
    if (!collect(points)) {
      return false;
    }
  }
  return submit_row(&points->usual, points->client, row, &error) || fail(points, "%s", error.text);
}

/* Handles an error: asks a busy daemon again, and marks the row as bad if the refusal names a
 * field. Any other error ends the work. */
static bool take_refusal(points_run *points, uint64_t id, const dipole_error *error) {
  points_row *row = error->kind == DIPOLE_ERROR_REFUSED ? find_row(points, id) : NULL;
  if (row == NULL || (error->retry_after_ms == 0 && error->field[0] == '\0')) {
    return fail(points, "%s", error->text);
  }
  if (error->retry_after_ms == 0) {
    row->state = POINTS_BAD;
    memcpy(row->status, error->text, sizeof row->status);
    count_done(points, row);
    return true;
  }
  return cli_try_again(points->usual.settings, points->answer_ms, error)
             ? submit(points, row)
             : fail(points, "%s", error->text);
}

_Static_assert(sizeof((points_row *)0)->status == sizeof((dipole_error *)0)->text, "status");

/* Waits for one answer. */
static bool collect(points_run *points) {
  dipole_error error;
  dipole_result *result;
  uint64_t id = 0;
  if (!dipole_collect(points->client, &id, &result, &error)) {
    return take_refusal(points, id, &error);
  }
  points->answer_ms = cli_now_ms();
  points_row *row = find_row(points, id);
  if (row != NULL) {
    take_answer(&points->usual, row, result);
    count_done(points, row);
  }
  dipole_result_free(result);
  return row != NULL || fail(points, "an answer came to a query that was not sent");
}

/* ---- rows that share a model, g and eta -------------------------------------------------------- */

/* The quantities that such rows can be asked for together. */
#define GROUP_QUANTITIES (DIPOLE_R | DIPOLE_ALBEDO | DIPOLE_CDF | DIPOLE_PDF | DIPOLE_RING)

/* The error of a table if none is given, as that of the evaluator lut. */
#define TABLE_TOLERANCE 1e-4

static uint64_t hash_more(uint64_t hash, const void *bytes, size_t count) {
  for (size_t i = 0; i < count; i++) { /* FNV-1a (Fowler, Noll, Vo 1991) */
    hash = (hash ^ ((const unsigned char *)bytes)[i]) * UINT64_C(0x100000001b3);
  }
  return hash;
}

/* Returns whether the row's medium is none of the first of its family. */
static bool is_worth_a_surface(points_run *points, const points_row *row) {
  uint64_t hash = hash_more(UINT64_C(0xcbf29ce484222325), &row->moments, sizeof row->moments);
  hash = hash_more(hash, &row->medium.g, 2 * sizeof(double));
  for (size_t i = 0; i < row->parameters.count; i++) {
    hash = hash_more(hash, &row->parameters.items[i].id, sizeof(unsigned));
    hash = hash_more(hash, &row->parameters.items[i].value, sizeof(double));
  }
  points_family *family = &points->families[(hash ^ hash >> 32) % FAMILIES];
  if (family->hash != hash) {
    *family = (points_family){.hash = hash};
  }
  const uint64_t medium = hash_more(hash, &row->medium, 2 * sizeof(double));
  size_t i = 0;
  while (i < family->count && family->media[i] != medium) {
    i++;
  }
  if (i == family->count && i < SURFACE_MEDIA) {
    family->media[family->count++] = medium;
  }
  return i == SURFACE_MEDIA;
}

/* Returns whether the row may be asked for in a group. Transport needs a surface for it, whose values
 * are those of a table. */
static bool is_for_group(points_run *points, const points_row *row) {
  const points_usual *usual = &points->usual;
  return (usual->quantities.wanted & ~(unsigned)GROUP_QUANTITIES) == 0 && row->model < MODELS &&
         !points->refused[row->model] &&
         (row->model != usual->transport ||
          (row->evaluator == DIPOLE_LUT && is_worth_a_surface(points, row)));
}

/* Orders rows by what the rows of a group share. */
static int compare(const points_row *a, const points_row *b) {
  const unsigned left[] = {a->model, a->evaluator, a->moments, (unsigned)a->parameters.count};
  const unsigned right[] = {b->model, b->evaluator, b->moments, (unsigned)b->parameters.count};
  int order = memcmp(left, right, sizeof left);
  order = order != 0 ? order : memcmp(&a->medium.g, &b->medium.g, 2 * sizeof(double));
  for (size_t i = 0; order == 0 && i < a->parameters.count; i++) {
    const dipole_parameter *x = &a->parameters.items[i], *y = &b->parameters.items[i];
    order =
        x->id != y->id ? (x->id < y->id ? -1 : 1) : memcmp(&x->value, &y->value, sizeof x->value);
  }
  return order;
}

_Static_assert(offsetof(dipole_medium, eta) == offsetof(dipole_medium, g) + sizeof(double),
               "g and eta are compared together");

static int compare_places(const void *a, const void *b) {
  return compare(*(points_row *const *)a, *(points_row *const *)b);
}

/* Lists the rows of the window that have only been read, those of a group side by side. */
static size_t list_read(points_run *points) {
  size_t count = 0;
  bool sorted = true;
  for (size_t i = 0; i < points->count; i++) {
    points_row *row = row_at(points, i);
    if (row->state == POINTS_READ) {
      sorted = sorted && (count == 0 || compare(points->group[count - 1], row) == 0);
      points->group[count++] = row;
    }
  }
  if (!sorted) {
    qsort(points->group, count, sizeof points->group[0], compare_places);
  }
  return count;
}

/* Asks for the values of `count` rows that share what compare() compares. Evaluators in single
 * precision get radii in single precision, and their values are those of double precision, rounded:
 * coefficients in single precision would put them off by more. */
static bool ask(points_run *points, points_row *const *rows, size_t count,
                dipole_varying_result **result, dipole_error *error) {
  const points_usual *usual = &points->usual;
  const size_t radii = usual->radius_count;
  const bool single = rows[0]->evaluator != DIPOLE_F64;
  for (size_t i = 0; i < count * radii; i++) {
    const points_row *row = rows[i / radii];
    const double r_mm = points_has_radii(usual) ? usual->radii->items[i % radii] : row->r_mm;
    points->arrays[0][i] = row->medium.sigma_a_per_mm;
    points->arrays[1][i] = row->medium.sigma_s_per_mm;
    points->arrays[2][i] = single ? (double)(float)r_mm : r_mm;
  }
  cli_parameters parameters = rows[0]->parameters;
  if (rows[0]->model == usual->transport && isnan(points_tolerance(usual, rows[0]))) {
    cli_parameters_set(&parameters, usual->tolerance, TABLE_TOLERANCE);
  }
  const dipole_varying_query query = {.model = rows[0]->model,
                                      .evaluator = DIPOLE_F64,
                                      .moments = rows[0]->moments,
                                      .wanted = wanted_of(usual),
                                      .g = rows[0]->medium.g,
                                      .eta = rows[0]->medium.eta,
                                      .sigma_a_per_mm = points->arrays[0],
                                      .sigma_s_per_mm = points->arrays[1],
                                      .radii = points->arrays[2],
                                      .value_count = count * radii,
                                      .parameters = parameters.items,
                                      .parameter_count = parameters.count};
  return CLI_ASK(usual->settings, error, dipole_varying(points->client, &query, result, error));
}

/* Numbers are rounded to single precision, and then to the fewest digits that are read as the same
 * number of single precision. Each is off by at most 2^-24. */
#define SINGLE_ERROR 0x1p-23

/* Takes the values of row `index` of a group. Returns false if one of them was not answered. */
static bool take_values(const points_usual *usual, points_row *row, size_t index,
                        const dipole_varying_result *result) {
  const size_t radii = usual->radius_count, count = usual->quantities.count;
  const bool single = row->evaluator != DIPOLE_F64;
  for (size_t i = 0; i < radii; i++) {
    if (result->statuses[index * radii + i] != DIPOLE_VALUE_OK) {
      return false;
    }
  }
  double *values = make_good(usual, row);
  row->numerical_error = result->numerical_error + (single ? SINGLE_ERROR : 0);
  row->numerical_error_per_mm = 0;
  row->model_error = result->model_error;
  for (size_t q = 0; q < count; q++) {
    const unsigned id = usual->quantities.items[q]->id;
    const double *from = dipole_varying_f64(result, id) + index * radii;
    for (size_t i = 0; i < radii; i++) {
      values[i * count + q] =
          single && id != DIPOLE_ALBEDO ? cli_number_of_single((float)from[i]) : from[i];
    }
  }
  return true;
}

/* Asks for the rows of a group. A row that is not answered is then asked for by itself, so that it
 * is known what is wrong with it. */
static bool ask_group(points_run *points, points_row *const *rows, size_t count) {
  dipole_error error;
  dipole_varying_result *result = NULL;
  if (!ask(points, rows, count, &result, &error)) {
    if (error.kind != DIPOLE_ERROR_REFUSED || error.retry_after_ms != 0) {
      return fail(points, "%s", error.text);
    }
    points->refused[rows[0]->model] |= strcmp(error.field, "model") == 0;
  }
  bool good = true;
  for (size_t i = 0; good && i < count; i++) {
    if (result != NULL && take_values(&points->usual, rows[i], i, result)) {
      count_done(points, rows[i]);
    } else {
      good = submit(points, rows[i]);
    }
  }
  dipole_varying_result_free(result);
  return good;
}

/* Asks for all rows that have only been read, group by group. */
static bool ask_groups(points_run *points) {
  const size_t radii = points->usual.radius_count;
  const size_t most = radii < GROUP_VALUES ? GROUP_VALUES / radii : 1;
  const size_t count = points->read_count > 0 ? list_read(points) : 0;
  points->read_count = 0;
  for (size_t first = 0, end; first < count; first = end) {
    end = first + 1;
    while (end < count && end - first < most &&
           compare(points->group[first], points->group[end]) == 0) {
      end++;
    }
    if (!ask_group(points, points->group + first, end - first)) {
      return false;
    }
  }
  return true;
}

/* ---- the window ------------------------------------------------------------------------------ */

static void write_first(points_run *points) {
  points_row *row = row_at(points, 0);
  if (row->state == POINTS_COPIED) {
    fwrite(row->record.bytes, 1, row->record.length, stdout);
  } else {
    const size_t lines = row->state == POINTS_GOOD ? points->usual.radius_count : 1;
    for (size_t i = 0; i < lines; i++) {
      points_write_line(&points->usual, &points->columns, row, i, stdout);
    }
    points->rows_written++;
    points->rows_bad += row->state == POINTS_BAD;
  }
  points->window_bytes -= row->record.length;
  cli_csv_record_trim(&row->record);
  points->first = (points->first + 1) % WINDOW_ROWS;
  points->count--;
}

/* Writes the oldest rows, and waits for their answers, until at most `left` rows are in the window.
 */
static bool write_down(points_run *points, size_t left) {
  ask_groups(points);
  while (!points->failed && points->count > left) {
    if (row_at(points, 0)->state != POINTS_WAITING) {
      write_first(points);
    } else {
      collect(points);
    }
  }
  if (!points->failed && ferror(stdout)) {
    points->failed = true; /* main() will say why */
  }
  return !points->failed;
}

/* Is called when the next read would wait. Answers all rows that have come, so that a program that
 * writes row by row gets each answer before it writes the next row. */
static void write_before_wait(void *context) {
  if (write_down(context, 0)) {
    fflush(stdout);
  }
}

/* ---- reading --------------------------------------------------------------------------------- */

/* Returns whether a record or a comment was read. If not, this is the end of the input, or the work
 * has failed. */
static bool read_record(points_run *points, cli_csv_record *record, enum cli_csv_kind *kind) {
  *kind = cli_csv_read(&points->reader, record);
  if (*kind == CLI_CSV_FAILED && !points->failed && write_down(points, 0)) { /* the rows before */
    return fail(points, "%s", points->reader.problem);
  }
  return !points->failed && (*kind == CLI_CSV_RECORD || *kind == CLI_CSV_COMMENT);
}

static bool read_header(points_run *points) {
  cli_csv_record header = {0};
  enum cli_csv_kind kind;
  bool good = true;
  while ((good = read_record(points, &header, &kind)) && kind == CLI_CSV_COMMENT) {
    fwrite(header.bytes, 1, header.length, stdout);
  }
  if (good) {
    good = points_find_columns(&points->usual, points->source, &header, &points->columns);
    if (good) {
      points_write_header(&points->columns, &header, stdout);
    }
  } else if (!points->failed) {
    fail(points, "there is no header line; it names the columns: sigma_a, sigma_s, g, eta, r, if "
                 "need be model, moments, medium, channel and parameters");
  }
  cli_csv_record_free(&header);
  return good;
}

static bool read_rows(points_run *points) {
  enum cli_csv_kind kind;
  for (;;) {
    if (points->count == WINDOW_ROWS || points->window_bytes > WINDOW_BYTES) {
      if (!write_down(points, points->count / 2)) {
        return false;
      }
    }
    /* Reading may write rows. That moves the start of the window, but not the place behind its end.
     */
    points_row *row = row_at(points, points->count);
    if (!read_record(points, &row->record, &kind)) {
      return !points->failed && write_down(points, 0);
    }
    points->count++;
    points->window_bytes += row->record.length;
    if (kind == CLI_CSV_COMMENT) {
      row->state = POINTS_COPIED;
      count_done(points, row);
    } else if (points_read_row(&points->usual, &points->columns, row)) {
      row->state = POINTS_READ;
      if (is_for_group(points, row)) {
        points->read_count++;
      } else if (!submit(points, row)) {
        return false;
      }
    } else {
      count_done(points, row);
    }
  }
}

/* ---- the command ----------------------------------------------------------------------------- */

/* Opens the input and learns its size. */
static bool open_input(points_run *points, const char *operand) {
  struct stat about;
  points->reader.fd = cli_sheet_open(operand, &points->source);
  if (points->reader.fd < 0) {
    return false;
  }
  if (fstat(points->reader.fd, &about) == 0 && S_ISREG(about.st_mode)) {
    points->input_bytes = (uint64_t)about.st_size;
  }
  points->reader.before_wait = write_before_wait;
  points->reader.context = points;
  return true;
}

/* Looks up what holds for rows whose cells are empty or absent. */
static void take_usual(const cli_profile *profile, bool is_given, points_usual *usual) {
  const dipole_info *info = usual->info = profile->info;
  usual->parameters = profile->parameters;
  usual->transport = cli_choice(info, DIPOLE_MODEL, CLI_MODEL_DEFAULT)->id;
  usual->model = profile->model != NULL ? profile->model->id : usual->transport;
  usual->moments = profile->moments->id;
  usual->evaluator = is_given ? profile->evaluator->id : DIPOLE_F64;
  usual->evaluator_of_transport = is_given ? profile->evaluator->id : DIPOLE_LUT;
  usual->tolerance = cli_choice(info, DIPOLE_PARAMETER, "tolerance")->id;
}

static int take_quantities(const cli_settings *settings, points_usual *usual) {
  const bool any_model = usual->settings->model.count == 0 &&
                         settings->parameters[CORE_PARAMETER_TOLERANCE].text != NULL;
  const unsigned wanted = settings->f.count > 0
                              ? DIPOLE_TRANSFER | DIPOLE_ALBEDO
                              : DIPOLE_R | DIPOLE_ALBEDO | (any_model ? 0 : DIPOLE_CDF);
  if (!cli_quantities_take(usual->info, &settings->wanted, wanted, 0, &usual->quantities)) {
    return CLI_USAGE;
  }
  if ((usual->quantities.wanted & DIPOLE_RADIUS) != 0) {
    return cli_fail_usage("--wanted r: r is a column of the input, or of --r: leave it out");
  }
  usual->by_f = (usual->quantities.wanted & ~(unsigned)DIPOLE_ALBEDO) == DIPOLE_TRANSFER;
  if (settings->f.count > 0 && (settings->r.count > 0 || !usual->by_f)) {
    return cli_fail_usage("--f gives spatial frequencies, which only R_f has: ask for R_f alone, "
                          "without --r");
  }
  usual->radii = settings->f.count > 0 ? &settings->f : &settings->r;
  usual->radius_count = points_has_radii(usual) ? usual->radii->count : 1;
  return CLI_OK;
}

/* Reads the options, and asks for the measured media. Returns an exit status. */
static int prepare(points_run *points) {
  points_usual *usual = &points->usual;
  const cli_settings *settings = usual->settings;
  cli_profile profile = {0};
  dipole_error error;
  if (!cli_profile_take_names(settings, points->client, &profile)) {
    return CLI_USAGE;
  }
  take_usual(&profile, settings->evaluator != NULL, usual);
  const int status = take_quantities(settings, usual);
  if (status != CLI_OK) {
    return status;
  }
  for (size_t i = 0; i < 3; i++) {
    const size_t values = usual->radius_count + GROUP_VALUES;
    points->arrays[i] = cli_allocate(values, sizeof *points->arrays[i]);
  }
  usual->r_f32 = cli_allocate(usual->radius_count, sizeof *usual->r_f32);
  for (size_t i = 0; i < usual->radii->count; i++) {
    usual->r_f32[i] = (float)usual->radii->items[i];
  }
  return dipole_media(points->client, &usual->media, &usual->medium_count, &error)
             ? CLI_OK
             : cli_fail_error(&error);
}

static int work(points_run *points) {
  const int status = prepare(points);
  if (status != CLI_OK) {
    return status;
  }
  points->answer_ms = cli_now_ms();
  cli_progress_start(&points->progress, "rows");
  const bool good = read_header(points) && read_rows(points);
  cli_progress_wipe(&points->progress);
  if (!good) {
    return CLI_FAILED;
  }
  if (points->rows_bad > 0) {
    cli_fail("%s: %llu of %llu rows were bad: see the column status", points->source,
             (unsigned long long)points->rows_bad, (unsigned long long)points->rows_written);
    return CLI_BAD_ROWS;
  }
  return CLI_OK;
}

static int run(const cli_settings *settings, dipole_client *client) {
  points_run *points = cli_allocate(1, sizeof *points);
  points->usual.settings = settings;
  points->usual.options = options;
  points->client = client;
  int status = CLI_FAILED;
  if (open_input(points, points->usual.settings->operand)) {
    status = work(points);
    if (points->reader.fd != STDIN_FILENO) {
      close(points->reader.fd);
    }
  }
  free(points->usual.media);
  return status;
}

const cli_command cli_command_points = {
    .name = "points",
    .operand = "[FILE]",
    .about = "Evaluate each row of a CSV file (or of standard input)",
    .more =
        "The header names the columns, in any order. These are needed: sigma_a, sigma_s (1/mm), "
        "g, eta and r (mm). In place of the coefficients, a row may name a measured medium in "
        "the columns medium and channel (red, green, blue). These may be absent or empty: "
        "model, moments (default: exact), and the parameters below, whose columns have _ where "
        "the options have -. An option is for the rows whose cell is empty. A column whose name "
        "is nearly one of these is an error; all others are copied.\n"
        "Each row is written as it is, with columns appended, or replaced if they exist: R "
        "(1/mm^2 per unit of power that entered; it may be inf), albedo, cdf (the share of the "
        "albedo within r) and status. status is ok or says what is wrong with the row; then the "
        "exit status is 3, but the other rows are evaluated. Comments are copied." CLI_CSV_TEXT
            CLI_DEFAULT_TEXT,
    .formats = "csv",
    .options = {options},
    .parameters = CLI_OF_MODELS,
    .examples = "  dipole points media.csv > profiles.csv\n"
                "  dipole media --format csv | dipole points --r 0.5,1,2 --wanted R,cdf\n"
                "  dipole points media.csv --wanted R --errors\n"
                "  dipole invert --albedo 0.4,0.2 --mean-free-path 1 --format csv |\n"
                "    dipole points --r 1 --model better\n"
                "  printf 'sigma_a,sigma_s,g,eta,r\\n0.01,1,0,1.4,2\\n' | dipole points\n",
    .run = run,
};
