#include "clients/cli/sheet.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

typedef struct reading {
  cli_sheet *sheet;
  const char *const *names; /* [columns + 1], the last one of the labels */
  bool has_labels;
  bool (*check)(const cli_sheet *sheet, const cli_csv_record *header);
  size_t header_cells; /* 0 before the header */
  size_t capacity;
  cli_csv_reader reader;
} reading;

static bool fail_line(const cli_sheet *sheet, uint64_t line, const char *what) {
  cli_fail("%s: line %llu: %s", sheet->source, (unsigned long long)line, what);
  return false;
}

static bool take_header(reading *of, const cli_csv_record *header) {
  of->header_cells = header->cell_count;
  return cli_csv_find(of->sheet->source, header, of->names,
                      of->sheet->columns + (of->has_labels ? 1 : 0), NULL, of->sheet->at) &&
         (of->check == NULL || of->check(of->sheet, header));
}

/* Reads the number of a cell: NAN if it is empty or absent. */
static bool take_number(const reading *of, const cli_csv_record *record, size_t column,
                        double *number) {
  const size_t at = of->sheet->at[column];
  size_t length;
  char what[256];
  *number = (double)NAN;
  if (at >= record->cell_count) {
    return true;
  }
  const char *text = cli_csv_cell_text(record, at, &length);
  if (length == 0 || cli_csv_number(record, at, number)) {
    return true;
  }
  snprintf(what, sizeof what, "%s: '%.40s' is no number%s", of->names[column], text,
           cli_csv_number_hint(text));
  return fail_line(of->sheet, record->line, what);
}

static void make_room(reading *of) {
  cli_sheet *sheet = of->sheet;
  if (sheet->count == of->capacity) {
    of->capacity = of->capacity > 0 ? 2 * of->capacity : 256;
    sheet->numbers =
        cli_resize(sheet->numbers, of->capacity, (sheet->columns + 1) * sizeof *sheet->numbers);
    sheet->lines = cli_resize(sheet->lines, of->capacity, sizeof *sheet->lines);
    sheet->labels = cli_resize(sheet->labels, of->capacity, sizeof *sheet->labels);
  }
}

static bool take_row(reading *of, const cli_csv_record *record) {
  cli_sheet *sheet = of->sheet;
  const size_t label = sheet->at[sheet->columns];
  size_t length;
  const char *fault = cli_csv_fault(record, of->header_cells);
  if (fault != NULL) {
    return fail_line(sheet, record->line, fault);
  }
  make_room(of);
  for (size_t i = 0; i < sheet->columns; i++) {
    if (!take_number(of, record, i, &sheet->numbers[sheet->count * sheet->columns + i])) {
      return false;
    }
  }
  sheet->labels[sheet->count] = NULL;
  if (of->has_labels) {
    const bool given = label < record->cell_count;
    const char *text = given ? cli_csv_cell_text(record, label, &length) : "1";
    sheet->labels[sheet->count] = cli_copy(text, strlen(text));
  }
  sheet->lines[sheet->count++] = record->line;
  return true;
}

static bool read_all(reading *of) {
  cli_csv_record record = {0};
  bool good = true;
  enum cli_csv_kind kind = CLI_CSV_COMMENT;
  while (good && (kind == CLI_CSV_RECORD || kind == CLI_CSV_COMMENT)) {
    kind = cli_csv_read(&of->reader, &record);
    good = kind != CLI_CSV_RECORD ||
           (of->header_cells > 0 ? take_row(of, &record) : take_header(of, &record));
  }
  cli_csv_record_free(&record);
  cli_csv_reader_free(&of->reader);
  if (good && kind == CLI_CSV_FAILED) {
    cli_fail("%s: %s", of->sheet->source, of->reader.problem);
  } else if (good && of->header_cells == 0) {
    cli_fail("%s: it has no header, a line that names the columns", of->sheet->source);
  }
  return good && kind == CLI_CSV_END && of->header_cells > 0;
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
  *sheet = (cli_sheet){.columns = columns, .at = cli_allocate(columns + 1, sizeof *sheet->at)};
  const int fd = cli_sheet_open(path, &sheet->source);
  if (fd < 0) {
    return false;
  }
  const char **all = cli_allocate(columns + 1, sizeof *all);
  memcpy(all, names, columns * sizeof *all);
  all[columns] = label;
  reading *of = cli_allocate(1, sizeof *of);
  *of = (reading){.sheet = sheet, .names = all, .has_labels = label != NULL, .check = check};
  of->reader.fd = fd;
  const bool good = read_all(of);
  if (fd != STDIN_FILENO) {
    close(fd);
  }
  return good;
}
