#include "clients/cli/csv.h"

#include <errno.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "clients/cli/cli.h"
#include "clients/cli/number.h"

enum { BYTE_ORDER_MARK_BYTES = 3, HALF_BYTES = CLI_CSV_INPUT_BYTES / 2 };

/* ---- bytes ----------------------------------------------------------------------------------- */

static size_t put_utf8(uint32_t code, unsigned char *to) {
  static const unsigned char marks[] = {0, 0, 0xc0, 0xe0, 0xf0};
  const size_t bytes = code < 0x80 ? 1 : code < 0x800 ? 2 : code < 0x10000 ? 3 : 4;
  for (size_t i = bytes; i-- > 1; code >>= 6) {
    to[i] = (unsigned char)(0x80 | (code & 0x3f));
  }
  to[0] = (unsigned char)(marks[bytes] | code);
  return bytes;
}

static uint32_t unit_at(const cli_csv_reader *reader, size_t at) {
  const size_t high = reader->encoding == CLI_CSV_UTF16_BIG ? at : at + 1;
  return reader->input[high] * 256u + reader->input[2 * at + 1 - high];
}

/* Turns the UTF-16 in the second half of the input into UTF-8, which is at most half as long again,
 * from its start on. What is no character becomes U+FFFD. Keeps the beginning of a character. */
static void decode_utf16(cli_csv_reader *reader, size_t bytes) {
  size_t at = HALF_BYTES;
  const size_t end = at + bytes;
  reader->begin = reader->end = 0;
  while (end - at >= 2) {
    uint32_t code = unit_at(reader, at), low = 0;
    const bool is_high = code >> 10 == 0xd800 >> 10;
    if (is_high && end - at >= 4) {
      low = unit_at(reader, at + 2);
    } else if (is_high && !reader->at_end) {
      break;
    }
    const bool is_pair = low >> 10 == 0xdc00 >> 10;
    code = is_pair ? 0x10000 + (code - 0xd800) * 0x400 + (low - 0xdc00) : code;
    at += is_pair ? 4 : 2;
    code = code >> 11 == 0xd800 >> 11 ? 0xfffd : code;
    reader->end += put_utf8(code, reader->input + reader->end);
  }
  reader->rest_bytes = end - at;
  memcpy(reader->rest, reader->input + at, reader->rest_bytes);
}

/* Reads bytes behind the first `bytes` of the second half of the input. Returns how many there are
 * then. */
static size_t read_some(cli_csv_reader *reader, size_t bytes) {
  ssize_t got;
  do {
    got = read(reader->fd, reader->input + HALF_BYTES + bytes, HALF_BYTES - bytes);
  } while (got < 0 && errno == EINTR);
  if (got <= 0) {
    reader->at_end = true;
    reader->read_errno = got < 0 ? errno : 0;
    return bytes;
  }
  reader->bytes_read += (uint64_t)got;
  return bytes + (size_t)got;
}

static bool fill(cli_csv_reader *reader) {
  struct pollfd wait = {.fd = reader->fd, .events = POLLIN};
  if (reader->before_wait != NULL && poll(&wait, 1, 0) == 0) {
    reader->before_wait(reader->context);
  }
  const bool first = reader->bytes_read == 0;
  do {
    size_t bytes = reader->rest_bytes;
    memcpy(reader->input + HALF_BYTES, reader->rest, bytes);
    do {
      bytes = read_some(reader, bytes);
    } while (reader->bytes_read < 2 && !reader->at_end);
    if (first && bytes >= 2) {
      const uint32_t mark = unit_at(reader, HALF_BYTES);
      reader->encoding = mark == 0xfeff   ? CLI_CSV_UTF16_LITTLE
                         : mark == 0xfffe ? CLI_CSV_UTF16_BIG
                                          : CLI_CSV_UTF8;
    }
    reader->begin = HALF_BYTES;
    reader->end = HALF_BYTES + bytes;
    if (reader->encoding != CLI_CSV_UTF8) {
      decode_utf16(reader, bytes);
    }
  } while (reader->begin == reader->end && !reader->at_end);
  return reader->begin < reader->end;
}

/* Returns the next byte without taking it; -1 at the end of the input. */
static int peek(cli_csv_reader *reader) {
  if (reader->begin == reader->end && (reader->at_end || !fill(reader))) {
    return -1;
  }
  return reader->input[reader->begin];
}

static void keep(cli_csv_record *record, const void *bytes, size_t count) {
  if (count > record->capacity - record->length) {
    record->capacity = 2 * (record->capacity + count) + 128;
    record->bytes = cli_resize(record->bytes, record->capacity, 1);
    record->texts = cli_resize(record->texts, record->capacity, 1);
  }
  memcpy(record->bytes + record->length, bytes, count);
  record->length += count;
}

/* ---- cells ----------------------------------------------------------------------------------- */

/* separator: 0 stands for all of them. */
static bool is_separator(int byte, char separator) {
  return separator != 0 ? byte == separator : byte == ',' || byte == ';' || byte == '\t';
}

static bool is_blank(int byte, char separator) {
  return (byte == ' ' || byte == '\t') && !is_separator(byte, separator);
}

static void add_cell(cli_csv_record *record, cli_csv_cell cell) {
  if (record->cell_count == record->cell_capacity) {
    record->cell_capacity = record->cell_capacity == 0 ? 16 : 2 * record->cell_capacity;
    record->cells = cli_resize(record->cells, record->cell_capacity, sizeof *record->cells);
  }
  record->texts[cell.begin + cell.text_length] = '\0';
  record->cells[record->cell_count++] = cell;
}

/* Copies the text of a quoted cell; *at is behind its first quote, and then behind its last. */
static void copy_quoted(cli_csv_record *record, cli_csv_cell *cell, size_t *at, size_t end) {
  for (; *at < end; (*at)++) {
    if (record->bytes[*at] == '"' && (++*at == end || record->bytes[*at] != '"')) {
      break;
    }
    record->texts[cell->begin + cell->text_length++] = record->bytes[*at];
  }
  for (; *at < end && !is_separator(record->bytes[*at], record->separator); (*at)++) {
    record->malformed = record->malformed || !is_blank(record->bytes[*at], record->separator);
  }
}

/* Makes the cells of a record from its bytes. The texts of cells lie where the cells do, so that
 * each has room. */
static void split(cli_csv_record *record, char separator) {
  const char *bytes = record->bytes;
  const size_t end = record->length - record->ending_bytes;
  record->cell_count = 0;
  record->malformed = record->decimal_comma = false;
  record->separator = separator;
  for (size_t at = record->begin; at <= end; at++) {
    cli_csv_cell cell = {.begin = at};
    while (at < end && is_blank(bytes[at], separator)) {
      at++;
    }
    if (at < end && bytes[at] == '"') {
      at++;
      copy_quoted(record, &cell, &at, end);
    } else {
      const size_t from = at;
      while (at < end && !is_separator(bytes[at], separator)) {
        at++;
      }
      cell.text_length = at - from;
      while (cell.text_length > 0 && is_blank(bytes[from + cell.text_length - 1], separator)) {
        cell.text_length--;
      }
      memcpy(record->texts + cell.begin, bytes + from, cell.text_length);
    }
    cell.end = at;
    add_cell(record, cell);
  }
}

const char *cli_csv_cell_text(const cli_csv_record *record, size_t index, size_t *length) {
  *length = record->cells[index].text_length;
  return record->texts + record->cells[index].begin;
}

/* Returns whether a text may have commas between its thousands: 1,234. */
static bool may_be_thousands(const char *text) {
  text += *text == '-' || *text == '+';
  const size_t digits = strspn(text, "0123456789");
  return text[0] != '0' && digits > 0 && digits <= 3 && strlen(text) == digits + 4 &&
         strspn(text + digits + 1, "0123456789") == 3;
}

bool cli_csv_number(cli_csv_record *record, size_t index, double *value) {
  const cli_csv_cell *cell = &record->cells[index];
  char *text = record->texts + cell->begin, *comma = strchr(text, ',');
  if (strlen(text) != cell->text_length) {
    return false;
  }
  if (comma == NULL || record->separator == ',' ||
      (record->separator != ';' && may_be_thousands(text))) {
    return cli_number_parse(text, value);
  }
  *comma = '.';
  const bool good = cli_number_parse(text, value);
  *comma = ',';
  record->decimal_comma = record->decimal_comma || good;
  return good;
}

const char *cli_csv_number_hint(const char *text) {
  return strchr(text, ',') != NULL ? ": write a decimal point" : "";
}

bool cli_csv_has_more(const cli_csv_record *row, size_t header_cells) {
  size_t i = header_cells;
  while (i < row->cell_count && row->cells[i].text_length == 0) {
    i++;
  }
  return i < row->cell_count;
}

/* ---- records --------------------------------------------------------------------------------- */

enum state { CELL_START, IN_CELL, IN_QUOTES, QUOTE_IN_QUOTES, IN_COMMENT };

/* Returns the state after a byte that ends no line outside of quotes. */
static enum state next_state(enum state state, int byte, char separator) {
  if (state == IN_QUOTES || state == IN_COMMENT) {
    return state == IN_QUOTES && byte == '"' ? QUOTE_IN_QUOTES : state;
  }
  if (is_separator(byte, separator) || (state == CELL_START && is_blank(byte, separator))) {
    return CELL_START;
  }
  return byte == '"' && state != IN_CELL ? IN_QUOTES : IN_CELL;
}

/* Takes further bytes of a cell that began without a quote, or of a comment: those that have been
 * read and end neither. */
static void take_run(cli_csv_reader *reader, cli_csv_record *record, bool comment) {
  const unsigned char *from = reader->input + reader->begin;
  size_t most = reader->end - reader->begin;
  if (most > CLI_CSV_RECORD_MAX_BYTES - record->length) {
    most = CLI_CSV_RECORD_MAX_BYTES - record->length;
  }
  size_t count = 0;
  while (count < most && from[count] != '\n' && from[count] != '\r' &&
         (comment || !is_separator(from[count], reader->separator))) {
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
    keep(record, &mark[taken++], 1);
    reader->begin++;
  }
  return taken;
}

/* Takes the next byte. Returns whether it ends a line. Once a carriage return has ended one, it does
 * so at once: a program may wait for an answer before it goes on. */
static bool take_byte(cli_csv_reader *reader, cli_csv_record *record, bool quoted) {
  const unsigned char byte = reader->input[reader->begin++];
  keep(record, &byte, 1);
  if (byte == '\r' && !quoted && !reader->lone_return) {
    reader->lone_return = peek(reader) != '\n';
  }
  const bool ends = byte == '\n' || (byte == '\r' && reader->lone_return);
  reader->lines += ends;
  return ends;
}

static enum cli_csv_kind fail_at(cli_csv_reader *reader, uint64_t line, const char *what) {
  snprintf(reader->problem, sizeof reader->problem, "line %llu: %s", (unsigned long long)line,
           what);
  return CLI_CSV_FAILED;
}

static bool is_empty(const cli_csv_record *record) {
  size_t at = record->begin;
  while (at < record->length - record->ending_bytes && is_blank(record->bytes[at], ',')) {
    at++;
  }
  return at == record->length - record->ending_bytes;
}

/* Reads a record or a comment, and makes no cells. */
static enum cli_csv_kind read_line(cli_csv_reader *reader, cli_csv_record *record) {
  record->length = record->ending_bytes = record->cell_count = 0;
  record->line = reader->lines + 1;
  const size_t mark_bytes = take_byte_order_mark(reader, record);
  const bool part_of_mark = mark_bytes > 0 && mark_bytes < BYTE_ORDER_MARK_BYTES;
  record->begin = part_of_mark ? 0 : mark_bytes;
  int byte = peek(reader);
  enum state state = part_of_mark ? IN_CELL : byte == '#' ? IN_COMMENT : CELL_START;
  uint64_t quote_line = 0;
  bool ends = false;
  for (; !ends && byte >= 0; byte = ends ? 0 : peek(reader)) {
    const bool quoted = state == IN_QUOTES;
    if (record->length >= CLI_CSV_RECORD_MAX_BYTES) {
      return quoted ? fail_at(reader, quote_line, "a quote is not closed within 1 MiB")
                    : fail_at(reader, record->line, "the row is longer than 1 MiB");
    }
    ends = take_byte(reader, record, quoted) && !quoted;
    state = ends ? state : next_state(state, byte, reader->separator);
    quote_line = state == IN_QUOTES && !quoted ? reader->lines + 1 : quote_line;
    if (!ends && (state == IN_CELL || state == IN_COMMENT)) {
      take_run(reader, record, state == IN_COMMENT);
    }
  }
  if (reader->read_errno != 0) {
    snprintf(reader->problem, sizeof reader->problem, "%s", strerror(reader->read_errno));
    return CLI_CSV_FAILED;
  }
  if (!ends && state == IN_QUOTES) {
    return fail_at(reader, quote_line, "a quote is not closed");
  }
  if (record->length == 0) {
    return CLI_CSV_END;
  }
  keep(record, "", 1); /* room for the zero byte of the last text */
  const char *end = record->bytes + --record->length;
  record->ending_bytes = (size_t)ends + (record->length > 1 && end[-1] == '\n' && end[-2] == '\r');
  return state == IN_COMMENT || is_empty(record) ? CLI_CSV_COMMENT : CLI_CSV_RECORD;
}

/* Returns what separates the columns of a header; 0 if that could be commas or semicolons. Splits
 * the header. */
static char split_header(cli_csv_record *header) {
  bool commas = false, semicolons = false;
  split(header, 0);
  for (size_t i = 0; i + 1 < header->cell_count; i++) {
    commas = commas || header->bytes[header->cells[i].end] == ',';
    semicolons = semicolons || header->bytes[header->cells[i].end] == ';';
  }
  const char separator = semicolons ? ';' : commas || header->cell_count == 1 ? ',' : '\t';
  split(header, separator);
  return commas && semicolons ? 0 : separator;
}

static enum cli_csv_kind take_header(cli_csv_reader *reader, cli_csv_record *header) {
  reader->separator = split_header(header);
  if (reader->separator == 0) {
    return fail_at(reader, header->line,
                   "the header has commas and semicolons: separate its columns by one of them");
  }
  if (memchr(header->bytes, '\0', header->length) != NULL) {
    return fail_at(reader, header->line, "the header has zero bytes: save the file as UTF-8");
  }
  if (header->cell_count == 1 && strchr(header->texts + header->cells[0].begin, ' ') != NULL) {
    return fail_at(reader, header->line,
                   "the header is one cell: separate its columns by commas, semicolons or tabs");
  }
  return CLI_CSV_RECORD;
}

/* Returns whether a comment above the first record is the header: it has as many cells, and only
 * the record has numbers among them. Then splits it. */
static bool is_header(cli_csv_record *comment, cli_csv_record *first) {
  const size_t begin = comment->begin;
  size_t names = 0, numbers = 0;
  double number;
  comment->begin += strspn(comment->bytes + begin, "#");
  split(first, split_header(comment));
  for (size_t i = 0; i < comment->cell_count; i++) {
    names += comment->cells[i].text_length > 0 && !cli_csv_number(comment, i, &number);
    numbers += i < first->cell_count && cli_csv_number(first, i, &number);
  }
  if (names > 1 && names == comment->cell_count && names == first->cell_count && numbers > 0 &&
      first->separator != 0 && !comment->malformed) {
    return true;
  }
  comment->begin = begin;
  comment->cell_count = 0;
  return false;
}

enum cli_csv_kind cli_csv_read(cli_csv_reader *reader, cli_csv_record *record) {
  enum cli_csv_kind kind = reader->held_kind;
  if (kind != CLI_CSV_END) {
    const cli_csv_record held = reader->held;
    reader->held = *record;
    *record = held;
    reader->held_kind = CLI_CSV_END;
  } else {
    kind = read_line(reader, record);
  }
  if (reader->separator != 0) {
    if (kind == CLI_CSV_RECORD) {
      split(record, reader->separator);
    }
  } else if (kind == CLI_CSV_RECORD) {
    return take_header(reader, record);
  } else if (kind == CLI_CSV_COMMENT && record->bytes[record->begin] == '#') {
    reader->held_kind = read_line(reader, &reader->held);
    if (reader->held_kind == CLI_CSV_RECORD && is_header(record, &reader->held)) {
      reader->separator = record->separator;
      return CLI_CSV_RECORD;
    }
  }
  return kind;
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

/* ---- writing --------------------------------------------------------------------------------- */

void cli_csv_copy_cell(const cli_csv_record *record, size_t index, FILE *file) {
  const cli_csv_cell cell = record->cells[index];
  fwrite_unlocked(record->bytes + cell.begin, 1, cell.end - cell.begin, file);
}

void cli_csv_write_cell(const char *text, FILE *file) {
  const size_t length = strlen(text);
  if (text[strcspn(text, ",;\t\"\r\n#")] == '\0' && text[0] != ' ' &&
      (length == 0 || text[length - 1] != ' ')) {
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
