#include "clients/cli/csv.h"

#include <errno.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "clients/cli/cli.h"

enum { BYTE_ORDER_MARK_BYTES = 3 };

/* ---- bytes ----------------------------------------------------------------------------------- */

static bool fill(cli_csv_reader *reader) {
  struct pollfd wait = {.fd = reader->fd, .events = POLLIN};
  if (reader->before_wait != NULL && poll(&wait, 1, 0) == 0) {
    reader->before_wait(reader->context);
  }
  ssize_t got;
  do {
    got = read(reader->fd, reader->input, sizeof reader->input);
  } while (got < 0 && errno == EINTR);
  if (got <= 0) {
    reader->at_end = true;
    reader->read_errno = got < 0 ? errno : 0;
    return false;
  }
  reader->begin = 0;
  reader->end = (size_t)got;
  reader->bytes_read += (uint64_t)got;
  return true;
}

/* Returns the next byte without taking it; -1 at the end of the input. */
static int peek(cli_csv_reader *reader) {
  if (reader->begin == reader->end && (reader->at_end || !fill(reader))) {
    return -1;
  }
  return (unsigned char)reader->input[reader->begin];
}

static void keep(cli_csv_record *record, const char *bytes, size_t count) {
  if (count > record->capacity - record->length) {
    record->capacity = 2 * (record->capacity + count) + 128;
    record->bytes = cli_resize(record->bytes, record->capacity, 1);
    record->texts = cli_resize(record->texts, record->capacity, 1);
  }
  memcpy(record->bytes + record->length, bytes, count);
  record->length += count;
}

static void end_cell(cli_csv_record *record, size_t begin, size_t end) {
  if (record->cell_count == record->cell_capacity) {
    record->cell_capacity = record->cell_capacity == 0 ? 16 : 2 * record->cell_capacity;
    record->cells = cli_resize(record->cells, record->cell_capacity, sizeof *record->cells);
  }
  record->cells[record->cell_count++] = (cli_csv_cell){begin, end, 0};
}

/* ---- records --------------------------------------------------------------------------------- */

enum state { CELL_START, IN_CELL, IN_QUOTES, QUOTE_IN_QUOTES, IN_COMMENT };

/* Returns the state after a byte that ends neither a cell nor the record. */
static enum state next_state(enum state state, int byte, cli_csv_record *record) {
  switch (state) {
  case CELL_START:
    return byte == '"' ? IN_QUOTES : IN_CELL;
  case IN_QUOTES:
    return byte == '"' ? QUOTE_IN_QUOTES : IN_QUOTES;
  case QUOTE_IN_QUOTES:
    if (byte == '"') {
      return IN_QUOTES;
    }
    record->malformed =
        record->malformed || byte != '\r'; /* a carriage return may belong to the line's end */
    return QUOTE_IN_QUOTES;
  case IN_CELL:
  case IN_COMMENT:
    break;
  }
  return state;
}

/* Copies the text of a cell without its quotes, with a zero byte behind it. The texts of a record's
 * cells lie where the cells do, so that each has room. */
static void copy_text(cli_csv_record *record, cli_csv_cell *cell) {
  const char *from = record->bytes + cell->begin;
  char *text = record->texts + cell->begin;
  size_t left = cell->end - cell->begin;
  const bool quoted = left >= 2 && from[0] == '"' && from[left - 1] == '"';
  if (!quoted) {
    memcpy(text, from, left);
    cell->text_length = left;
    text[left] = '\0';
    return;
  }
  from++;
  left -= 2;
  for (size_t i = 0; i < left; i++) {
    text[cell->text_length++] = from[i];
    i += from[i] == '"' && i + 1 < left && from[i + 1] == '"';
  }
  text[cell->text_length] = '\0';
}

/* Ends the last cell before the line's end. */
static void end_record(cli_csv_record *record, size_t cell_begin, bool comment) {
  const size_t length = record->length;
  if (length > 0 && record->bytes[length - 1] == '\n') {
    record->ending_bytes = length > 1 && record->bytes[length - 2] == '\r' ? 2 : 1;
  }
  if (!comment) {
    const size_t end = length - record->ending_bytes;
    end_cell(record, cell_begin, end > cell_begin ? end : cell_begin);
    keep(record, "", 1); /* room for the zero byte of the last text */
    record->length--;
    for (size_t i = 0; i < record->cell_count; i++) {
      copy_text(record, &record->cells[i]);
    }
  }
}

static bool is_blank(const cli_csv_record *record, size_t begin) {
  while (begin < record->length && strchr(" \t\r\n", record->bytes[begin]) != NULL &&
         record->bytes[begin] != '\0') {
    begin++;
  }
  return begin == record->length;
}

/* Takes further bytes of a cell that began without a quote, or of a comment: those that have been
 * read and end neither. */
static void take_run(cli_csv_reader *reader, cli_csv_record *record, bool comment) {
  const char *from = reader->input + reader->begin;
  size_t most = reader->end - reader->begin;
  if (most > CLI_CSV_RECORD_MAX_BYTES - record->length) {
    most = CLI_CSV_RECORD_MAX_BYTES - record->length;
  }
  size_t count = 0;
  while (count < most && from[count] != '\n' && (comment || from[count] != ',')) {
    count++;
  }
  keep(record, from, count);
  reader->begin += count;
}

/* Takes the bytes of a byte order mark at the start of the input, and returns their number: 3, or
 * less if the mark is not whole. */
static size_t take_byte_order_mark(cli_csv_reader *reader, cli_csv_record *record) {
  static const unsigned char mark[BYTE_ORDER_MARK_BYTES] = {0xef, 0xbb, 0xbf};
  size_t taken = 0;
  if (reader->bytes_read > 0) {
    return 0;
  }
  while (taken < sizeof mark && peek(reader) == mark[taken]) {
    keep(record, (const char *)&mark[taken++], 1);
    reader->begin++;
  }
  return taken;
}

enum cli_csv_kind cli_csv_read(cli_csv_reader *reader, cli_csv_record *record) {
  record->length = record->ending_bytes = record->cell_count = 0;
  record->malformed = false;
  const size_t mark_bytes = take_byte_order_mark(reader, record);
  const bool part_of_mark = mark_bytes > 0 && mark_bytes < BYTE_ORDER_MARK_BYTES;
  const size_t begin = part_of_mark ? 0 : mark_bytes;
  size_t cell_begin = begin;
  int byte = peek(reader);
  enum state state = part_of_mark ? IN_CELL : byte == '#' ? IN_COMMENT : CELL_START;
  for (; byte >= 0; byte = peek(reader)) {
    if (record->length >= CLI_CSV_RECORD_MAX_BYTES) {
      return CLI_CSV_TOO_LONG;
    }
    reader->begin++;
    keep(record, &(char){(char)byte}, 1);
    reader->lines += byte == '\n';
    if (byte == '\n' && state != IN_QUOTES) {
      break;
    }
    if (byte == ',' && state != IN_QUOTES && state != IN_COMMENT) {
      end_cell(record, cell_begin, record->length - 1);
      cell_begin = record->length;
      state = CELL_START;
    } else {
      state = next_state(state, byte, record);
    }
    if (state == IN_CELL || state == IN_COMMENT) {
      take_run(reader, record, state == IN_COMMENT);
    }
  }
  if (reader->read_errno != 0) {
    return CLI_CSV_FAILED;
  }
  if (byte < 0 && state == IN_QUOTES) {
    return CLI_CSV_UNCLOSED;
  }
  if (record->length == 0) {
    return CLI_CSV_END;
  }
  const bool comment = state == IN_COMMENT || is_blank(record, begin);
  end_record(record, cell_begin, comment);
  return comment ? CLI_CSV_COMMENT : CLI_CSV_RECORD;
}

void cli_csv_record_free(cli_csv_record *record) {
  free(record->bytes);
  free(record->texts);
  free(record->cells);
  *record = (cli_csv_record){0};
}

void cli_csv_record_trim(cli_csv_record *record) {
  if (record->capacity > CLI_CSV_RECORD_KEPT_BYTES ||
      record->cell_capacity * sizeof *record->cells > CLI_CSV_RECORD_KEPT_BYTES) {
    cli_csv_record_free(record);
  }
}

/* ---- cells ----------------------------------------------------------------------------------- */

const char *cli_csv_cell_text(const cli_csv_record *record, size_t index, size_t *length) {
  *length = record->cells[index].text_length;
  return record->texts + record->cells[index].begin;
}

void cli_csv_copy_cell(const cli_csv_record *record, size_t index, FILE *file) {
  const cli_csv_cell cell = record->cells[index];
  fwrite_unlocked(record->bytes + cell.begin, 1, cell.end - cell.begin, file);
}

void cli_csv_write_cell(const char *text, FILE *file) {
  if (text[strcspn(text, ",\"\r\n")] == '\0') {
    fputs(text, file);
    return;
  }
  fputc('"', file);
  for (; *text != '\0'; text++) {
    if (*text == '"') {
      fputc('"', file);
    }
    fputc(*text, file);
  }
  fputc('"', file);
}
