/* top_write: what happened in a daemon between two looks at its statistics, and how it is written. */
#ifndef DIPOLE_CLI_TOP_WRITE_H
#define DIPOLE_CLI_TOP_WRITE_H

#include <stdio.h>

#include "clients/c/dipole.h"

/* One look. Starts all 0, which is how a daemon starts. */
typedef struct top_look {
  dipole_value *values; /* to be freed */
  size_t count;
  double at_s; /* of a clock that does not jump */
} top_look;

typedef struct top_record {
  top_look before;
  top_look now;
  double interval_s;
} top_record;

/* Returns a statistic of the later look; 0 if the daemon has none of this name. */
uint64_t top_value(const top_record *record, const char *name);

/* Writes a table for people, about 80 columns wide. Models and errors are listed if there have been
 * some. */
void top_write_table(const dipole_info *info, const top_record *record, FILE *file);

/* Writes a line of CSV; names: with the line of names before it. */
void top_write_csv(const top_record *record, bool names, FILE *file);

/* Writes a JSON object with the same names on a line of its own. */
void top_write_json(const top_record *record, FILE *file);

#endif
