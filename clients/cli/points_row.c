#include "clients/cli/points_row.h"

#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/number.h"

#define AT(row, offset) ((double *)(void *)((char *)(row) + (offset)))

/* The columns that are read, names first. */
enum { MODEL, MOMENTS, FIRST_NUMBER };

static const struct {
  const char *name;
  bool required;
  size_t offset;     /* of a number in the row */
  const char *usual; /* the name where the cell is empty or absent */
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
  size_t offset; /* of a number in the row */
} outputs[POINTS_OUTPUTS] = {
    {"R", offsetof(points_row, R)},
    {"albedo", offsetof(points_row, albedo)},
    {"cdf", offsetof(points_row, cdf)},
    {"status", 0},
};

/* ---- the header ---------------------------------------------------------------------------- */

/* Returns the place for the position of a parameter's column, and adds it if there is none. */
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

/* Returns the place for the position of a column of this name; NULL if the column is not ours. */
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

bool points_find_columns(const char *source, const dipole_info *info, const cli_csv_record *header,
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

/* ---- writing ------------------------------------------------------------------------------- */

/* Writes the line's end as it was read; the last line of a file may lack one. */
static void write_ending(const cli_csv_record *record, FILE *file) {
  if (record->ending_bytes == 0) {
    fputc('\n', file);
  } else {
    fwrite(record->bytes + record->length - record->ending_bytes, 1, record->ending_bytes, file);
  }
}

void points_write_header(const points_columns *columns, const cli_csv_record *header, FILE *file) {
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

void points_write_row(const points_columns *columns, const points_row *row, FILE *file) {
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
  for (size_t i = columns->count; i < record->cell_count; i++) { /* more than the header has */
    fputc(',', file);
    cli_csv_copy_cell(record, i, file);
  }
  write_ending(record, file);
}

/* ---- reading ------------------------------------------------------------------------------- */

/* How much of a wrong cell is shown in its row's status. */
enum { SHOWN_BYTES = 40 };

static bool make_bad(points_row *row, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

static bool make_bad(points_row *row, const char *format, ...) {
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

/* Sets the parameters of the row: the usual ones, and then those in its cells. */
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

bool points_parse(const points_columns *columns, const dipole_info *info,
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

/* ---- asking -------------------------------------------------------------------------------- */

bool points_submit(dipole_client *client, unsigned evaluator, points_row *row,
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

void points_take(points_row *row, const dipole_result *result) {
  const dipole_channel *channel = &result->channels[0];
  row->state = POINTS_GOOD;
  row->albedo = channel->albedo;
  row->R = channel->R_f64 != NULL ? channel->R_f64[0] : (double)channel->R_f32[0];
  row->cdf = channel->cdf_f64 != NULL ? channel->cdf_f64[0] : (double)channel->cdf_f32[0];
}
