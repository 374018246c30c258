/* dipole points: evaluates the rows of a CSV file. The rows that wait for an answer are kept in a
 * window of bounded size. So many queries are under way at a time, and rows are written in their
 * order. */
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "clients/cli/csv.h"
#include "clients/cli/daemon.h"
#include "clients/cli/number.h"
#include "clients/cli/options.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"
#include "core/core.h"

typedef struct points_settings {
  cli_profile_settings profile;
  cli_texts want;
  cli_numbers r;
} points_settings;

static const cli_option options[] = {
    {"Evaluation", NULL, NULL, CLI_HEADING, 0, NULL},
    {"model", "NAME",
     "the model of the rows whose cell is empty or absent (default: transport;\n"
     "with a tolerance, the cheapest that is so near to radiative transport)",
     CLI_TEXT, offsetof(cli_profile_settings, model), NULL},
    {CLI_EVALUATOR_OPTION, NULL},
    {"r", "X[,X...]",
     "for files without a column r: each row is written once for each of these\nradii, mm",
     CLI_NUMBERS, offsetof(points_settings, r), NULL},
    {"want", "NAME[,NAME...]",
     "the quantities to write; `dipole info` lists all (default: R,albedo,cdf)", CLI_NAMES,
     offsetof(points_settings, want), NULL},
    {0},
};

/* ---- a row: its cells, a query, and what came of it ------------------------------------------ */

enum { POINTS_INPUTS = 9, POINTS_OUTPUTS_MAX = CLI_QUANTITIES_MAX + 2 };

/* The position of a column that the header does not have. */
#define POINTS_ABSENT SIZE_MAX

/* A column that is written. */
typedef struct points_output {
  const char *name;
  size_t at; /* its position in the header */
} points_output;

/* The positions of the columns in the header. */
typedef struct points_columns {
  size_t count; /* number of cells in the header */
  size_t input_at[POINTS_INPUTS];
  size_t parameter_count; /* number of columns that are named after a parameter */
  const dipole_choice *parameters[CLI_PARAMETERS_MAX];
  size_t parameter_at[CLI_PARAMETERS_MAX];
  size_t output_count; /* with --r the radius, then the quantities, then the status */
  points_output outputs[POINTS_OUTPUTS_MAX];
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
  unsigned model, evaluator, moments;
  dipole_medium medium;
  double r_mm; /* of its cell */
  cli_parameters parameters;
  uint64_t id;
  double *values;                   /* [radii][quantities], set if the row is good */
  char status[POINTS_STATUS_BYTES]; /* says what is wrong if the row is bad */
} points_row;

#define AT(row, offset) ((double *)(void *)((char *)(row) + (offset)))

/* The columns that are read. Those with names come first. */
enum { MODEL, MOMENTS, MEDIUM, CHANNEL, FIRST_NUMBER, R = POINTS_INPUTS - 1 };

static const struct {
  const char *name;
  size_t offset; /* where the number lies in a points_row */
} inputs[POINTS_INPUTS] = {
    {"model", 0},
    {"moments", 0},
    {"medium", 0},
    {"channel", 0},
    {"sigma_a", offsetof(points_row, medium.sigma_a_per_mm)},
    {"sigma_s", offsetof(points_row, medium.sigma_s_per_mm)},
    {"g", offsetof(points_row, medium.g)},
    {"eta", offsetof(points_row, medium.eta)},
    {"r", offsetof(points_row, r_mm)},
};

/* What holds for all rows. */
typedef struct points_usual {
  const points_settings *settings;
  const dipole_info *info;
  cli_parameters parameters; /* for rows whose cells are empty or absent */
  cli_quantities quantities;
  size_t radius_count; /* of each row: those of --r, or 1 */
  float *r_f32;        /* [radius_count]; NULL without --r */
  dipole_measured_medium *media;
  size_t medium_count;
} points_usual;

static bool has_radii(const points_usual *usual) {
  return usual->settings->r.count > 0;
}

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
  for (size_t i = 0; i < columns->output_count; i++) {
    if (strcmp(columns->outputs[i].name, name) == 0) {
      return &columns->outputs[i].at;
    }
  }
  const dipole_choice *parameter = cli_choice(info, DIPOLE_PARAMETER, name);
  return parameter != NULL ? parameter_place(columns, parameter) : NULL;
}

/* Refuses a column that is not read although its name is nearly that of one that is, or is that of
 * an option. Others are copied. */
static bool check_unread(const points_usual *usual, const char *source, const char *name) {
  const dipole_choice *parameter;
  cli_nearest nearest = {0};
  if (cli_choice(usual->info, DIPOLE_QUANTITY, name) != NULL) {
    return true;
  }
  for (size_t i = 0; i < POINTS_INPUTS; i++) {
    cli_nearest_try(&nearest, name, inputs[i].name, strlen(inputs[i].name) / 4);
  }
  for (size_t from = 0;
       (parameter = cli_next_choice(usual->info, DIPOLE_PARAMETER, &from)) != NULL;) {
    cli_nearest_try(&nearest, name, parameter->name, strlen(parameter->name) / 4);
  }
  if (nearest.name != NULL) {
    cli_fail("%s: the column %s is not read; the nearest that is read is %s: rename it", source,
             name, nearest.name);
    return false;
  }
  for (const cli_option *option = options; option->name != NULL; option++) {
    if (option->kind != CLI_HEADING) {
      cli_nearest_try(&nearest, name, option->name, strlen(option->name) / 8);
    }
  }
  if (nearest.name != NULL) {
    cli_fail("%s: the column %s is not read; the nearest is the option --%s, which holds for all "
             "rows: give it, and rename the column",
             source, name, nearest.name);
  }
  return nearest.name == NULL;
}

static bool fail_missing(const char *source, const char *missing, const cli_csv_record *header) {
  char *text = NULL;
  size_t bytes = 0, length;
  FILE *found = open_memstream(&text, &bytes);
  for (size_t i = 0; found != NULL && i < header->cell_count; i++) {
    fprintf(found, "%s%s", i > 0 ? ", " : "", cli_csv_cell_text(header, i, &length));
  }
  if (found != NULL) {
    fclose(found);
  }
  const char *separator = header->cell_count > 1 || text == NULL ? NULL : strpbrk(text, ";\t");
  if (separator != NULL) {
    cli_fail("%s: the cells of the header are separated by %s; this command reads commas, and "
             "points in numbers: convert the file, for example with tr '%s' '%s'",
             source, *separator == ';' ? "semicolons" : "tabs", *separator == ';' ? ",;" : ",\\t",
             ".,");
  } else {
    cli_fail("%s: the column %s is missing; the header has %s; it needs sigma_a, sigma_s, g and "
             "eta, or medium and channel; and r unless --r is given; and may have model, moments "
             "and parameters",
             source, missing, text != NULL ? text : "others");
  }
  free(text);
  return false;
}

static bool is_required(const points_usual *usual, const points_columns *columns, size_t input) {
  return input == R ? !has_radii(usual)
                    : input >= FIRST_NUMBER && columns->input_at[MEDIUM] == POINTS_ABSENT;
}

static void list_outputs(const points_usual *usual, points_columns *columns) {
  if (has_radii(usual)) {
    columns->outputs[columns->output_count++].name = inputs[R].name;
  }
  for (size_t i = 0; i < usual->quantities.count; i++) {
    columns->outputs[columns->output_count++].name = usual->quantities.items[i]->name;
  }
  columns->outputs[columns->output_count++].name = "status";
}

/* Takes one column of the header. */
static bool take_column(const points_usual *usual, const char *source, const char *name, size_t at,
                        points_columns *columns) {
  size_t *place = place_of(columns, usual->info, name);
  if (place == NULL) {
    return check_unread(usual, source, name);
  }
  if (*place != POINTS_ABSENT) {
    cli_fail("%s: the header has the column %s twice: rename one", source, name);
    return false;
  }
  *place = at;
  return true;
}

/* Finds the columns in the header of `source`. Says what is wrong and returns false if one is
 * missing, misspelt or stands there twice. */
static bool find_columns(const points_usual *usual, const char *source,
                         const cli_csv_record *header, points_columns *columns) {
  size_t length;
  bool good = true;
  memset(columns, 0xff, sizeof *columns); /* POINTS_ABSENT everywhere */
  columns->count = header->cell_count;
  columns->parameter_count = columns->output_count = 0;
  list_outputs(usual, columns);
  for (size_t i = 0; good && i < header->cell_count; i++) {
    good = take_column(usual, source, cli_csv_cell_text(header, i, &length), i, columns);
  }
  if (good && has_radii(usual) && columns->input_at[R] != POINTS_ABSENT) {
    cli_fail("%s: the header has the column r: leave --r out, or rename the column", source);
    return false;
  }
  for (size_t i = 0; good && i < POINTS_INPUTS; i++) {
    if (is_required(usual, columns, i) && columns->input_at[i] == POINTS_ABSENT) {
      return fail_missing(source, inputs[i].name, header);
    }
  }
  return good;
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
  for (size_t i = 0; i < columns->output_count; i++) {
    if (columns->outputs[i].at == POINTS_ABSENT) {
      fprintf(file, ",%s", columns->outputs[i].name);
    }
  }
  write_ending(header, file);
}

/* A cell of the row's line for radius number `radius`. */
static void write_output(const points_usual *usual, const points_row *row, size_t radius,
                         size_t output, FILE *file) {
  char text[CLI_NUMBER_BYTES];
  const bool good = row->state == POINTS_GOOD;
  const size_t first = has_radii(usual) ? 1 : 0, count = usual->quantities.count;
  if (output == first + count) {
    cli_csv_write_cell(good ? "ok" : row->status, file);
  } else if (good && output < first) {
    fputs(cli_number_format(usual->settings->r.items[radius], text), file);
  } else if (good) {
    const double value = row->values[radius * count + output - first];
    fputs(isnan(value) ? "" : cli_number_format(value, text), file);
  }
}

/* Writes the line of a row, which is good or bad, for radius number `radius`. */
static void write_line(const points_usual *usual, const points_columns *columns,
                       const points_row *row, size_t radius, FILE *file) {
  const cli_csv_record *record = &row->record;
  for (size_t i = 0; i < columns->count; i++) {
    size_t output = 0;
    while (output < columns->output_count && columns->outputs[output].at != i) {
      output++;
    }
    fputs(i > 0 ? "," : "", file);
    if (output < columns->output_count) {
      write_output(usual, row, radius, output, file);
    } else if (i < record->cell_count) {
      cli_csv_copy_cell(record, i, file);
    }
  }
  for (size_t output = 0; output < columns->output_count; output++) {
    if (columns->outputs[output].at == POINTS_ABSENT) {
      fputc(',', file);
      write_output(usual, row, radius, output, file);
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

/* Returns the text of an input's cell; NULL if it is empty or absent. */
static const char *text_of(const points_columns *columns, const points_row *row, size_t input) {
  size_t length = 0;
  const size_t at = columns->input_at[input];
  const char *text = at == POINTS_ABSENT ? NULL : cli_csv_cell_text(&row->record, at, &length);
  return length == 0 ? NULL : text;
}

/* Reads the name of a model or a kind of moments, `otherwise` if the cell is empty or absent. */
static bool parse_name(const points_usual *usual, const points_columns *columns, points_row *row,
                       size_t input, enum dipole_kind kind, const char *otherwise, unsigned *id) {
  char known[160];
  const char *text = text_of(columns, row, input);
  const char *name = text != NULL ? text : otherwise;
  const dipole_choice *choice = cli_choice(usual->info, kind, name);
  if (choice == NULL) {
    cli_list_names(usual->info, kind, known, sizeof known);
    make_bad(row, "%s: '%.*s' is unknown: allowed: %s", inputs[input].name, SHOWN_BYTES, name,
             known);
  } else {
    *id = choice->id;
  }
  return choice != NULL;
}

static bool has_parameter(const points_usual *usual, const points_row *row, const char *name) {
  const dipole_choice *parameter = cli_choice(usual->info, DIPOLE_PARAMETER, name);
  size_t i = 0;
  while (i < row->parameters.count &&
         (parameter == NULL || row->parameters.items[i].id != parameter->id)) {
    i++;
  }
  return i < row->parameters.count;
}

/* Chooses the model and the evaluator, as `dipole eval` does. The parameters are known already. */
static bool parse_model(const points_usual *usual, const points_columns *columns, points_row *row) {
  const cli_profile_settings *settings = &usual->settings->profile;
  const char *text = text_of(columns, row, MODEL);
  const char *name = text != NULL ? text : settings->model;
  const dipole_choice *evaluator =
      cli_choice(usual->info, DIPOLE_EVALUATOR,
                 settings->evaluator != NULL ? settings->evaluator : cli_usual_evaluator(name));
  bool good = evaluator != NULL;
  if (good && name == NULL && has_parameter(usual, row, "tolerance")) {
    row->model = DIPOLE_ANY_MODEL;
  } else if (good) {
    good = parse_name(usual, columns, row, MODEL, DIPOLE_MODEL,
                      name != NULL ? name : CLI_MODEL_DEFAULT, &row->model);
  }
  row->evaluator = good ? evaluator->id : 0;
  return good;
}

/* Reads a cell with a number into the row. */
static bool parse_number(points_row *row, size_t input, const char *text, size_t length) {
  return (strlen(text) == length && cli_number_parse(text, AT(row, inputs[input].offset))) ||
         make_bad(row,
                  "%s: '%.*s' is no number: allowed: decimal numbers within the range of "
                  "doubles",
                  inputs[input].name, SHOWN_BYTES, text);
}

/* measured: whether the row has the coefficients of a measured medium, which its cells override. */
static bool parse_numbers(const points_usual *usual, const points_columns *columns, bool measured,
                          points_row *row) {
  bool good = true;
  for (size_t i = FIRST_NUMBER; good && i < POINTS_INPUTS; i++) {
    size_t length = 0;
    const bool needed = i == R ? !has_radii(usual) : !measured;
    const size_t at = columns->input_at[i];
    const char *text = at != POINTS_ABSENT ? cli_csv_cell_text(&row->record, at, &length) : "";
    if (needed || length > 0) {
      good = parse_number(row, i, text, length);
    }
  }
  return good;
}

/* Finds the coefficients of a channel of a measured medium. */
static bool take_measured(const points_usual *usual, const char *name, const char *channel,
                          points_row *row) {
  size_t i = 0;
  const size_t colour = cli_colour(channel);
  while (i < usual->medium_count && strcmp(usual->media[i].name, name) != 0) {
    i++;
  }
  if (i == usual->medium_count) {
    return make_bad(row,
                    "medium: '%.*s' is unknown: allowed: those of `dipole media`, or any "
                    "text with sigma_a and sigma_s",
                    SHOWN_BYTES, name);
  }
  if (colour == CLI_COLOURS) {
    return make_bad(row, "channel: '%.*s': allowed: red, green, blue", SHOWN_BYTES,
                    channel != NULL ? channel : "");
  }
  row->medium = usual->media[i].channel[colour];
  return true;
}

/* Reads the medium and the radius. The coefficients are those in the cells or, if sigma_a and
 * sigma_s are both empty, those of a measured medium. */
static bool parse_medium(const points_usual *usual, const points_columns *columns,
                         points_row *row) {
  const char *name = text_of(columns, row, MEDIUM);
  const bool measured = name != NULL && text_of(columns, row, FIRST_NUMBER) == NULL &&
                        text_of(columns, row, FIRST_NUMBER + 1) == NULL;
  return (!measured || take_measured(usual, name, text_of(columns, row, CHANNEL), row)) &&
         parse_numbers(usual, columns, measured, row);
}

/* Sets the parameters of the row: first the usual ones, then those in its cells. */
static bool parse_parameters(const points_usual *usual, const points_columns *columns,
                             points_row *row) {
  bool good = true;
  row->parameters = usual->parameters;
  for (size_t i = 0; good && i < columns->parameter_count; i++) {
    const dipole_choice *parameter = columns->parameters[i];
    size_t length;
    double value;
    const char *text = cli_csv_cell_text(&row->record, columns->parameter_at[i], &length);
    good = length == 0 ||
           (strlen(text) == length && cli_parameter_parse(usual->info, parameter, text, &value));
    if (!good) {
      make_bad(row, "%s: '%.*s' is no value: allowed: %s", parameter->name, SHOWN_BYTES, text,
               parameter->about);
    } else if (length > 0) {
      cli_parameters_set(&row->parameters, parameter->id, value);
    }
  }
  return good;
}

/* Reads the row's cells. Returns false if the row is bad; its status then says why. */
static bool parse_row(const points_usual *usual, const points_columns *columns, points_row *row) {
  if (row->record.malformed) {
    return make_bad(row, "the row: text after a closing quote: allowed: quotes around whole cells, "
                         "doubled within");
  }
  if (row->record.cell_count != columns->count) {
    return make_bad(row, "the row: %zu cells: allowed: %zu, as many as in the header",
                    row->record.cell_count, columns->count);
  }
  return parse_parameters(usual, columns, row) && parse_model(usual, columns, row) &&
         parse_name(usual, columns, row, MOMENTS, DIPOLE_MOMENTS, "exact", &row->moments) &&
         parse_medium(usual, columns, row);
}

/* ---- asking ---------------------------------------------------------------------------------- */

/* Sends the row's query; the row then waits for the answer. */
static bool submit_row(const points_usual *usual, dipole_client *client, points_row *row,
                       dipole_error *error) {
  const float r_f32_mm = (float)row->r_mm;
  const void *f64 = has_radii(usual) ? usual->settings->r.items : &row->r_mm;
  const void *f32 = has_radii(usual) ? usual->r_f32 : &r_f32_mm;
  const dipole_query query = {.model = row->model,
                              .evaluator = row->evaluator,
                              .moments = row->moments,
                              .wanted = usual->quantities.wanted,
                              .media = &row->medium,
                              .medium_count = 1,
                              .spacing = DIPOLE_LIST,
                              .radii = row->evaluator == DIPOLE_F64 ? f64 : f32,
                              .radius_count = usual->radius_count,
                              .parameters = row->parameters.items,
                              .parameter_count = row->parameters.count};
  row->state = POINTS_WAITING;
  return dipole_submit(client, &query, &row->id, error);
}

/* Takes the answer; the row is then good. */
static void take_answer(const points_usual *usual, points_row *row, const dipole_result *result) {
  const size_t count = usual->quantities.count;
  row->state = POINTS_GOOD;
  if (row->values == NULL) {
    row->values = cli_allocate(usual->radius_count * count, sizeof *row->values);
  }
  for (size_t q = 0; q < count; q++) {
    const unsigned id = usual->quantities.items[q]->id;
    const double *f64 = dipole_values_f64(result, 0, id);
    const float *f32 = dipole_values_f32(result, 0, id);
    for (size_t i = 0; i < usual->radius_count; i++) {
      row->values[i * count + q] = f64 != NULL   ? f64[i]
                                   : f32 != NULL ? cli_number_of_single(f32[i])
                                                 : result->channels[0].albedo;
    }
  }
}

/* ---- the work -------------------------------------------------------------------------------- */

/* When the window is full, half of its rows are written before more are read. So many queries are
 * sent together. */
enum { WINDOW_ROWS = 512 };

/* How many bytes of text the rows of the window may hold together. */
#define WINDOW_BYTES ((size_t)4 << 20)

typedef struct points_run {
  points_usual usual;
  const char *source; /* name of the input, for messages */
  dipole_client *client;
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
    return true;
  }
  return cli_try_again(&points->usual.settings->profile.common, points->answer_ms, error)
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
    const size_t lines = row->state == POINTS_GOOD ? points->usual.radius_count : 1;
    for (size_t i = 0; i < lines; i++) {
      write_line(&points->usual, &points->columns, row, i, stdout);
    }
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
    good = find_columns(&points->usual, points->source, &header, &points->columns);
    if (good) {
      write_header(&points->columns, &header, stdout);
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
    } else if (parse_row(&points->usual, &points->columns, row) && !submit(points, row)) {
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

/* Reads the options, and asks for the measured media. Returns an exit status. */
static int prepare(points_run *points) {
  points_usual *usual = &points->usual;
  const points_settings *settings = usual->settings;
  const cli_profile_settings *profile = &settings->profile;
  dipole_error error;
  usual->info = dipole_get_info(points->client);
  if ((profile->evaluator != NULL &&
       cli_named(usual->info, DIPOLE_EVALUATOR, "evaluator", profile->evaluator) == NULL) ||
      (profile->model != NULL &&
       cli_named(usual->info, DIPOLE_MODEL, "model", profile->model) == NULL) ||
      !cli_parameters_take(usual->info, profile, &usual->parameters) ||
      !cli_quantities_take(usual->info, &settings->want, DIPOLE_R | DIPOLE_ALBEDO | DIPOLE_CDF, 0,
                           &usual->quantities)) {
    return CLI_USAGE;
  }
  if ((usual->quantities.wanted & DIPOLE_RADIUS) != 0) {
    return cli_fail_usage("--want r: r is a column of the input, or of --r: leave it out");
  }
  usual->radius_count = has_radii(usual) ? settings->r.count : 1;
  usual->r_f32 = cli_allocate(usual->radius_count, sizeof *usual->r_f32);
  for (size_t i = 0; i < settings->r.count; i++) {
    usual->r_f32[i] = (float)settings->r.items[i];
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

static int run(void *settings, dipole_client *client) {
  points_run *points = cli_allocate(1, sizeof *points);
  points->usual.settings = settings;
  points->client = client;
  int status = CLI_FAILED;
  if (open_input(points, points->usual.settings->profile.common.operand)) {
    status = work(points);
    if (points->reader.fd != STDIN_FILENO) {
      close(points->reader.fd);
    }
  }
  for (size_t i = 0; i < WINDOW_ROWS; i++) {
    cli_csv_record_free(&points->rows[i].record);
    free(points->rows[i].values);
  }
  free(points->usual.r_f32);
  free(points->usual.media);
  free(points);
  return status;
}

const cli_command cli_command_points = {
    .name = "points",
    .operand = "[FILE]",
    .about = "Evaluate each row of a CSV file (or of standard input)",
    .more =
        "\n"
        "The header names the columns, in any order. These are needed: sigma_a, sigma_s (1/mm),\n"
        "g, eta and r (mm). In place of the coefficients, a row may name a measured medium in the\n"
        "columns medium and channel (red, green, blue). These may be absent or empty: model,\n"
        "moments (default: exact), and the parameters below, whose columns have _ where the\n"
        "options have -. An option is for the rows whose cell is empty. A column whose name is\n"
        "nearly one of these is an error; all others are copied.\n"
        "\n"
        "Each row is written as it is, with columns appended, or replaced if they exist: R\n"
        "(1/mm^2 per unit of power that entered; it may be inf), albedo, cdf (the share of the\n"
        "albedo within r) and status. status is ok or says what is wrong with the row; then the\n"
        "exit status is 3, but the other rows are evaluated. Lines that start with # are "
        "copied.\n" CLI_DEFAULT_TEXT,
    .formats = "csv",
    .options = {options, cli_parameter_options},
    .examples = "  dipole points media.csv > profiles.csv\n"
                "  dipole media --format csv | dipole points --r 0.5,1,2 --want R,cdf\n"
                "  dipole invert --albedo 0.4,0.2 --mean-free-path 1 --format csv |\n"
                "    dipole points --r 1 --model better\n"
                "  printf 'sigma_a,sigma_s,g,eta,r\\n0.01,1,0,1.4,2\\n' | dipole points\n",
    .settings_bytes = sizeof(points_settings),
    .run = run,
};
