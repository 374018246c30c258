/* checks: compares the table with the solver, at media and radii that the table is not made from.
 */
#ifndef DIPOLED_TOOLS_CHECKS_H
#define DIPOLED_TOOLS_CHECKS_H

#include "core/tools/transport_table/samples.h"
#include "core/transport/table.h"

enum { CHECKS = 72 };

/* Makes the media and radii: those at the ends of the covered ranges, around eta = 1, and random
 * ones. Every call makes the same. */
void checks_make(const double *field, table_sample samples[CHECKS]);

/* The largest relative error and the place where it was found. */
typedef struct worst_error {
  double error;
  double albedo, eta, x, R; /* where the error was found; x is NAN for the total */
} worst_error;

typedef struct checks_result {
  worst_error R, total;
  size_t values; /* number of values of R that were compared */
} checks_result;

checks_result checks_compare(const transport_table *table, const table_sample samples[CHECKS]);

#endif
