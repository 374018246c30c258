/* points_row: a row of `dipole points`: which columns it has, what its cells ask for, and how it is
 * written. */
#ifndef DIPOLE_CLI_POINTS_ROW_H
#define DIPOLE_CLI_POINTS_ROW_H

#include "clients/cli/csv.h"
#include "clients/cli/profile.h"

enum {
  POINTS_INPUTS = 9,
  POINTS_NAMES_MAX = POINTS_INPUTS + CLI_PARAMETERS_MAX + CLI_QUANTITIES_MAX + 3
};

/* The columns that are read or written, and where they are in the header. */
typedef struct points_columns {
  size_t count; /* number of cells in the header */
  size_t name_count;
  const char *names[POINTS_NAMES_MAX]; /* inputs, parameters, quantities, errors and the status */
  size_t at[POINTS_NAMES_MAX];         /* their positions, or CLI_CSV_ABSENT */
  size_t parameter_count;              /* how many names, from POINTS_INPUTS on, are parameters */
  size_t output_count;              /* the radius of --r, the quantities, errors and the status */
  size_t outputs[POINTS_NAMES_MAX]; /* positions in names */
  size_t first_output; /* position in the header of the first column that is replaced, or count */
} points_columns;

enum points_state {
  POINTS_COPIED,  /* written as it was read */
  POINTS_READ,    /* its cells have been read */
  POINTS_WAITING, /* waits for the answer to query `id` */
  POINTS_GOOD,
  POINTS_BAD,
};

enum { POINTS_STATUS_BYTES = 256 };

typedef struct points_row {
  cli_csv_record record;
  enum points_state state;
  unsigned model, evaluator, moments;
  dipole_medium medium;
  double r_mm; /* of its cell */
  cli_parameters parameters;
  uint64_t id;
  double *values; /* [radii][quantities], set if the row is good */
  double numerical_error, numerical_error_per_mm, model_error; /* the same */
  char status[POINTS_STATUS_BYTES]; /* says what is wrong if the row is bad */
} points_row;

/* What holds for all rows. */
typedef struct points_usual {
  const cli_settings *settings;
  const cli_option *options; /* of the command, as a column may have the name of one */
  const dipole_info *info;
  cli_parameters parameters; /* for rows whose cells are empty or absent */
  cli_quantities quantities;
  unsigned model, moments; /* of rows whose cells are empty or absent */
  unsigned evaluator;
  unsigned evaluator_of_transport; /* and of rows whose model a tolerance chooses */
  unsigned transport, tolerance;   /* ids of this model and of this parameter */
  bool by_f;                       /* R_f alone is wanted: radii are spatial frequencies, 1/mm */
  const cli_numbers *radii;        /* those of --r or --f */
  size_t radius_count;             /* of each row: those of --r, or 1 */
  float *r_f32;                    /* [radius_count]; NULL without --r */
  dipole_measured_medium *media;
  size_t medium_count;
} points_usual;

static inline bool points_has_radii(const points_usual *usual) {
  return usual->radii->count > 0;
}

/* Finds the columns in the header of `source`. Says what is wrong and returns false if one is
 * missing, misspelt or stands there twice. */
bool points_find_columns(const points_usual *usual, const char *source,
                         const cli_csv_record *header, points_columns *columns);

/* Reads the row's cells. Returns false if the row is bad; its status then says why. */
bool points_read_row(const points_usual *usual, const points_columns *columns, points_row *row);

/* Returns the row's parameter `tolerance`; NaN if it has none. */
double points_tolerance(const points_usual *usual, const points_row *row);

/* Writes the header and appends the output columns that it lacks. */
void points_write_header(const points_columns *columns, const cli_csv_record *header, FILE *file);

/* Writes the line of a row, which is good or bad, for radius number `radius`. */
void points_write_line(const points_usual *usual, const points_columns *columns,
                       const points_row *row, size_t radius, FILE *file);

#endif
