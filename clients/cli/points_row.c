#include "clients/cli/points_row.h"

#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "core/core.h"
#include "proto/decimal.h"

#define AT(row, offset) ((double *)(void *)((char *)(row) + (offset)))

/* The columns that are read. Those with names come first. */
enum { MODEL, MOMENTS, MEDIUM, CHANNEL, FIRST_NUMBER, R = POINTS_INPUTS - 1 };

static const char *const inputs[POINTS_INPUTS] = {
    "model", "moments", "medium", "channel", "sigma_a", "sigma_s", "g", "eta", "r"};

/* Where the numbers lie in a points_row. */
static const size_t offsets[POINTS_INPUTS] = {
    [FIRST_NUMBER] = offsetof(points_row, medium.sigma_a_per_mm),
    [FIRST_NUMBER + 1] = offsetof(points_row, medium.sigma_s_per_mm),
    [FIRST_NUMBER + 2] = offsetof(points_row, medium.g),
    [FIRST_NUMBER + 3] = offsetof(points_row, medium.eta),
    [R] = offsetof(points_row, r_mm)};

/* ---- the header ------------------------------------------------------------------------------ */

static void add_names(const dipole_info *info, enum dipole_kind kind, points_columns *columns) {
  const dipole_choice *choice;
  for (size_t from = 0; columns->name_count < POINTS_NAMES_MAX - 3 &&
                        (choice = cli_next_choice(info, kind, &from)) != NULL;) {
    columns->names[columns->name_count++] = choice->name;
  }
}

/* Adds a column that is written. */
static void add_output(points_columns *columns, const char *name) {
  size_t i = 0;
  while (strcmp(columns->names[i], name) != 0) {
    i++;
  }
  columns->outputs[columns->output_count++] = i;
}

static void list_columns(const points_usual *usual, points_columns *columns) {
  *columns = (points_columns){.name_count = POINTS_INPUTS};
  memcpy(columns->names, inputs, sizeof inputs);
  columns->names[R] = usual->by_f ? "f" : "r";
  add_names(usual->info, DIPOLE_PARAMETER, columns);
  columns->parameter_count = columns->name_count - POINTS_INPUTS;
  add_names(usual->info, DIPOLE_QUANTITY, columns);
  columns->names[columns->name_count++] = "numerical_error";
  columns->names[columns->name_count++] = "status";
  if (points_has_radii(usual)) {
    add_output(columns, columns->names[R]);
  }
  for (size_t i = 0; i < usual->quantities.count; i++) {
    add_output(columns, usual->quantities.items[i]->name);
  }
  if (usual->settings->errors) {
    add_output(columns, "numerical_error");
    add_output(columns, "model_error"); /* a quantity */
  }
  add_output(columns, "status");
}

static bool is_required(const points_usual *usual, const points_columns *columns, size_t input) {
  return input == R ? !points_has_radii(usual)
                    : input >= FIRST_NUMBER && columns->at[MEDIUM] == CLI_CSV_ABSENT;
}

bool points_find_columns(const points_usual *usual, const char *source,
                         const cli_csv_record *header, points_columns *columns) {
  list_columns(usual, columns);
  columns->count = columns->first_output = header->cell_count;
  if (!cli_csv_find(source, header, columns->names, columns->name_count, usual->options,
                    columns->at)) {
    return false;
  }
  if (points_has_radii(usual) && columns->at[R] != CLI_CSV_ABSENT) {
    cli_fail("%s: the header has the column %s: leave --%s out, or rename the column", source,
             columns->names[R], columns->names[R]);
    return false;
  }
  for (size_t i = 0; i < columns->output_count; i++) {
    const size_t at = columns->at[columns->outputs[i]];
    columns->first_output = at < columns->first_output ? at : columns->first_output;
  }
  for (size_t i = 0; i < POINTS_INPUTS; i++) {
    if (is_required(usual, columns, i) && columns->at[i] == CLI_CSV_ABSENT) {
      return cli_csv_fail_missing(
          source, header, columns->names[i],
          "sigma_a, sigma_s, g and eta, or medium and channel; and r unless --r is given; and may "
          "have model, moments and parameters");
    }
  }
  return true;
}

/* ---- writing --------------------------------------------------------------------------------- */

/* Writes the end of the line as it was read. The last line of a file may lack one; then writes \n.
 */
static void write_ending(const cli_csv_record *record, FILE *file) {
  if (record->ending_bytes == 0) {
    putc_unlocked('\n', file);
  } else {
    fwrite_unlocked(record->bytes + record->length - record->ending_bytes, 1, record->ending_bytes,
                    file);
  }
}

void points_write_header(const points_columns *columns, const cli_csv_record *header, FILE *file) {
  fwrite(header->bytes, 1, header->length - header->ending_bytes, file);
  for (size_t i = 0; i < columns->output_count; i++) {
    if (columns->at[columns->outputs[i]] == CLI_CSV_ABSENT) {
      fprintf(file, "%c%s", header->separator, columns->names[columns->outputs[i]]);
    }
  }
  write_ending(header, file);
}

/* Returns the error of the row's values at radius number `radius`. It does not grow with r at an
 * infinite r. */
static double numerical_error(const points_usual *usual, const points_row *row, size_t radius) {
  const double r_mm = points_has_radii(usual) ? usual->radii->items[radius] : row->r_mm;
  const bool grows = row->numerical_error_per_mm > 0 && r_mm < (double)INFINITY;
  return row->numerical_error + (grows ? row->numerical_error_per_mm * r_mm : 0);
}

static void write_number(double value, FILE *file) {
  char text[DECIMAL_BYTES];
  decimal_write(value, text);
  fputs_unlocked(isnan(value) ? "" : text, file);
}

/* A cell of the row's line for radius number `radius`. */
static void write_output(const points_usual *usual, const points_row *row, size_t radius,
                         size_t output, FILE *file) {
  const bool good = row->state == POINTS_GOOD;
  const size_t first = points_has_radii(usual) ? 1 : 0, count = usual->quantities.count;
  if (output == first + count + (usual->settings->errors ? 2 : 0)) {
    cli_csv_write_cell(good ? "ok" : row->status, file);
  } else if (good && output >= first + count) {
    write_number(output == first + count ? numerical_error(usual, row, radius) : row->model_error,
                 file);
  } else if (good && output < first) {
    write_number(usual->radii->items[radius], file);
  } else if (good) {
    write_number(row->values[radius * count + output - first], file);
  }
}

void points_write_line(const points_usual *usual, const points_columns *columns,
                       const points_row *row, size_t radius, FILE *file) {
  const cli_csv_record *record = &row->record;
  /* The cells up to the first that is replaced are written as they were read. */
  const size_t as_read =
      columns->first_output < record->cell_count ? columns->first_output : record->cell_count;
  if (as_read > 0) {
    fwrite_unlocked(record->bytes, 1, record->cells[as_read - 1].end, file);
  }
  for (size_t i = as_read; i < columns->count; i++) {
    size_t output = 0;
    while (output < columns->output_count && columns->at[columns->outputs[output]] != i) {
      output++;
    }
    if (i > 0) {
      putc_unlocked(record->separator, file);
    }
    if (output < columns->output_count) {
      write_output(usual, row, radius, output, file);
    } else if (i < record->cell_count) {
      cli_csv_copy_cell(record, i, file);
    }
  }
  for (size_t output = 0; output < columns->output_count; output++) {
    if (columns->at[columns->outputs[output]] == CLI_CSV_ABSENT) {
      putc_unlocked(record->separator, file);
      write_output(usual, row, radius, output, file);
    }
  }
  for (size_t i = columns->count; i < record->cell_count;
       i++) { /* cells beyond those of the header */
    putc_unlocked(record->separator, file);
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
  const size_t at = columns->at[input];
  const char *text = at == CLI_CSV_ABSENT ? NULL : cli_csv_cell_text(&row->record, at, &length);
  return length == 0 ? NULL : text;
}

/* Finds the id of a model or a kind of moments by its name. */
static bool find_id(const points_usual *usual, points_row *row, size_t input, enum dipole_kind kind,
                    const char *name, unsigned *id) {
  char known[160];
  const dipole_choice *choice = cli_choice(usual->info, kind, name);
  if (choice == NULL) {
    cli_list_names(usual->info, kind, known, sizeof known);
    return make_bad(row, "%s: '%.*s' is unknown: allowed: %s", inputs[input], SHOWN_BYTES, name,
                    known);
  }
  *id = choice->id;
  return true;
}

double points_tolerance(const points_usual *usual, const points_row *row) {
  for (size_t i = 0; i < row->parameters.count; i++) {
    if (row->parameters.items[i].id == usual->tolerance) {
      return row->parameters.items[i].value;
    }
  }
  return (double)NAN;
}

/* Chooses the model and the evaluator. The parameters are known already. */
static bool read_model(const points_usual *usual, const points_columns *columns, points_row *row) {
  const char *name = text_of(columns, row, MODEL);
  const bool named = name != NULL || usual->settings->model.count > 0;
  row->model = named || isnan(points_tolerance(usual, row)) ? usual->model : DIPOLE_ANY_MODEL;
  if (name != NULL && !find_id(usual, row, MODEL, DIPOLE_MODEL, name, &row->model)) {
    return false;
  }
  const bool by_table = row->model == usual->transport || row->model == DIPOLE_ANY_MODEL;
  row->evaluator = by_table && !(points_tolerance(usual, row) < CORE_LUT_TOLERANCE_MIN)
                       ? usual->evaluator_of_transport
                       : usual->evaluator;
  return true;
}

static bool read_moments(const points_usual *usual, const points_columns *columns,
                         points_row *row) {
  const char *name = text_of(columns, row, MOMENTS);
  row->moments = usual->moments;
  return name == NULL || find_id(usual, row, MOMENTS, DIPOLE_MOMENTS, name, &row->moments);
}

/* Reads a cell with a number into the row. */
static bool read_number(points_row *row, size_t input, size_t at) {
  size_t length;
  const bool given = at != CLI_CSV_ABSENT;
  const char *text = given ? cli_csv_cell_text(&row->record, at, &length) : "";
  return (given && cli_csv_number(&row->record, at, AT(row, offsets[input]))) ||
         make_bad(row,
                  "%s: '%.*s' is no number: allowed: decimal numbers within the range of doubles%s",
                  inputs[input], SHOWN_BYTES, text, cli_csv_number_hint(text));
}

/* measured: whether the row has the coefficients of a measured medium, which its cells override. */
static bool read_numbers(const points_usual *usual, const points_columns *columns, bool measured,
                         points_row *row) {
  bool good = true;
  for (size_t i = FIRST_NUMBER; good && i < POINTS_INPUTS; i++) {
    const bool needed = i == R ? !points_has_radii(usual) : !measured;
    const size_t at = columns->at[i];
    if (needed || (at != CLI_CSV_ABSENT && row->record.cells[at].text_length > 0)) {
      good = read_number(row, i, at);
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
static bool read_medium(const points_usual *usual, const points_columns *columns, points_row *row) {
  const char *name = text_of(columns, row, MEDIUM);
  const bool measured = name != NULL && text_of(columns, row, FIRST_NUMBER) == NULL &&
                        text_of(columns, row, FIRST_NUMBER + 1) == NULL;
  return (!measured || take_measured(usual, name, text_of(columns, row, CHANNEL), row)) &&
         read_numbers(usual, columns, measured, row);
}

/* Sets the parameters of the row: first the usual ones, then those in its cells. */
static bool read_parameters(const points_usual *usual, const points_columns *columns,
                            points_row *row) {
  bool good = true;
  row->parameters = usual->parameters;
  for (size_t i = 0; good && i < columns->parameter_count; i++) {
    const size_t at = columns->at[POINTS_INPUTS + i];
    if (at == CLI_CSV_ABSENT) {
      continue;
    }
    const dipole_choice *parameter =
        cli_choice(usual->info, DIPOLE_PARAMETER, columns->names[POINTS_INPUTS + i]);
    size_t length;
    double value;
    const char *text = cli_csv_cell_text(&row->record, at, &length);
    good = length == 0 || (strlen(text) == length && !decimal_starts_with_zero(text) &&
                           cli_parameter_parse(usual->info, parameter, text, &value));
    if (!good) {
      make_bad(row, "%s: '%.*s' is no value: allowed: %s", parameter->name, SHOWN_BYTES, text,
               parameter->about);
    } else if (length > 0) {
      cli_parameters_set(&row->parameters, parameter->id, value);
    }
  }
  return good;
}

bool points_read_row(const points_usual *usual, const points_columns *columns, points_row *row) {
  if (row->record.malformed) {
    return make_bad(row, "the row: text after a closing quote: allowed: quotes around whole cells, "
                         "doubled within");
  }
  if (row->record.cell_count != columns->count) {
    return make_bad(row, "the row: %zu cells: allowed: %zu, as many as in the header",
                    row->record.cell_count, columns->count);
  }
  return read_parameters(usual, columns, row) && read_model(usual, columns, row) &&
         read_moments(usual, columns, row) && read_medium(usual, columns, row);
}
