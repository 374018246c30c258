/* table: prints cells in columns, each as wide as its widest cell. */
#ifndef DIPOLE_CLI_TABLE_H
#define DIPOLE_CLI_TABLE_H

#include <stddef.h>
#include <stdio.h>

typedef struct cli_table {
  size_t columns;
  size_t left;       /* the first so many columns are aligned left, the others right */
  size_t heads;      /* the first so many rows are the header */
  size_t cell_count; /* the cells are stored row by row */
  size_t cell_capacity;
  char **cells;
} cli_table;

/* Adds the next cell. */
void cli_table_add(cli_table *table, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Prints the table, with a line under its header, and frees the cells. */
void cli_table_print(cli_table *table, FILE *file);

#endif
