/* top_write: a record of `dipole top` in one of its formats. */
#ifndef DIPOLE_CLI_TOP_WRITE_H
#define DIPOLE_CLI_TOP_WRITE_H

#include <stdio.h>

#include "clients/cli/top_record.h"

/* For people, about 80 columns wide; models and errors are listed when there have been some. */
void top_write_table(const dipole_info *info, const top_record *record, FILE *file);

/* A line; first: with one of names before it. */
void top_write_csv(const top_record *record, bool first, FILE *file);

/* An object on a line of its own, with the same names. */
void top_write_json(const top_record *record, FILE *file);

#endif
