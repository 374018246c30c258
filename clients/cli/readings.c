#include "clients/cli/readings.h"

#include <math.h>
#include <search.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/sheet.h"

/* ---- names ----------------------------------------------------------------------------------- */

typedef struct named {
  const char *name;
  size_t number; /* from 0 on */
} named;

static int compare(const void *a, const void *b) {
  return strcmp(((const named *)a)->name, ((const named *)b)->name);
}

/* Returns the number of a name, of which `count` are in the tree already; `count` if it is new. */
static size_t number_of(void **tree, size_t count, const char *name) {
  named *one = cli_allocate(1, sizeof *one);
  *one = (named){name, count};
  named *const *found = tsearch(one, tree, compare);
  if (found == NULL) {
    fputs("dipole: out of memory\n", stderr);
    exit(CLI_FAILED);
  }
  return (*found)->number;
}

static void keep_named(void *one) {
  (void)one;
}

/* ---- columns --------------------------------------------------------------------------------- */

enum { RADIUS, FREQUENCY, VALUE, ERROR, G, ETA, APERTURE, SOURCE, DETECTOR, COLUMNS };

static const char *const names[COLUMNS] = {"r",   "f",           "R",         "error",      "g",
                                           "eta", "detector_na", "source_mm", "detector_mm"};

static bool check_header(const cli_sheet *sheet, const cli_csv_record *header) {
  size_t length;
  for (size_t i = 0; i < header->cell_count; i++) {
    const char *name = cli_csv_cell_text(header, i, &length);
    if (strcmp(name, "thickness") == 0 || strncmp(name, "phase", strlen("phase")) == 0) {
      cli_fail("%s: the column %s is of no medium that can be fitted: those are half spaces that "
               "scatter by Henyey-Greenstein's function",
               sheet->source, name);
      return false;
    }
  }
  const char *missing =
      (sheet->at[RADIUS] == CLI_CSV_ABSENT) == (sheet->at[FREQUENCY] == CLI_CSV_ABSENT)
          ? "r or f (one of both)"
      : sheet->at[VALUE] == CLI_CSV_ABSENT ? "R"
      : sheet->at[ERROR] == CLI_CSV_ABSENT ? "error"
                                           : NULL;
  return missing == NULL ||
         cli_csv_fail_missing(
             sheet->source, header, missing,
             "r (distances in mm) or f (spatial frequencies in 1/mm), R and error, "
             "and may have sample, g, eta, detector_na, source_mm and detector_mm");
}

/* ---- grouping -------------------------------------------------------------------------------- */

/* Sets what all lines of a sample must agree about. */
static bool set_of_sample(const cli_sheet *sheet, size_t row, size_t column, double *kept) {
  const double given = cli_sheet_number(sheet, row, column);
  const bool good = isnan(given) || !(*kept < given || *kept > given);
  if (!good) {
    cli_fail("%s: line %llu: %s differs from that of the sample's other lines", sheet->source,
             (unsigned long long)sheet->lines[row], names[column]);
  }
  *kept = isnan(given) ? *kept : given;
  return good;
}

/* Lists the samples, and counts their readings. numbers: [rows] those of the rows' samples */
static bool list_samples(const cli_sheet *sheet, cli_readings *readings, size_t *numbers) {
  void *tree = NULL;
  bool good = true;
  readings->samples = cli_allocate(sheet->count, sizeof *readings->samples);
  for (size_t row = 0; good && row < sheet->count; row++) {
    const size_t number = numbers[row] =
        number_of(&tree, readings->sample_count, sheet->labels[row]);
    cli_sample *sample = &readings->samples[number];
    if (number == readings->sample_count) {
      readings->sample_count++;
      *sample = (cli_sample){.name = sheet->labels[row],
                             .g = (double)NAN,
                             .eta = (double)NAN,
                             .detector_na = (double)NAN};
    }
    good = set_of_sample(sheet, row, G, &sample->g) &&
           set_of_sample(sheet, row, ETA, &sample->eta) &&
           set_of_sample(sheet, row, APERTURE, &sample->detector_na);
    sample->count++;
  }
  tdestroy(tree, keep_named);
  return good;
}

static double or_zero(double number) {
  return isnan(number) ? 0 : number;
}

/* Puts the readings into their arrays, sample by sample. */
static void arrange(const cli_sheet *sheet, const size_t *numbers, cli_readings *readings) {
  const size_t place = readings->frequency ? FREQUENCY : RADIUS, count = sheet->count;
  double **const arrays[] = {&readings->at, &readings->values, &readings->errors,
                             &readings->source_mm, &readings->detector_mm};
  readings->count = count;
  readings->lines = cli_allocate(count, sizeof *readings->lines);
  for (size_t i = 0; i < sizeof arrays / sizeof arrays[0]; i++) {
    *arrays[i] = cli_allocate(count, sizeof(double));
  }
  for (size_t i = 0, next = 0; i < readings->sample_count; i++) {
    readings->samples[i].first = next;
    next += readings->samples[i].count;
    readings->samples[i].count = 0;
  }
  for (size_t row = 0; row < count; row++) {
    cli_sample *sample = &readings->samples[numbers[row]];
    const size_t to = sample->first + sample->count++;
    readings->at[to] = cli_sheet_number(sheet, row, place);
    readings->values[to] = cli_sheet_number(sheet, row, VALUE);
    readings->errors[to] = cli_sheet_number(sheet, row, ERROR);
    readings->source_mm[to] = or_zero(cli_sheet_number(sheet, row, SOURCE));
    readings->detector_mm[to] = or_zero(cli_sheet_number(sheet, row, DETECTOR));
    readings->lines[to] = sheet->lines[row];
  }
}

int cli_readings_read(const char *path, cli_readings *readings) {
  cli_sheet sheet;
  *readings = (cli_readings){0};
  bool good = cli_sheet_read(path, "sample", names, COLUMNS, check_header, &sheet);
  readings->source = sheet.source;
  if (good && sheet.count == 0) {
    cli_fail("%s: there are no readings", sheet.source);
    good = false;
  }
  size_t *numbers = cli_allocate(sheet.count, sizeof *numbers);
  if (good && list_samples(&sheet, readings, numbers)) {
    readings->frequency = sheet.at[FREQUENCY] != CLI_CSV_ABSENT;
    arrange(&sheet, numbers, readings);
  } else {
    good = false;
  }
  return good ? CLI_OK : CLI_FAILED;
}
