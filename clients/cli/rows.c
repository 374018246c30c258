#include "clients/cli/rows.h"

#include <math.h>
#include <stdlib.h>

#include "clients/cli/csv.h"
#include "clients/cli/number.h"

/* Writes the column's cell of the header if a line of the header is being written. Returns whether
 * the value is to be written instead. */
static bool begin_value(cli_rows *rows, const cli_column *column) {
  if (column->forms != 0 && (column->forms & 1U << rows->form) == 0) {
    return false;
  }
  if (rows->form == CLI_CSV) {
    fputs(rows->filled ? "," : "", rows->file);
    rows->filled = true;
    if (rows->pass != CLI_ROWS_VALUES) {
      cli_csv_write_cell(column->name, rows->file);
    }
  } else if (rows->form == CLI_TABLE && rows->pass != CLI_ROWS_VALUES) {
    const char *head = column->head != NULL ? column->head : column->name;
    const char *text = rows->pass == CLI_ROWS_OVER   ? column->over
                       : rows->pass == CLI_ROWS_HEAD ? head
                                                     : column->unit;
    cli_table_add(rows->table, "%s", text != NULL ? text : "");
  }
  return rows->pass == CLI_ROWS_VALUES;
}

void cli_put_shown(cli_rows *rows, const cli_column *column, double value, const char *text) {
  char number[CLI_NUMBER_BYTES];
  if (!begin_value(rows, column)) {
    return;
  }
  if (rows->form == CLI_JSON) {
    cli_json_number(rows->json, column->name, value);
  } else if (rows->form == CLI_CSV) {
    fputs(isnan(value) ? "" : cli_number_format(value, number), rows->file);
  } else if (text != NULL) {
    cli_table_add(rows->table, "%s", text);
  } else {
    cli_table_add(rows->table, column->format != NULL ? column->format : "%.6g", value);
  }
}

void cli_put_number(cli_rows *rows, const cli_column *column, double value) {
  cli_put_shown(rows, column, value, isnan(value) ? column->missing : NULL);
}

void cli_put_count(cli_rows *rows, const cli_column *column, uint64_t value) {
  if (!begin_value(rows, column)) {
    return;
  }
  if (rows->form == CLI_JSON) {
    cli_json_count(rows->json, column->name, value);
  } else if (rows->form == CLI_CSV) {
    fprintf(rows->file, "%llu", (unsigned long long)value);
  } else {
    cli_table_add(rows->table, "%llu", (unsigned long long)value);
  }
}

void cli_put_text(cli_rows *rows, const cli_column *column, const char *text) {
  if (!begin_value(rows, column)) {
    return;
  }
  if (rows->form == CLI_JSON) {
    cli_json_text(rows->json, column->name, text);
  } else if (rows->form == CLI_CSV) {
    cli_csv_write_cell(text, rows->file);
  } else {
    cli_table_add(rows->table, "%s", text);
  }
}

void cli_put_medium(cli_rows *rows, const dipole_medium *medium) {
  cli_put_number(rows, CLI_COLUMN("sigma_a", .unit = "1/mm"), medium->sigma_a_per_mm);
  cli_put_number(rows, CLI_COLUMN("sigma_s", .unit = "1/mm"), medium->sigma_s_per_mm);
  cli_put_number(rows, CLI_COLUMN("g"), medium->g);
  cli_put_number(rows, CLI_COLUMN("eta"), medium->eta);
}

/* ---- all rows -------------------------------------------------------------------------------- */

/* Removes the cells from `first` on if all of them are empty. Returns whether it kept them. */
static bool keep_filled(cli_table *table, size_t first) {
  bool filled = false;
  for (size_t i = first; i < table->cell_count; i++) {
    filled = filled || table->cells[i][0] != '\0';
  }
  while (!filled && table->cell_count > first) {
    free(table->cells[--table->cell_count]);
  }
  return filled;
}

void cli_rows_print(FILE *file, size_t left, size_t count, cli_put_row *put, const void *context) {
  cli_rows_fit(file, 0, left, count, put, context);
}

void cli_rows_fit(FILE *file, size_t width, size_t left, size_t count, cli_put_row *put,
                  const void *context) {
  cli_table table = {.left = left, .width = width};
  cli_rows rows = {.form = CLI_TABLE, .table = &table};
  for (rows.pass = CLI_ROWS_OVER; rows.pass < CLI_ROWS_VALUES; rows.pass++) {
    const size_t first = table.cell_count;
    put(&rows, context, 0);
    table.columns = rows.pass == CLI_ROWS_OVER ? table.cell_count : table.columns;
    table.heads += keep_filled(&table, first);
  }
  for (size_t i = 0; i < count; i++) {
    put(&rows, context, i);
  }
  cli_table_print(&table, file);
}

void cli_rows_csv(FILE *file, bool names, size_t count, cli_put_row *put, const void *context) {
  cli_rows rows = {.form = CLI_CSV, .file = file, .pass = CLI_ROWS_HEAD};
  if (names) {
    put(&rows, context, 0);
    fputc('\n', file);
  }
  rows.pass = CLI_ROWS_VALUES;
  for (size_t i = 0; i < count; i++) {
    rows.filled = false;
    put(&rows, context, i);
    fputc('\n', file);
  }
}

void cli_rows_members(cli_json *json, cli_put_row *put, const void *context, size_t index) {
  cli_rows rows = {.form = CLI_JSON, .pass = CLI_ROWS_VALUES, .json = json};
  put(&rows, context, index);
}

void cli_rows_json(cli_json *json, const char *key, size_t count, cli_put_row *put,
                   const void *context) {
  cli_json_begin(json, key, '[');
  for (size_t i = 0; i < count; i++) {
    cli_json_begin(json, NULL, '{');
    cli_rows_members(json, put, context, i);
    cli_json_end(json, '}');
  }
  cli_json_end(json, ']');
}

void cli_write(const cli_output *output, enum cli_form form, const void *context) {
  if (form == CLI_TABLE) {
    output->table(context);
  } else if (form == CLI_CSV && output->csv != NULL) {
    output->csv(context);
  } else if (form == CLI_CSV) {
    cli_rows_csv(stdout, true, output->rows, output->put_row, context);
  } else if (form == CLI_JSON) {
    cli_json json = {.file = stdout};
    cli_json_begin(&json, NULL, '{');
    output->members(&json, context);
    cli_json_end(&json, '}');
  }
}
