/* invert: what `dipole invert` asks for and what it got, as its parts share it. */
#ifndef DIPOLE_CLI_INVERT_H
#define DIPOLE_CLI_INVERT_H

#include "clients/cli/cli.h"

/* One medium that is wanted. */
typedef struct cli_invert_row {
  double wanted_albedo;
  double length_mm;
  bool found;
  dipole_medium medium;
  double albedo; /* of that medium, evaluated */
} cli_invert_row;

typedef struct cli_invert_report {
  const dipole_info *info;
  const dipole_choice *model, *moments, *given;
  double g, eta;
  double albedo_least, albedo_most;
  size_t count;
  size_t missing;
  cli_invert_row *rows;
} cli_invert_report;

/* Why there is no medium. */
const char *cli_invert_reason(const cli_invert_report *report, const cli_invert_row *row);

void cli_invert_write_table(const cli_invert_report *report, FILE *file);
void cli_invert_write_csv(const cli_invert_report *report, FILE *file);
void cli_invert_write_json(const cli_invert_report *report, FILE *file);

#endif
