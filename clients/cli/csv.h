/* csv: reads comma-separated values by records (RFC 4180) and keeps their bytes; writes cells. Also
 * reads what cannot be misunderstood: cells between semicolons or tabs, as the header has them;
 * blanks around cells; lines that end with a carriage return; a first line sep=;.
 *
 * Comments are blank lines and lines that start with #, but no data is lost as one: above the
 * header, the last such line with as many cells as the first row, and names where that has a
 * number, is the header; below it, such a line with several cells is a row, as that of a sample
 * called #1. */
#ifndef DIPOLE_CLI_CSV_H
#define DIPOLE_CLI_CSV_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include "clients/cli/cli.h"

/* The description of CSV input in --help. */
#define CLI_CSV_TEXT                                                                               \
  " CSV has a header, and commas, semicolons or tabs between its cells. Lines that start with # "  \
  "are "                                                                                           \
  "comments, but below the header only those with one cell."

/* Largest size of a record, including line breaks within quotes. */
#define CLI_CSV_RECORD_MAX_BYTES ((size_t)1 << 20)

enum { CLI_CSV_INPUT_BYTES = 65536 };

typedef struct cli_csv_cell {
  size_t begin, end;  /* position of the cell in the record's bytes, with its quotes and blanks */
  size_t text_length; /* length of its text without quotes and blanks */
} cli_csv_cell;

typedef struct cli_csv_record {
  char *bytes; /* the record as it was read, with the line's end */
  char *texts; /* texts of the cells: see cli_csv_cell_text() */
  size_t length, capacity;
  size_t begin;        /* where the first cell begins */
  size_t ending_bytes; /* size of the line's end: 0, 1 or 2 */
  uint64_t line;       /* number of its first line, from 1 on */
  cli_csv_cell *cells;
  size_t cell_count, cell_capacity;
  bool malformed; /* whether text follows a closing quote */
  char separator; /* separator of its cells */
} cli_csv_record;

enum cli_csv_kind {
  CLI_CSV_END,
  CLI_CSV_RECORD,
  CLI_CSV_COMMENT, /* a comment line: it has no cells */
  CLI_CSV_FAILED,  /* see problem */
};

typedef struct cli_csv_reader {
  int fd;
  uint64_t lines;      /* number of lines read so far */
  uint64_t bytes_read; /* number of bytes read so far */
  /* If not NULL, is called before a read that would have to wait for input. */
  void (*before_wait)(void *context);
  void *context;
  char problem[160]; /* after CLI_CSV_FAILED: what is wrong, and where */
  /* The rest belongs to the functions below. */
  char separator;      /* separator of cells; 0 until the header is read */
  size_t header_cells; /* number of cells in the header; 0 until it is read */
  bool lone_return;    /* a line has ended with a carriage return alone */
  struct cli_csv_held {
    cli_csv_record record;
    enum cli_csv_kind kind;
  } * held; /* records that were read ahead to find the header */
  size_t held_count, held_next;
  bool at_end;
  int read_errno;
  size_t begin, end;
  unsigned char input[CLI_CSV_INPUT_BYTES];
} cli_csv_reader;

/* Reads the next record into *record, which may hold another one. The first one is the header. A
 * byte order mark is part of the first record's bytes, but not of its first cell. */
enum cli_csv_kind cli_csv_read(cli_csv_reader *reader, cli_csv_record *record);

/* Returns the text of a cell without its quotes and the blanks around it. It is valid until the
 * next record is read. The text may hold zero bytes; *length is its length with them. */
const char *cli_csv_cell_text(const cli_csv_record *record, size_t index, size_t *length);

/* Reads a cell as a number. 05 is none, since 0,05 in two cells is meant as 0.05. */
bool cli_csv_number(const cli_csv_record *record, size_t index, double *value);

/* Returns a hint if a text is no number: it begins with ": ", or is "". */
const char *cli_csv_number_hint(const char *text);

/* Finds the columns with these names in the header of `source`, a file's name: at[i] is the
 * position of names[i], or CLI_CSV_ABSENT. Says what is wrong and returns false if one stands there
 * twice, or is nearly called as one of them, or as one of the options, which may be NULL. */
#define CLI_CSV_ABSENT SIZE_MAX
bool cli_csv_find(const char *source, const cli_csv_record *header, const char *const *names,
                  size_t count, const cli_option *options, size_t *at);

/* Says that a column is missing, which the header has, and what it needs. Returns false. */
bool cli_csv_fail_missing(const char *source, const cli_csv_record *header, const char *missing,
                          const char *needs);

/* Write a cell as it was read, or a text as a cell, in quotes where it needs them. */
void cli_csv_copy_cell(const cli_csv_record *record, size_t index, FILE *file);
void cli_csv_write_cell(const char *text, FILE *file);

/* Frees the memory of a record. */
void cli_csv_record_free(cli_csv_record *record);

/* ---- sheets: the numbers of a file, by the names of their columns ---------------------------- */

typedef struct cli_sheet {
  const char *source; /* the file's name, for messages */
  size_t columns;
  size_t *at; /* [columns] positions in the header, or CLI_CSV_ABSENT */
  size_t count, capacity;
  double *numbers; /* [count][columns]; NAN where the cell is empty or absent */
  char **labels;   /* [count] texts of the column of labels; "1" if it is absent */
  uint64_t *lines; /* [count] line numbers in the file, from 1 on */
} cli_sheet;

/* Reads a file; NULL or "-" stands for standard input. names: of the columns; label: of one with
 * texts, or NULL. check() is called once, after the header, with at[] set; it says what is wrong
 * and returns false to end the reading. Says what is wrong and returns false. */
bool cli_sheet_read(const char *path, const char *label, const char *const *names, size_t columns,
                    bool (*check)(const cli_sheet *sheet, const cli_csv_record *header),
                    cli_sheet *sheet);

/* Returns a number of a row. */
static inline double cli_sheet_number(const cli_sheet *sheet, size_t row, size_t column) {
  return sheet->numbers[row * sheet->columns + column];
}

/* Opens a file; NULL or "-" stands for standard input. *source: its name, for messages. Says what
 * is wrong and returns a negative number if it cannot. */
int cli_sheet_open(const char *path, const char **source);

#endif
