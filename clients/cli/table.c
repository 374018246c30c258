#include "clients/cli/table.h"

#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/cli.h"

void cli_table_add(cli_table *table, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  const int length = vsnprintf(NULL, 0, format, arguments);
  va_end(arguments);
  char *cell = cli_allocate((size_t)length + 1, 1);
  va_start(arguments, format);
  vsnprintf(cell, (size_t)length + 1, format, arguments);
  va_end(arguments);
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

static void print_rule(const size_t *widths, size_t columns, FILE *file) {
  for (size_t column = 0; column < columns; column++) {
    fputs(column > 0 ? "  " : "", file);
    for (size_t i = 0; i < widths[column]; i++) {
      fputc('-', file);
    }
  }
  fputc('\n', file);
}

static void print_cell(const char *cell, size_t width, bool left, FILE *file) {
  const int padding = (int)(width - width_of(cell));
  if (left) {
    fprintf(file, "%s%*s", cell, padding, "");
  } else {
    fprintf(file, "%*s%s", padding, "", cell);
  }
}

/* Prints a row. Leaves out empty cells at its end. */
static void print_row(const cli_table *table, char *const *cells, const size_t *widths,
                      FILE *file) {
  size_t count = table->columns;
  while (count > 1 && cells[count - 1][0] == '\0') {
    count--;
  }
  for (size_t i = 0; i < count; i++) {
    const bool left = i < table->left;
    fputs(i > 0 ? "  " : "", file);
    print_cell(cells[i], left && i + 1 == count ? width_of(cells[i]) : widths[i], left, file);
  }
  fputc('\n', file);
}

void cli_table_print(cli_table *table, FILE *file) {
  const size_t columns = table->columns;
  size_t *widths = cli_allocate(columns, sizeof *widths);
  for (size_t i = 0; i < table->cell_count; i++) {
    const size_t width = width_of(table->cells[i]);
    widths[i % columns] = width > widths[i % columns] ? width : widths[i % columns];
  }
  for (size_t i = 0; i + columns <= table->cell_count; i += columns) {
    if (table->heads > 0 && i == table->heads * columns) {
      print_rule(widths, columns, file);
    }
    print_row(table, table->cells + i, widths, file);
  }
  for (size_t i = 0; i < table->cell_count; i++) {
    free(table->cells[i]);
  }
  free(table->cells);
  free(widths);
  *table = (cli_table){0};
}
