/* dipole points: evaluates the rows of a CSV file. It reads a number of rows, requests them
 * together, and writes them in their order. */
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "clients/cli/csv.h"
#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"
#include "core/core.h"
#include "proto/decimal.h"

static const cli_option options[] = {
    CLI_TITLE("Evaluation"),
    CLI_OPTION(NAME, model, NULL,
               "the model of the rows whose cell is empty or absent (default: transport; with a "
               "tolerance, the cheapest that keeps it)"),
    CLI_OPTION(TEXT, evaluator, NULL,
               "f64 or f32: double or single precision; lut: single, by a table (default: f64; for "
               "transport lut where many rows share g and eta, else f32)"),
    CLI_OPTION(
        NUMBERS, r, NULL,
        "for files without a column r: each row is written once for each of these radii, mm"),
    CLI_OPTION(NUMBERS, f, NULL,
               "in place of radii: these spatial frequencies, 1/mm, for R_f, whose column is f in "
               "place of r"),
    CLI_OPTION(
        NAMES, wanted, NULL,
        "the quantities to write; `dipole info` lists all (default: R,albedo,cdf; if --tolerance "
        "replaces --model: R,albedo, for which more tolerances can be kept)"),
    CLI_OPTION(ONE, thickness, NULL,
               "of slabs, mm, for rows whose cell is empty or absent (default: a half space)"),
    CLI_OPTION(SWITCH, errors, NULL,
               "write numerical_error and model_error, too: how far the values may be from the "
               "model's formula, and the model from radiative transport (empty: not known, "
               "as for derivatives and paths). Rows "
               "that are evaluated together have the largest error of all"),
    {0},
};

/* ---- what is known --------------------------------------------------------------------------- */

/* The input columns; those with names as cells come first, then the members of dipole_medium. */
enum {
  MODEL,
  MOMENTS,
  MEDIUM,
  CHANNEL,
  LAYERS,
  FIRST_NUMBER,
  THICKNESS = FIRST_NUMBER + 4,
  RADIUS,
  INPUTS
};

static const char *const inputs[INPUTS] = {"model",  "moments",   "medium",  "channel",
                                           "layers", "sigma_a",   "sigma_s", "g",
                                           "eta",    "thickness", "r"};

enum { NAMES_MAX = INPUTS + CLI_PARAMETERS_MAX + CLI_QUANTITIES_MAX + 3 };

/* The columns that are read or written, and their positions in the header. */
typedef struct columns {
  size_t count; /* number of cells in the header */
  size_t name_count;
  /* names of all: inputs, parameters, quantities, errors and the status */
  const char *names[NAMES_MAX];
  size_t at[NAMES_MAX];      /* positions in the header, or CLI_CSV_ABSENT */
  size_t parameter_count;    /* number of parameters among the names, from INPUTS on */
  size_t output_count;       /* the radius of --r, the quantities, errors and the status */
  size_t outputs[NAMES_MAX]; /* indices of the outputs in `names` */
  /* position in the header of the first column that is replaced; `count` if none is */
  size_t first_output;
} columns;

enum row_state {
  ROW_COPIED,  /* written as it was read, without evaluation */
  ROW_READ,    /* its cells are read */
  ROW_GROUPED, /* its cells are read, and a request may unite it with others */
  ROW_WAITING, /* waits for the reply to query `id` */
  ROW_GOOD,
  ROW_BAD,
};

typedef struct points_row {
  cli_csv_record record;
  enum row_state state;
  unsigned model, evaluator, moments;
  dipole_medium medium;
  dipole_medium read[CORE_LAYERS_MAX]; /* layers of its cell */
  const dipole_medium *layers; /* [layer_count] in place of `medium`; NULL: the row has none */
  uint32_t layer_count;
  double r_mm; /* of its cell */
  cli_parameters parameters;
  uint64_t id;
  double *values; /* [radii][quantities]; valid if the row is good */
  dipole_errors errors;
  char status[sizeof((dipole_error *)0)->text]; /* the error's text if the row is bad */
} points_row;

/* Rows that are requested and written together; fewer if their texts reach this many bytes. */
enum { ROWS = 8192 };
#define ROWS_BYTES ((size_t)4 << 20)

/* Ids of models are below this; the values of a group, unless one row has more. */
enum { MODELS = 256, GROUP_VALUES = 65536 };

/* Media that share a model, g and eta. A surface for all of them takes the daemon as long as
 * profiles of the first SURFACE_MEDIA, which are requested one by one. So neither a file of few
 * media nor one of many takes more than twice the time of the better way, and a row's values depend
 * on nothing but the rows above it. */
enum { SURFACE_MEDIA = 256, FAMILIES = 512 };

typedef struct family {
  uint64_t hash; /* hash of what the media share; 0: the family is empty */
  size_t count;
  uint64_t media[SURFACE_MEDIA]; /* hashes of the first media */
} family;

typedef struct points_run {
  const cli_settings *settings;
  const char *source; /* name of the input, for messages */
  dipole_client *client;
  cli_profile profile; /* values for cells that are empty or absent */
  cli_quantities quantities;
  unsigned transport, tolerance; /* ids of the model `transport` and the parameter `tolerance` */
  bool by_f;                /* whether R_f alone is wanted: radii are then frequencies in 1/mm */
  const cli_numbers *radii; /* the radii of --r or --f; NULL: each row has its own */
  size_t radius_count;      /* number of radii of each row: those of --r, or 1 */
  const float *r_f32;       /* [radius_count] radii in single precision; NULL without --r */
  dipole_measured_medium *media;
  size_t medium_count;
  cli_csv_reader reader;
  columns columns;
  cli_progress progress;
  uint64_t input_bytes; /* size of the input; 0 if it is unknown */
  uint64_t rows_written, rows_bad;
  /* rows with a result so far, and bytes of these rows and of comments */
  uint64_t rows_done, bytes_done;
  int64_t reply_ms; /* time of the last reply */
  bool failed;
  size_t count, oldest; /* rows that have been read, and the first of them that may wait */
  size_t row_bytes;
  bool refused[MODELS]; /* [id of a model]: whether its media cannot vary */
  double *arrays[3];    /* [ROWS] of sigma_a, sigma_s and radii of a group */
  points_row *group[ROWS];
  family families[FAMILIES]; /* indexed by hash; a new family may replace an old one */
  points_row rows[ROWS];
} points_run;

static bool has_radii(const points_run *points) {
  return points->radii->count > 0;
}

/* Says what is wrong with the input or the connection, and ends the work. Returns false. */
static bool fail(points_run *points, const char *what) {
  cli_progress_wipe(&points->progress);
  cli_fail("%s: %s", points->source, what);
  points->failed = true;
  return false;
}

/* Counts a row that has been evaluated, refused or copied. */
static void count_done(points_run *points, const points_row *row) {
  const double input_bytes = (double)points->input_bytes; /* size of the input; 0: unknown */
  points->rows_done += row->state != ROW_COPIED;
  points->bytes_done += row->record.length;
  cli_progress_show(&points->progress,
                    input_bytes > 0 ? (double)points->bytes_done / input_bytes : (double)NAN,
                    (double)points->rows_done);
}

/* ---- the header ------------------------------------------------------------------------------ */

static void add_names(const dipole_info *info, enum dipole_kind kind, columns *of) {
  const dipole_choice *choice;
  for (size_t from = 0;
       of->name_count < NAMES_MAX - 3 && (choice = cli_next_choice(info, kind, &from)) != NULL;) {
    of->names[of->name_count++] = choice->name;
  }
}

/* Adds a column that is written. */
static void add_output(columns *of, const char *name) {
  size_t i = 0;
  while (strcmp(of->names[i], name) != 0) {
    i++;
  }
  of->outputs[of->output_count++] = i;
}

static void list_columns(const points_run *points, columns *of) {
  *of = (columns){.name_count = INPUTS};
  memcpy(of->names, inputs, sizeof inputs);
  of->names[RADIUS] = points->by_f ? "f" : "r";
  add_names(points->profile.info, DIPOLE_PARAMETER, of);
  of->parameter_count = of->name_count - INPUTS;
  add_names(points->profile.info, DIPOLE_QUANTITY, of);
  of->names[of->name_count++] = "numerical_error";
  of->names[of->name_count++] = "status";
  if (has_radii(points)) {
    add_output(of, of->names[RADIUS]);
  }
  for (size_t i = 0; i < points->quantities.count; i++) {
    add_output(of, points->quantities.items[i]->name);
  }
  if (points->settings->errors) {
    add_output(of, "numerical_error");
    add_output(of, "model_error"); /* a quantity */
  }
  add_output(of, "status");
}

static bool is_required(const points_run *points, size_t input) {
  return input == RADIUS ? !has_radii(points)
                         : input >= FIRST_NUMBER && input != THICKNESS &&
                               points->columns.at[MEDIUM] == CLI_CSV_ABSENT &&
                               points->columns.at[LAYERS] == CLI_CSV_ABSENT;
}

/* Finds the columns. Says so and returns false if one is missing, misspelt or there twice. */
static bool find_columns(points_run *points, const cli_csv_record *header) {
  columns *of = &points->columns;
  list_columns(points, of);
  of->count = of->first_output = header->cell_count;
  if (!cli_csv_find(points->source, header, of->names, of->name_count, options, of->at)) {
    return false;
  }
  if (has_radii(points) && of->at[RADIUS] != CLI_CSV_ABSENT) {
    return cli_fails("%s: the header has the column %s: leave --%s out, or rename the column",
                     points->source, of->names[RADIUS], of->names[RADIUS]);
  }
  for (size_t i = 0; i < of->output_count; i++) {
    const size_t at = of->at[of->outputs[i]];
    of->first_output = at < of->first_output ? at : of->first_output;
  }
  for (size_t i = 0; i < INPUTS; i++) {
    if (is_required(points, i) && of->at[i] == CLI_CSV_ABSENT) {
      return cli_csv_fail_missing(points->source, header, of->names[i],
                                  "sigma_a, sigma_s, g and eta, or medium and channel, or layers; "
                                  "and r unless --r is given; and may "
                                  "have model, moments and parameters");
    }
  }
  return true;
}

/* ---- writing --------------------------------------------------------------------------------- */

/* Writes the end of the line as it was read, or \n if the last line of a file lacks one. */
static void write_ending(const cli_csv_record *record) {
  if (record->ending_bytes == 0) {
    putc_unlocked('\n', stdout);
  } else {
    fwrite_unlocked(record->bytes + record->length - record->ending_bytes, 1, record->ending_bytes,
                    stdout);
  }
}

/* Writes the header and appends the output columns that it lacks. */
static void write_header(const columns *of, const cli_csv_record *header) {
  fwrite(header->bytes, 1, header->length - header->ending_bytes, stdout);
  for (size_t i = 0; i < of->output_count; i++) {
    if (of->at[of->outputs[i]] == CLI_CSV_ABSENT) {
      printf("%c%s", header->separator, of->names[of->outputs[i]]);
    }
  }
  write_ending(header);
}

static void write_number(double value) {
  char text[DECIMAL_BYTES];
  decimal_write(value, text);
  fputs_unlocked(isnan(value) ? "" : text, stdout);
}

/* Writes a cell of the row's line for radius number `radius`. */
static void write_output(const points_run *points, const points_row *row, size_t radius,
                         size_t output) {
  const bool good = row->state == ROW_GOOD;
  const size_t first = has_radii(points) ? 1 : 0, count = points->quantities.count;
  const double r_mm = has_radii(points) ? points->radii->items[radius] : row->r_mm;
  if (output == first + count + (points->settings->errors ? 2 : 0)) {
    cli_csv_write_cell(good ? "ok" : row->status, stdout);
  } else if (good && output >= first + count) {
    write_number(output == first + count ? cli_numerical_error(&row->errors, r_mm)
                                         : row->errors.model_error);
  } else if (good) {
    write_number(output < first ? r_mm : row->values[radius * count + output - first]);
  }
}

/* Writes the line of a row, which is good or bad, for radius number `radius`. */
static void write_line(const points_run *points, const points_row *row, size_t radius) {
  const columns *of = &points->columns;
  const cli_csv_record *record = &row->record;
  /* The cells up to the first that is replaced are written as they were read. */
  const size_t as_read =
      of->first_output < record->cell_count ? of->first_output : record->cell_count;
  if (as_read > 0) {
    fwrite_unlocked(record->bytes, 1, record->cells[as_read - 1].end, stdout);
  }
  for (size_t i = as_read; i < of->count; i++) {
    size_t output = 0;
    while (output < of->output_count && of->at[of->outputs[output]] != i) {
      output++;
    }
    if (i > 0) {
      putc_unlocked(record->separator, stdout);
    }
    if (output < of->output_count) {
      write_output(points, row, radius, output);
    } else if (i < record->cell_count) {
      cli_csv_copy_cell(record, i, stdout);
    }
  }
  for (size_t output = 0; output < of->output_count; output++) {
    if (of->at[of->outputs[output]] == CLI_CSV_ABSENT) {
      putc_unlocked(record->separator, stdout);
      write_output(points, row, radius, output);
    }
  }
  /* cells beyond those of the header are kept */
  for (size_t i = of->count; i < record->cell_count; i++) {
    putc_unlocked(record->separator, stdout);
    cli_csv_copy_cell(record, i, stdout);
  }
  write_ending(record);
}

static void write_row(points_run *points, points_row *row) {
  if (row->state == ROW_COPIED) {
    fwrite(row->record.bytes, 1, row->record.length, stdout);
  } else {
    const size_t lines = row->state == ROW_GOOD ? points->radius_count : 1;
    for (size_t i = 0; i < lines; i++) {
      write_line(points, row, i);
    }
    points->rows_written++;
    points->rows_bad += row->state == ROW_BAD;
  }
  cli_csv_record_free(&row->record);
}

/* ---- reading rows ---------------------------------------------------------------------------- */

/* The status of a row shows at most this many bytes of a wrong cell. */
enum { SHOWN_BYTES = 40 };

__attribute__((format(printf, 2, 3))) static bool make_bad(points_row *row, const char *format,
                                                           ...) {
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(row->status, sizeof row->status, format, arguments);
  va_end(arguments);
  row->state = ROW_BAD;
  return false;
}

/* Returns the text of a cell; NULL if it is empty or absent. */
static const char *text_of(const points_run *points, const points_row *row, size_t name) {
  size_t length = 0;
  const size_t at = points->columns.at[name];
  const char *text = at == CLI_CSV_ABSENT ? NULL : cli_csv_cell_text(&row->record, at, &length);
  return length == 0 ? NULL : text;
}

/* Reads the id of a model or a kind of moments, unless its cell is empty. */
static bool read_id(const points_run *points, points_row *row, size_t input, enum dipole_kind kind,
                    unsigned *id) {
  char known[160];
  const char *name = text_of(points, row, input);
  const dipole_choice *choice = name != NULL ? cli_choice(points->profile.info, kind, name) : NULL;
  if (choice != NULL) {
    *id = choice->id;
  } else if (name != NULL) {
    cli_list_names(points->profile.info, kind, known, sizeof known);
    make_bad(row, "%s: '%.*s' is unknown: allowed: %s", inputs[input], SHOWN_BYTES, name, known);
  }
  return choice != NULL || name == NULL;
}

/* Returns the row's parameter `tolerance`; NaN if it has none. */
static double tolerance_of(const points_run *points, const points_row *row) {
  for (size_t i = 0; i < row->parameters.count; i++) {
    if (row->parameters.items[i].id == points->tolerance) {
      return row->parameters.items[i].value;
    }
  }
  return (double)NAN;
}

/* Chooses the model and the evaluator. The parameters are known already. */
static bool read_model(const points_run *points, points_row *row) {
  const cli_profile *profile = &points->profile;
  const double tolerance = tolerance_of(points, row);
  row->moments = profile->moments->id;
  row->model = profile->model != NULL ? profile->model->id
               : isnan(tolerance)     ? points->transport
                                      : DIPOLE_ANY_MODEL;
  if (!read_id(points, row, MODEL, DIPOLE_MODEL, &row->model)) {
    return false;
  }
  const bool by_table = (row->model == points->transport || row->model == DIPOLE_ANY_MODEL) &&
                        !(tolerance < CORE_LUT_TOLERANCE_MIN);
  row->evaluator = profile->evaluator != NULL ? profile->evaluator->id
                   : by_table                 ? DIPOLE_LUT
                                              : DIPOLE_F64;
  return true;
}

/* Reads a cell with a number into the row. */
static bool read_number(const points_run *points, points_row *row, size_t input) {
  size_t length;
  const size_t at = points->columns.at[input];
  const bool given = at != CLI_CSV_ABSENT;
  const char *text = given ? cli_csv_cell_text(&row->record, at, &length) : "";
  double *to = input == RADIUS ? &row->r_mm : (double *)&row->medium + (input - FIRST_NUMBER);
  return (given && cli_csv_number(&row->record, at, to)) ||
         make_bad(row,
                  "%s: '%.*s' is no number: allowed: decimal numbers within the range of doubles%s",
                  inputs[input], SHOWN_BYTES, text, cli_csv_number_hint(text));
}

/* Finds the coefficients of a channel of a measured medium. */
static bool take_measured(const points_run *points, const char *name, const char *channel,
                          points_row *row) {
  size_t i = 0;
  const size_t colour = cli_colour(channel);
  while (i < points->medium_count && strcmp(points->media[i].name, name) != 0) {
    i++;
  }
  if (i == points->medium_count) {
    return make_bad(row,
                    "medium: '%.*s' is unknown: allowed: those of `dipole media`, or any text with "
                    "sigma_a and sigma_s",
                    SHOWN_BYTES, name);
  }
  if (colour == CLI_COLOURS) {
    return make_bad(row, "channel: '%.*s': allowed: red, green, blue", SHOWN_BYTES,
                    channel != NULL ? channel : "");
  }
  row->layer_count = points->media[i].layer_count;
  row->medium = points->media[i].channel[colour * row->layer_count];
  row->layers = row->layer_count > 1 ? &points->media[i].channel[colour * row->layer_count] : NULL;
  return true;
}

/* Reads layers with blanks between them. */
static bool read_layers(points_row *row, const char *text) {
  char *copy = cli_copy(text, strlen(text)), *one;
  bool good = true;
  row->layers = row->read;
  for (char *rest = copy; good && (one = strsep(&rest, " ")) != NULL;) {
    good =
        row->layer_count < CORE_LAYERS_MAX && cli_layer_read(one, &row->read[row->layer_count++]);
  }
  cli_free(copy);
  return good || make_bad(row,
                          "layers: '%.*s': allowed: 1 to 8 of SIGMA_A,SIGMA_S,G,ETA[,THICKNESS] "
                          "with blanks between them",
                          SHOWN_BYTES, text);
}

/* Reads the medium and the radius. The coefficients are those in the cells or, without sigma_a and
 * sigma_s, the layers in their cell, or those of a measured medium, which other cells override. */
static bool read_medium(const points_run *points, points_row *row) {
  const char *name = text_of(points, row, MEDIUM);
  const char *layers = text_of(points, row, LAYERS);
  const bool measured = (name != NULL || layers != NULL) &&
                        text_of(points, row, FIRST_NUMBER) == NULL &&
                        text_of(points, row, FIRST_NUMBER + 1) == NULL;
  bool good = !measured ||
              (layers != NULL ? read_layers(row, layers)
                              : take_measured(points, name, text_of(points, row, CHANNEL), row));
  row->medium.thickness_mm = cli_numbers_pick(&points->settings->thickness, 0, 0);
  for (size_t i = FIRST_NUMBER; good && i < INPUTS; i++) {
    if (row->layers != NULL && i < RADIUS && text_of(points, row, i) != NULL) {
      return make_bad(row, "%s: its layers have theirs: leave the cell empty", inputs[i]);
    }
    const bool needed = i == RADIUS ? !has_radii(points) : i != THICKNESS && !measured;
    good = (!needed && text_of(points, row, i) == NULL) || read_number(points, row, i);
  }
  return good;
}

/* Sets the parameters of the row: first the usual ones, then those in its cells. */
static bool read_parameters(const points_run *points, points_row *row) {
  const dipole_info *info = points->profile.info;
  row->parameters = points->profile.parameters;
  for (size_t i = INPUTS; i < INPUTS + points->columns.parameter_count; i++) {
    const char *text = text_of(points, row, i);
    double value;
    if (text == NULL) {
      continue;
    }
    const dipole_choice *parameter = cli_choice(info, DIPOLE_PARAMETER, points->columns.names[i]);
    if (strlen(text) != row->record.cells[points->columns.at[i]].text_length ||
        decimal_starts_with_zero(text) || !cli_parameter_parse(info, parameter, text, &value)) {
      return make_bad(row, "%s: '%.*s' is no value: allowed: %s", parameter->name, SHOWN_BYTES,
                      text, parameter->about);
    }
    cli_parameters_set(&row->parameters, parameter->id, value);
  }
  return true;
}

/* Reads the row's cells. Returns false if the row is bad; its status then says why. */
static bool read_row(const points_run *points, points_row *row) {
  if (row->record.malformed) {
    return make_bad(
        row,
        "the row: text after a closing quote: allowed: quotes around whole cells, doubled within");
  }
  if (row->record.cell_count != points->columns.count) {
    return make_bad(row, "the row: %zu cells: allowed: %zu, as many as in the header",
                    row->record.cell_count, points->columns.count);
  }
  return read_parameters(points, row) && read_model(points, row) &&
         read_id(points, row, MOMENTS, DIPOLE_MOMENTS, &row->moments) && read_medium(points, row);
}

/* ---- rows that are requested by themselves --------------------------------------------------- */

static unsigned wanted_of(const points_run *points) {
  return points->quantities.wanted | (points->settings->errors ? (unsigned)DIPOLE_MODEL_ERROR : 0);
}

static double *make_good(const points_run *points, points_row *row) {
  row->state = ROW_GOOD;
  if (row->values == NULL) {
    row->values =
        cli_allocate(points->radius_count * points->quantities.count, sizeof *row->values);
  }
  return row->values;
}

/* Sends the row's query; the row then waits for the reply. For a row of transport, f32 replaces
 * lut if --evaluator is not given: a table for one row would cost 6 ms. f32 evaluates stored
 * solutions, too, so the tolerance, which would be the table's, is left out. */
static bool submit_row(const points_run *points, points_row *row, dipole_error *error) {
  const float r_f32_mm = (float)row->r_mm;
  const void *f64 = has_radii(points) ? points->radii->items : &row->r_mm;
  const void *f32 = has_radii(points) ? points->r_f32 : &r_f32_mm;
  cli_parameters parameters = row->parameters;
  unsigned evaluator = row->evaluator;
  if (row->model == points->transport && evaluator == DIPOLE_LUT &&
      points->profile.evaluator == NULL && row->layers == NULL) {
    evaluator = DIPOLE_F32;
    cli_parameters_remove(&parameters, points->tolerance);
  }
  const dipole_query query = {.model = row->model,
                              .evaluator = evaluator,
                              .moments = row->moments,
                              .wanted = wanted_of(points),
                              .media = row->layers != NULL ? row->layers : &row->medium,
                              .layer_count = row->layers != NULL ? row->layer_count : 1,
                              .medium_count = 1,
                              .spacing = DIPOLE_LIST,
                              .radii = evaluator == DIPOLE_F64 ? f64 : f32,
                              .radius_count = points->radius_count,
                              .parameters = parameters.items,
                              .parameter_count = parameters.count};
  row->state = ROW_WAITING;
  return dipole_submit(points->client, &query, &row->id, error);
}

/* Takes the reply; the row is then good. */
static void take_reply(const points_run *points, points_row *row, const dipole_result *result) {
  const size_t count = points->quantities.count;
  double *values = make_good(points, row);
  const dipole_channel *channel = &result->channels[0];
  row->errors = (dipole_errors){channel->numerical_error, channel->numerical_error_per_mm,
                                channel->model_error};
  for (size_t q = 0; q < count; q++) {
    for (size_t i = 0; i < points->radius_count; i++) {
      values[i * count + q] = cli_value(result, 0, points->quantities.items[q]->id, i);
    }
  }
}

/* Waits for the reply to the first row that has none. Repeats the request to a busy daemon, and marks
 * the row as bad if a refusal names a field. Any other error ends the work. */
static bool collect(points_run *points) {
  dipole_error error;
  dipole_result *result;
  while (points->rows[points->oldest].state != ROW_WAITING) {
    points->oldest++;
  }
  points_row *row = &points->rows[points->oldest];
  while (!dipole_collect_id(points->client, row->id, &result, &error)) {
    const bool refused = error.kind == DIPOLE_ERROR_REFUSED;
    if (refused && error.retry_after_ms == 0 && error.field[0] != '\0') {
      make_bad(row, "%s", error.text);
      count_done(points, row);
      return true;
    }
    if (!refused || !cli_try_again(points->settings, points->reply_ms, &error) ||
        !submit_row(points, row, &error)) {
      return fail(points, error.text);
    }
  }
  points->reply_ms = cli_now_ms();
  take_reply(points, row, result);
  count_done(points, row);
  dipole_result_free(result);
  return true;
}

/* Requests the row by itself. Takes replies first if as many queries are outstanding as may be. */
static bool submit(points_run *points, points_row *row) {
  dipole_error error;
  while (dipole_outstanding(points->client) >= DIPOLE_IN_FLIGHT_MAX) {
    if (!collect(points)) {
      return false;
    }
  }
  return submit_row(points, row, &error) || fail(points, error.text);
}

/* ---- rows that share a model, g and eta ------------------------------------------------------ */

/* The quantities that such rows can be requested together. */
#define GROUP_QUANTITIES (DIPOLE_R | DIPOLE_ALBEDO | DIPOLE_CDF | DIPOLE_PDF | DIPOLE_RING)

/* The error of a table if none is given, as that of the evaluator lut. */
#define TABLE_TOLERANCE 1e-4

static uint64_t hash_more(uint64_t hash, const void *bytes, size_t count) {
  for (size_t i = 0; i < count; i++) { /* hash function FNV-1a (Fowler, Noll, Vo 1991) */
    hash = (hash ^ ((const unsigned char *)bytes)[i]) * UINT64_C(0x100000001b3);
  }
  return hash;
}

/* Returns whether the row's medium is none of the first of its family. */
static bool is_worth_a_surface(points_run *points, const points_row *row) {
  uint64_t hash = hash_more(UINT64_C(0xcbf29ce484222325), &row->moments, sizeof row->moments);
  hash = hash_more(hash, &row->medium.g, 2 * sizeof(double));
  for (size_t i = 0; i < row->parameters.count; i++) {
    hash = hash_more(hash, &row->parameters.items[i].id, sizeof(unsigned));
    hash = hash_more(hash, &row->parameters.items[i].value, sizeof(double));
  }
  family *of = &points->families[(hash ^ hash >> 32) % FAMILIES];
  if (of->hash != hash) {
    *of = (family){.hash = hash};
  }
  const uint64_t medium = hash_more(hash, &row->medium, 2 * sizeof(double));
  size_t i = 0;
  while (i < of->count && of->media[i] != medium) {
    i++;
  }
  if (i == of->count && i < SURFACE_MEDIA) {
    of->media[of->count++] = medium;
  }
  return i == SURFACE_MEDIA;
}

/* Returns whether the row may be requested in a group. Transport needs a surface for it, whose
 * values are those of a table. */
static bool is_for_group(points_run *points, const points_row *row) {
  return (points->quantities.wanted & ~(unsigned)GROUP_QUANTITIES) == 0 && row->model < MODELS &&
         row->layers == NULL && !(row->medium.thickness_mm > 0) &&
         (row->model != points->transport ||
          (row->evaluator == DIPOLE_LUT && is_worth_a_surface(points, row)));
}

/* Compares rows by what the rows of a group have in common. */
static int compare(const points_row *a, const points_row *b) {
  const unsigned left[] = {a->model, a->evaluator, a->moments, (unsigned)a->parameters.count};
  const unsigned right[] = {b->model, b->evaluator, b->moments, (unsigned)b->parameters.count};
  int order = memcmp(left, right, sizeof left);
  order = order != 0 ? order : memcmp(&a->medium.g, &b->medium.g, 2 * sizeof(double));
  for (size_t i = 0; order == 0 && i < a->parameters.count; i++) {
    const dipole_parameter *x = &a->parameters.items[i], *y = &b->parameters.items[i];
    order =
        x->id != y->id ? (x->id < y->id ? -1 : 1) : memcmp(&x->value, &y->value, sizeof x->value);
  }
  return order;
}

_Static_assert(offsetof(dipole_medium, eta) == offsetof(dipole_medium, g) + sizeof(double),
               "g and eta are compared together");

/* Orders the rows of a group as they were read, so that its values do not depend on the sorting. */
static int compare_places(const void *a, const void *b) {
  const points_row *left = *(points_row *const *)a, *right = *(points_row *const *)b;
  const int order = compare(left, right);
  return order != 0 ? order : (left > right) - (left < right);
}

/* Requests the values of `count` rows that share what compare() compares. Evaluators in single
 * precision get radii in single precision, and their values are those of double precision, rounded:
 * coefficients in single precision would put them off by more. */
static bool request_group(points_run *points, points_row *const *rows, size_t count,
                          dipole_varying_result **result, dipole_error *error) {
  const size_t radii = points->radius_count;
  const bool single = rows[0]->evaluator != DIPOLE_F64;
  for (size_t i = 0; i < count * radii; i++) {
    const points_row *row = rows[i / radii];
    const double r_mm = has_radii(points) ? points->radii->items[i % radii] : row->r_mm;
    points->arrays[0][i] = row->medium.sigma_a_per_mm;
    points->arrays[1][i] = row->medium.sigma_s_per_mm;
    points->arrays[2][i] = single ? (double)(float)r_mm : r_mm;
  }
  cli_parameters parameters = rows[0]->parameters;
  if (rows[0]->model == points->transport && isnan(tolerance_of(points, rows[0]))) {
    cli_parameters_set(&parameters, points->tolerance, TABLE_TOLERANCE);
  }
  const dipole_varying_query query = {.model = rows[0]->model,
                                      .evaluator = DIPOLE_F64,
                                      .moments = rows[0]->moments,
                                      .wanted = wanted_of(points),
                                      .g = rows[0]->medium.g,
                                      .eta = rows[0]->medium.eta,
                                      .sigma_a_per_mm = points->arrays[0],
                                      .sigma_s_per_mm = points->arrays[1],
                                      .radii = points->arrays[2],
                                      .value_count = count * radii,
                                      .parameters = parameters.items,
                                      .parameter_count = parameters.count};
  return CLI_RETRY(points->settings, error, dipole_varying(points->client, &query, result, error));
}

/* Numbers are rounded to single precision, and then to the fewest digits that are read as the same
 * number of single precision. Each is off by at most 2^-24. */
#define SINGLE_ERROR 0x1p-23

/* Takes the values of row `index` of a group. Returns false if one of them was not computed. */
static bool take_values(const points_run *points, points_row *row, size_t index,
                        const dipole_varying_result *result) {
  const size_t radii = points->radius_count, count = points->quantities.count;
  const bool single = row->evaluator != DIPOLE_F64;
  for (size_t i = 0; i < radii; i++) {
    if (result->statuses[index * radii + i] != DIPOLE_VALUE_OK) {
      return false;
    }
  }
  double *values = make_good(points, row);
  row->errors = (dipole_errors){result->numerical_error + (single ? SINGLE_ERROR : 0), 0,
                                result->model_error};
  for (size_t q = 0; q < count; q++) {
    const unsigned id = points->quantities.items[q]->id;
    const double *from = dipole_varying_f64(result, id) + index * radii;
    for (size_t i = 0; i < radii; i++) {
      values[i * count + q] =
          single && id != DIPOLE_ALBEDO ? cli_number_of_single((float)from[i]) : from[i];
    }
  }
  return true;
}

/* Requests the rows of a group. A row that is not computed is then requested by itself, so that it
 * is known what is wrong with it. */
static bool request_rows(points_run *points, points_row *const *rows, size_t count) {
  dipole_error error;
  dipole_varying_result *result = NULL;
  if (!points->refused[rows[0]->model] && !request_group(points, rows, count, &result, &error)) {
    if (error.kind != DIPOLE_ERROR_REFUSED || error.retry_after_ms != 0) {
      return fail(points, error.text);
    }
    points->refused[rows[0]->model] |= strcmp(error.field, "model") == 0;
  }
  for (size_t i = 0; i < count; i++) {
    if (result != NULL && take_values(points, rows[i], i, result)) {
      count_done(points, rows[i]);
    } else {
      rows[i]->state = ROW_READ;
    }
  }
  dipole_varying_result_free(result);
  return true;
}

/* Requests the rows that may be requested together, group by group. */
static bool request_groups(points_run *points) {
  const size_t radii = points->radius_count;
  const size_t most = radii < GROUP_VALUES ? GROUP_VALUES / radii : 1;
  size_t count = 0;
  for (size_t i = 0; i < points->count; i++) {
    if (points->rows[i].state == ROW_GROUPED) {
      points->group[count++] = &points->rows[i];
    }
  }
  qsort(points->group, count, sizeof points->group[0], compare_places);
  for (size_t first = 0, end; first < count; first = end) {
    end = first + 1;
    while (end < count && end - first < most &&
           compare(points->group[first], points->group[end]) == 0) {
      end++;
    }
    if (!request_rows(points, points->group + first, end - first)) {
      return false;
    }
  }
  return true;
}

/* ---- the whole file -------------------------------------------------------------------------- */

/* Requests the rows that have been read, and writes them up to the first that has no reply. */
static bool write_all(points_run *points) {
  points->oldest = 0;
  bool good = request_groups(points);
  for (size_t i = 0; good && i < points->count; i++) {
    good = points->rows[i].state != ROW_READ || submit(points, &points->rows[i]);
  }
  while (good && dipole_outstanding(points->client) > 0) {
    good = collect(points);
  }
  for (size_t i = 0; i < points->count && (good || points->rows[i].state > ROW_WAITING ||
                                           points->rows[i].state == ROW_COPIED);
       i++) {
    write_row(points, &points->rows[i]);
  }
  points->count = points->row_bytes = 0;
  points->failed = points->failed || ferror(stdout); /* main() reports the error */
  return !points->failed;
}

/* Is called when the next read would wait. Evaluates all rows that have come, so that a program that
 * writes row by row gets each result before it writes the next row. */
static void write_before_wait(void *context) {
  points_run *points = context;
  if (!points->failed && write_all(points)) {
    fflush(stdout);
  }
}

/* Returns whether a record or a comment was read. Else the input ends, or the work has failed. */
static bool read_record(points_run *points, cli_csv_record *record, enum cli_csv_kind *kind) {
  *kind = cli_csv_read(&points->reader, record);
  if (*kind == CLI_CSV_FAILED && !points->failed && write_all(points)) { /* the rows before */
    return fail(points, points->reader.problem);
  }
  return !points->failed && (*kind == CLI_CSV_RECORD || *kind == CLI_CSV_COMMENT);
}

static bool read_header(points_run *points) {
  cli_csv_record header = {0};
  enum cli_csv_kind kind;
  bool good = true;
  while ((good = read_record(points, &header, &kind)) && kind == CLI_CSV_COMMENT) {
    fwrite(header.bytes, 1, header.length, stdout);
  }
  if (!good && !points->failed) {
    fail(points, "there is no header line; it names the columns: sigma_a, sigma_s, g, eta, r, if "
                 "need be model, moments, medium, channel and parameters");
  }
  good = good && find_columns(points, &header);
  if (good) {
    write_header(&points->columns, &header);
  }
  cli_csv_record_free(&header);
  return good;
}

static bool read_rows(points_run *points) {
  enum cli_csv_kind kind;
  cli_csv_record record = {0};
  while (read_record(points, &record, &kind)) {
    /* read_record() may have written all rows, which resets the count */
    points_row *row = &points->rows[points->count++];
    const cli_csv_record before = row->record;
    row->record = record;
    record = before;
    points->row_bytes += row->record.length;
    row->state = kind == CLI_CSV_COMMENT ? ROW_COPIED : ROW_READ;
    if (kind == CLI_CSV_COMMENT || !read_row(points, row)) {
      count_done(points, row);
    } else if (is_for_group(points, row)) {
      row->state = ROW_GROUPED;
    }
    if ((points->count == ROWS || points->row_bytes > ROWS_BYTES) && !write_all(points)) {
      return false;
    }
  }
  cli_csv_record_free(&record);
  return !points->failed && write_all(points);
}

/* ---- the command ----------------------------------------------------------------------------- */

/* Opens the input and determines its size. */
static bool open_input(points_run *points, const char *operand) {
  struct stat about;
  points->reader.fd = cli_sheet_open(operand, &points->source);
  if (points->reader.fd < 0) {
    return false;
  }
  if (fstat(points->reader.fd, &about) == 0 && S_ISREG(about.st_mode)) {
    points->input_bytes = (uint64_t)about.st_size;
  }
  points->reader.before_wait = write_before_wait;
  points->reader.context = points;
  return true;
}

static int take_quantities(points_run *points) {
  const cli_settings *settings = points->settings;
  const bool any_model =
      settings->model.count == 0 && settings->parameters[CORE_PARAMETER_TOLERANCE].text != NULL;
  const unsigned wanted = settings->f.count > 0
                              ? DIPOLE_TRANSFER | DIPOLE_ALBEDO
                              : DIPOLE_R | DIPOLE_ALBEDO | (any_model ? 0 : DIPOLE_CDF);
  if (!cli_quantities_take(points->profile.info, &settings->wanted, wanted, 0,
                           &points->quantities)) {
    return CLI_USAGE;
  }
  if ((points->quantities.wanted & DIPOLE_RADIUS) != 0) {
    return cli_fail_usage("--wanted r: r is a column of the input, or of --r: leave it out");
  }
  if ((points->quantities.wanted & DIPOLE_BALANCE) != 0) {
    return cli_fail_usage("--wanted balance: rows have no room for its shares; use dipole eval");
  }
  points->by_f = core_is_at_frequencies(points->quantities.wanted);
  if ((settings->f.count > 0 || (points->quantities.wanted & CORE_AT_FREQUENCIES) != 0) &&
      (settings->r.count > 0 || !points->by_f)) {
    return cli_fail_usage("what ends with _f is at the spatial frequencies of --f or a column f: "
                          "request it alone, without --r");
  }
  points->radii = settings->f.count > 0 ? &settings->f : &settings->r;
  points->radius_count = has_radii(points) ? points->radii->count : 1;
  return CLI_OK;
}

/* Reads the options, and requests the measured media. Returns an exit status. */
static int prepare(points_run *points) {
  dipole_error error;
  if (!cli_profile_take_names(points->settings, points->client, &points->profile)) {
    return CLI_USAGE;
  }
  const int status = take_quantities(points);
  if (status != CLI_OK) {
    return status;
  }
  points->transport = cli_choice(points->profile.info, DIPOLE_MODEL, CLI_MODEL_DEFAULT)->id;
  points->tolerance = cli_choice(points->profile.info, DIPOLE_PARAMETER, "tolerance")->id;
  for (size_t i = 0; i < 3; i++) {
    const size_t values = points->radius_count + GROUP_VALUES;
    points->arrays[i] = cli_allocate(values, sizeof *points->arrays[i]);
  }
  points->r_f32 = cli_numbers_in(points->radii, true);
  return dipole_media(points->client, &points->media, &points->medium_count, &error)
             ? CLI_OK
             : cli_fail_error(&error);
}

static int evaluate_rows(points_run *points) {
  const int status = prepare(points);
  if (status != CLI_OK) {
    return status;
  }
  points->reply_ms = cli_now_ms();
  cli_progress_start(&points->progress, "rows");
  const bool good = read_header(points) && read_rows(points);
  cli_progress_wipe(&points->progress);
  if (good && points->rows_bad > 0) {
    return cli_say(CLI_BAD_ROWS, "%s: %llu of %llu rows were bad: see the column status",
                   points->source, (unsigned long long)points->rows_bad,
                   (unsigned long long)points->rows_written);
  }
  return good ? CLI_OK : CLI_FAILED;
}

static int run_points(const cli_settings *settings, dipole_client *client) {
  points_run *points = cli_allocate(1, sizeof *points);
  points->settings = settings;
  points->client = client;
  int status = CLI_FAILED;
  if (open_input(points, settings->operand)) {
    status = evaluate_rows(points);
    if (points->reader.fd != STDIN_FILENO) {
      close(points->reader.fd);
    }
  }
  free(points->media);
  return status;
}

const cli_command cli_command_points = {
    .name = "points",
    .operand = "[FILE]",
    .about = "Evaluate each row of a CSV file (or of standard input)",
    .more =
        "The header names the columns, in any order. These are needed: sigma_a, sigma_s (1/mm), "
        "g, eta and r (mm). In place of the coefficients, a row may name a measured medium in "
        "the columns medium and channel (red, green, blue), or have the column layers: those of "
        "--layer, with blanks between them. These may be absent or empty: "
        "model, moments (default: exact), and the parameters below, whose columns have _ where "
        "the options have -. An option is for the rows whose cell is empty. A column whose name "
        "is nearly one of these is an error; all others are copied.\n"
        "Each row is written as it is, with columns appended, or replaced if they exist: R "
        "(1/mm^2 per unit of power that entered; it may be inf), albedo, cdf (the share of the "
        "albedo within r) and status. status is ok or says what is wrong with the row; then the "
        "exit status is 3, but the other rows are evaluated. Comments are copied." CLI_CSV_TEXT
            CLI_DEFAULT_TEXT,
    .formats = "csv",
    .options = {options},
    .parameters = CLI_OF_MODELS,
    .examples = "  dipole points media.csv > profiles.csv\n"
                "  dipole media --format csv | dipole points --r 0.5,1,2 --model transport "
                "--tolerance 0.01\n"
                "  dipole points media.csv --wanted R --errors\n"
                "  dipole invert --albedo 0.4,0.2 --mean-free-path 1 --format csv |\n"
                "    dipole points --r 1 --model better\n"
                "  printf 'sigma_a,sigma_s,g,eta,r\\n0.01,1,0,1.4,2\\n' | dipole points\n",
    .run = run_points,
};
