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

/* The columns that are printed side by side: those aligned left, and a run of others. */
typedef struct run {
  size_t left, first, end;
} run;

static size_t next_in(const run *of, size_t column) {
  return column + 1 == of->left && of->first > of->left ? of->first : column + 1;
}

static size_t begin_of(const run *of) {
  return of->left > 0 ? 0 : of->first;
}

static void print_rule(const size_t *widths, const run *of, FILE *file) {
  for (size_t column = begin_of(of); column < of->end; column = next_in(of, column)) {
    fputs(column > begin_of(of) ? "  " : "", file);
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
                      const run *whole, FILE *file) {
  run of = *whole;
  while (of.end > of.first + (of.left == 0) && cells[of.end - 1][0] == '\0') {
    of.end--;
  }
  of.end = of.end == of.first ? of.left : of.end;
  for (size_t i = begin_of(&of); i < of.end; i = next_in(&of, i)) {
    const bool left = i < table->left, last = next_in(&of, i) >= of.end;
    fputs(i > begin_of(&of) ? "  " : "", file);
    print_cell(cells[i], left && last ? width_of(cells[i]) : widths[i], left, file);
  }
  fputc('\n', file);
}

static void print_run(const cli_table *table, const size_t *widths, const run *of, FILE *file) {
  const size_t columns = table->columns;
  for (size_t i = 0; i + columns <= table->cell_count; i += columns) {
    if (table->heads > 0 && i == table->heads * columns) {
      print_rule(widths, of, file);
    }
    print_row(table, table->cells + i, widths, of, file);
  }
}

/* Returns the end of the longest run of columns from `first` on that fits, at least one. */
static size_t end_of_run(const cli_table *table, const size_t *widths, size_t first) {
  size_t width = 0, end = first;
  for (size_t i = 0; i < table->left; i++) {
    width += widths[i] + 2;
  }
  while (end < table->columns &&
         (end == first || table->width == 0 || width + widths[end] <= table->width)) {
    width += widths[end++] + 2;
  }
  return end;
}

void cli_table_print(cli_table *table, FILE *file) {
  const size_t columns = table->columns;
  size_t *widths = cli_allocate(columns, sizeof *widths);
  for (size_t i = 0; i < table->cell_count; i++) {
    const size_t width = width_of(table->cells[i]);
    widths[i % columns] = width > widths[i % columns] ? width : widths[i % columns];
  }
  run of = {.left = table->left < columns ? table->left : columns, .end = table->left};
  do {
    of.first = of.end;
    of.end = end_of_run(table, widths, of.first);
    fputs(of.first > of.left ? "\n" : "", file);
    print_run(table, widths, &of, file);
  } while (of.end < columns);
  for (size_t i = 0; i < table->cell_count; i++) {
    free(table->cells[i]);
  }
  free(table->cells);
  free(widths);
  *table = (cli_table){0};
}
