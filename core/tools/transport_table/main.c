/* transport-table FOLDER FILE: solves for the media of the table of core/transport/table.h, makes
 * the table, measures its error and writes it to FILE. It keeps solutions in FOLDER, so that an
 * interrupted run continues where it stopped. Every machine writes the same file. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/tools/tools.h"
#include "core/tools/transport_table/nodes.h"
#include "core/transport/functions.h"
#include "core/transport/table.h"
#include "core/transport/transport.h"

#define D_SOLVER_ERROR 2e-4 /* of the solver with TRANSPORT_EFFORT_NORMAL */
#define G_MOST 0.951
#define G_ZERO 0.28173255684142967 /* sin(pi / 11) */

/* The ranges are a little wider than promised, so that rounding puts no promised medium outside. At
 * the reach R is far below TRANSPORT_TABLE_R_LEAST. */
static const double fields[TRANSPORT_TABLE_FIELDS] = {
    [TRANSPORT_TABLE_QUANTUM] = 0x1p-26,
    [TRANSPORT_TABLE_ALBEDO_LEAST] = 0.0099,
    [TRANSPORT_TABLE_ALBEDO_MOST] = 1 - 9.9e-7,
    [TRANSPORT_TABLE_ETA_LEAST] = 0.699,
    [TRANSPORT_TABLE_ETA_MOST] = 2.202,
    [TRANSPORT_TABLE_REACH_DECAYS] = 30,
    [TRANSPORT_TABLE_REACH_MOST] = 1e4,
    [TRANSPORT_TABLE_EDGES] = 1e-10,
    [TRANSPORT_TABLE_EDGES + 1] = 1e-3,
    [TRANSPORT_TABLE_EDGES + 2] = 1,
    [TRANSPORT_TABLE_D_QUANTUM] = 0x1p-18,
    [TRANSPORT_TABLE_D_REACH_DECAYS] = 18,
    [TRANSPORT_TABLE_D_REACH_MOST] = 300,
    [TRANSPORT_TABLE_G_MOST] = G_MOST,
    /* with these ends, 0 is one of Chebyshev's points */
    [TRANSPORT_TABLE_G_LEAST] = -G_MOST * (1 - G_ZERO) / (1 + G_ZERO),
};

enum { CHECKS = 72, ALBEDOS = 8, RADII = 96, RADII_FAR = 32 };
enum { ETAS_D = 16, RADII_D = 64 };

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
    sample_make(sample, 0, ALBEDOS, RADII);
    const double eta = eta_of(field, n, &random);
    for (size_t i = 0; i < ALBEDOS; i++) {
      double edge[TRANSPORT_TABLE_PANELS + 1];
      sample->eta[i] = eta;
      sample->albedo[i] = albedo_of(field, i, &random);
      transport_table_edges(field, false, transport_kappa(sample->albedo[i]), edge);
      for (size_t j = 0; j < RADII; j++) {
        sample->x[i * RADII + j] = radius_of(edge, j, &random);
      }
    }
  }
}

/* Media whose values are computed with the finest grids. Their distance from the table includes the
 * error of the solutions that the table is made from. */
static const struct {
  double g, ratio; /* ratio: sigma_a / (sigma_s (1 - g)) */
} finest[] = {{0.9, 0.05}, {0.95, 0.7}, {0.8, 0.3},  {0.95, 0.003},
              {0.9, 5},    {0.5, 0.02}, {-0.5, 0.2}, {0.95, 30}};

enum {
  FINEST = sizeof finest / sizeof finest[0],
  RANDOM_D = TRANSPORT_TABLE_BANDS_G * TRANSPORT_TABLE_BANDS_ALBEDO,
  CHECKS_D = RANDOM_D + FINEST
};

/* A random medium in each band of g and of the albedo (transport_table_region()). */
static void make_random_medium(const double *field, size_t n, uint64_t *random,
                               table_sample *sample, double *albedo) {
  static const double g[TRANSPORT_TABLE_BANDS_G + 1] = {-0.5, 0.6, 0.85, 0.95};
  const double albedos[TRANSPORT_TABLE_BANDS_ALBEDO + 1] = {field[TRANSPORT_TABLE_ALBEDO_LEAST],
                                                            1.0 / 11, 0.5, 0.9, 1};
  const size_t i = n % TRANSPORT_TABLE_BANDS_G;
  const size_t j = n / TRANSPORT_TABLE_BANDS_G % TRANSPORT_TABLE_BANDS_ALBEDO;
  sample_make(sample, between(random, g[i], g[i + 1]), ETAS_D, RADII_D);
  *albedo = transport_table_albedo_of_u(
      between(random, transport_table_u(albedos[j]), transport_table_u(albedos[j + 1])));
}

/* Returns eta i of a medium: some fixed ones, then random ones below 1, from 1 on, and large ones. */
static double eta_of_difference(size_t i, uint64_t *random) {
  static const double fixed[] = {0.7, 1, 1.01, 2.2};
  static const double ends[][2] = {{0.7, 1}, {1, 1.5}, {1.5, 2.2}};
  return i < 4 ? fixed[i] : between(random, ends[i % 3][0], ends[i % 3][1]);
}

/* Sets the boundaries and radii of a medium. Most radii are from 0.003 on, where a user's are. */
static void make_places(const double *field, uint64_t *random, double albedo,
                        table_sample *sample) {
  double edge[TRANSPORT_TABLE_PANELS + 1];
  transport_table_edges(field, false, transport_kappa(albedo), edge);
  for (size_t i = 0; i < ETAS_D; i++) {
    sample->albedo[i] = albedo;
    sample->eta[i] = eta_of_difference(i, random);
    for (size_t j = 0; j < RADII_D; j++) {
      const double first = j % 4 == 0 ? edge[0] : fn_log(0.003);
      sample->x[i * RADII_D + j] = fn_exp(between(random, first, edge[TRANSPORT_TABLE_PANELS]));
    }
  }
}

/* The same for media with g other than 0: each sample has one albedo and g, and some eta. */
static void checks_make_difference(const double *field, table_sample samples[CHECKS_D]) {
  uint64_t random = 1941;
  for (size_t n = 0; n < CHECKS_D; n++) {
    double albedo;
    if (n < RANDOM_D) {
      make_random_medium(field, n, &random, &samples[n], &albedo);
    } else {
      sample_make(&samples[n], finest[n - RANDOM_D].g, ETAS_D, RADII_D);
      samples[n].effort = TRANSPORT_EFFORT_FINEST;
      albedo = 1 / (1 + finest[n - RANDOM_D].ratio);
    }
    make_places(field, &random, albedo, &samples[n]);
  }
}

/* ---- comparing the table with the solvers ---------------------------------------------------- */

/* The largest relative error and the place where it was found. */
typedef struct worst_error {
  double error;
  double albedo, g, eta, x, R; /* where the error was found; x is NAN for the total */
  size_t values;               /* number of values that were compared */
} worst_error;

typedef struct checks_result {
  worst_error R, total; /* of isotropic scattering */
  worst_error D[TRANSPORT_TABLE_REGIONS], D_totals;
} checks_result;

static void take(worst_error *worst, worst_error found) {
  found.values = worst->values + 1;
  if (!(found.error <= worst->error)) {
    *worst = found;
  }
  worst->values = found.values;
}

static void compare_total(worst_error *worst, const table_sample *sample, size_t i, double value,
                          double truth) {
  take(worst, (worst_error){fabs(value / truth - 1), sample->albedo[i], sample->g, sample->eta[i],
                            (double)NAN, (double)NAN, 0});
}

static void compare_radii(const table_sample *sample, size_t i, const transport_series *series,
                          checks_result *result) {
  for (size_t j = i * sample->radii; j < (i + 1) * sample->radii; j++) {
    const double x = sample->x[j];
    const double R = sample->R[j];
    if (R > TRANSPORT_TABLE_R_LEAST) {
      const double ln_xR = transport_series_at(series, fn_log(x)) - series->kappa * x;
      const double error = fabs(fn_exp(ln_xR - fn_log(x * R)) - 1);
      const double albedo = sample->albedo[i];
      take(sample->g == 0
               ? &result->R
               : &result->D[transport_table_region(albedo, sample->g, sample->eta[i], x)],
           (worst_error){error, albedo, sample->g, sample->eta[i], x, R, 0});
    }
  }
}

static void check_reach(const table_sample *sample, size_t i) {
  if (sample->g == 0 && sample->R[i * RADII + 1] > TRANSPORT_TABLE_R_LEAST) {
    tools_fail("R at the table's last radius is not negligible: the table must reach farther");
  }
}

static checks_result checks_compare(const transport_table *table, const table_sample *samples,
                                    size_t count) {
  checks_result result = {0};
  for (const table_sample *sample = samples; sample < samples + count; sample++) {
    for (size_t i = 0; i < sample->media; i++) {
      transport_series series;
      transport_table_look_up(table, sample->albedo[i], sample->g, sample->eta[i], &series);
      compare_total(sample->g == 0 ? &result.total : &result.D_totals, sample, i, series.total,
                    sample->total[i]);
      if (sample->g != 0) {
        compare_total(&result.D_totals, sample, i, series.total_diffuse, sample->diffuse[i]);
      }
      compare_radii(sample, i, &series, &result);
      check_reach(sample, i);
    }
  }
  return result;
}

/* ---- the table ------------------------------------------------------------------------------- */

/* Returns an error times the margin, plus the solver's own, rounded up to two digits. */
static double quoted(double found, double of_solver) {
  const double error = TRANSPORT_TABLE_MARGIN * found + of_solver;
  double unit = 1;
  while (unit > error / 10 && unit > 1e-12) {
    unit /= 10;
  }
  return ceil(error / unit) * unit;
}

/* Returns the largest error of a region, or, if it has few values, of the regions with any g that
 * are otherwise the same. */
static double error_of(const checks_result *result, size_t region) {
  enum { SAME = TRANSPORT_TABLE_REGIONS / TRANSPORT_TABLE_BANDS_G, FEW = 20 };
  double error = result->D[region].error;
  for (size_t i = region % SAME; i < TRANSPORT_TABLE_REGIONS && result->D[region].values < FEW;
       i += SAME) {
    error = fmax(error, result->D[i].error);
  }
  return error;
}

static void set_errors(double *field, const checks_result *result) {
  field[TRANSPORT_TABLE_ERROR] = quoted(fmax(result->R.error, result->total.error), 0);
  field[TRANSPORT_TABLE_TOTALS_ERROR] = quoted(result->D_totals.error, 0);
  for (size_t i = 0; i < TRANSPORT_TABLE_REGIONS; i++) {
    field[TRANSPORT_TABLE_D_ERRORS + i] = quoted(error_of(result, i), D_SOLVER_ERROR);
  }
}

static void report_one(const char *what, const worst_error *worst, double written) {
  printf("  %-12s %6zu values, at most %.2g off, at albedo %.9g, g %.4g, eta %.6g, x = %.4g (R = "
         "%.2g); written: %.2g\n",
         what, worst->values, worst->error, worst->albedo, worst->g, worst->eta, worst->x, worst->R,
         written);
}

static void report(const checks_result *result, size_t length, const double *field) {
  printf("transport.table: %zu bytes\n", length);
  report_one("R", &result->R, field[TRANSPORT_TABLE_ERROR]);
  report_one("total", &result->total, field[TRANSPORT_TABLE_ERROR]);
  report_one("g: totals", &result->D_totals, field[TRANSPORT_TABLE_TOTALS_ERROR]);
  for (size_t i = 0; i < TRANSPORT_TABLE_REGIONS; i++) {
    char what[32];
    snprintf(what, sizeof what, "g: region %zu", i);
    report_one(what, &result->D[i], field[TRANSPORT_TABLE_D_ERRORS + i]);
  }
}

int main(int argc, char **argv) {
  enum { ALL = NODES + CHECKS + NODES_D + CHECKS_D };
  if (argc != 3) {
    tools_fail("usage: transport-table FOLDER FILE");
  }
  static table_sample samples[ALL];
  double field[TRANSPORT_TABLE_FIELDS];
  memcpy(field, fields, sizeof field);
  table_sample *nodes_d = samples + NODES, *checks = nodes_d + NODES_D;
  nodes_make(field, samples);
  nodes_make_difference(field, nodes_d);
  checks_make(field, checks);
  checks_make_difference(field, checks + CHECKS);
  samples_solve(argv[1], samples, ALL);
  table_bytes bytes = nodes_encode(field, samples);
  nodes_seal(bytes, field);
  nodes_encode_difference(&bytes, nodes_d);
  transport_table table;
  if (!transport_table_open(&table, bytes.bytes, bytes.length)) {
    tools_fail("the table cannot be read back");
  }
  const checks_result result = checks_compare(&table, checks, CHECKS + CHECKS_D);
  set_errors(field, &result);
  nodes_seal(bytes, field);
  FILE *file = tools_open(argv[2]);
  fwrite(bytes.bytes, bytes.length, 1, file);
  tools_close(file, argv[2]);
  report(&result, bytes.length, field);
  free(bytes.bytes);
  for (size_t i = 0; i < ALL; i++) {
    sample_free(&samples[i]);
  }
  return EXIT_SUCCESS;
}
