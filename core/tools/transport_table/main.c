/* transport-table FOLDER FILE: solves for the media of the table of core/transport/table.h, makes
 * the table, measures its error and writes it to FILE. It keeps solutions in FOLDER, so that an
 * interrupted run continues where it stopped. Every machine writes the same file. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/tools/tools.h"
#include "core/tools/transport_table/checks.h"
#include "core/tools/transport_table/nodes.h"

#define SOLVER_TOLERANCE 1e-8

/* The ranges are a little wider than promised, so that rounding puts no promised medium outside. At
 * the reach R is far below TRANSPORT_TABLE_R_LEAST. */
static const double fields[TRANSPORT_TABLE_FIELDS] = {
    [TRANSPORT_TABLE_QUANTUM] = 0x1p-26,        [TRANSPORT_TABLE_ALBEDO_LEAST] = 0.0099,
    [TRANSPORT_TABLE_ALBEDO_MOST] = 1 - 9.9e-7, [TRANSPORT_TABLE_ETA_LEAST] = 0.699,
    [TRANSPORT_TABLE_ETA_MOST] = 2.202,         [TRANSPORT_TABLE_REACH_DECAYS] = 30,
    [TRANSPORT_TABLE_REACH_MOST] = 1e4,         [TRANSPORT_TABLE_EDGES] = 1e-10,
    [TRANSPORT_TABLE_EDGES + 1] = 1e-3,         [TRANSPORT_TABLE_EDGES + 2] = 1,
};

/* Returns the largest error times the margin, rounded up to two digits. */
static double quoted(checks_result result) {
  const double error = TRANSPORT_TABLE_MARGIN * fmax(result.R.error, result.total.error);
  double unit = 1;
  while (unit > error / 10) {
    unit /= 10;
  }
  return ceil(error / unit) * unit;
}

static void report(checks_result result, size_t length, double error) {
  const worst_error R = result.R, total = result.total;
  printf("transport.table: %zu bytes\n", length);
  printf("  R of %zu radii: at most %.2g off, at albedo %.9g, eta %.6g, x = %.4g (R = %.2g)\n",
         result.values, R.error, R.albedo, R.eta, R.x, R.R);
  printf("  total: at most %.2g off, at albedo %.9g, eta %.6g\n", total.error, total.albedo,
         total.eta);
  printf("  error written into the table: %.2g\n", error);
}

int main(int argc, char **argv) {
  if (argc != 3) {
    tools_fail("usage: transport-table FOLDER FILE");
  }
  static table_sample samples[NODES + CHECKS];
  nodes_make(fields, samples);
  checks_make(fields, samples + NODES);
  samples_solve(argv[1], SOLVER_TOLERANCE, samples, NODES + CHECKS);
  size_t length;
  uint8_t *bytes = nodes_encode(fields, samples, &length);
  nodes_seal(bytes, length, 0);
  transport_table table;
  if (!transport_table_open(&table, bytes, length)) {
    tools_fail("the table cannot be read back");
  }
  const checks_result result = checks_compare(&table, samples + NODES);
  const double error = quoted(result);
  nodes_seal(bytes, length, error);
  FILE *file = tools_open(argv[2]);
  fwrite(bytes, length, 1, file);
  tools_close(file, argv[2]);
  report(result, length, error);
  free(bytes);
  for (size_t i = 0; i < NODES + CHECKS; i++) {
    sample_free(&samples[i]);
  }
  return EXIT_SUCCESS;
}
