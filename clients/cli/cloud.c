#include "clients/cli/cloud.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "clients/cli/cli.h"
#include "clients/cli/csv.h"
#include "clients/cli/number.h"

enum { AXES = 3, COLUMNS_MAX = AXES + CLI_CLOUD_CHANNELS_MAX, LINE_BYTES = 1024, FIELDS_MAX = 64 };

/* Which column, or property, holds each number: x, y, z, then the powers. */
typedef struct cloud_columns {
  size_t count;
  size_t at[COLUMNS_MAX];
  size_t cell_count; /* of the header */
} cloud_columns;

/* ---- columns --------------------------------------------------------------------------------- */

static bool find(const char *const *names, size_t count, const char *name, size_t *at) {
  for (size_t i = 0; i < count; i++) {
    if (strcmp(names[i], name) == 0) {
      *at = i;
      return true;
    }
  }
  return false;
}

/* Finds the columns among the names. Says which one is missing. */
static bool find_columns(const char *file, const char *const *names, size_t count, bool with_power,
                         cloud_columns *found) {
  found->cell_count = count;
  static const char *const axes[AXES] = {"x", "y", "z"};
  for (size_t i = 0; i < AXES; i++) {
    if (!find(names, count, axes[i], &found->at[i])) {
      cli_fail("%s: there is no column or property %s", file, axes[i]);
      return false;
    }
  }
  found->count = AXES;
  if (with_power && find(names, count, "power", &found->at[AXES])) {
    found->count++;
    return true;
  }
  for (size_t i = 1; with_power && i <= CLI_CLOUD_CHANNELS_MAX; i++) {
    char name[16];
    snprintf(name, sizeof name, "power_%zu", i);
    if (!find(names, count, name, &found->at[found->count])) {
      break;
    }
    found->count++;
  }
  if (with_power && found->count == AXES) {
    cli_fail("%s: there is no column or property power or power_1", file);
    return false;
  }
  return true;
}

/* Makes room for a point, and returns where it goes. */
static void add(cli_cloud *cloud, uint64_t *capacity, const double *numbers, uint64_t line) {
  if (cloud->count == *capacity) {
    *capacity = *capacity == 0 ? 4096 : 2 * *capacity;
    cloud->xyz_mm = cli_resize(cloud->xyz_mm, (size_t)*capacity, AXES * sizeof *cloud->xyz_mm);
    cloud->power_W = cli_resize(cloud->power_W, (size_t)*capacity,
                                (cloud->channels + 1) * sizeof *cloud->power_W);
    cloud->lines = cli_resize(cloud->lines, (size_t)*capacity, sizeof *cloud->lines);
  }
  memcpy(cloud->xyz_mm + cloud->count * AXES, numbers, AXES * sizeof *numbers);
  for (uint32_t i = 0; i < cloud->channels; i++) {
    cloud->power_W[cloud->count * cloud->channels + i] = (float)numbers[AXES + i];
  }
  cloud->lines[cloud->count++] = line;
}

/* ---- CSV ------------------------------------------------------------------------------------- */

static bool read_header(const cli_csv_record *record, bool with_power, cli_cloud *cloud,
                        cloud_columns *found) {
  const char **names = cli_allocate(record->cell_count, sizeof *names);
  for (size_t i = 0; i < record->cell_count; i++) {
    size_t length;
    names[i] = cli_csv_cell_text(record, i, &length);
  }
  const bool good = find_columns(cloud->file, names, record->cell_count, with_power, found);
  cloud->channels = good ? (uint32_t)(found->count - AXES) : 0;
  free(names);
  return good;
}

static bool read_row(cli_csv_record *record, const cloud_columns *columns, cli_cloud *cloud,
                     uint64_t *capacity) {
  double numbers[COLUMNS_MAX];
  const unsigned long long line = record->line;
  const char *fault = cli_csv_fault(record, columns->cell_count);
  if (fault != NULL) {
    cli_fail("%s:%llu: %s", cloud->file, line, fault);
    return false;
  }
  for (size_t i = 0; i < columns->count; i++) {
    size_t length = 0;
    const bool given = columns->at[i] < record->cell_count;
    if (!given || !cli_csv_number(record, columns->at[i], &numbers[i])) {
      const char *text = given ? cli_csv_cell_text(record, columns->at[i], &length) : "";
      cli_fail("%s:%llu: column %zu: '%.40s' is no number%s", cloud->file, line, columns->at[i] + 1,
               text, cli_csv_number_hint(text));
      return false;
    }
  }
  add(cloud, capacity, numbers, record->line);
  return true;
}

static bool read_records(cli_csv_reader *reader, cli_csv_record *record, bool with_power,
                         cli_cloud *cloud) {
  cloud_columns columns = {0};
  uint64_t capacity = 0;
  enum cli_csv_kind kind;
  while ((kind = cli_csv_read(reader, record)) == CLI_CSV_RECORD || kind == CLI_CSV_COMMENT) {
    if (kind == CLI_CSV_RECORD &&
        (columns.count == 0 ? !read_header(record, with_power, cloud, &columns)
                            : !read_row(record, &columns, cloud, &capacity))) {
      return false;
    }
  }
  if (kind == CLI_CSV_FAILED || columns.count == 0) {
    cli_fail("%s: %s", cloud->file, kind == CLI_CSV_FAILED ? reader->problem : "it has no header");
    return false;
  }
  return true;
}

static bool read_csv(int fd, bool with_power, cli_cloud *cloud) {
  cli_csv_reader *reader = cli_allocate(1, sizeof *reader);
  cli_csv_record record = {0};
  reader->fd = fd;
  const bool good = read_records(reader, &record, with_power, cloud);
  cli_csv_record_free(&record);
  cli_csv_reader_free(reader);
  free(reader);
  return good;
}

/* ---- PLY ------------------------------------------------------------------------------------- */

static const struct type {
  const char *name, *other_name;
  size_t bytes;
  enum { SIGNED, UNSIGNED, REAL } kind;
} types[] = {
    {"char", "int8", 1, SIGNED},   {"uchar", "uint8", 1, UNSIGNED},
    {"short", "int16", 2, SIGNED}, {"ushort", "uint16", 2, UNSIGNED},
    {"int", "int32", 4, SIGNED},   {"uint", "uint32", 4, UNSIGNED},
    {"float", "float32", 4, REAL}, {"double", "float64", 8, REAL},
};

typedef struct ply_reader {
  FILE *file;
  uint64_t line;
  uint64_t vertices;
  size_t property_count;
  char names[FIELDS_MAX][64];
  const struct type *types[FIELDS_MAX];
  size_t offsets[FIELDS_MAX];
  size_t vertex_bytes;
} ply_reader;

static bool fail_ply(const cli_cloud *cloud, const ply_reader *ply, const char *what) {
  cli_fail("%s:%llu: %s", cloud->file, (unsigned long long)ply->line, what);
  return false;
}

static bool read_line(ply_reader *ply, char line[LINE_BYTES]) {
  ply->line++;
  if (fgets(line, LINE_BYTES, ply->file) == NULL || strchr(line, '\n') == NULL) {
    return false;
  }
  line[strcspn(line, "\r\n")] = '\0';
  return true;
}

static bool add_property(const cli_cloud *cloud, ply_reader *ply, const char *type,
                         const char *name) {
  if (ply->property_count == FIELDS_MAX) {
    return fail_ply(cloud, ply, "vertices have more than 64 properties");
  }
  for (size_t i = 0; i < sizeof types / sizeof types[0]; i++) {
    if (strcmp(type, types[i].name) == 0 || strcmp(type, types[i].other_name) == 0) {
      const size_t at = ply->property_count++;
      snprintf(ply->names[at], sizeof ply->names[at], "%.63s", name);
      ply->types[at] = &types[i];
      ply->offsets[at] = ply->vertex_bytes;
      ply->vertex_bytes += types[i].bytes;
      return true;
    }
  }
  return fail_ply(cloud, ply, "a property of vertices is a list, or of an unknown type");
}

/* Reads the header, up to where the first vertex begins. */
static bool read_ply_header(const cli_cloud *cloud, ply_reader *ply) {
  char line[LINE_BYTES], first[LINE_BYTES], second[LINE_BYTES];
  enum { NO_ELEMENT, VERTEX, LATER } element = NO_ELEMENT;
  bool binary = false;
  if (!read_line(ply, line) || strcmp(line, "ply") != 0) {
    return fail_ply(cloud, ply, "this is no PLY file");
  }
  while (read_line(ply, line)) {
    if (strcmp(line, "end_header") == 0) {
      return !binary ? fail_ply(cloud, ply, "the format is not binary_little_endian")
             : element == NO_ELEMENT ? fail_ply(cloud, ply, "there is no element vertex")
                                     : true;
    }
    unsigned long long count;
    if (strcmp(line, "format binary_little_endian 1.0") == 0) {
      binary = true;
    } else if (sscanf(line, "element %1023s %llu", first, &count) == 2) {
      if (element == NO_ELEMENT && strcmp(first, "vertex") != 0) {
        return fail_ply(cloud, ply, "the first element is not vertex");
      }
      ply->vertices = element == NO_ELEMENT ? count : ply->vertices;
      element = element == NO_ELEMENT ? VERTEX : LATER;
    } else if (element == VERTEX && sscanf(line, "property %1023s %1023s", first, second) == 2 &&
               !add_property(cloud, ply, first, second)) {
      return false;
    }
  }
  return fail_ply(cloud, ply, "the header has no end_header");
}

static double property(const struct type *type, const uint8_t *at) {
  uint64_t bits = 0;
  memcpy(&bits, at, type->bytes);
  if (type->kind == REAL) {
    float single;
    double number;
    memcpy(&single, at, sizeof single);
    memcpy(&number, &bits, sizeof number);
    return type->bytes == sizeof single ? (double)single : number;
  }
  const unsigned unused = 64 - 8 * (unsigned)type->bytes;
  return type->kind == UNSIGNED ? (double)bits : (double)((int64_t)(bits << unused) >> unused);
}

static bool read_vertices(const ply_reader *ply, bool with_power, cli_cloud *cloud) {
  const char *names[FIELDS_MAX];
  cloud_columns columns = {0};
  uint8_t *vertex = cli_allocate(ply->vertex_bytes + sizeof(double), 1);
  uint64_t capacity = 0;
  for (size_t i = 0; i < ply->property_count; i++) {
    names[i] = ply->names[i];
  }
  bool good = find_columns(cloud->file, names, ply->property_count, with_power, &columns);
  cloud->channels = good ? (uint32_t)(columns.count - AXES) : 0;
  for (uint64_t v = 0; good && v < ply->vertices; v++) {
    double numbers[COLUMNS_MAX];
    good = fread(vertex, ply->vertex_bytes, 1, ply->file) == 1;
    if (!good) {
      cli_fail("%s: it ends within vertex %llu of %llu", cloud->file, (unsigned long long)v,
               (unsigned long long)ply->vertices);
      break;
    }
    for (size_t i = 0; i < columns.count; i++) {
      numbers[i] = property(ply->types[columns.at[i]], vertex + ply->offsets[columns.at[i]]);
    }
    add(cloud, &capacity, numbers, 0);
  }
  free(vertex);
  free(cloud->lines);
  cloud->lines = NULL;
  return good;
}

static bool read_ply(int fd, bool with_power, cli_cloud *cloud) {
  ply_reader *ply = cli_allocate(1, sizeof *ply);
  const int copy = dup(fd);
  ply->file = copy >= 0 ? fdopen(copy, "rb") : NULL;
  bool good = ply->file != NULL;
  if (!good) {
    cli_fail("%s: %s", cloud->file, strerror(errno));
  } else {
    good = read_ply_header(cloud, ply) && read_vertices(ply, with_power, cloud);
    fclose(ply->file);
  }
  free(ply);
  return good;
}

/* ---- public: reading ------------------------------------------------------------------------- */

bool cli_cloud_is_ply(const char *file) {
  const size_t length = strlen(file);
  return length > 4 && strcmp(file + length - 4, ".ply") == 0;
}

bool cli_cloud_read(const char *file, bool with_power, cli_cloud *cloud) {
  *cloud = (cli_cloud){.file = file};
  const bool standard = strcmp(file, "-") == 0;
  const int fd = standard ? STDIN_FILENO : open(file, O_RDONLY | O_CLOEXEC);
  if (fd < 0) {
    cli_fail("%s: %s", file, strerror(errno));
    return false;
  }
  const bool good =
      cli_cloud_is_ply(file) ? read_ply(fd, with_power, cloud) : read_csv(fd, with_power, cloud);
  if (!standard) {
    close(fd);
  }
  return good;
}

void cli_cloud_free(cli_cloud *cloud) {
  free(cloud->xyz_mm);
  free(cloud->power_W);
  free(cloud->lines);
}

void cli_cloud_place(const cli_cloud *cloud, uint64_t i, char *text, uint64_t bytes) {
  if (cloud->lines != NULL && i < cloud->count) {
    snprintf(text, bytes, "%s:%llu: ", cloud->file, (unsigned long long)cloud->lines[i]);
  } else {
    snprintf(text, bytes, "%s: vertex %llu: ", cloud->file, (unsigned long long)i);
  }
}

/* ---- writing --------------------------------------------------------------------------------- */

static void write_csv(FILE *file, const cli_cloud *at, uint32_t channels, const double *M) {
  char text[CLI_NUMBER_BYTES];
  fputs("x,y,z", file);
  for (uint32_t c = 0; c < channels; c++) {
    fprintf(file, ",M_%u", c + 1);
  }
  fputc('\n', file);
  for (uint64_t i = 0; i < at->count; i++) {
    for (size_t k = 0; k < AXES; k++) {
      fprintf(file, "%s%s", k > 0 ? "," : "", cli_number_format(at->xyz_mm[i * AXES + k], text));
    }
    for (uint32_t c = 0; c < channels; c++) {
      fprintf(file, ",%s", cli_number_format(M[i * channels + c], text));
    }
    fputc('\n', file);
  }
}

/* Returns a colour of sRGB (IEC 61966-2-1) for a share of light from 0 to 1. */
static uint8_t colour_of(double share) {
  const double clipped = share > 0 ? fmin(share, 1) : 0; /* also of NaN */
  const double srgb =
      clipped <= 0.0031308 ? 12.92 * clipped : 1.055 * pow(clipped, 1 / 2.4) - 0.055;
  return (uint8_t)lrint(255 * srgb);
}

static void write_ply(FILE *file, const cli_cloud *at, uint32_t channels, const double *M) {
  double most = 0;
  for (uint64_t i = 0; i < at->count * channels; i++) {
    most = isfinite(M[i]) ? fmax(most, M[i]) : most;
  }
  fprintf(file,
          "ply\nformat binary_little_endian 1.0\ncomment positions in mm, M in W/mm^2\n"
          "element vertex %llu\nproperty double x\nproperty double y\nproperty double z\n"
          "property uchar red\nproperty uchar green\nproperty uchar blue\n",
          (unsigned long long)at->count);
  for (uint32_t c = 0; c < channels; c++) {
    fprintf(file, "property double M_%u\n", c + 1);
  }
  fputs("end_header\n", file);
  for (uint64_t i = 0; i < at->count; i++) {
    uint8_t colours[3];
    for (uint32_t c = 0; c < 3; c++) {
      const uint32_t channel = c < channels ? c : channels - 1;
      colours[c] = most > 0 ? colour_of(M[i * channels + channel] / most) : 0;
    }
    fwrite(at->xyz_mm + i * AXES, sizeof(double), AXES, file);
    fwrite(colours, 1, sizeof colours, file);
    fwrite(M + i * channels, sizeof(double), channels, file);
  }
}

bool cli_cloud_write(const char *name, const cli_cloud *at, uint32_t channels, const double *M) {
  FILE *file = name != NULL ? fopen(name, "wb") : stdout;
  bool good = file != NULL;
  if (good) {
    if (name != NULL && cli_cloud_is_ply(name)) {
      write_ply(file, at, channels, M);
    } else {
      write_csv(file, at, channels, M);
    }
    good = ferror(file) == 0;
    good = (name != NULL ? fclose(file) : fflush(file)) == 0 && good;
  }
  if (!good) {
    cli_fail("%s: %s", name != NULL ? name : "standard output", strerror(errno));
  }
  return good;
}
