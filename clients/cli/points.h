/* points: the rows of `dipole points`: a header, and for each row a query and what came of it. */
#ifndef DIPOLE_CLI_POINTS_H
#define DIPOLE_CLI_POINTS_H

#include "clients/cli/cli.h"
#include "clients/cli/csv.h"
#include "clients/cli/parameters.h"

enum cli_points_input {
  CLI_POINTS_MODEL,
  CLI_POINTS_MOMENTS,
  CLI_POINTS_SIGMA_A,
  CLI_POINTS_SIGMA_S,
  CLI_POINTS_G,
  CLI_POINTS_ETA,
  CLI_POINTS_RADIUS,
  CLI_POINTS_INPUTS
};

enum cli_points_output {
  CLI_POINTS_R,
  CLI_POINTS_ALBEDO,
  CLI_POINTS_CDF,
  CLI_POINTS_STATUS,
  CLI_POINTS_OUTPUTS
};

/* Where the columns stand. A position of CLI_POINTS_ABSENT: nowhere. */
#define CLI_POINTS_ABSENT SIZE_MAX

typedef struct cli_points_columns {
  size_t count; /* cells of the header */
  size_t input_at[CLI_POINTS_INPUTS];
  size_t output_at[CLI_POINTS_OUTPUTS];
  size_t parameter_count; /* columns that have the name of a parameter of the daemon */
  const dipole_choice *parameters[CLI_PARAMETERS_MAX];
  size_t parameter_at[CLI_PARAMETERS_MAX];
} cli_points_columns;

enum cli_points_state {
  CLI_POINTS_COPIED,  /* written as it was read */
  CLI_POINTS_WAITING, /* for the answer to query id */
  CLI_POINTS_GOOD,
  CLI_POINTS_BAD,
};

enum { CLI_POINTS_STATUS_BYTES = 256 };

typedef struct cli_points_row {
  cli_csv_record record;
  enum cli_points_state state;
  unsigned model, moments;
  dipole_medium medium;
  double r_mm;
  cli_parameters parameters;
  uint64_t id;
  double R, albedo, cdf;
  char status[CLI_POINTS_STATUS_BYTES]; /* what is wrong with a bad row */
} cli_points_row;

/* ---- points_columns.c ---------------------------------------------------------------------- */

/* Finds the columns in the header; says what is wrong when they do not do. */
bool cli_points_find_columns(const cli_command *command, const char *source,
                             const dipole_info *info, const cli_csv_record *header,
                             cli_points_columns *columns);

/* Writes the header with the columns that are missing. */
void cli_points_write_header(const cli_points_columns *columns, const cli_csv_record *header,
                             FILE *file);

/* Writes a row that is good or bad. */
void cli_points_write_row(const cli_points_columns *columns, const cli_points_row *row, FILE *file);

const char *cli_points_input_name(enum cli_points_input input);

/* ---- points_row.c -------------------------------------------------------------------------- */

/* Reads the row's cells; usual: the parameters of a row that does not say otherwise. False: the row
 * is BAD, and its status says why. */
bool cli_points_parse(const cli_points_columns *columns, const dipole_info *info,
                      const cli_parameters *usual, cli_points_row *row);

/* Sends the row's query and makes it WAITING. */
bool cli_points_submit(dipole_client *client, unsigned evaluator, cli_points_row *row,
                       dipole_error *error);

/* Takes the answer: the row is then GOOD. */
void cli_points_take(cli_points_row *row, const dipole_result *result);

#endif
