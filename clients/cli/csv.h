/* csv: comma-separated values as RFC 4180 has them, read by records and kept byte for byte. */
#ifndef DIPOLE_CLI_CSV_H
#define DIPOLE_CLI_CSV_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

/* The longest record, its quoted line breaks included. */
#define CLI_CSV_RECORD_MAX_BYTES ((size_t)1 << 20)

/* Memory that an emptied record keeps for the next one. */
#define CLI_CSV_RECORD_KEPT_BYTES ((size_t)1 << 14)

enum { CLI_CSV_INPUT_BYTES = 65536 };

typedef struct cli_csv_cell {
  size_t begin, end; /* in the record's bytes, quotes included */
} cli_csv_cell;

typedef struct cli_csv_record {
  char *bytes; /* as read, with the line's end */
  size_t length, capacity;
  size_t ending_bytes; /* of the line's end: 0, 1 or 2 */
  cli_csv_cell *cells;
  size_t cell_count, cell_capacity;
  bool malformed; /* text stands after a closing quote */
} cli_csv_record;

typedef struct cli_csv_reader {
  int fd;
  uint64_t lines;      /* read so far */
  uint64_t bytes_read; /* likewise */
  /* Called before a read that may take long, because nothing has arrived yet. */
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
  CLI_CSV_COMMENT, /* a line that starts with #, or a blank one: no cells */
  CLI_CSV_TOO_LONG,
  CLI_CSV_UNCLOSED, /* the input ends within quotes */
  CLI_CSV_FAILED,   /* see read_errno */
};

/* Reads the next record into *record, whatever that holds. A byte order mark at the start of the
 * input is part of the first record's bytes, but not of its first cell. */
enum cli_csv_kind cli_csv_read(cli_csv_reader *reader, cli_csv_record *record);

/* A cell without its quotes, to be freed; its length in *length, for it may hold zero bytes. */
char *cli_csv_cell_text(const cli_csv_record *record, size_t index, size_t *length);

/* Writes a cell as it was read, or a text as a cell, quoted where that is needed. */
void cli_csv_copy_cell(const cli_csv_record *record, size_t index, FILE *file);
void cli_csv_write_cell(const char *text, FILE *file);

/* Gives memory back, all of it or what is beyond CLI_CSV_RECORD_KEPT_BYTES. */
void cli_csv_record_free(cli_csv_record *record);
void cli_csv_record_trim(cli_csv_record *record);

#endif
