#include "clients/cli/readings.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "clients/cli/csv.h"
#include "core/core.h"

/* ---- finding equal things -------------------------------------------------------------------- */

/* Numbers things from 0 on: equal bytes have the same number. */
typedef struct numbering {
  size_t count;
  size_t slot_count; /* a power of two */
  struct slot {
    char *bytes; /* NULL: the slot is empty */
    size_t length;
    size_t number;
  } * slots;
} numbering;

static uint64_t hash_of(const char *bytes, size_t length) {
  uint64_t hash = UINT64_C(0xcbf29ce484222325); /* FNV-1a (Fowler, Noll, Vo 1991) */
  for (size_t i = 0; i < length; i++) {
    hash = (hash ^ (unsigned char)bytes[i]) * UINT64_C(0x100000001b3);
  }
  return hash ^ hash >> 32;
}

static struct slot *slot_of(const numbering *of, const char *bytes, size_t length) {
  size_t at = hash_of(bytes, length) & (of->slot_count - 1);
  while (of->slots[at].bytes != NULL &&
         (of->slots[at].length != length || memcmp(of->slots[at].bytes, bytes, length) != 0)) {
    at = (at + 1) & (of->slot_count - 1);
  }
  return &of->slots[at];
}

static void grow(numbering *of) {
  numbering larger = {.count = of->count,
                      .slot_count = of->slot_count > 0 ? 2 * of->slot_count : 64};
  larger.slots = cli_allocate(larger.slot_count, sizeof *larger.slots);
  for (size_t i = 0; i < of->slot_count; i++) {
    if (of->slots[i].bytes != NULL) {
      *slot_of(&larger, of->slots[i].bytes, of->slots[i].length) = of->slots[i];
    }
  }
  free(of->slots);
  *of = larger;
}

/* Returns the number of a thing; of->count - 1 if it is new. */
static size_t number_of(numbering *of, const char *bytes, size_t length) {
  if (2 * of->count >= of->slot_count) {
    grow(of);
  }
  struct slot *slot = slot_of(of, bytes, length);
  if (slot->bytes == NULL) {
    *slot = (struct slot){cli_allocate(length + 1, 1), length, of->count++};
    memcpy(slot->bytes, bytes, length);
  }
  return slot->number;
}

static void free_numbering(numbering *of) {
  for (size_t i = 0; i < of->slot_count; i++) {
    free(of->slots[i].bytes);
  }
  free(of->slots);
}

/* ---- columns --------------------------------------------------------------------------------- */

enum { SAMPLE, RADIUS, FREQUENCY, VALUE, ERROR, G, ETA, APERTURE, SOURCE, DETECTOR, COLUMNS };

static const char *const columns[COLUMNS] = {
    "sample", "r", "f", "R", "error", "g", "eta", "detector_na", "source_mm", "detector_mm"};

#define ABSENT SIZE_MAX

/* A line of the file. */
typedef struct row {
  size_t sample;
  double numbers[COLUMNS];
  uint64_t line;
} row;

typedef struct reading {
  const char *source;
  cli_csv_reader reader;
  size_t at[COLUMNS]; /* positions in the header */
  size_t column_count;
  numbering names;
  cli_readings *readings;
  size_t row_count, row_capacity;
  row *rows;
} reading;

__attribute__((format(printf, 3, 4))) static int fail_line(const reading *of, uint64_t line,
                                                           const char *format, ...) {
  char what[160];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(what, sizeof what, format, arguments);
  va_end(arguments);
  return cli_fail("%s: line %llu: %s", of->source, (unsigned long long)line, what);
}

/* Finds the nearest column to a name that is not known; NULL if none is near. */
static const char *nearest_to(const char *name) {
  const char *nearest = NULL;
  unsigned least = 3;
  for (size_t i = 0; i < COLUMNS; i++) {
    const unsigned apart = core_name_distance(name, columns[i]);
    if (apart < least && apart <= strlen(columns[i]) / 3) {
      least = apart;
      nearest = columns[i];
    }
  }
  return nearest;
}

static int take_column(reading *of, const char *name, size_t at) {
  for (size_t i = 0; i < COLUMNS; i++) {
    if (strcmp(name, columns[i]) == 0) {
      if (of->at[i] != ABSENT) {
        return cli_fail("%s: the header has the column %s twice: rename one", of->source, name);
      }
      of->at[i] = at;
      return CLI_OK;
    }
  }
  if (strcmp(name, "thickness") == 0 || strncmp(name, "phase", strlen("phase")) == 0) {
    return cli_fail("%s: the column %s is of no medium that can be fitted: those are half spaces "
                    "that scatter by Henyey-Greenstein's function",
                    of->source, name);
  }
  const char *nearest = nearest_to(name);
  return nearest == NULL
             ? CLI_OK
             : cli_fail("%s: the column %s is not read; the nearest that is read is %s: "
                        "rename it",
                        of->source, name, nearest);
}

static int take_header(reading *of, const cli_csv_record *header) {
  int status = CLI_OK;
  size_t length;
  of->column_count = header->cell_count;
  for (size_t i = 0; i < COLUMNS; i++) {
    of->at[i] = ABSENT;
  }
  for (size_t i = 0; status == CLI_OK && i < header->cell_count; i++) {
    status = take_column(of, cli_csv_cell_text(header, i, &length), i);
  }
  if (status != CLI_OK) {
    return status;
  }
  if ((of->at[RADIUS] == ABSENT) == (of->at[FREQUENCY] == ABSENT)) {
    return cli_fail("%s: the header needs either the column r (distances in mm) or the column f "
                    "(spatial frequencies in 1/mm)",
                    of->source);
  }
  for (size_t i = VALUE; i <= ERROR; i++) {
    if (of->at[i] == ABSENT) {
      return cli_fail("%s: the column %s is missing; the header needs r or f, R and error, and may "
                      "have sample, g, eta, detector_na, source_mm and detector_mm",
                      of->source, columns[i]);
    }
  }
  of->readings->frequency = of->at[FREQUENCY] != ABSENT;
  return CLI_OK;
}

/* ---- rows ------------------------------------------------------------------------------------ */

/* Reads the number of a cell: NAN if it is empty or absent. */
static int take_number(const reading *of, cli_csv_record *record, size_t column, double *number) {
  size_t length;
  *number = (double)NAN;
  if (of->at[column] >= record->cell_count) {
    return CLI_OK;
  }
  const char *text = cli_csv_cell_text(record, of->at[column], &length);
  if (length == 0 || cli_csv_number(record, of->at[column], number)) {
    return CLI_OK;
  }
  return fail_line(of, record->line, "%s: '%.40s' is no number%s", columns[column], text,
                   cli_csv_number_hint(text));
}

static size_t sample_of(reading *of, const cli_csv_record *record) {
  cli_readings *readings = of->readings;
  const bool named = of->at[SAMPLE] < record->cell_count;
  size_t length = 1;
  const char *name = named ? cli_csv_cell_text(record, of->at[SAMPLE], &length) : "1";
  const size_t number = number_of(&of->names, name, length);
  if (number == readings->sample_count) {
    if ((number & (number - 1)) == 0) {
      readings->samples =
          cli_resize(readings->samples, number > 0 ? 2 * number : 1, sizeof *readings->samples);
    }
    char *copy = cli_allocate(length + 1, 1);
    memcpy(copy, name, length);
    readings->samples[readings->sample_count++] = (cli_sample){
        .name = copy, .g = (double)NAN, .eta = (double)NAN, .detector_na = (double)NAN};
  }
  return number;
}

/* Sets what all lines of a sample must agree about. */
static int set_of_sample(const reading *of, const row *from, size_t column, double *kept) {
  const double given = from->numbers[column];
  if (isnan(given) || !(*kept < given || *kept > given)) {
    *kept = isnan(given) ? *kept : given;
    return CLI_OK;
  }
  return fail_line(of, from->line, "%s differs from that of the sample's other lines",
                   columns[column]);
}

static int take_row(reading *of, cli_csv_record *record) {
  row taken = {.line = record->line};
  const char *fault = cli_csv_fault(record, of->column_count);
  int status = fault != NULL ? fail_line(of, record->line, "%s", fault) : CLI_OK;
  for (size_t i = RADIUS; status == CLI_OK && i < COLUMNS; i++) {
    status = take_number(of, record, i, &taken.numbers[i]);
  }
  if (status != CLI_OK) {
    return status;
  }
  taken.sample = sample_of(of, record);
  cli_sample *sample = &of->readings->samples[taken.sample];
  status = set_of_sample(of, &taken, G, &sample->g);
  status = status == CLI_OK ? set_of_sample(of, &taken, ETA, &sample->eta) : status;
  status = status == CLI_OK ? set_of_sample(of, &taken, APERTURE, &sample->detector_na) : status;
  sample->count++;
  if (of->row_count == of->row_capacity) {
    of->row_capacity = of->row_capacity > 0 ? 2 * of->row_capacity : 256;
    of->rows = cli_resize(of->rows, of->row_capacity, sizeof *of->rows);
  }
  of->rows[of->row_count++] = taken;
  return status;
}

/* ---- grouping -------------------------------------------------------------------------------- */

/* Puts the readings into their arrays, sample by sample. */
static void arrange(const reading *of, cli_readings *readings) {
  const size_t place = readings->frequency ? FREQUENCY : RADIUS;
  const size_t count = of->row_count;
  size_t next = 0;
  readings->count = count;
  readings->at = cli_allocate(count, sizeof(double));
  readings->values = cli_allocate(count, sizeof(double));
  readings->errors = cli_allocate(count, sizeof(double));
  readings->source_mm = cli_allocate(count, sizeof(double));
  readings->detector_mm = cli_allocate(count, sizeof(double));
  readings->lines = cli_allocate(count, sizeof *readings->lines);
  for (size_t i = 0; i < readings->sample_count; i++) {
    readings->samples[i].first = next;
    next += readings->samples[i].count;
    readings->samples[i].count = 0;
  }
  for (size_t i = 0; i < count; i++) {
    const row *from = &of->rows[i];
    cli_sample *sample = &readings->samples[from->sample];
    const size_t to = sample->first + sample->count++;
    readings->at[to] = from->numbers[place];
    readings->values[to] = from->numbers[VALUE];
    readings->errors[to] = from->numbers[ERROR];
    readings->source_mm[to] = isnan(from->numbers[SOURCE]) ? 0 : from->numbers[SOURCE];
    readings->detector_mm[to] = isnan(from->numbers[DETECTOR]) ? 0 : from->numbers[DETECTOR];
    readings->lines[to] = from->line;
  }
}

/* Numbers the designs of samples: g, eta, the aperture, and where the readings were taken. */
static void number_designs(cli_readings *readings) {
  enum { OF_SAMPLE = 3 };
  numbering designs = {0};
  double *key = NULL;
  for (size_t i = 0; i < readings->sample_count; i++) {
    cli_sample *sample = &readings->samples[i];
    const size_t n = sample->count, bytes = n * sizeof *key;
    key = cli_resize(key, OF_SAMPLE + 3 * n, sizeof *key);
    key[0] = sample->g;
    key[1] = sample->eta;
    key[2] = sample->detector_na;
    double *places = key + OF_SAMPLE;
    memcpy(places, readings->at + sample->first, bytes);
    memcpy(places + n, readings->source_mm + sample->first, bytes);
    memcpy(places + 2 * n, readings->detector_mm + sample->first, bytes);
    sample->design = number_of(&designs, (const char *)key, (OF_SAMPLE + 3 * n) * sizeof *key);
  }
  readings->design_count = designs.count;
  free(key);
  free_numbering(&designs);
}

/* ---- the file -------------------------------------------------------------------------------- */

static bool is_standard(const char *path) {
  return path == NULL || strcmp(path, "-") == 0;
}

const char *cli_readings_source(const char *path) {
  return is_standard(path) ? "standard input" : path;
}

static int read_all(reading *of) {
  cli_csv_record record = {0};
  bool has_header = false;
  int status = CLI_OK;
  enum cli_csv_kind kind = CLI_CSV_COMMENT;
  while (status == CLI_OK && (kind == CLI_CSV_RECORD || kind == CLI_CSV_COMMENT)) {
    kind = cli_csv_read(&of->reader, &record);
    if (kind == CLI_CSV_RECORD) {
      status = has_header ? take_row(of, &record) : take_header(of, &record);
      has_header = true;
    }
  }
  cli_csv_record_free(&record);
  cli_csv_reader_free(&of->reader);
  if (status == CLI_OK && kind == CLI_CSV_FAILED) {
    return cli_fail("%s: %s", of->source, of->reader.problem);
  }
  return status != CLI_OK || of->row_count > 0
             ? status
             : cli_fail("%s: there are no readings; a header line names the columns: sample, r or "
                        "f, R and error",
                        of->source);
}

int cli_readings_read(const char *path, cli_readings *readings) {
  reading *of = cli_allocate(1, sizeof *of);
  *readings = (cli_readings){0};
  of->source = cli_readings_source(path);
  of->readings = readings;
  of->reader.fd = is_standard(path) ? STDIN_FILENO : open(path, O_RDONLY | O_CLOEXEC);
  int status = of->reader.fd < 0 ? cli_fail("%s: %s", path, strerror(errno)) : read_all(of);
  if (status == CLI_OK) {
    arrange(of, readings);
    number_designs(readings);
  }
  if (of->reader.fd > STDIN_FILENO) {
    close(of->reader.fd);
  }
  free_numbering(&of->names);
  free(of->rows);
  free(of);
  return status;
}

void cli_readings_free(cli_readings *readings) {
  for (size_t i = 0; i < readings->sample_count; i++) {
    free(readings->samples[i].name);
  }
  free(readings->samples);
  free(readings->at);
  free(readings->values);
  free(readings->errors);
  free(readings->source_mm);
  free(readings->detector_mm);
  free(readings->lines);
  *readings = (cli_readings){0};
}
