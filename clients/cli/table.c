#include "clients/cli/table.h"

#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
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
  libdipole_clean_text(cell); /* names come from files */
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

void cli_table_print(cli_table *table, FILE *file) {
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
