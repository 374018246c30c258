/* csv: reads comma-separated values by records (RFC 4180) and keeps their bytes; writes cells. Also
 * reads what cannot be misunderstood: cells between semicolons or tabs, as the header has them;
 * blanks around cells; lines that end with a carriage return; a header that starts with #, if the
 * line below it has as many cells, and numbers; UTF-16 with a byte order mark, as UTF-8. */
#ifndef DIPOLE_CLI_CSV_H
#define DIPOLE_CLI_CSV_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

/* What --help says about it. */
#define CLI_CSV_TEXT                                                                               \
  "CSV has a header, and commas, semicolons or tabs between its cells. Between semicolons or\n"    \
  "tabs a number may have a decimal comma. UTF-16 is read if it starts with a mark.\n"

/* The size of the longest record, with the line breaks in its quotes. */
#define CLI_CSV_RECORD_MAX_BYTES ((size_t)1 << 20)

/* How much memory cli_csv_record_trim() leaves to a record. */
#define CLI_CSV_RECORD_KEPT_BYTES ((size_t)1 << 14)

enum { CLI_CSV_INPUT_BYTES = 65536 };

typedef struct cli_csv_cell {
  size_t begin, end;  /* where the cell lies in the record's bytes, with its quotes and blanks */
  size_t text_length; /* of the cell without these */
} cli_csv_cell;

typedef struct cli_csv_record {
  char *bytes; /* the record as it was read, with the line's end */
  char *texts; /* the texts of the cells, see cli_csv_cell_text() */
  size_t length, capacity;
  size_t begin;        /* where the first cell begins */
  size_t ending_bytes; /* how many bytes the line's end has: 0, 1 or 2 */
  uint64_t line;       /* number of its first line, from 1 on */
  cli_csv_cell *cells;
  size_t cell_count, cell_capacity;
  bool malformed;     /* text stands after a closing quote */
  char separator;     /* of its cells */
  bool decimal_comma; /* cli_csv_number() has read one */
} cli_csv_record;

enum cli_csv_kind {
  CLI_CSV_END,
  CLI_CSV_RECORD,
  CLI_CSV_COMMENT, /* a line that starts with #, or a blank line; it has no cells */
  CLI_CSV_FAILED,  /* see problem */
};

typedef struct cli_csv_reader {
  int fd;
  uint64_t lines;      /* how many lines have been read */
  uint64_t bytes_read; /* how many bytes have been read */
  /* If not NULL, is called before a read that would have to wait for input. */
  void (*before_wait)(void *context);
  void *context;
  char problem[160]; /* after CLI_CSV_FAILED: what is wrong, and where */
  /* The rest belongs to the functions below. Free `held` at the end. */
  char separator;   /* 0 before the header */
  bool lone_return; /* a line has ended with a carriage return alone */
  cli_csv_record held;
  enum cli_csv_kind held_kind; /* of the record that was read ahead; CLI_CSV_END if none was */
  bool at_end;
  int read_errno;
  enum { CLI_CSV_UTF8, CLI_CSV_UTF16_LITTLE, CLI_CSV_UTF16_BIG } encoding;
  size_t rest_bytes;
  unsigned char rest[4]; /* of UTF-16: the beginning of a character */
  size_t begin, end;
  unsigned char input[CLI_CSV_INPUT_BYTES];
} cli_csv_reader;

/* Reads the next record into *record, which may hold another one. The first one is the header. A
 * byte order mark at the start of the input is part of the first record's bytes, but not of its
 * first cell. */
enum cli_csv_kind cli_csv_read(cli_csv_reader *reader, cli_csv_record *record);

/* Returns the text of a cell without its quotes and the blanks around it. It is valid until the next
 * record is read. The text may hold zero bytes; *length is its length with them. */
const char *cli_csv_cell_text(const cli_csv_record *record, size_t index, size_t *length);

/* Reads a cell as a number. Where no comma separates cells, it may be a decimal comma; 1,234 is then
 * a number only between semicolons, since it may mean 1234 elsewhere. */
bool cli_csv_number(cli_csv_record *record, size_t index, double *value);

/* Says what may help if a text is no number: starts with ": ", or is "". */
const char *cli_csv_number_hint(const char *text);

/* Returns whether a row has cells beyond those of the header that are not empty. */
bool cli_csv_has_more(const cli_csv_record *row, size_t header_cells);

/* Write a cell as it was read, or a text as a cell, in quotes where it needs them. */
void cli_csv_copy_cell(const cli_csv_record *record, size_t index, FILE *file);
void cli_csv_write_cell(const char *text, FILE *file);

/* Free the memory of a record: always, or only if it is more than CLI_CSV_RECORD_KEPT_BYTES. */
void cli_csv_record_free(cli_csv_record *record);
void cli_csv_record_trim(cli_csv_record *record);

#endif
