/* dipole points: evaluates the rows of a CSV file. The rows that wait for an answer are kept in a
 * window of bounded size. So many queries are under way at a time, and rows are written in their
 * order. */
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "clients/cli/csv.h"
#include "clients/cli/daemon.h"
#include "clients/cli/number.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"

/* ---- a row: its cells, a query, and what came of it ------------------------------------------ */

enum { POINTS_INPUTS = 7, POINTS_OUTPUTS = 4 };

/* The position of a column that the header does not have. */
#define POINTS_ABSENT SIZE_MAX

/* The positions of the columns in the header. */
typedef struct points_columns {
  size_t count; /* number of cells in the header */
  size_t input_at[POINTS_INPUTS];
  size_t output_at[POINTS_OUTPUTS];
  size_t parameter_count; /* number of columns that are named after a parameter */
  const dipole_choice *parameters[CLI_PARAMETERS_MAX];
  size_t parameter_at[CLI_PARAMETERS_MAX];
} points_columns;

enum points_state {
  POINTS_COPIED,  /* written as it was read */
  POINTS_WAITING, /* waits for the answer to query `id` */
  POINTS_GOOD,
  POINTS_BAD,
};

enum { POINTS_STATUS_BYTES = 256 };

typedef struct points_row {
  cli_csv_record record;
  enum points_state state;
  unsigned model, moments;
  dipole_medium medium;
  double r_mm;
  cli_parameters parameters;
  uint64_t id;
  double R, albedo, cdf;            /* set if the row is good */
  char status[POINTS_STATUS_BYTES]; /* says what is wrong if the row is bad */
} points_row;

#define AT(row, offset) ((double *)(void *)((char *)(row) + (offset)))

/* The columns that are read. Those with names come first. */
enum { MODEL, MOMENTS, FIRST_NUMBER };

static const struct {
  const char *name;
  bool required;
  size_t offset;     /* where the number lies in a points_row */
  const char *usual; /* the name if the cell is empty or absent */
} inputs[POINTS_INPUTS] = {
    {"model", false, 0, "better"},
    {"moments", false, 0, "exact"},
    {"sigma_a", true, offsetof(points_row, medium.sigma_a_per_mm), NULL},
    {"sigma_s", true, offsetof(points_row, medium.sigma_s_per_mm), NULL},
    {"g", true, offsetof(points_row, medium.g), NULL},
    {"eta", true, offsetof(points_row, medium.eta), NULL},
    {"r", true, offsetof(points_row, r_mm), NULL},
};

/* The columns that are written. The last one has the status. */
enum { STATUS = POINTS_OUTPUTS - 1 };

static const struct {
  const char *name;
  size_t offset; /* where the number lies in a points_row */
} outputs[POINTS_OUTPUTS] = {
    {"R", offsetof(points_row, R)},
    {"albedo", offsetof(points_row, albedo)},
    {"cdf", offsetof(points_row, cdf)},
    {"status", 0},
};

/* ---- the header ------------------------------------------------------------------------------ */

/* Returns where the position of a parameter's column is stored. Adds the parameter if it is new; if
 * there is no room for it, returns NULL. */
static size_t *parameter_place(points_columns *columns, const dipole_choice *parameter) {
  size_t i = 0;
  while (i < columns->parameter_count && columns->parameters[i] != parameter) {
    i++;
  }
  if (i == CLI_PARAMETERS_MAX) {
    return NULL;
  }
  if (i == columns->parameter_count) {
    columns->parameters[i] = parameter;
    columns->parameter_at[i] = POINTS_ABSENT;
    columns->parameter_count++;
  }
  return &columns->parameter_at[i];
}

/* Returns where the position of a column with this name is stored. Returns NULL if the column is
 * neither read nor written. */
static size_t *place_of(points_columns *columns, const dipole_info *info, const char *name) {
  for (size_t i = 0; i < POINTS_INPUTS; i++) {
    if (strcmp(inputs[i].name, name) == 0) {
      return &columns->input_at[i];
    }
  }
  for (size_t i = 0; i < POINTS_OUTPUTS; i++) {
    if (strcmp(outputs[i].name, name) == 0) {
      return &columns->output_at[i];
    }
  }
  const dipole_choice *parameter = cli_choice(info, DIPOLE_PARAMETER, name);
  return parameter != NULL ? parameter_place(columns, parameter) : NULL;
}

static bool fail_missing(const char *source, const char *missing, const cli_csv_record *header) {
  char *text = NULL;
  size_t bytes = 0, length;
  FILE *found = open_memstream(&text, &bytes);
  for (size_t i = 0; found != NULL && i < header->cell_count; i++) {
    char *name = cli_csv_cell_text(header, i, &length);
    fprintf(found, "%s%s", i > 0 ? ", " : "", name);
    free(name);
  }
  if (found != NULL) {
    fclose(found);
  }
  cli_fail("%s: the column %s is missing; the header has %s; it needs sigma_a, sigma_s, g, eta "
           "and r, and may have model, moments and parameters",
           source, missing, text != NULL ? text : "others");
  free(text);
  return false;
}

/* Finds the columns in the header of `source`. Says what is wrong and returns false if one is
 * missing or stands there twice. */
static bool find_columns(const char *source, const dipole_info *info, const cli_csv_record *header,
                         points_columns *columns) {
  size_t length;
  memset(columns, 0xff, sizeof *columns); /* POINTS_ABSENT everywhere */
  columns->count = header->cell_count;
  columns->parameter_count = 0;
  for (size_t i = 0; i < header->cell_count; i++) {
    char *name = cli_csv_cell_text(header, i, &length);
    size_t *place = place_of(columns, info, name);
    const bool twice = place != NULL && *place != POINTS_ABSENT;
    if (twice) {
      cli_fail("%s: the header has the column %s twice: rename one", source, name);
    } else if (place != NULL) {
      *place = i;
    }
    free(name);
    if (twice) {
      return false;
    }
  }
  for (size_t i = 0; i < POINTS_INPUTS; i++) {
    if (inputs[i].required && columns->input_at[i] == POINTS_ABSENT) {
      return fail_missing(source, inputs[i].name, header);
    }
  }
  return true;
}

/* ---- writing --------------------------------------------------------------------------------- */

/* Writes the end of the line as it was read. The last line of a file may lack one; then writes \n.
 */
static void write_ending(const cli_csv_record *record, FILE *file) {
  if (record->ending_bytes == 0) {
    fputc('\n', file);
  } else {
    fwrite(record->bytes + record->length - record->ending_bytes, 1, record->ending_bytes, file);
  }
}

/* Writes the header and appends the output columns that it lacks. */
static void write_header(const points_columns *columns, const cli_csv_record *header, FILE *file) {
  fwrite(header->bytes, 1, header->length - header->ending_bytes, file);
  for (size_t i = 0; i < POINTS_OUTPUTS; i++) {
    if (columns->output_at[i] == POINTS_ABSENT) {
      fprintf(file, ",%s", outputs[i].name);
    }
  }
  write_ending(header, file);
}

static void write_output(const points_row *row, size_t output, FILE *file) {
  char text[CLI_NUMBER_BYTES];
  const bool good = row->state == POINTS_GOOD;
  if (output == STATUS) {
    cli_csv_write_cell(good ? "ok" : row->status, file);
  } else if (good) {
    const void *at = (const char *)row + outputs[output].offset;
    fputs(cli_number_format(*(const double *)at, text), file);
  }
}

/* Writes a row that is good or bad. */
static void write_row(const points_columns *columns, const points_row *row, FILE *file) {
  const cli_csv_record *record = &row->record;
  for (size_t i = 0; i < columns->count; i++) {
    size_t output = 0;
    while (output < POINTS_OUTPUTS && columns->output_at[output] != i) {
      output++;
    }
    fputs(i > 0 ? "," : "", file);
    if (output < POINTS_OUTPUTS) {
      write_output(row, output, file);
    } else if (i < record->cell_count) {
      cli_csv_copy_cell(record, i, file);
    }
  }
  for (size_t output = 0; output < POINTS_OUTPUTS; output++) {
    if (columns->output_at[output] == POINTS_ABSENT) {
      fputc(',', file);
      write_output(row, output, file);
    }
  }
  for (size_t i = columns->count; i < record->cell_count;
       i++) { /* cells beyond those of the header */
    fputc(',', file);
    cli_csv_copy_cell(record, i, file);
  }
  write_ending(record, file);
}

/* ---- reading --------------------------------------------------------------------------------- */

/* The status of a row shows at most so many bytes of a wrong cell. */
enum { SHOWN_BYTES = 40 };

__attribute__((format(printf, 2, 3))) static bool make_bad(points_row *row, const char *format,
                                                           ...) {
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(row->status, sizeof row->status, format, arguments);
  va_end(arguments);
  row->state = POINTS_BAD;
  return false;
}

/* Reads the name of a model or a kind of moments. */
static bool parse_name(const points_columns *columns, const dipole_info *info, points_row *row,
                       size_t input, enum dipole_kind kind, unsigned *id) {
  char known[160];
  size_t length = 0;
  const size_t at = columns->input_at[input];
  char *text = at == POINTS_ABSENT ? NULL : cli_csv_cell_text(&row->record, at, &length);
  const char *name = length == 0 ? inputs[input].usual : text;
  const dipole_choice *choice = cli_choice(info, kind, name);
  if (choice == NULL) {
    cli_list_names(info, kind, known, sizeof known);
    make_bad(row, "%s: '%.*s' is unknown: allowed: %s", inputs[input].name, SHOWN_BYTES, name,
             known);
  } else {
    *id = choice->id;
  }
  free(text);
  return choice != NULL;
}

static bool parse_numbers(const points_columns *columns, points_row *row) {
  bool good = true;
  for (size_t i = FIRST_NUMBER; good && i < POINTS_INPUTS; i++) {
    size_t length;
    char *text = cli_csv_cell_text(&row->record, columns->input_at[i], &length);
    good = strlen(text) == length && cli_number_parse(text, AT(row, inputs[i].offset));
    if (!good) {
      make_bad(row, "%s: '%.*s' is no number: allowed: decimal numbers within the range of doubles",
               inputs[i].name, SHOWN_BYTES, text);
    }
    free(text);
  }
  return good;
}

/* Sets the parameters of the row: first the usual ones, then those in its cells. */
static bool parse_parameters(const points_columns *columns, const dipole_info *info,
                             const cli_parameters *usual, points_row *row) {
  bool good = true;
  row->parameters = *usual;
  for (size_t i = 0; good && i < columns->parameter_count; i++) {
    const dipole_choice *parameter = columns->parameters[i];
    size_t length;
    double value;
    char *text = cli_csv_cell_text(&row->record, columns->parameter_at[i], &length);
    good = length == 0 ||
           (strlen(text) == length && cli_parameter_parse(info, parameter, text, &value));
    if (!good) {
      make_bad(row, "%s: '%.*s' is no value: allowed: %s", parameter->name, SHOWN_BYTES, text,
               parameter->about);
    } else if (length > 0) {
      cli_parameters_set(&row->parameters, parameter->id, value);
    }
    free(text);
  }
  return good;
}

/* Reads the row's cells. usual: parameters for which the row's cells are empty or absent. Returns
 * false if the row is bad; its status then says why. */
static bool parse_row(const points_columns *columns, const dipole_info *info,
                      const cli_parameters *usual, points_row *row) {
  if (row->record.malformed) {
    return make_bad(row, "the row: text after a closing quote: allowed: quotes around whole cells, "
                         "doubled within");
  }
  if (row->record.cell_count != columns->count) {
    return make_bad(row, "the row: %zu cells: allowed: %zu, as many as in the header",
                    row->record.cell_count, columns->count);
  }
  return parse_name(columns, info, row, MODEL, DIPOLE_MODEL, &row->model) &&
         parse_name(columns, info, row, MOMENTS, DIPOLE_MOMENTS, &row->moments) &&
         parse_numbers(columns, row) && parse_parameters(columns, info, usual, row);
}

/* ---- asking ---------------------------------------------------------------------------------- */

/* Sends the row's query; the row then waits for the answer. */
static bool submit_row(dipole_client *client, unsigned evaluator, points_row *row,
                       dipole_error *error) {
  const float r_f32_mm = (float)row->r_mm;
  const dipole_query query = {.model = row->model,
                              .evaluator = evaluator,
                              .moments = row->moments,
                              .wanted = DIPOLE_R | DIPOLE_ALBEDO | DIPOLE_CDF,
                              .media = &row->medium,
                              .medium_count = 1,
                              .spacing = DIPOLE_LIST,
                              .radii = evaluator == DIPOLE_F64 ? (const void *)&row->r_mm
                                                               : (const void *)&r_f32_mm,
                              .radius_count = 1,
                              .parameters = row->parameters.items,
                              .parameter_count = row->parameters.count};
  row->state = POINTS_WAITING;
  return dipole_submit(client, &query, &row->id, error);
}

/* Takes the answer; the row is then good. */
static void take_answer(points_row *row, const dipole_result *result) {
  const dipole_channel *channel = &result->channels[0];
  row->state = POINTS_GOOD;
  row->albedo = channel->albedo;
  row->R = channel->R_f64 != NULL ? channel->R_f64[0] : (double)channel->R_f32[0];
  row->cdf = channel->cdf_f64 != NULL ? channel->cdf_f64[0] : (double)channel->cdf_f32[0];
}

/* ---- the work -------------------------------------------------------------------------------- */

/* When the window is full, half of its rows are written before more are read. So many queries are
 * sent together. */
enum { WINDOW_ROWS = 512 };

/* How many bytes of text the rows of the window may hold together. */
#define WINDOW_BYTES ((size_t)4 << 20)

typedef struct points_run {
  const cli_profile_settings *settings;
  const char *source; /* name of the input, for messages */
  dipole_client *client;
  unsigned evaluator;
  cli_parameters parameters; /* for rows whose cells are empty or absent */
  cli_csv_reader reader;
  points_columns columns;
  cli_progress progress;
  uint64_t input_bytes; /* size of the input; 0 if it is unknown */
  uint64_t rows_written, rows_bad;
  int64_t answer_ms; /* when the last answer came */
  bool failed;
  size_t first, count; /* row i of the window is rows[(first + i) % WINDOW_ROWS] */
  size_t window_bytes;
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

static bool submit(points_run *points, points_row *row) {
  dipole_error error;
  return submit_row(points->client, points->evaluator, row, &error) ||
         fail(points, "%s", error.text);
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
    return true;
  }
  return cli_try_again(&points->settings->common, points->answer_ms, error)
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
    take_answer(row, result);
  }
  dipole_result_free(result);
  return row != NULL || fail(points, "an answer came to a query that was not sent");
}

/* ---- the window ------------------------------------------------------------------------------ */

static void write_first(points_run *points) {
  points_row *row = row_at(points, 0);
  if (row->state == POINTS_COPIED) {
    fwrite(row->record.bytes, 1, row->record.length, stdout);
  } else {
    write_row(&points->columns, row, stdout);
    points->rows_written++;
    points->rows_bad += row->state == POINTS_BAD;
  }
  points->window_bytes -= row->record.length;
  cli_csv_record_trim(&row->record);
  points->first = (points->first + 1) % WINDOW_ROWS;
  points->count--;
  const double input_bytes = (double)points->input_bytes; /* 0 if it is unknown */
  cli_progress_show(&points->progress,
                    input_bytes > 0 ? (double)points->reader.bytes_read / input_bytes : NAN,
                    (double)points->rows_written);
}

/* Writes the oldest rows, and waits for their answers, until at most `left` rows are in the window.
 */
static bool write_down(points_run *points, size_t left) {
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
  const char *what = "";
  *kind = cli_csv_read(&points->reader, record);
  switch (*kind) {
  case CLI_CSV_RECORD:
  case CLI_CSV_COMMENT:
    return !points->failed;
  case CLI_CSV_END:
    return false;
  case CLI_CSV_TOO_LONG:
    what = "the row is longer than 1 MiB";
    break;
  case CLI_CSV_UNCLOSED:
    what = "a quote is not closed";
    break;
  case CLI_CSV_FAILED:
    what = strerror(points->reader.read_errno);
    break;
  }
  if (points->failed || !write_down(points, 0)) { /* answer the rows before this one */
    return false;
  }
  return fail(points, "line %llu: %s", (unsigned long long)points->reader.lines + 1, what);
}

static bool read_header(points_run *points) {
  cli_csv_record header = {0};
  enum cli_csv_kind kind;
  bool good = true;
  while ((good = read_record(points, &header, &kind)) && kind == CLI_CSV_COMMENT) {
    fwrite(header.bytes, 1, header.length, stdout);
  }
  if (good) {
    good = find_columns(points->source, dipole_get_info(points->client), &header, &points->columns);
    if (good) {
      write_header(&points->columns, &header, stdout);
    }
  } else if (!points->failed) {
    fail(points, "there is no header line; it names the columns: sigma_a, sigma_s, g, eta, r, if "
                 "need be model, moments and parameters");
  }
  cli_csv_record_free(&header);
  return good;
}

static bool read_rows(points_run *points) {
  const dipole_info *info = dipole_get_info(points->client);
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
    } else if (parse_row(&points->columns, info, &points->parameters, row) &&
               !submit(points, row)) {
      return false;
    }
  }
}

/* ---- the command ----------------------------------------------------------------------------- */

/* Opens the input and learns its size. */
static bool open_input(points_run *points, const char *operand) {
  struct stat about;
  const bool standard = operand == NULL || strcmp(operand, "-") == 0;
  points->source = standard ? "standard input" : operand;
  points->reader.fd = standard ? STDIN_FILENO : open(operand, O_RDONLY | O_CLOEXEC);
  if (points->reader.fd < 0) {
    cli_fail("%s: %s", operand, strerror(errno));
    return false;
  }
  if (fstat(points->reader.fd, &about) == 0 && S_ISREG(about.st_mode)) {
    points->input_bytes = (uint64_t)about.st_size;
  }
  points->reader.before_wait = write_before_wait;
  points->reader.context = points;
  return true;
}

static int work(points_run *points) {
  const dipole_info *info = dipole_get_info(points->client);
  const dipole_choice *evaluator =
      cli_named(info, DIPOLE_EVALUATOR, "evaluator", points->settings->evaluator);
  if (evaluator == NULL || !cli_parameters_take(info, points->settings, &points->parameters)) {
    return CLI_USAGE;
  }
  points->evaluator = evaluator->id;
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

static int run(void *settings, dipole_client *client) {
  points_run *points = cli_allocate(1, sizeof *points);
  points->settings = settings;
  points->client = client;
  int status = CLI_FAILED;
  if (open_input(points, points->settings->common.operand)) {
    status = work(points);
    if (points->reader.fd != STDIN_FILENO) {
      close(points->reader.fd);
    }
  }
  for (size_t i = 0; i < WINDOW_ROWS; i++) {
    cli_csv_record_free(&points->rows[i].record);
  }
  free(points);
  return status;
}

static const cli_option options[] = {
    {"Evaluation", NULL, NULL, CLI_HEADING, 0, NULL},
    {"evaluator", "NAME",
     "f64 or f32: double or single precision; lut: single, by a table, which is\n"
     "faster if many rows have the same medium (default: f64)",
     CLI_TEXT, offsetof(cli_profile_settings, evaluator), "f64"},
    {0},
};

const cli_command cli_command_points = {
    .name = "points",
    .operand = "[FILE]",
    .about = "Evaluate each row of a CSV file (or of standard input)",
    .more =
        "\n"
        "The header names the columns, in any order. These are needed: sigma_a, sigma_s (1/mm),\n"
        "g, eta and r (mm). These may be absent or empty: model (default: better), moments\n"
        "(default: exact), and the parameters below, whose columns have _ where the options have\n"
        "-. An option is for the rows whose cell is empty.\n"
        "\n"
        "Each row is written as it is, with four columns appended, or replaced if they exist: R\n"
        "(1/mm^2 per unit of power that entered; it may be inf), albedo, cdf (the share of the\n"
        "albedo within r) and status. status is ok or says what is wrong with the row; then the\n"
        "exit status is 3, but the other rows are evaluated. Lines that start with # are copied.\n",
    .formats = "csv",
    .options = {options, cli_parameter_options},
    .examples = "  dipole points media.csv > profiles.csv\n"
                "  printf 'sigma_a,sigma_s,g,eta,r\\n0.01,1,0,1.4,2\\n' | dipole points\n",
    .settings_bytes = sizeof(cli_profile_settings),
    .run = run,
};
