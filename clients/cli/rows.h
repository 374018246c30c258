/* rows: a list of like things, described once and written as an aligned table, as CSV or as JSON. */
#ifndef DIPOLE_CLI_ROWS_H
#define DIPOLE_CLI_ROWS_H

#include "clients/cli/cli.h"
#include "clients/cli/json.h"
#include "clients/cli/table.h"

/* Bits for cli_column.forms. */
enum { CLI_IN_TABLE = 1 << CLI_TABLE, CLI_IN_CSV = 1 << CLI_CSV, CLI_IN_JSON = 1 << CLI_JSON };

typedef struct cli_column {
  const char *name;    /* in CSV and JSON */
  const char *head;    /* in a table; NULL for the name */
  const char *unit;    /* below the head in a table; NULL for none */
  const char *format;  /* of a number in a table; NULL for "%.6g" */
  const char *missing; /* what a table shows instead of NaN; NULL for "nan" */
  const char *over;    /* above the head in a table; NULL for none */
  unsigned forms;      /* output formats (CLI_IN_*) in which the column appears; 0: all */
} cli_column;

#define CLI_COLUMN(...) (&(const cli_column){.name = __VA_ARGS__})

/* The lines of a table's header, of which CSV has the second only, and then the values. */
enum cli_pass { CLI_ROWS_OVER, CLI_ROWS_HEAD, CLI_ROWS_UNIT, CLI_ROWS_VALUES };

/* Where a row goes. */
typedef struct cli_rows {
  enum cli_form form;
  enum cli_pass pass;
  FILE *file;
  cli_table *table;
  cli_json *json; /* of CLI_JSON, for further members of the row's object; else NULL */
  bool filled;    /* a cell of this line of CSV has been written */
} cli_rows;

/* Puts row `index` by one call of the functions below for each column, for every row the same
 * columns in the same order. It is also called for row 0 where only the columns are needed. */
typedef void cli_put_row(cli_rows *rows, const void *context, size_t index);

/* A number that is NaN is an empty cell in CSV and null in JSON. */
void cli_put_number(cli_rows *rows, const cli_column *column, double value);
void cli_put_count(cli_rows *rows, const cli_column *column, uint64_t value);
void cli_put_text(cli_rows *rows, const cli_column *column, const char *text);

/* A number that a table shows as this text. */
void cli_put_shown(cli_rows *rows, const cli_column *column, double value, const char *text);

/* Puts the four coefficients of a medium, as every command writes them. */
void cli_put_medium(cli_rows *rows, const dipole_medium *medium);

/* Write `count` rows, at least one: as an aligned table, whose first `left` columns are aligned
 * left; as CSV, with the line of names where `names` is true; as an array of objects with a key. */
void cli_rows_print(FILE *file, size_t left, size_t count, cli_put_row *put, const void *context);
void cli_rows_csv(FILE *file, bool names, size_t count, cli_put_row *put, const void *context);
void cli_rows_json(cli_json *json, const char *key, size_t count, cli_put_row *put,
                   const void *context);

/* Puts one row as members of the JSON object that is open. */
void cli_rows_members(cli_json *json, cli_put_row *put, const void *context, size_t index);

/* How a command writes what `context` holds to standard output, in each form. */
typedef struct cli_output {
  void (*table)(const void *context);
  void (*csv)(const void *context); /* NULL: CSV has `rows` rows by put_row() */
  size_t rows;
  cli_put_row *put_row;
  void (*members)(cli_json *json, const void *context); /* the members of the JSON object */
} cli_output;

/* Writes nothing for CLI_NONE. */
void cli_write(const cli_output *output, enum cli_form form, const void *context);

#endif
