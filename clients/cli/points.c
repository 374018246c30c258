/* dipole points: evaluates the rows of a CSV file. The rows that wait for their answers form a
 * window, so that many queries are under way while memory stays bounded and the order is kept. */
#include "clients/cli/points_row.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "clients/cli/daemon.h"
#include "clients/cli/progress.h"

/* A full window is written down to half before more is read, so that many queries leave at once. */
enum { WINDOW_ROWS = 512 };

/* How many bytes of text the rows of the window may hold together. */
#define WINDOW_BYTES ((size_t)4 << 20)

typedef struct points_run {
  const cli_profile_settings *settings;
  const char *source; /* name of the input, for messages */
  dipole_client *client;
  unsigned evaluator;
  cli_parameters parameters; /* of every row that has none in its cells */
  cli_csv_reader reader;
  points_columns columns;
  cli_progress progress;
  uint64_t input_bytes; /* size of the input; 0 if it is unknown */
  uint64_t rows_written, rows_bad;
  int64_t answer_ms; /* when the last answer came */
  bool failed;
  size_t first, count; /* the window: rows[(first + i) % WINDOW_ROWS] */
  size_t window_bytes;
  points_row rows[WINDOW_ROWS];
} points_run;

static points_row *row_at(points_run *points, size_t index) {
  return &points->rows[(points->first + index) % WINDOW_ROWS];
}

/* Says what is wrong with the input or the connection, and ends the work. Returns false. */
static bool fail(points_run *points, const char *format, ...) __attribute__((format(printf, 2, 3)));

static bool fail(points_run *points, const char *format, ...) {
  char text[512];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  cli_progress_wipe(&points->progress);
  cli_fail("%s: %s", points->source, text);
  points->failed = true;
  return false;
}

/* ---- answers ------------------------------------------------------------------------------- */

static points_row *find_row(points_run *points, uint64_t id) {
  for (size_t i = 0; i < points->count; i++) {
    points_row *row = row_at(points, i);
    if (row->state == POINTS_WAITING && row->id == id) {
      return row;
    }
  }
  return NULL;
}

static bool submit(points_run *points, points_row *row) {
  dipole_error error;
  return points_submit(points->client, points->evaluator, row, &error) ||
         fail(points, "%s", error.text);
}

/* Asks a busy daemon again. A refusal that names a field is the row's own fault; any other error
 * ends the work. */
static bool take_refusal(points_run *points, uint64_t id, const dipole_error *error) {
  points_row *row = error->kind == DIPOLE_ERROR_REFUSED ? find_row(points, id) : NULL;
  if (row == NULL || (error->retry_after_ms == 0 && error->field[0] == '\0')) {
    return fail(points, "%s", error->text);
  }
  if (error->retry_after_ms == 0) {
    row->state = POINTS_BAD;
    memcpy(row->status, error->text, sizeof row->status);
    return true;
  }
  return cli_try_again(&points->settings->common, points->answer_ms, error)
             ? submit(points, row)
             : fail(points, "%s", error->text);
}

_Static_assert(sizeof((points_row *)0)->status == sizeof((dipole_error *)0)->text, "status");

/* Waits for one answer. */
static bool collect(points_run *points) {
  dipole_error error;
  dipole_result *result;
  uint64_t id = 0;
  if (!dipole_collect(points->client, &id, &result, &error)) {
    return take_refusal(points, id, &error);
  }
  points->answer_ms = cli_now_ms();
  points_row *row = find_row(points, id);
  if (row != NULL) {
    points_take(row, result);
  }
  dipole_result_free(result);
  return row != NULL || fail(points, "an answer came to a query that was not sent");
}

/* ---- the window ---------------------------------------------------------------------------- */

static void write_first(points_run *points) {
  points_row *row = row_at(points, 0);
  if (row->state == POINTS_COPIED) {
    fwrite(row->record.bytes, 1, row->record.length, stdout);
  } else {
    points_write_row(&points->columns, row, stdout);
    points->rows_written++;
    points->rows_bad += row->state == POINTS_BAD;
  }
  points->window_bytes -= row->record.length;
  cli_csv_record_trim(&row->record);
  points->first = (points->first + 1) % WINDOW_ROWS;
  points->count--;
  const double input_bytes = (double)points->input_bytes; /* 0 if it is unknown */
  cli_progress_show(&points->progress,
                    input_bytes > 0 ? (double)points->reader.bytes_read / input_bytes : NAN,
                    (double)points->rows_written);
}

/* Waits for the oldest rows and writes them, until no more than `left` are in the window. */
static bool write_down(points_run *points, size_t left) {
  while (!points->failed && points->count > left) {
    if (row_at(points, 0)->state != POINTS_WAITING) {
      write_first(points);
    } else {
      collect(points);
    }
  }
  if (!points->failed && ferror(stdout)) {
    points->failed = true; /* main() will say why */
  }
  return !points->failed;
}

/* Nothing can be read yet: whoever writes row by row gets the answers to what has come so far. */
static void write_before_wait(void *context) {
  if (write_down(context, 0)) {
    fflush(stdout);
  }
}

/* ---- reading ------------------------------------------------------------------------------- */

/* Returns whether a record or a comment was read. If not, this is the end of the input, or the work
 * has failed. */
static bool read_record(points_run *points, cli_csv_record *record, enum cli_csv_kind *kind) {
  const char *what = "";
  *kind = cli_csv_read(&points->reader, record);
  switch (*kind) {
  case CLI_CSV_RECORD:
  case CLI_CSV_COMMENT:
    return !points->failed;
  case CLI_CSV_END:
    return false;
  case CLI_CSV_TOO_LONG:
    what = "the row is longer than 1 MiB";
    break;
  case CLI_CSV_UNCLOSED:
    what = "a quote is not closed";
    break;
  case CLI_CSV_FAILED:
    what = strerror(points->reader.read_errno);
    break;
  }
  if (points->failed || !write_down(points, 0)) { /* the rows before this one are still answered */
    return false;
  }
  return fail(points, "line %llu: %s", (unsigned long long)points->reader.lines + 1, what);
}

static bool read_header(points_run *points) {
  cli_csv_record header = {0};
  enum cli_csv_kind kind;
  bool good = true;
  while ((good = read_record(points, &header, &kind)) && kind == CLI_CSV_COMMENT) {
    fwrite(header.bytes, 1, header.length, stdout);
  }
  if (good) {
    good = points_find_columns(points->source, dipole_get_info(points->client), &header,
                               &points->columns);
    if (good) {
      points_write_header(&points->columns, &header, stdout);
    }
  } else if (!points->failed) {
    fail(points, "there is no header line; it names the columns: sigma_a, sigma_s, g, eta, r, if "
                 "need be model, moments and parameters");
  }
  cli_csv_record_free(&header);
  return good;
}

static bool read_rows(points_run *points) {
  const dipole_info *info = dipole_get_info(points->client);
  enum cli_csv_kind kind;
  for (;;) {
    if (points->count == WINDOW_ROWS || points->window_bytes > WINDOW_BYTES) {
      if (!write_down(points, points->count / 2)) {
        return false;
      }
    }
    /* Reading may write rows. That moves the start of the window, but not the place behind its end. */
    points_row *row = row_at(points, points->count);
    if (!read_record(points, &row->record, &kind)) {
      return !points->failed && write_down(points, 0);
    }
    points->count++;
    points->window_bytes += row->record.length;
    if (kind == CLI_CSV_COMMENT) {
      row->state = POINTS_COPIED;
    } else if (points_parse(&points->columns, info, &points->parameters, row) &&
               !submit(points, row)) {
      return false;
    }
  }
}

/* ---- the command --------------------------------------------------------------------------- */

/* Opens the input and learns its size. */
static bool open_input(points_run *points, const char *operand) {
  struct stat about;
  const bool standard = operand == NULL || strcmp(operand, "-") == 0;
  points->source = standard ? "standard input" : operand;
  points->reader.fd = standard ? STDIN_FILENO : open(operand, O_RDONLY | O_CLOEXEC);
  if (points->reader.fd < 0) {
    cli_fail("%s: %s", operand, strerror(errno));
    return false;
  }
  if (fstat(points->reader.fd, &about) == 0 && S_ISREG(about.st_mode)) {
    points->input_bytes = (uint64_t)about.st_size;
  }
  points->reader.before_wait = write_before_wait;
  points->reader.context = points;
  return true;
}

static int work(points_run *points) {
  const dipole_info *info = dipole_get_info(points->client);
  const dipole_choice *evaluator =
      cli_named(info, DIPOLE_EVALUATOR, "evaluator", points->settings->evaluator);
  if (evaluator == NULL || !cli_parameters_take(info, points->settings, &points->parameters)) {
    return CLI_USAGE;
  }
  points->evaluator = evaluator->id;
  points->answer_ms = cli_now_ms();
  cli_progress_start(&points->progress, "rows");
  const bool good = read_header(points) && read_rows(points);
  cli_progress_wipe(&points->progress);
  if (!good) {
    return CLI_FAILED;
  }
  if (points->rows_bad > 0) {
    cli_fail("%s: %llu of %llu rows were bad: see the column status", points->source,
             (unsigned long long)points->rows_bad, (unsigned long long)points->rows_written);
    return CLI_BAD_ROWS;
  }
  return CLI_OK;
}

static int run(void *settings, dipole_client *client) {
  points_run *points = cli_allocate(1, sizeof *points);
  points->settings = settings;
  points->client = client;
  int status = CLI_FAILED;
  if (open_input(points, points->settings->common.operand)) {
    status = work(points);
    if (points->reader.fd != STDIN_FILENO) {
      close(points->reader.fd);
    }
  }
  for (size_t i = 0; i < WINDOW_ROWS; i++) {
    cli_csv_record_free(&points->rows[i].record);
  }
  free(points);
  return status;
}

static const cli_option options[] = {
    {"Evaluation", NULL, NULL, CLI_HEADING, 0, NULL},
    {"evaluator", "NAME",
     "f64 or f32: double or single precision; lut: single, by a table, which is\n"
     "faster if many rows have the same medium (default: f64)",
     CLI_TEXT, offsetof(cli_profile_settings, evaluator), "f64"},
    {0},
};

const cli_command cli_command_points = {
    .name = "points",
    .operand = "[FILE]",
    .about = "Evaluate each row of a CSV file (or of standard input)",
    .more =
        "\n"
        "The header names the columns, in any order. These are needed: sigma_a, sigma_s (1/mm),\n"
        "g, eta and r (mm). These may be absent or empty: model (default: better), moments\n"
        "(default: exact), and the parameters below, whose columns have _ where the options have\n"
        "-. An option is for the rows whose cell is empty.\n"
        "\n"
        "Each row is written as it is, with four columns appended, or replaced if they exist: R\n"
        "(1/mm^2 per unit of power that entered; it may be inf), albedo, cdf (the share of the\n"
        "albedo within r) and status. status is ok or says what is wrong with the row; then the\n"
        "exit status is 3, but the other rows are evaluated. Lines that start with # are copied.\n",
    .formats = "csv",
    .options = options,
    .shared_options = cli_parameter_options,
    .examples = "  dipole points media.csv > profiles.csv\n"
                "  printf 'sigma_a,sigma_s,g,eta,r\\n0.01,1,0,1.4,2\\n' | dipole points\n",
    .settings_bytes = sizeof(cli_profile_settings),
    .run = run,
};
