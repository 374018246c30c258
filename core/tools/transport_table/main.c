/* transport-table FOLDER FILE: solves for the media of the table of core/transport/table.h, makes
 * the table, measures its error and writes it to FILE. It keeps solutions in FOLDER, so that an
 * interrupted run continues where it stopped. Every machine writes the same file. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/splitmix.h"
#include "core/tools/tools.h"
#include "core/tools/transport_table/nodes.h"
#include "core/transport/decay.h"
#include "core/transport/functions.h"
#include "core/transport/table.h"

/* With these ends, g = 0 is one of Chebyshev's points in w: w(G_LEAST) / w(G_MOST) = -(1 - c) / (1
 * + c), c = sin(pi / 9). */
#define G_MOST 0.951
#define G_LEAST -0.50098670663654021

/* The ranges are a little wider than promised, so that rounding puts no promised medium outside. At
 * the reach R is far below TRANSPORT_TABLE_R_LEAST. */
static const double fields[TRANSPORT_TABLE_FIELDS] = {
    [TRANSPORT_TABLE_QUANTUM] = 0x1p-26,        [TRANSPORT_TABLE_ALBEDO_LEAST] = 0.0099,
    [TRANSPORT_TABLE_ALBEDO_MOST] = 1 - 9.9e-7, [TRANSPORT_TABLE_ETA_LEAST] = 0.699,
    [TRANSPORT_TABLE_ETA_MOST] = 2.202,         [TRANSPORT_TABLE_REACH_DECAYS] = 30,
    [TRANSPORT_TABLE_REACH_MOST] = 1e4,         [TRANSPORT_TABLE_EDGES] = 1e-10,
    [TRANSPORT_TABLE_EDGES + 1] = 1e-3,         [TRANSPORT_TABLE_EDGES + 2] = 1,
    [TRANSPORT_TABLE_D_QUANTUM] = 0x1p-20,      [TRANSPORT_TABLE_G_LEAST] = G_LEAST,
    [TRANSPORT_TABLE_G_MOST] = G_MOST,          [TRANSPORT_TABLE_D_REACH_DECAYS] = 25,
    [TRANSPORT_TABLE_D_REACH_MOST] = 200,       [TRANSPORT_TABLE_D_EDGES] = 1e-10,
    [TRANSPORT_TABLE_D_EDGES + 1] = 1e-3,       [TRANSPORT_TABLE_D_EDGES + 2] = 1,
    [TRANSPORT_TABLE_D_EDGES + 3] = 14,         [TRANSPORT_TABLE_TOTALS_QUANTUM] = 0x1p-30,
};

enum { CHECKS = 72, ALBEDOS = 8, RADII = 96, RADII_FAR = 32 };
enum { ETAS_D = 16, RADII_D = 64 };

/* ---- media and radii that the table is not made from ----------------------------------------- */

static double between(uint64_t *state, double low, double high) {
  return low + (high - low) * core_splitmix_f64(state);
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

/* albedo of the medium with this ratio sigma_a / (sigma_s (1 - g)) */
#define OF_RATIO(ratio) (1.0 / (1 + (ratio)))

/* The media of the checks: drawn from a range of g and of the albedo, or, where both ends of g are
 * equal, this one. The first ranges are the bands of transport_table_region(). Then, because bands are
 * wide, g below 0, the smallest albedos of the second band, places where the series converge slowly,
 * and the largest albedos, where solutions are least exact. */
static const struct {
  double g[2];
  double albedo[2];
} check_media[] = {{{-0.5, 0.6}, {0.0099, 1.0 / 11}},
                   {{0.6, 0.85}, {0.0099, 1.0 / 11}},
                   {{0.85, 0.95}, {0.0099, 1.0 / 11}},
                   {{-0.5, 0.6}, {1.0 / 11, 0.5}},
                   {{0.6, 0.85}, {1.0 / 11, 0.5}},
                   {{0.85, 0.95}, {1.0 / 11, 0.5}},
                   {{-0.5, 0.6}, {0.5, 0.9}},
                   {{0.6, 0.85}, {0.5, 0.9}},
                   {{0.85, 0.95}, {0.5, 0.9}},
                   {{-0.5, 0.6}, {0.9, 1}},
                   {{0.6, 0.85}, {0.9, 1}},
                   {{0.85, 0.95}, {0.9, 1}},
                   {{0.9, 0.9}, {OF_RATIO(0.05)}},
                   {{0.95, 0.95}, {OF_RATIO(0.7)}},
                   {{0.8, 0.8}, {OF_RATIO(0.3)}},
                   {{0.95, 0.95}, {OF_RATIO(0.003)}},
                   {{0.9, 0.9}, {OF_RATIO(5)}},
                   {{0.5, 0.5}, {OF_RATIO(0.02)}},
                   {{-0.5, -0.5}, {OF_RATIO(0.2)}},
                   {{0.95, 0.95}, {OF_RATIO(30)}},
                   {{-0.5, 0}, {0.0099, 1.0 / 11}},
                   {{-0.5, 0}, {1.0 / 11, 0.5}},
                   {{-0.5, 0}, {0.5, 0.9}},
                   {{-0.5, 0}, {0.9, 1}},
                   {{-0.5, 0}, {1.0 / 11, 0.2}},
                   {{0.3, 0.6}, {1.0 / 11, 0.2}},
                   {{0.6, 0.85}, {1.0 / 11, 0.2}},
                   {{0.85, 0.95}, {1.0 / 11, 0.2}},
                   {{0.9, 0.93}, {1.0 / 11, 0.5}},
                   {{0.9, 0.93}, {0.9, 0.99999}},
                   {{-0.47, -0.42}, {0.0099, 1.0 / 11}},
                   {{-0.47, -0.42}, {1.0 / 11, 0.5}},
                   {{-0.47, -0.42}, {0.5, 0.9}},
                   {{-0.47, -0.42}, {0.9, 0.99999}},
                   {{0.1, 0.4}, {1.0 / 11, 0.5}},
                   {{0.1, 0.4}, {0.5, 0.9}},
                   {{0.1, 0.4}, {0.9, 0.99999}},
                   {{0.82, 0.85}, {1.0 / 11, 0.5}},
                   {{0.82, 0.85}, {0.9, 0.99999}},
                   {{-0.5, -0.45}, {0.999998, 0.999999}},
                   {{-0.5, -0.25}, {0.999, 0.9999}},
                   {{-0.25, 0.6}, {0.999, 0.999998}},
                   {{0.6, 0.85}, {0.999, 0.999998}},
                   {{0.85, 0.95}, {0.999, 0.999998}}};

/* Besides, media halfway between the points of u, where the series are furthest off, with two g that lie
 * between the table's. */
static const double between_g[] = {0.31, 0.88};

/* And media with g below 0 that absorb most: for a large eta, D falls by 1.5 within a mean free path, at
 * a radius that depends on g and eta. With three such media alone, one that was not among them used 0.91 of
 * the error that was stated. */
static const double steep_g[] = {-0.5, 0}, steep_albedo[] = {0.0099, 1.0 / 11};

enum {
  CHECK_MEDIA = sizeof check_media / sizeof check_media[0],
  BETWEEN = NODES_D_U - 1,
  STEEP = 10,
  CHECKS_D = CHECK_MEDIA + 2 * BETWEEN + STEEP
};

/* Returns eta i of a medium: some fixed ones, then random ones below 1, from 1 on, and large
 * ones. */
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

/* Returns the level whose solutions the table is compared with. */
static size_t check_level(double g) {
  return g >= -0.25 && g < 0.85 ? SAMPLE_NORMAL : SAMPLE_FINEST;
}

/* Draws a medium from ranges of g and of the albedo. Returns the albedo. */
static double make_random(uint64_t *random, const double g[2], const double albedo[2],
                          table_sample *sample) {
  sample_make(sample, between(random, g[0], g[1]), ETAS_D, RADII_D);
  return transport_table_albedo_of_u(
      between(random, transport_table_u(albedo[0]), transport_table_u(albedo[1])));
}

/* The same for media with g other than 0: each sample has one albedo and g, and some eta. */
static void checks_make_difference(const double *field, table_sample samples[CHECKS_D]) {
  uint64_t random = 1941;
  for (size_t n = 0; n < CHECKS_D; n++) {
    double albedo;
    if (n >= CHECK_MEDIA + 2 * BETWEEN) {
      albedo = make_random(&random, steep_g, steep_albedo, &samples[n]);
    } else if (n >= CHECK_MEDIA) {
      const size_t i = n - CHECK_MEDIA;
      sample_make(&samples[n], between_g[i / BETWEEN], ETAS_D, RADII_D);
      albedo = nodes_albedo_between(field, i % BETWEEN);
    } else if (check_media[n].g[0] == check_media[n].g[1]) {
      sample_make(&samples[n], check_media[n].g[0], ETAS_D, RADII_D);
      albedo = check_media[n].albedo[0];
    } else {
      albedo = make_random(&random, check_media[n].g, check_media[n].albedo, &samples[n]);
    }
    samples[n].level = check_level(samples[n].g);
    make_places(field, &random, albedo, &samples[n]);
  }
}

/* ---- comparing the table with the solvers ---------------------------------------------------- */

/* The largest relative error and the place where it was found. */
typedef struct worst_error {
  double error;
  double albedo, g, eta, x, R; /* where it was found; x is NAN for totals */
  size_t values;               /* number of values that were compared */
} worst_error;

typedef struct checks_result {
  worst_error R, total; /* of isotropic scattering: of R, and of the total */
  worst_error D[TRANSPORT_TABLE_REGIONS], D_total, D_diffuse[TRANSPORT_TABLE_BANDS_ALBEDO];
} checks_result;

static void keep_worst(worst_error *worst, worst_error found) {
  found.values = worst->values + 1;
  if (!(found.error <= worst->error)) {
    *worst = found;
  }
  worst->values = found.values;
}

/* Returns what profiles multiply R by, such that its integral is the total: the model transport does
 * so where g is not 0 (core/models/transport.c). An error far away, where most light leaves if little
 * is absorbed, is then one everywhere. By the midpoint rule in ln x. */
static double scale_of(const transport_series *series) {
  const double step = 0.02, last = series->edge[TRANSPORT_TABLE_PANELS];
  double energy = 0;
  for (double y = series->edge[0] + 0.5 * step; y < last && series->g != 0; y += step) {
    const double x = fn_exp(y);
    energy += 2 * FN_PI * step * x * fn_exp(transport_series_at(series, y) - series->kappa * x);
  }
  return series->g != 0 ? series->total / energy : 1;
}

static void compare_radii(const table_sample *sample, size_t i, const transport_series *series,
                          checks_result *result) {
  const double scale = scale_of(series);
  for (size_t j = i * sample->radii; j < (i + 1) * sample->radii; j++) {
    const double x = sample->x[j];
    const double R = sample->R[j];
    if (R > TRANSPORT_TABLE_R_LEAST) {
      const double ln_xR = transport_series_at(series, fn_log(x)) - series->kappa * x;
      const double error = fabs(scale * fn_exp(ln_xR - fn_log(x * R)) - 1);
      const double albedo = sample->albedo[i];
      keep_worst(sample->g == 0
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
      if (sample->g == 0) {
        keep_worst(&result.total,
                   (worst_error){fabs(series.total / sample->total[i] - 1), sample->albedo[i], 0,
                                 sample->eta[i], (double)NAN, (double)NAN, 0});
      }
      compare_radii(sample, i, &series, &result);
      check_reach(sample, i);
    }
  }
  return result;
}

static void compare_total(worst_error *worst, double value, transport_number truth, double albedo,
                          double g, double eta) {
  const double error = (fabs(value - truth.value) + truth.error) / truth.value;
  keep_worst(worst, (worst_error){error, albedo, g, eta, (double)NAN, (double)NAN, 0});
}

/* Compares the totals of random media with g other than 0 with the solver, which takes milliseconds
 * for each. The errors include the solver's own. */
static void totals_compare(const transport_table *table, checks_result *result) {
  enum { MEDIA = 200 };
  uint64_t random = 1950;
  const double u_least = transport_table_u(1 - 2e-6);
  const double u_most = transport_table_u(table->field[TRANSPORT_TABLE_ALBEDO_LEAST]);
  for (size_t n = 0; n < MEDIA; n++) {
    const solver_phase phase = {between(&random, -0.5, 0.95), 0, NULL};
    const double albedo = transport_table_albedo_of_u(between(&random, u_least, u_most));
    solver_total truth[ETAS_D];
    double eta[ETAS_D];
    for (size_t i = 0; i < ETAS_D; i++) {
      eta[i] = eta_of_difference(i, &random);
    }
    tools_check(
        solver_totals(truth, core_isa_select(NULL), (1 - albedo) / albedo, &phase, eta, ETAS_D),
        "transport");
    for (size_t i = 0; i < ETAS_D; i++) {
      transport_slice *slice = transport_slice_create(table, phase.g, eta[i]);
      if (slice == NULL) {
        tools_fail("out of memory");
      }
      const double beam = transport_slice_total(slice, false, albedo);
      const double diffuse = transport_slice_total(slice, true, albedo);
      free(slice);
      compare_total(&result->D_total, beam, truth[i].normal, albedo, phase.g, eta[i]);
      compare_total(&result->D_diffuse[transport_table_albedo_band(albedo)], diffuse,
                    truth[i].diffuse, albedo, phase.g, eta[i]);
    }
  }
}

/* ---- the table ------------------------------------------------------------------------------- */

/* Returns an error times a margin, plus the solver's own, rounded up to two digits. */
static double quoted(double margin, double found, double of_solver) {
  const double error = margin * found + of_solver;
  double unit = 1;
  while (unit > error / 10 && unit > 1e-12) {
    unit /= 10;
  }
  return ceil(error / unit) * unit;
}

/* A region's bands, see transport_table_region(). */
struct bands {
  size_t g, albedo, eta, x;
};

static struct bands bands_of(size_t region) {
  const size_t x = region % TRANSPORT_TABLE_BANDS_X;
  region /= TRANSPORT_TABLE_BANDS_X;
  const size_t eta = region % TRANSPORT_TABLE_BANDS_ETA;
  region /= TRANSPORT_TABLE_BANDS_ETA;
  return (struct bands){region / TRANSPORT_TABLE_BANDS_ALBEDO,
                        region % TRANSPORT_TABLE_BANDS_ALBEDO, eta, x};
}

/* Returns the error of the solutions that the table is compared with. Those on the finest grids were
 * compared with grids of 34 to 38 degrees and up to 140 moments. For g = 0.95 the largest errors were
 * 6.2e-4 below x = 0.05, 5.8e-4 with sigma_a of 30 sigma_s', 4.2e-4 with 0.7 sigma_s' and 1e-4 with
 * 0.05 sigma_s'. Those on the normal ones, for g up to 0.85, were compared with the finest: they were
 * at most 2.1e-5 off for eta = 1.4, and 2.8e-4 for eta = 2.2. */
static double solver_error(size_t region) {
  const struct bands at = bands_of(region);
  const bool near = at.x == 0;
  /* dark: albedo below 0.5; bright: from 0.9 on */
  const bool dark = at.albedo<2, bright = at.albedo> 2;
  const double forward = near || dark ? 7e-4 : bright ? 2e-4 : 5e-4;
  return at.g + 1 == TRANSPORT_TABLE_BANDS_G ? forward : at.g > 0 && at.eta > 0 ? 3e-4 : 1e-4;
}

/* Returns whether what is found in region i counts for a region, too, which has `values` of its own.
 * Not every region has a medium with the finest grids. Near the source the error hardly depends on the
 * albedo, unless that is very small. If it is, and if the region has few values, the error for all g
 * counts. Far from the source the series in u set the error, which all g have in common; only for the
 * lowest g it is twice as large. */
static bool is_like(size_t i, size_t region, size_t values) {
  enum { FEW = 20, NEAR = 2, FAR = 3 /* indices of bands of x, and a small number of values */ };
  const struct bands at = bands_of(i), of = bands_of(region);
  const bool far = of.x >= FAR && of.x + 1 < TRANSPORT_TABLE_BANDS_X;
  const bool all_g = (far || of.albedo == 0 || values < FEW) && (at.g > 0 || of.g == 0);
  const bool all_albedos = of.x < NEAR && at.albedo > 0 && of.albedo > 0;
  return at.eta == of.eta && at.x == of.x &&
         ((at.g == of.g && (at.albedo == of.albedo || all_albedos)) ||
          (all_g && at.albedo == of.albedo));
}

/* Returns the largest error of a region and of those that are like it. Where R is negligible in all of
 * them, the error is that of the band of smaller x. */
static double error_of(const checks_result *result, size_t region) {
  double error = 0;
  size_t values = 0;
  for (size_t i = 0; i < TRANSPORT_TABLE_REGIONS; i++) {
    if (is_like(i, region, result->D[region].values)) {
      error = fmax(error, result->D[i].error);
      values += result->D[i].values;
    }
  }
  const bool first = region % TRANSPORT_TABLE_BANDS_X == 0;
  return values == 0 && !first ? error_of(result, region - 1) : error;
}

static void set_errors_of_difference(double *field, const checks_result *result) {
  for (size_t i = 0; i < TRANSPORT_TABLE_REGIONS; i++) {
    field[TRANSPORT_TABLE_D_ERRORS + i] =
        quoted(TRANSPORT_TABLE_MARGIN_D, error_of(result, i), solver_error(i));
  }
}

static void set_errors_of_totals(double *field, const checks_result *result) {
  const double margin = TRANSPORT_TABLE_MARGIN;
  field[TRANSPORT_TABLE_TOTALS_ERROR] = quoted(margin, result->D_total.error, 0);
  for (size_t i = 0; i < TRANSPORT_TABLE_BANDS_ALBEDO; i++) {
    field[TRANSPORT_TABLE_DIFFUSE_ERRORS + i] = quoted(margin, result->D_diffuse[i].error, 0);
  }
}

static void report_one(const char *what, const worst_error *worst, double written) {
  printf("  %-12s %6zu values, at most %.2g off, at albedo %.9g, g %.4g, eta %.6g, x = %.4g (R = "
         "%.2g); written: %.2g\n",
         what, worst->values, worst->error, worst->albedo, worst->g, worst->eta, worst->x, worst->R,
         written);
}

static void report_difference(const checks_result *result, const double *field) {
  for (size_t i = 0; i < TRANSPORT_TABLE_REGIONS; i++) {
    char what[32];
    snprintf(what, sizeof what, "g: region %zu", i);
    report_one(what, &result->D[i], field[TRANSPORT_TABLE_D_ERRORS + i]);
  }
}

static void report_totals(const checks_result *result, const double *field) {
  report_one("g: total", &result->D_total, field[TRANSPORT_TABLE_TOTALS_ERROR]);
  for (size_t i = 0; i < TRANSPORT_TABLE_BANDS_ALBEDO; i++) {
    report_one("g: diffuse", &result->D_diffuse[i], field[TRANSPORT_TABLE_DIFFUSE_ERRORS + i]);
  }
}

static void open_bytes(transport_table *table, table_bytes bytes) {
  if (!transport_table_open(table, bytes.bytes, bytes.length)) {
    tools_fail("the table cannot be read");
  }
}

/* Makes a table from solutions, without the errors of its totals. */
static table_bytes make_all(const char *folder) {
  enum { ALL = NODES + CHECKS + NODES_D + CHECKS_D };
  static table_sample samples[ALL];
  double field[TRANSPORT_TABLE_FIELDS];
  memcpy(field, fields, sizeof field);
  table_sample *nodes_d = samples + NODES, *checks = nodes_d + NODES_D;
  nodes_make(field, samples);
  nodes_make_difference(field, nodes_d);
  checks_make(field, checks);
  checks_make_difference(field, checks + CHECKS);
  samples_solve(folder, samples, ALL);
  table_bytes bytes = nodes_encode(field, samples);
  nodes_seal(bytes, field);
  nodes_encode_difference(&bytes, nodes_d);
  transport_table table;
  open_bytes(&table, bytes);
  const checks_result result = checks_compare(&table, checks, CHECKS + CHECKS_D);
  field[TRANSPORT_TABLE_ERROR] =
      quoted(TRANSPORT_TABLE_MARGIN, fmax(result.R.error, result.total.error), 0);
  set_errors_of_difference(field, &result);
  nodes_seal(bytes, field);
  report_one("R", &result.R, field[TRANSPORT_TABLE_ERROR]);
  report_one("total", &result.total, field[TRANSPORT_TABLE_ERROR]);
  report_difference(&result, field);
  transport_table_close(&table);
  for (size_t i = 0; i < ALL; i++) {
    sample_free(&samples[i]);
  }
  return bytes;
}

int main(int argc, char **argv) {
  if (argc != 3) {
    tools_fail("usage: transport-table FOLDER FILE");
  }
  table_bytes bytes = make_all(argv[1]);
  transport_table table;
  checks_result result = {0};
  open_bytes(&table, bytes);
  totals_compare(&table, &result);
  set_errors_of_totals(table.field, &result);
  nodes_seal(bytes, table.field);
  report_totals(&result, table.field);
  FILE *file = tools_open(argv[2]);
  fwrite(bytes.bytes, bytes.length, 1, file);
  tools_close(file, argv[2]);
  transport_table_close(&table);
  printf("transport.table: %zu bytes\n", bytes.length);
  free(bytes.bytes);
  return EXIT_SUCCESS;
}
