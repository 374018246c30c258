/* transport-table FOLDER FILE: solves for the media of the table of core/transport/table.h, makes
 * the table, measures its error and writes it to FILE. It keeps solutions in FOLDER, so that an
 * interrupted run continues where it stopped. Every machine writes the same file. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/tools/tools.h"
#include "core/tools/transport_table/nodes.h"
#include "core/transport/functions.h"
#include "core/transport/table.h"
#include "core/transport/transport.h"

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

enum { CHECKS = 72, ALBEDOS = 8, RADII = 96, RADII_FAR = 32 };

/* ---- media and radii that the table is not made from ----------------------------------------- */

/* Returns a random number from 0 to 1, by Vigna's splitmix64. */
static double next_random(uint64_t *state) {
  uint64_t z = *state += UINT64_C(0x9e3779b97f4a7c15);
  z = (z ^ z >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
  z = (z ^ z >> 27) * UINT64_C(0x94d049bb133111eb);
  z ^= z >> 31;
  return (double)(z >> 11) * 0x1p-53;
}

static double between(uint64_t *state, double low, double high) {
  return low + (high - low) * next_random(state);
}

/* The first samples have `etas`: the ends of the range and values around 1. Random eta follow. The
 * last samples have `etas_again`, where errors are largest, with other albedos. */
static const double etas[] = {0.7, 0.9999, 1, 1.0001, 2.2, 0.99, 1.01, 1.4};
static const double etas_again[] = {1, 1, 1, 1, 1, 1, 2.2, 0.7};

enum { ETAS = sizeof etas / sizeof etas[0], AGAIN = sizeof etas_again / sizeof etas_again[0] };

static double eta_of(const double *field, size_t i, uint64_t *random) {
  if (i < ETAS || i >= CHECKS - AGAIN) {
    return i < ETAS ? etas[i] : etas_again[i - (CHECKS - AGAIN)];
  }
  const enum transport_table_side side =
      i % 2 == 0 ? TRANSPORT_TABLE_BELOW_1 : TRANSPORT_TABLE_FROM_1;
  double range[2];
  transport_table_v_range(field, side, range);
  return transport_table_eta(side, between(random, range[0], range[1]));
}

/* Returns albedo i: first both ends of the range, then random ones that are uniform in t, and two
 * that are uniform in the albedo. */
static double albedo_of(const double *field, size_t i, uint64_t *random) {
  const double least = field[TRANSPORT_TABLE_ALBEDO_LEAST];
  const double most = field[TRANSPORT_TABLE_ALBEDO_MOST];
  if (i < 2) {
    return i == 0 ? least : most;
  }
  if (i < ALBEDOS - 2) {
    return transport_table_albedo(
        between(random, transport_table_t(most), transport_table_t(least)));
  }
  return between(random, least, most);
}

/* Returns radius i: first both ends, then random ones in the far panels, then in all panels. */
static double radius_of(const double *edge, size_t i, uint64_t *random) {
  if (i < 2) {
    return fn_exp(edge[i == 0 ? 0 : TRANSPORT_TABLE_PANELS]);
  }
  return fn_exp(between(random, edge[i < RADII_FAR ? TRANSPORT_TABLE_NEAR : 0],
                        edge[TRANSPORT_TABLE_PANELS]));
}

/* Makes the media and radii of the checks: those at the ends of the covered ranges, around eta = 1,
 * and random ones. Every call makes the same. */
static void checks_make(const double *field, table_sample samples[CHECKS]) {
  uint64_t random = 2012;
  for (size_t n = 0; n < CHECKS; n++) {
    table_sample *sample = &samples[n];
    sample_make(sample, eta_of(field, n, &random), ALBEDOS, RADII);
    for (size_t i = 0; i < ALBEDOS; i++) {
      double edge[TRANSPORT_TABLE_PANELS + 1];
      sample->albedo[i] = albedo_of(field, i, &random);
      transport_table_edges(field, transport_kappa(sample->albedo[i]), edge);
      for (size_t j = 0; j < RADII; j++) {
        sample->x[i * RADII + j] = radius_of(edge, j, &random);
      }
    }
  }
}

/* ---- comparing the table with the solver ----------------------------------------------------- */

/* The largest relative error and the place where it was found. */
typedef struct worst_error {
  double error;
  double albedo, eta, x, R; /* where the error was found; x is NAN for the total */
} worst_error;

typedef struct checks_result {
  worst_error R, total;
  size_t values; /* number of values of R that were compared */
} checks_result;

static void take(worst_error *worst, worst_error found) {
  if (!(found.error <= worst->error)) {
    *worst = found;
  }
}

static void compare_radii(const table_sample *sample, size_t i, const transport_series *series,
                          checks_result *result) {
  for (size_t j = i * RADII; j < (i + 1) * RADII; j++) {
    const double x = sample->x[j];
    const double R = sample->R[j];
    if (R > TRANSPORT_TABLE_R_LEAST) {
      const double ln_xR = transport_series_at(series, fn_log(x)) - series->kappa * x;
      const double error = fabs(fn_exp(ln_xR - fn_log(x * R)) - 1);
      take(&result->R, (worst_error){error, sample->albedo[i], sample->eta, x, R});
      result->values++;
    }
  }
  if (sample->R[i * RADII + 1] > TRANSPORT_TABLE_R_LEAST) {
    tools_fail("R at the table's last radius is not negligible: the table must reach farther");
  }
}

static checks_result checks_compare(const transport_table *table,
                                    const table_sample samples[CHECKS]) {
  checks_result result = {0};
  for (const table_sample *sample = samples; sample < samples + CHECKS; sample++) {
    for (size_t i = 0; i < sample->albedos; i++) {
      transport_series series;
      transport_table_look_up(table, sample->albedo[i], sample->eta, &series);
      const double error = fabs(series.total / sample->total[i] - 1);
      take(&result.total,
           (worst_error){error, sample->albedo[i], sample->eta, (double)NAN, (double)NAN});
      compare_radii(sample, i, &series, &result);
    }
  }
  return result;
}

/* ---- the table ------------------------------------------------------------------------------- */

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
