#include "clients/cli/points_row.h"

#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/number.h"
#include "clients/cli/options.h"
#include "core/core.h"

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
  for (const cli_option *option = usual->options; option->name != NULL; option++) {
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
  cli_fail("%s: the column %s is missing; the header has %s; it needs sigma_a, sigma_s, g and "
           "eta, or medium and channel; and r unless --r is given; and may have model, moments "
           "and parameters",
           source, missing, text != NULL ? text : "others");
  free(text);
  return false;
}

static bool is_required(const points_usual *usual, const points_columns *columns, size_t input) {
  return input == R ? !points_has_radii(usual)
                    : input >= FIRST_NUMBER && columns->input_at[MEDIUM] == POINTS_ABSENT;
}

/* Returns the name of the column of radii, which are spatial frequencies if only R_f is wanted. */
static const char *name_of_radii(const points_usual *usual) {
  return usual->by_f ? "f" : inputs[R].name;
}

static void list_outputs(const points_usual *usual, points_columns *columns) {
  if (points_has_radii(usual)) {
    columns->outputs[columns->output_count++].name = name_of_radii(usual);
  }
  for (size_t i = 0; i < usual->quantities.count; i++) {
    columns->outputs[columns->output_count++].name = usual->quantities.items[i]->name;
  }
  if (usual->settings->errors) {
    columns->outputs[columns->output_count++].name = "numerical_error";
    columns->outputs[columns->output_count++].name = "model_error";
  }
  columns->outputs[columns->output_count++].name = "status";
}

/* Takes one column of the header. */
static bool take_column(const points_usual *usual, const char *source, const char *name, size_t at,
                        points_columns *columns) {
  const bool f = usual->by_f && strcmp(name, name_of_radii(usual)) == 0;
  size_t *place = place_of(columns, usual->info, f ? inputs[R].name : name);
  if (place == NULL) {
    return strcmp(name, "f") == 0 || check_unread(usual, source, name); /* of an earlier R_f */
  }
  if (*place != POINTS_ABSENT) {
    cli_fail("%s: the header has the column %s twice: rename one", source, name);
    return false;
  }
  *place = at;
  return true;
}

bool points_find_columns(const points_usual *usual, const char *source,
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
  if (good && points_has_radii(usual) && columns->input_at[R] != POINTS_ABSENT) {
    cli_fail("%s: the header has the column %s: leave --%s out, or rename the column", source,
             name_of_radii(usual), name_of_radii(usual));
    return false;
  }
  columns->first_output = columns->count;
  for (size_t i = 0; i < columns->output_count; i++) {
    if (columns->outputs[i].at < columns->first_output) {
      columns->first_output = columns->outputs[i].at;
    }
  }
  for (size_t i = 0; good && i < POINTS_INPUTS; i++) {
    if (is_required(usual, columns, i) && columns->input_at[i] == POINTS_ABSENT) {
      return fail_missing(source, i == R ? name_of_radii(usual) : inputs[i].name, header);
    }
  }
  return good;
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
    if (columns->outputs[i].at == POINTS_ABSENT) {
      fprintf(file, "%c%s", header->separator, columns->outputs[i].name);
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
  char text[CLI_NUMBER_BYTES];
  fputs_unlocked(isnan(value) ? "" : cli_number_format(value, text), file);
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
    while (output < columns->output_count && columns->outputs[output].at != i) {
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
    if (columns->outputs[output].at == POINTS_ABSENT) {
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
  const size_t at = columns->input_at[input];
  const char *text = at == POINTS_ABSENT ? NULL : cli_csv_cell_text(&row->record, at, &length);
  return length == 0 ? NULL : text;
}

/* Finds the id of a model or a kind of moments by its name. */
static bool find_id(const points_usual *usual, points_row *row, size_t input, enum dipole_kind kind,
                    const char *name, unsigned *id) {
  char known[160];
  const dipole_choice *choice = cli_choice(usual->info, kind, name);
  if (choice == NULL) {
    cli_list_names(usual->info, kind, known, sizeof known);
    return make_bad(row, "%s: '%.*s' is unknown: allowed: %s", inputs[input].name, SHOWN_BYTES,
                    name, known);
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
  const bool named = name != NULL || usual->settings->profile.model != NULL;
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
  const bool given = at != POINTS_ABSENT;
  const char *text = given ? cli_csv_cell_text(&row->record, at, &length) : "";
  return (given && cli_csv_number(&row->record, at, AT(row, inputs[input].offset))) ||
         make_bad(row,
                  "%s: '%.*s' is no number: allowed: decimal numbers within the range of doubles%s",
                  inputs[input].name, SHOWN_BYTES, text, cli_csv_number_hint(text));
}

/* measured: whether the row has the coefficients of a measured medium, which its cells override. */
static bool read_numbers(const points_usual *usual, const points_columns *columns, bool measured,
                         points_row *row) {
  bool good = true;
  for (size_t i = FIRST_NUMBER; good && i < POINTS_INPUTS; i++) {
    const bool needed = i == R ? !points_has_radii(usual) : !measured;
    const size_t at = columns->input_at[i];
    if (needed || (at != POINTS_ABSENT && row->record.cells[at].text_length > 0)) {
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
    const dipole_choice *parameter = columns->parameters[i];
    size_t length;
    double value;
    const size_t at = columns->parameter_at[i];
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
