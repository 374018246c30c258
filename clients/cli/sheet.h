/* sheet: the numbers of a CSV file, by the names of their columns. */
#ifndef DIPOLE_CLI_SHEET_H
#define DIPOLE_CLI_SHEET_H

#include "clients/cli/csv.h"

typedef struct cli_sheet {
  const char *source; /* the file's name, for messages */
  size_t columns;
  size_t *at; /* [columns] positions in the header, or CLI_CSV_ABSENT */
  size_t count, capacity;
  double *numbers; /* [count][columns]; NAN where the cell is empty or absent */
  char **labels;   /* [count] texts of the column of labels; "1" if it is absent */
  uint64_t *lines; /* [count] of the file, from 1 on */
} cli_sheet;

/* Reads a file; NULL or "-" stands for standard input. names: of the columns; label: of one with
 * texts, or NULL. check() is called once, after the header, with at[] set; it says what is wrong and returns false to end the reading. Says what is wrong and returns false. */
bool cli_sheet_read(const char *path, const char *label, const char *const *names, size_t columns,
                    bool (*check)(const cli_sheet *sheet, const cli_csv_record *header),
                    cli_sheet *sheet);

/* Returns a number of a row. */
static inline double cli_sheet_number(const cli_sheet *sheet, size_t row, size_t column) {
  return sheet->numbers[row * sheet->columns + column];
}

/* Opens a file; NULL or "-" stands for standard input. *source: its name, for messages. Says what is
 * wrong and returns a negative number if it cannot. */
int cli_sheet_open(const char *path, const char **source);

#endif
