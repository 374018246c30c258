#include "clients/cli/sheet.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static bool fail_line(const cli_sheet *sheet, uint64_t line, const char *what) {
  cli_fail("%s: line %llu: %s", sheet->source, (unsigned long long)line, what);
  return false;
}

/* Reads the number of a cell: NAN if it is empty or absent. */
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

/* names: [columns + 1], the last one of the labels or NULL */
static bool take_row(cli_sheet *sheet, const cli_csv_record *record, const char *const *names,
                     size_t header_cells) {
  const char *fault = cli_csv_fault(record, header_cells);
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
  cli_csv_reader_free(reader);
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
