/* A row of `dipole points`: from cells to a query, from an answer to cells. */
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/number.h"
#include "clients/cli/points.h"

#define MODEL_DEFAULT "better"
#define MOMENTS_DEFAULT "exact"

/* So much of a wrong cell is shown in its row's status. */
enum { SHOWN_BYTES = 40 };

static bool make_bad(cli_points_row *row, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

static bool make_bad(cli_points_row *row, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(row->status, sizeof row->status, format, arguments);
  va_end(arguments);
  row->state = CLI_POINTS_BAD;
  return false;
}

/* The text of a cell, to be freed; NULL when its column is absent. */
static char *text_of(const cli_points_columns *columns, const cli_points_row *row,
                     enum cli_points_input input, size_t *length) {
  const size_t at = columns->input_at[input];
  return at == CLI_POINTS_ABSENT ? NULL : cli_csv_cell_text(&row->record, at, length);
}

static bool parse_number(const cli_points_columns *columns, cli_points_row *row,
                         enum cli_points_input input, double *value) {
  size_t length;
  char *text = text_of(columns, row, input, &length);
  const bool good = strlen(text) == length && cli_number_parse(text, value);
  if (!good) {
    make_bad(row, "%s: '%.*s' is no number: allowed: decimal numbers within the range of doubles",
             cli_points_input_name(input), SHOWN_BYTES, text);
  }
  free(text);
  return good;
}

/* A model or a kind of moments: by its name, or the usual one where there is none. */
static bool parse_name(const cli_points_columns *columns, const dipole_info *info,
                       cli_points_row *row, enum cli_points_input input, enum dipole_kind kind,
                       const char *usual, unsigned *id) {
  char known[160];
  size_t length = 0;
  char *text = text_of(columns, row, input, &length);
  const char *name = length == 0 ? usual : text;
  const dipole_choice *choice = cli_choice(info, kind, name);
  if (choice == NULL) {
    cli_list_names(info, kind, known, sizeof known);
    make_bad(row, "%s: '%.*s' is unknown: allowed: %s", cli_points_input_name(input), SHOWN_BYTES,
             name, known);
  } else {
    *id = choice->id;
  }
  free(text);
  return choice != NULL;
}

/* The parameters of the row: the usual ones, and what its cells say. */
static bool parse_parameters(const cli_points_columns *columns, const dipole_info *info,
                             const cli_parameters *usual, cli_points_row *row) {
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

bool cli_points_parse(const cli_points_columns *columns, const dipole_info *info,
                      const cli_parameters *usual, cli_points_row *row) {
  if (row->record.malformed) {
    return make_bad(row, "the row: text after a closing quote: allowed: quotes around whole cells, "
                         "doubled within");
  }
  if (row->record.cell_count != columns->count) {
    return make_bad(row, "the row: %zu cells: allowed: %zu, as many as in the header",
                    row->record.cell_count, columns->count);
  }
  return parse_name(columns, info, row, CLI_POINTS_MODEL, DIPOLE_MODEL, MODEL_DEFAULT,
                    &row->model) &&
         parse_name(columns, info, row, CLI_POINTS_MOMENTS, DIPOLE_MOMENTS, MOMENTS_DEFAULT,
                    &row->moments) &&
         parse_number(columns, row, CLI_POINTS_SIGMA_A, &row->medium.sigma_a_per_mm) &&
         parse_number(columns, row, CLI_POINTS_SIGMA_S, &row->medium.sigma_s_per_mm) &&
         parse_number(columns, row, CLI_POINTS_G, &row->medium.g) &&
         parse_number(columns, row, CLI_POINTS_ETA, &row->medium.eta) &&
         parse_number(columns, row, CLI_POINTS_RADIUS, &row->r_mm) &&
         parse_parameters(columns, info, usual, row);
}

bool cli_points_submit(dipole_client *client, unsigned evaluator, cli_points_row *row,
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
  row->state = CLI_POINTS_WAITING;
  return dipole_submit(client, &query, &row->id, error);
}

void cli_points_take(cli_points_row *row, const dipole_result *result) {
  const dipole_channel *channel = &result->channels[0];
  row->state = CLI_POINTS_GOOD;
  row->albedo = channel->albedo;
  row->R = channel->R_f64 != NULL ? channel->R_f64[0] : (double)channel->R_f32[0];
  row->cdf = channel->cdf_f64 != NULL ? channel->cdf_f64[0] : (double)channel->cdf_f32[0];
}
