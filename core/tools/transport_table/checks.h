/* checks: media and radii that the table is not made from, to compare it with the solver at. */
#ifndef DIPOLED_TOOLS_CHECKS_H
#define DIPOLED_TOOLS_CHECKS_H

#include "core/tools/transport_table/samples.h"
#include "core/transport/table.h"

enum { CHECKS = 72 };

/* The ends of what is covered, and what is around eta = 1, and random ones: always the same. */
void checks_make(const double *field, table_sample samples[CHECKS]);

/* The largest relative error, and where. */
typedef struct worst_error {
  double error;
  double albedo, eta, x, R; /* x: NAN of the total */
} worst_error;

typedef struct checks_result {
  worst_error R, total;
  size_t values; /* of R that were compared */
} checks_result;

checks_result checks_compare(const transport_table *table, const table_sample samples[CHECKS]);

#endif
