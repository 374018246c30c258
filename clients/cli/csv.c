#include "clients/cli/csv.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "clients/cli/options.h"
#include "proto/decimal.h"

#define UTF8_MARK "\xef\xbb\xbf" /* a byte order mark, with which a file may begin */

/* ---- bytes ----------------------------------------------------------------------------------- */

static bool read_bytes(cli_csv_reader *reader) {
  struct pollfd wait = {.fd = reader->fd, .events = POLLIN};
  ssize_t got;
  if (reader->before_wait != NULL && poll(&wait, 1, 0) == 0) {
    reader->before_wait(reader->context);
  }
  do {
    got = read(reader->fd, reader->input, sizeof reader->input);
  } while (got < 0 && errno == EINTR);
  reader->at_end = got <= 0;
  reader->read_errno = got < 0 ? errno : 0;
  reader->begin = 0;
  reader->end = got > 0 ? (size_t)got : 0;
  reader->bytes_read += reader->end;
  return got > 0;
}

/* Returns the next byte without consuming it, or -1 at the end of the input. */
static int peek(cli_csv_reader *reader) {
  if (reader->begin == reader->end && (reader->at_end || !read_bytes(reader))) {
    return -1;
  }
  return reader->input[reader->begin];
}

static void keep_bytes(cli_csv_record *record, const void *bytes, size_t count) {
  if (count > record->capacity - record->length) {
    record->capacity = 2 * (record->capacity + count) + 128;
    record->bytes = cli_resize(record->bytes, record->capacity, 1);
    record->texts = cli_resize(record->texts, record->capacity, 1);
  }
  memcpy(record->bytes + record->length, bytes, count);
  record->length += count;
}

/* ---- cells ----------------------------------------------------------------------------------- */

/* Returns whether a byte separates cells. separator 0: any of comma, semicolon and tab. */
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

/* Copies the text of a quoted cell. *at: the place behind its first quote, then behind its last. */
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

/* Makes the cells of a record. The texts of cells lie where the cells do, so that each has room. */
static void split(cli_csv_record *record, char separator) {
  const char *bytes = record->bytes;
  const size_t end = record->length - record->ending_bytes;
  record->cell_count = 0;
  record->malformed = false;
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

bool cli_csv_number(const cli_csv_record *record, size_t index, double *value) {
  const cli_csv_cell *cell = &record->cells[index];
  const char *text = record->texts + cell->begin;
  return strlen(text) == cell->text_length && !decimal_starts_with_zero(text) &&
         decimal_read(text, value);
}

const char *cli_csv_number_hint(const char *text) {
  return strchr(text, ',') != NULL || decimal_starts_with_zero(text) ? ": write a decimal point"
         : text[0] == '#' ? ": below the header, lines with several cells are no comments"
                          : "";
}

/* ---- columns --------------------------------------------------------------------------------- */

/* Says so and returns false if a column that is not read is nearly called as one that is, or as an
 * option, which holds for all rows. */
static bool check_unread(const char *source, const char *name, const char *const *names,
                         size_t count, const cli_option *options) {
  cli_nearest column = {0}, given = {0};
  for (size_t i = 0; i < count; i++) {
    cli_nearest_try(&column, name, names[i], strlen(names[i]) / 4);
  }
  for (; options != NULL && options->name != NULL; options++) {
    if (options->kind != CLI_HEADING) {
      cli_nearest_try(&given, name, options->name, strlen(options->name) / 8);
    }
  }
  if (column.name != NULL) {
    return cli_fails("%s: the column %s is not read; the nearest that is read is %s: rename it",
                     source, name, column.name);
  }
  return given.name == NULL ||
         cli_fails("%s: the column %s is not read; the nearest is the option --%s, which holds for "
                   "all rows: give it, and rename the column",
                   source, name, given.name);
}

bool cli_csv_find(const char *source, const cli_csv_record *header, const char *const *names,
                  size_t count, const cli_option *options, size_t *at) {
  size_t length;
  bool good = true;
  memset(at, 0xff, count * sizeof *at); /* CLI_CSV_ABSENT */
  for (size_t i = 0; good && i < header->cell_count; i++) {
    const char *name = cli_csv_cell_text(header, i, &length);
    size_t k = 0;
    while (k < count && strcmp(names[k], name) != 0) {
      k++;
    }
    if (k == count) {
      good = check_unread(source, name, names, count, options);
    } else if (at[k] != CLI_CSV_ABSENT) {
      good = cli_fails("%s: the header has the column %s twice: rename one", source, name);
    } else {
      at[k] = i;
    }
  }
  return good;
}

bool cli_csv_fail_missing(const char *source, const cli_csv_record *header, const char *missing,
                          const char *needs) {
  char *text = NULL;
  size_t bytes = 0, length;
  FILE *found = open_memstream(&text, &bytes);
  for (size_t i = 0; found != NULL && i < header->cell_count; i++) {
    fprintf(found, "%s%s", i > 0 ? ", " : "", cli_csv_cell_text(header, i, &length));
  }
  if (found != NULL) {
    fclose(found);
  }
  cli_fail("%s: the column %s is missing; the header has %s; it needs %s", source, missing,
           text != NULL ? text : "others", needs);
  free(text);
  return false;
}

/* ---- records --------------------------------------------------------------------------------- */

enum state { CELL_START, IN_CELL, IN_QUOTES, QUOTE_IN_QUOTES, IN_COMMENT };

/* Returns the state after a byte. The byte does not end a line outside of quotes. */
static enum state next_state(enum state state, int byte, char separator) {
  if (state == IN_QUOTES || state == IN_COMMENT) {
    return state == IN_QUOTES && byte == '"' ? QUOTE_IN_QUOTES : state;
  }
  if (is_separator(byte, separator) || (state == CELL_START && is_blank(byte, separator))) {
    return CELL_START;
  }
  return byte == '"' && state != IN_CELL ? IN_QUOTES : IN_CELL;
}

/* Takes the next byte. Returns whether it ends a line. Once a carriage return has ended one, it
 * does so at once: a program may wait for a reply before it continues. */
static bool take_byte(cli_csv_reader *reader, cli_csv_record *record, bool quoted) {
  const unsigned char byte = reader->input[reader->begin++];
  keep_bytes(record, &byte, 1);
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

/* Returns whether a line is the one that Excel reads and writes above the header: sep=; */
static bool names_separator(const cli_csv_record *record) {
  return record->length - record->ending_bytes - record->begin == strlen("sep=;") &&
         strncmp(record->bytes + record->begin, "sep=", 4) == 0;
}

/* Reads a record or a comment, and makes no cells. */
static enum cli_csv_kind read_line(cli_csv_reader *reader, cli_csv_record *record) {
  record->length = record->ending_bytes = record->cell_count = 0;
  record->line = reader->lines + 1;
  int byte = peek(reader);
  const bool marked = record->line == 1 && reader->end - reader->begin >= strlen(UTF8_MARK) &&
                      memcmp(reader->input + reader->begin, UTF8_MARK, strlen(UTF8_MARK)) == 0;
  if (marked) {
    keep_bytes(record, UTF8_MARK, strlen(UTF8_MARK));
    reader->begin += strlen(UTF8_MARK);
    byte = peek(reader);
  }
  record->begin = record->length;
  const bool comment = byte == '#' && reader->header_cells == 0;
  enum state state = comment ? IN_COMMENT : CELL_START;
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
  keep_bytes(record, "", 1); /* room for the zero byte of the last text */
  const char *end = record->bytes + --record->length;
  record->ending_bytes = (size_t)ends + (record->length > 1 && end[-1] == '\n' && end[-2] == '\r');
  return comment || is_empty(record) || (record->line == 1 && names_separator(record))
             ? CLI_CSV_COMMENT
             : CLI_CSV_RECORD;
}

/* Splits the header. Returns its separator; 0 if it could be comma or semicolon. */
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
  const char separator = split_header(header);
  if (memchr(header->bytes, '\0', header->length) != NULL) {
    return fail_at(reader, header->line,
                   "the header has zero bytes, as UTF-16 has: save the file as UTF-8, or convert "
                   "it by iconv -f UTF-16 -t UTF-8");
  }
  if (separator == 0) {
    return fail_at(reader, header->line,
                   "the header has commas and semicolons: separate its columns by one of them");
  }
  if (header->cell_count == 1 && strchr(header->texts + header->cells[0].begin, ' ') != NULL) {
    return fail_at(reader, header->line,
                   "the header is one cell: separate its columns by commas, semicolons or tabs");
  }
  reader->separator = separator;
  reader->header_cells = header->cell_count;
  return CLI_CSV_RECORD;
}

/* Returns whether a comment above the first record is the header: it has as many cells, and only
 * the record has numbers among them. Then splits both. */
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
  if (comment->begin > begin && names > 1 && names == comment->cell_count &&
      names == first->cell_count && numbers > 0 && first->separator != 0 && !comment->malformed) {
    return true;
  }
  comment->begin = begin;
  comment->cell_count = 0;
  return false;
}

/* Splits a line after the header into cells. Returns what kind of line it is. */
static enum cli_csv_kind take_line(const cli_csv_reader *reader, cli_csv_record *record) {
  split(record, reader->separator);
  const bool is_comment = record->bytes[record->begin] == '#' && record->cell_count == 1;
  return is_comment && reader->header_cells > 1 ? CLI_CSV_COMMENT : CLI_CSV_RECORD;
}

/* Reads the comments before the first record, and that record, and finds the header among them. */
static void read_ahead(cli_csv_reader *reader) {
  struct cli_csv_held *last;
  do {
    reader->held = cli_resize(reader->held, reader->held_count + 1, sizeof *reader->held);
    last = &reader->held[reader->held_count++];
    last->record = (cli_csv_record){0};
    last->kind = read_line(reader, &last->record);
  } while (last->kind == CLI_CSV_COMMENT);
  if (last->kind != CLI_CSV_RECORD) {
    return;
  }
  for (struct cli_csv_held *one = last; one-- > reader->held;) {
    if (is_header(&one->record, &last->record)) {
      one->kind = take_header(reader, &one->record);
      while (++one < last) {
        one->kind = is_empty(&one->record) ? one->kind : take_line(reader, &one->record);
      }
      return;
    }
  }
  last->kind = take_header(reader, &last->record);
}

/* Frees what was read ahead. */
static void free_held(cli_csv_reader *reader) {
  while (reader->held_next < reader->held_count) {
    cli_csv_record_free(&reader->held[reader->held_next++].record);
  }
  cli_free(reader->held);
  reader->held = NULL;
  reader->held_count = reader->held_next = 0;
}

enum cli_csv_kind cli_csv_read(cli_csv_reader *reader, cli_csv_record *record) {
  if (reader->header_cells == 0 && reader->held_count == 0) {
    read_ahead(reader);
  }
  if (reader->held_next < reader->held_count) {
    cli_csv_record_free(record);
    const struct cli_csv_held *next = &reader->held[reader->held_next++];
    *record = next->record;
    const enum cli_csv_kind kind = next->kind;
    if (reader->held_next == reader->held_count) {
      free_held(reader);
    }
    return kind;
  }
  const enum cli_csv_kind kind = read_line(reader, record);
  return kind == CLI_CSV_RECORD ? take_line(reader, record) : kind;
}

void cli_csv_record_free(cli_csv_record *record) {
  cli_free(record->bytes);
  cli_free(record->texts);
  cli_free(record->cells);
  *record = (cli_csv_record){0};
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

/* ---- sheets ---------------------------------------------------------------------------------- */

static bool fail_line(const cli_sheet *sheet, uint64_t line, const char *what) {
  return cli_fails("%s: line %llu: %s", sheet->source, (unsigned long long)line, what);
}

/* Reads a number: NAN if the cell is empty or absent. Says so and returns false if it is none. */
static bool take_number(const cli_sheet *sheet, const cli_csv_record *record, const char *name,
                        size_t at, double *number) {
  size_t length;
  char what[256];
  *number = (double)NAN;
  if (at >= record->cell_count) {
    return true;
  }
  const char *text = cli_csv_cell_text(record, at, &length);
  snprintf(what, sizeof what, "%s: '%.40s' is no number%s", name, text, cli_csv_number_hint(text));
  return length == 0 || cli_csv_number(record, at, number) || fail_line(sheet, record->line, what);
}

static void make_room(cli_sheet *sheet) {
  if (sheet->count == sheet->capacity) {
    const size_t rows = sheet->capacity = 2 * sheet->capacity + 256;
    sheet->numbers = cli_resize(sheet->numbers, rows, (sheet->columns + 1) * sizeof(double));
    sheet->lines = cli_resize(sheet->lines, rows, sizeof *sheet->lines);
    sheet->labels = cli_resize(sheet->labels, rows, sizeof *sheet->labels);
  }
}

/* Says what is wrong with a row; NULL if nothing is. Empty cells beyond the header's do no harm. */
static const char *fault_of(const cli_csv_record *row, size_t header_cells) {
  size_t i = header_cells;
  while (i < row->cell_count && row->cells[i].text_length == 0) {
    i++;
  }
  return row->malformed        ? "text stands after a closing quote"
         : i < row->cell_count ? "more cells than in the header: numbers have a decimal point"
                               : NULL;
}

/* Adds a row to the sheet. names: [columns + 1]; the last one is the column of labels, or NULL. */
static bool take_row(cli_sheet *sheet, const cli_csv_record *record, const char *const *names,
                     size_t header_cells) {
  const char *fault = fault_of(record, header_cells);
  const size_t label = sheet->at[sheet->columns];
  size_t length;
  if (fault != NULL) {
    return fail_line(sheet, record->line, fault);
  }
  make_room(sheet);
  for (size_t i = 0; i < sheet->columns; i++) {
    if (!take_number(sheet, record, names[i], sheet->at[i],
                     &sheet->numbers[sheet->count * sheet->columns + i])) {
      return false;
    }
  }
  const char *text = label < record->cell_count ? cli_csv_cell_text(record, label, &length) : "1";
  sheet->labels[sheet->count] = names[sheet->columns] != NULL ? cli_copy(text, strlen(text)) : NULL;
  sheet->lines[sheet->count++] = record->line;
  return true;
}

int cli_sheet_open(const char *path, const char **source) {
  const bool standard = path == NULL || strcmp(path, "-") == 0;
  *source = standard ? "standard input" : path;
  const int fd = standard ? STDIN_FILENO : open(path, O_RDONLY | O_CLOEXEC);
  if (fd < 0) {
    cli_fail("%s: %s", path, strerror(errno));
  }
  return fd;
}

bool cli_sheet_read(const char *path, const char *label, const char *const *names, size_t columns,
                    bool (*check)(const cli_sheet *sheet, const cli_csv_record *header),
                    cli_sheet *sheet) {
  const char **all = cli_allocate(columns + 1, sizeof *all);
  cli_csv_reader *reader = cli_allocate(1, sizeof *reader);
  cli_csv_record record = {0};
  size_t header_cells = 0;
  enum cli_csv_kind kind = CLI_CSV_COMMENT;
  *sheet = (cli_sheet){.columns = columns, .at = cli_allocate(columns + 1, sizeof *sheet->at)};
  memcpy(all, names, columns * sizeof *all);
  all[columns] = label;
  sheet->at[columns] = CLI_CSV_ABSENT;
  reader->fd = cli_sheet_open(path, &sheet->source);
  bool good = reader->fd >= 0;
  while (good && (kind == CLI_CSV_RECORD || kind == CLI_CSV_COMMENT)) {
    kind = cli_csv_read(reader, &record);
    if (kind == CLI_CSV_RECORD && header_cells > 0) {
      good = take_row(sheet, &record, all, header_cells);
    } else if (kind == CLI_CSV_RECORD) {
      header_cells = record.cell_count;
      good = cli_csv_find(sheet->source, &record, all, columns + (label != NULL ? 1 : 0), NULL,
                          sheet->at) &&
             check(sheet, &record);
    }
  }
  cli_csv_record_free(&record);
  free_held(reader);
  if (reader->fd > STDIN_FILENO) {
    close(reader->fd);
  }
  if (good && kind == CLI_CSV_FAILED) {
    cli_fail("%s: %s", sheet->source, reader->problem);
  } else if (good && header_cells == 0) {
    cli_fail("%s: it has no header, a line that names the columns", sheet->source);
  }
  return good && kind == CLI_CSV_END && header_cells > 0;
}
