/* csv: reads comma-separated values by records (RFC 4180) and keeps their bytes; writes cells. */
#ifndef DIPOLE_CLI_CSV_H
#define DIPOLE_CLI_CSV_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

/* The size of the longest record, with the line breaks in its quotes. */
#define CLI_CSV_RECORD_MAX_BYTES ((size_t)1 << 20)

/* How much memory cli_csv_record_trim() leaves to a record. */
#define CLI_CSV_RECORD_KEPT_BYTES ((size_t)1 << 14)

enum { CLI_CSV_INPUT_BYTES = 65536 };

typedef struct cli_csv_cell {
  size_t begin, end;  /* where the cell lies in the record's bytes, with its quotes */
  size_t text_length; /* of the cell without its quotes */
} cli_csv_cell;

typedef struct cli_csv_record {
  char *bytes; /* the record as it was read, with the line's end */
  char *texts; /* the texts of the cells, see cli_csv_cell_text() */
  size_t length, capacity;
  size_t ending_bytes; /* how many bytes the line's end has: 0, 1 or 2 */
  cli_csv_cell *cells;
  size_t cell_count, cell_capacity;
  bool malformed; /* text stands after a closing quote */
} cli_csv_record;

typedef struct cli_csv_reader {
  int fd;
  uint64_t lines;      /* how many lines have been read */
  uint64_t bytes_read; /* how many bytes have been read */
  /* If not NULL, is called before a read that would have to wait for input. */
  void (*before_wait)(void *context);
  void *context;
  bool at_end;
  int read_errno;
  size_t begin, end;
  char input[CLI_CSV_INPUT_BYTES];
} cli_csv_reader;

enum cli_csv_kind {
  CLI_CSV_END,
  CLI_CSV_RECORD,
  CLI_CSV_COMMENT, /* a line that starts with #, or a blank line; it has no cells */
  CLI_CSV_TOO_LONG,
  CLI_CSV_UNCLOSED, /* the input ends within quotes */
  CLI_CSV_FAILED,   /* see read_errno */
};

/* Reads the next record into *record, which may hold another one. A byte order mark at the start of
 * the input is part of the first record's bytes, but not of its first cell. */
enum cli_csv_kind cli_csv_read(cli_csv_reader *reader, cli_csv_record *record);

/* Returns the text of a cell without its quotes. It is valid until the next record is read. The
 * text may hold zero bytes; *length is its length with them. */
const char *cli_csv_cell_text(const cli_csv_record *record, size_t index, size_t *length);

/* Write a cell as it was read, or a text as a cell, in quotes where it needs them. */
void cli_csv_copy_cell(const cli_csv_record *record, size_t index, FILE *file);
void cli_csv_write_cell(const char *text, FILE *file);

/* Free the memory of a record: always, or only if it is more than CLI_CSV_RECORD_KEPT_BYTES. */
void cli_csv_record_free(cli_csv_record *record);
void cli_csv_record_trim(cli_csv_record *record);

#endif
