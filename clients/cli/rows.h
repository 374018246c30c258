/* rows: a list of like things, described once and written as an aligned table, as CSV or as JSON.
 */
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

/* Which line of the output is being written. The header of a table has up to three lines. That of
 * CSV is the line of names. */
enum cli_pass {
  CLI_ROWS_OVER,   /* the header's line above the names; see cli_column.over */
  CLI_ROWS_HEAD,   /* the header's line of names */
  CLI_ROWS_UNIT,   /* the header's line of units */
  CLI_ROWS_VALUES, /* a row of values */
};

/* What a row is written to. */
typedef struct cli_rows {
  enum cli_form form;
  enum cli_pass pass;
  FILE *file;
  cli_table *table;
  cli_json *json; /* for CLI_JSON, where a row may write further members of its object; else NULL */
  bool filled;    /* this line of CSV has a cell already */
} cli_rows;

/* Writes row `index`: calls one of the functions below for each column, always for the same columns
 * in the same order. For a line of the header, `index` is 0 and the values do not matter. */
typedef void cli_put_row(cli_rows *rows, const void *context, size_t index);

/* These write one cell. A number that is NaN is an empty cell in CSV and null in JSON. */
void cli_put_number(cli_rows *rows, const cli_column *column, double value);
void cli_put_count(cli_rows *rows, const cli_column *column, uint64_t value);
void cli_put_text(cli_rows *rows, const cli_column *column, const char *text);

/* Writes a number. A table shows `text` in its place, unless `text` is NULL. */
void cli_put_shown(cli_rows *rows, const cli_column *column, double value, const char *text);

/* Writes the four coefficients of a medium. */
void cli_put_medium(cli_rows *rows, const dipole_medium *medium);

/* These write `count` rows, at least one: as an aligned table, whose first `left` columns are
 * aligned left; as CSV, after a line of names if `names` is true; or as an array of objects with
 * this key. */
void cli_rows_print(FILE *file, size_t left, size_t count, cli_put_row *put, const void *context);
/* Like cli_rows_print(), for a terminal of a width in characters; see cli_table.width. */
void cli_rows_fit(FILE *file, size_t width, size_t left, size_t count, cli_put_row *put,
                  const void *context);
void cli_rows_csv(FILE *file, bool names, size_t count, cli_put_row *put, const void *context);
void cli_rows_json(cli_json *json, const char *key, size_t count, cli_put_row *put,
                   const void *context);

/* Writes one row as members of the innermost JSON object. */
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
