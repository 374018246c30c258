/* rows: a list of like things, described once and written as a table, as CSV or as JSON. */
#ifndef DIPOLE_CLI_ROWS_H
#define DIPOLE_CLI_ROWS_H

#include "clients/cli/cli.h"

/* Bits for cli_column.forms. */
enum { CLI_IN_TABLE = 1 << CLI_TABLE, CLI_IN_CSV = 1 << CLI_CSV, CLI_IN_JSON = 1 << CLI_JSON };

typedef struct cli_column {
  const char *name;    /* in CSV and JSON */
  const char *head;    /* title of the column for people; NULL: the name */
  const char *unit;    /* unit of the column, in JSON and below the title in a table; NULL: none */
  const char *format;  /* printf format of numbers in a table; NULL: "%.6g" */
  const char *missing; /* text for NaN in a table; NULL: "nan" */
  const char *over;    /* text above the title in a table; NULL: none */
  const char *below;   /* in place of the unit below the head in a table; NULL for that */
  unsigned forms;      /* output formats (CLI_IN_*) in which the column appears; 0: all */
} cli_column;

/* Which part of a row is written. */
enum cli_pass {
  CLI_ROWS_OVER,   /* the line above the titles; see cli_column.over */
  CLI_ROWS_HEAD,   /* the line of names or titles */
  CLI_ROWS_UNIT,   /* the header's line of units; in JSON the members of "units" */
  CLI_ROWS_VALUES, /* a row of values */
  CLI_ROWS_TITLE,  /* for people: names and values on one line */
};

/* The output of rows, and its state. */
typedef struct cli_rows {
  enum cli_form form;
  enum cli_pass pass;
  FILE *file;
  struct cli_table *table;
  const char *between; /* separator of cells of this line, or of members of this object */
  bool filled;         /* whether the line or object has a cell or member */
} cli_rows;

/* Writes row `index`: calls one of the functions below for each column, always for the same columns
 * in the same order. For a line of the header, `index` is 0 and the values do not matter. */
typedef void cli_put_row(cli_rows *rows, const void *context, size_t index);

/* These write one cell: a value, and the members of its column from the name on. A number that is
 * NaN is an empty cell in CSV and null in JSON, where infinities are the texts "inf" and "-inf".
 * cli_put_shown() writes a number, in whose place a table shows `text`, unless that is NULL. */
#define cli_put_number(rows, value, ...)                                                           \
  cli_rows_number(rows, value, &(const cli_column){.name = __VA_ARGS__})
#define cli_put_count(rows, value, ...)                                                            \
  cli_rows_count(rows, value, &(const cli_column){.name = __VA_ARGS__})
#define cli_put_text(rows, value, ...)                                                             \
  cli_rows_text(rows, value, &(const cli_column){.name = __VA_ARGS__})
#define cli_put_shown(rows, value, text, ...)                                                      \
  cli_rows_shown(rows, value, text, &(const cli_column){.name = __VA_ARGS__})
void cli_rows_number(cli_rows *rows, double value, const cli_column *column);
void cli_rows_count(cli_rows *rows, uint64_t value, const cli_column *column);
void cli_rows_text(cli_rows *rows, const char *value, const cli_column *column);
void cli_rows_shown(cli_rows *rows, double value, const char *text, const cli_column *column);

/* Return the decimal number with the fewest digits that reads back to the same float, 0.1 for 0.1f;
 * and the nearest one of 15 digits, 0.943 for 0.9430000000000001. Infinities and NaN stay. */
double cli_number_of_single(float value);
double cli_number_rounded(double value);

/* Returns value i of a quantity, or the albedo, in the fewest digits of its precision. */
double cli_value(const dipole_result *result, uint32_t channel, unsigned quantity, size_t i);

/* Returns the numerical error of the values at a radius. */
double cli_numerical_error(const dipole_errors *errors, double r_mm);

/* Writes the layers of a medium as one text: those of --layer, with blanks between them. */
void cli_put_layers(cli_rows *rows, const dipole_medium *layers, size_t count);

/* Writes the coefficients of a medium, or its layers as one text. */
void cli_put_medium(cli_rows *rows, const dipole_medium *layers, size_t count);

/* Writes `count` rows as an aligned table, whose first `left` columns are aligned left. */
void cli_rows_print(FILE *file, size_t left, size_t count, cli_put_row *put, const void *context);

/* A command's output, written to standard output in each form. JSON is an object of the facts,
 * "units" and "rows", which has an object for each row; CSV has the rows; people get a line of the
 * facts, and the rows unless there is table(). */
typedef struct cli_report {
  /* writes what holds for all rows; NULL: nothing does */
  void (*facts)(cli_rows *rows, const void *context);
  size_t rows;
  cli_put_row *put_row;
  size_t left; /* see cli_rows_print() */
  /* writes the table for people; NULL: rows are written, and then foot() */
  void (*table)(const void *context);
  void (*foot)(const void *context);
} cli_report;

/* Writes nothing for CLI_NONE. */
void cli_write(const cli_report *report, enum cli_form form, const void *context);

#endif
