#include "clients/cli/rows.h"

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/cli/csv.h"
#include "proto/decimal.h"

/* ---- tables: cells in columns, each as wide as its widest cell ------------------------------- */

typedef struct cli_table {
  size_t columns;
  size_t left;  /* number of leading columns that are aligned left; the others are aligned right */
  size_t heads; /* number of leading rows that are the header */
  size_t cell_count; /* the cells are stored row by row */
  size_t cell_capacity;
  char **cells;
} cli_table;

/* Adds the next cell, or writes it at once if there is no table. */
__attribute__((format(printf, 2, 3), nonnull)) static void add_cell(const cli_rows *rows,
                                                                    const char *format, ...) {
  cli_table *table = rows->table;
  va_list arguments;
  va_start(arguments, format);
  const int length = vsnprintf(NULL, 0, format, arguments);
  va_end(arguments);
  char *cell = cli_allocate((size_t)length + 1, 1);
  va_start(arguments, format);
  vsnprintf(cell, (size_t)length + 1, format, arguments);
  va_end(arguments);
  libdipole_clean_text(cell); /* names may come from files */
  if (table == NULL) {
    fputs(cell, rows->file);
    cli_free(cell);
    return;
  }
  if (table->cell_count == table->cell_capacity) {
    table->cell_capacity = table->cell_capacity == 0 ? 64 : 2 * table->cell_capacity;
    table->cells = cli_resize(table->cells, table->cell_capacity, sizeof *table->cells);
  }
  table->cells[table->cell_count++] = cell;
}

/* Returns the number of characters: counts all bytes except the continuation bytes of UTF-8. */
static size_t width_of(const char *text) {
  size_t width = 0;
  for (; *text != '\0'; text++) {
    width += ((unsigned char)*text & 0xc0) != 0x80;
  }
  return width;
}

static void print_rule(const cli_table *table, const size_t *widths, FILE *file) {
  for (size_t column = 0; column < table->columns; column++) {
    fputs(column > 0 ? "  " : "", file);
    for (size_t i = 0; i < widths[column]; i++) {
      fputc('-', file);
    }
  }
  fputc('\n', file);
}

/* Prints a row without the empty cells at its end, and without blanks there. */
static void print_row(const cli_table *table, char *const *cells, const size_t *widths,
                      FILE *file) {
  size_t end = table->columns;
  while (end > 1 && cells[end - 1][0] == '\0') {
    end--;
  }
  for (size_t i = 0; i < end; i++) {
    const bool left = i < table->left;
    const int padding = (int)(widths[i] - width_of(cells[i]));
    fprintf(file, "%s%*s%s%*s", i > 0 ? "  " : "", left ? 0 : padding, "", cells[i],
            left && i + 1 < end ? padding : 0, "");
  }
  fputc('\n', file);
}

/* Prints the table, with a line under its header, and frees the cells. */
static void print_table(cli_table *table, FILE *file) {
  const size_t columns = table->columns;
  size_t *widths = cli_allocate(columns, sizeof *widths);
  for (size_t i = 0; i < table->cell_count; i++) {
    const size_t width = width_of(table->cells[i]);
    widths[i % columns] = width > widths[i % columns] ? width : widths[i % columns];
  }
  for (size_t i = 0; i + columns <= table->cell_count; i += columns) {
    if (table->heads > 0 && i == table->heads * columns) {
      print_rule(table, widths, file);
    }
    print_row(table, table->cells + i, widths, file);
  }
  for (size_t i = 0; i < table->cell_count; i++) {
    cli_free(table->cells[i]);
  }
  cli_free(table->cells);
  cli_free(widths);
  *table = (cli_table){0};
}

/* ---- JSON ------------------------------------------------------------------------------------ */

static void write_text(const char *text, FILE *file) {
  fputc('"', file);
  for (size_t bytes; *text != '\0'; text += bytes > 0 ? bytes : 1) {
    const unsigned char byte = (unsigned char)*text;
    bytes = libdipole_character_bytes(text);
    if (byte == '"' || byte == '\\') {
      fprintf(file, "\\%c", byte);
    } else if (byte < 0x20 || bytes == 0) {
      fprintf(file, "\\u%04x", bytes == 0 ? 0xfffdU : byte);
    } else {
      fwrite(text, 1, bytes, file);
    }
  }
  fputc('"', file);
}

static void write_number(double value, FILE *file) {
  char text[DECIMAL_BYTES];
  decimal_write(value, text);
  if (isinf(value)) {
    write_text(text, file);
  } else {
    fputs(isnan(value) ? "null" : text, file);
  }
}

double cli_number_of_single(float value) {
  char text[DECIMAL_BYTES];
  double found = (double)value;
  decimal_write_single(value, text);
  return decimal_read(text, &found) ? found : (double)value;
}

double cli_value(const dipole_result *result, uint32_t channel, unsigned quantity, size_t i) {
  const double *f64 = dipole_values_f64(result, channel, quantity);
  const float *f32 = dipole_values_f32(result, channel, quantity);
  return f64 != NULL   ? f64[i]
         : f32 != NULL ? cli_number_of_single(f32[i])
                       : result->channels[channel].albedo;
}

double cli_numerical_error(const dipole_errors *errors, double r_mm) {
  const bool grows = errors->numerical_error_per_mm > 0 && r_mm < (double)INFINITY;
  return errors->numerical_error + (grows ? errors->numerical_error_per_mm * r_mm : 0);
}

double cli_number_rounded(double value) {
  char text[DECIMAL_BYTES];
  snprintf(text, sizeof text, "%.*e", DBL_DIG - 1, value);
  const double rounded = strtod(text, NULL);
  return isfinite(rounded) ? rounded : value;
}

/* ---- cells ----------------------------------------------------------------------------------- */

static void write_between(cli_rows *rows) {
  fputs(rows->filled ? rows->between : "", rows->file);
  rows->filled = true;
}

/* Writes the column's cell of the header if a line of the header is being written, and in JSON and
 * titles the name. Returns whether the value is to be written. */
static bool begin_value(cli_rows *rows, const cli_column *column) {
  const char *head = column->head != NULL ? column->head : column->name;
  const bool values = rows->pass == CLI_ROWS_VALUES;
  if (column->forms != 0 && (column->forms & 1U << rows->form) == 0) {
    return false;
  }
  if (rows->pass == CLI_ROWS_TITLE) {
    write_between(rows);
    fprintf(rows->file, "%s%s", head, head[0] != '\0' ? " " : "");
    return true;
  }
  if (rows->form == CLI_TABLE && !values) {
    const char *text = rows->pass == CLI_ROWS_OVER   ? column->over
                       : rows->pass == CLI_ROWS_HEAD ? head
                       : column->below != NULL       ? column->below
                                                     : column->unit;
    add_cell(rows, "%s", text != NULL ? text : "");
  } else if (rows->form == CLI_CSV) {
    write_between(rows);
    if (!values) {
      cli_csv_write_cell(column->name, rows->file);
    }
  } else if (rows->form == CLI_JSON && (values || column->unit != NULL)) {
    write_between(rows);
    write_text(column->name, rows->file);
    fputs(": ", rows->file);
    if (!values) {
      write_text(column->unit, rows->file);
    }
  }
  return values;
}

void cli_rows_shown(cli_rows *rows, double value, const char *text, const cli_column *column) {
  char number[DECIMAL_BYTES];
  if (!begin_value(rows, column)) {
    return;
  }
  if (rows->form == CLI_JSON) {
    write_number(value, rows->file);
  } else if (rows->form == CLI_CSV) {
    decimal_write(value, number);
    fputs(isnan(value) ? "" : number, rows->file);
  } else if (text != NULL) {
    add_cell(rows, "%s", text);
  } else {
    add_cell(rows, column->format != NULL ? column->format : "%.6g", value);
  }
}

void cli_rows_number(cli_rows *rows, double value, const cli_column *column) {
  cli_rows_shown(rows, value, isnan(value) ? column->missing : NULL, column);
}

void cli_rows_count(cli_rows *rows, uint64_t value, const cli_column *column) {
  if (begin_value(rows, column)) {
    add_cell(rows, "%llu", (unsigned long long)value);
  }
}

void cli_rows_text(cli_rows *rows, const char *text, const cli_column *column) {
  if (!begin_value(rows, column)) {
    return;
  }
  if (rows->form == CLI_JSON) {
    write_text(text, rows->file);
  } else if (rows->form == CLI_CSV) {
    cli_csv_write_cell(text, rows->file);
  } else {
    add_cell(rows, "%s", text);
  }
}

void cli_put_layers(cli_rows *rows, const dipole_medium *layers, size_t count) {
  char text[1024] = "";
  for (size_t i = 0, length = 0; i < count; i++) {
    const dipole_medium *of = &layers[i];
    length += (size_t)snprintf(
        text + length, sizeof text - length,
        of->thickness_mm > 0 ? "%s%.9g,%.9g,%.9g,%.9g,%.9g" : "%s%.9g,%.9g,%.9g,%.9g",
        i > 0 ? " " : "", of->sigma_a_per_mm, of->sigma_s_per_mm, of->g, of->eta, of->thickness_mm);
  }
  cli_put_text(rows, text, "layers");
}

void cli_put_medium(cli_rows *rows, const dipole_medium *layers, size_t count) {
  const dipole_medium *medium = &layers[0];
  if (count > 1) {
    cli_put_layers(rows, layers, count);
    return;
  }
  cli_put_number(rows, medium->sigma_a_per_mm, "sigma_a", .unit = "1/mm");
  cli_put_number(rows, medium->sigma_s_per_mm, "sigma_s", .unit = "1/mm");
  cli_put_number(rows, medium->g, "g");
  cli_put_number(rows, medium->eta, "eta");
  if (medium->thickness_mm > 0) { /* `dipole fit` refuses this column, so a half space has none. */
    cli_put_number(rows, medium->thickness_mm, "thickness", .unit = "mm");
  }
}

/* ---- all rows -------------------------------------------------------------------------------- */

/* Removes the cells from `first` on if all of them are empty. Returns whether it kept them. */
static bool keep_filled(cli_table *table, size_t first) {
  bool filled = false;
  for (size_t i = first; i < table->cell_count; i++) {
    filled = filled || table->cells[i][0] != '\0';
  }
  while (!filled && table->cell_count > first) {
    cli_free(table->cells[--table->cell_count]);
  }
  return filled;
}

void cli_rows_print(FILE *file, size_t left, size_t count, cli_put_row *put, const void *context) {
  cli_table table = {.left = left};
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
  print_table(&table, file);
}

static void write_csv(const cli_report *report, const void *context) {
  cli_rows rows = {.form = CLI_CSV, .file = stdout, .between = ",", .pass = CLI_ROWS_HEAD};
  report->put_row(&rows, context, 0);
  putchar('\n');
  rows.pass = CLI_ROWS_VALUES;
  for (size_t i = 0; i < report->rows; i++) {
    rows.filled = false;
    report->put_row(&rows, context, i);
    putchar('\n');
  }
}

static void write_json(const cli_report *report, const void *context) {
  cli_rows rows = {.form = CLI_JSON, .pass = CLI_ROWS_VALUES, .file = stdout, .between = ",\n  "};
  fputs("{\n  ", stdout);
  if (report->facts != NULL) {
    report->facts(&rows, context);
    fputs(rows.filled ? rows.between : "", stdout);
  }
  fputs("\"units\": {", stdout);
  rows = (cli_rows){.form = CLI_JSON, .pass = CLI_ROWS_UNIT, .file = stdout, .between = ", "};
  report->put_row(&rows, context, 0);
  fputs("},\n  \"rows\": [", stdout);
  for (size_t i = 0; i < report->rows; i++) {
    rows = (cli_rows){.form = CLI_JSON, .pass = CLI_ROWS_VALUES, .file = stdout, .between = ", "};
    fputs(i > 0 ? ",\n    {" : "\n    {", stdout);
    report->put_row(&rows, context, i);
    putchar('}');
  }
  fputs("\n  ]\n}\n", stdout);
}

static void write_table(const cli_report *report, const void *context) {
  if (report->facts != NULL) {
    cli_rows title = {.form = CLI_TABLE, .pass = CLI_ROWS_TITLE, .file = stdout, .between = ", "};
    report->facts(&title, context);
    fputs("\n\n", stdout);
  }
  if (report->table != NULL) {
    report->table(context);
    return;
  }
  cli_rows_print(stdout, report->left, report->rows, report->put_row, context);
  if (report->foot != NULL) {
    report->foot(context);
  }
}

void cli_write(const cli_report *report, enum cli_form form, const void *context) {
  if (form == CLI_TABLE) {
    write_table(report, context);
  } else if (form == CLI_CSV) {
    write_csv(report, context);
  } else if (form == CLI_JSON) {
    write_json(report, context);
  }
}
