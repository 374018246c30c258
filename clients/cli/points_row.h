/* points_row: a row of `dipole points`: its cells, a query, and what came of it. */
#ifndef DIPOLE_CLI_POINTS_ROW_H
#define DIPOLE_CLI_POINTS_ROW_H

#include "clients/cli/csv.h"
#include "clients/cli/profile.h"

enum { POINTS_INPUTS = 7, POINTS_OUTPUTS = 4 };

/* The position of a column that the header does not have. */
#define POINTS_ABSENT SIZE_MAX

/* Where the columns stand. */
typedef struct points_columns {
  size_t count; /* cells of the header */
  size_t input_at[POINTS_INPUTS];
  size_t output_at[POINTS_OUTPUTS];
  size_t parameter_count; /* columns that have the name of a parameter of the daemon */
  const dipole_choice *parameters[CLI_PARAMETERS_MAX];
  size_t parameter_at[CLI_PARAMETERS_MAX];
} points_columns;

enum points_state {
  POINTS_COPIED,  /* written as it was read */
  POINTS_WAITING, /* for the answer to query id */
  POINTS_GOOD,
  POINTS_BAD,
};

enum { POINTS_STATUS_BYTES = 256 };

typedef struct points_row {
  cli_csv_record record;
  enum points_state state;
  unsigned model, moments;
  dipole_medium medium;
  double r_mm;
  cli_parameters parameters;
  uint64_t id;
  double R, albedo, cdf;            /* of a good row */
  char status[POINTS_STATUS_BYTES]; /* what is wrong with a bad row */
} points_row;

/* Finds the columns in the header of `source`. Says what is wrong and returns false if one is
 * missing or stands there twice. */
bool points_find_columns(const char *source, const dipole_info *info, const cli_csv_record *header,
                         points_columns *columns);

/* Writes the header with the columns that are missing. */
void points_write_header(const points_columns *columns, const cli_csv_record *header, FILE *file);

/* Writes a row that is good or bad. */
void points_write_row(const points_columns *columns, const points_row *row, FILE *file);

/* Reads the row's cells. usual: the parameters of a row that has none in its cells. Returns false if
 * the row is bad; its status then says why. */
bool points_parse(const points_columns *columns, const dipole_info *info,
                  const cli_parameters *usual, points_row *row);

/* Sends the row's query; the row then waits for the answer. */
bool points_submit(dipole_client *client, unsigned evaluator, points_row *row, dipole_error *error);

/* Takes the answer; the row is then good. */
void points_take(points_row *row, const dipole_result *result);

#endif
