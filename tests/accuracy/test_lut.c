/* Tables keep what they were asked for: every function that they hold, for every model, at media all
 * over the domain, against the model in double precision.
 *
 * The default run takes a few media for each model and tolerance in turn; `test_lut all` takes all.
 */
#include <float.h>
#include <math.h>
#include <time.h>

#include "core/transport/transport.h"
#include "tests/accuracy/table_case.h"
#include "tests/unit/unit.h"

enum { RADII = 100000, TOLERANCES = 4, MODELS_MAX = 40 };

static const double tolerances[TOLERANCES] = {1e-3, 1e-4, 1e-5, 1e-6};

static bool all_of_them;

/* ---- what is measured --------------------------------------------------------------------- */

enum function { R, CDF, PDF, RING, SAMPLE, FUNCTIONS };

static const struct {
  const char *name;
  unsigned quantity; /* 0: radii for given cdf */
} functions[FUNCTIONS] = {{"R", CORE_QUANTITY_R},
                          {"cdf", CORE_QUANTITY_CDF},
                          {"pdf", CORE_QUANTITY_PDF},
                          {"2 pi r R", CORE_QUANTITY_RING},
                          {"r of cdf", 0}};

/* Of all tables of a model and a tolerance. */
struct record {
  size_t built;
  size_t refused;
  double worst[FUNCTIONS]; /* over the tolerance */
  double claim;            /* error found over the numerical error that is stated for it */
  size_t bytes;
  double seconds;
};

static struct record records[MODELS_MAX][TOLERANCES];

/* The arguments and the truth about one model and medium. */
static struct {
  float r[RADII];
  float u[RADII];
  double truth[FUNCTIONS][RADII];
} given;

static float radius_of(uint64_t *random, size_t i, double mfp_mm) {
  static const double ranges[4][2] = {{1e-14, 1e4}, {1e-14, 1e4}, {1e-3, 1e2}, {1e4, 1e16}};
  const double r = unit_random_log(random, ranges[i % 4][0], ranges[i % 4][1]) * mfp_mm;
  return (float)fmin(fmax(r, 0x1p-126), (double)FLT_MAX);
}

static float cdf_of(uint64_t *random, size_t i) {
  const double u = i % 3 == 0   ? unit_random_between(random, 0, 1)
                   : i % 3 == 1 ? unit_random_log(random, 1e-37, 1)
                                : 1 - unit_random_log(random, 0x1p-24, 1);
  return (float)fmin(u, 1 - 0x1p-24);
}

static void widen(const float *from, double *to) {
  for (size_t i = 0; i < RADII; i++) {
    to[i] = (double)from[i];
  }
}

static void evaluate(const core_profile *profile, enum function f, const double *in, double *out) {
  if (f == SAMPLE) {
    core_sample_f64(profile, RADII, in, out);
  } else {
    core_eval_f64(profile, functions[f].quantity, RADII, in, out);
  }
}

static double wide[RADII];

static void give(const core_profile *truth, uint64_t *random) {
  const double mfp_mm = table_mfp_mm(&truth->medium);
  for (size_t i = 0; i < RADII; i++) {
    given.r[i] = radius_of(random, i, mfp_mm);
    given.u[i] = cdf_of(random, i);
  }
  for (int f = 0; f < FUNCTIONS; f++) {
    widen(f == SAMPLE ? given.u : given.r, wide);
    evaluate(truth, f, wide, given.truth[f]);
  }
}

/* ---- measuring ---------------------------------------------------------------------------- */

static double seconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void complain(const core_profile *table, enum function f, double tolerance, double at,
                     double value, double truth) {
  const core_medium *m = &table->medium;
  print_error("%s of %s at %g, sigma_a %.9g sigma_s %.9g g %g eta %g, x = %.9g (%.3g mfp): %.9g, not "
           "%.9g: off by %.3g; stated %.3g\n",
           functions[f].name, core_choice_by_id(core_models, table->model)->name, tolerance,
           m->sigma_a_per_mm, m->sigma_s_per_mm, m->g, m->eta, at, at / table_mfp_mm(m), value, truth,
           fabs(value / truth - 1), table->numerical_error);
}

static size_t complaints;

/* Beyond the radii that a model's tolerance holds for, the table's own source is the model:
 * transport's solver has no digits left, and quantized diffusion no Gaussians. */
static double range_of(const core_profile *table) {
  const core_medium *m = &table->medium;
  const double mfp_mm = table_mfp_mm(m);
  if (table->model == CORE_MODEL_TRANSPORT) {
    return 30 / transport_kappa(m->sigma_s_per_mm * (1 - m->g) * mfp_mm) * mfp_mm;
  }
  return m->sigma_a_per_mm * mfp_mm < 1e-28 ? 1e13 * mfp_mm : (double)INFINITY;
}

static void measure(const core_profile *table, const core_profile *truth, enum function f,
                    double tolerance, struct record *record) {
  static float out[RADII];
  static double source[RADII];
  const float *in = f == SAMPLE ? given.u : given.r;
  if (f == SAMPLE) {
    core_sample_f32(table, RADII, in, out);
  } else {
    core_eval_f32(table, functions[f].quantity, RADII, in, out);
  }
  const bool approximate = table_is_approximate(table->model);
  const double range = range_of(table);
  if (approximate) {
    widen(in, wide);
    evaluate(table->source, f, wide, source);
  }
  double worst = 0;
  size_t worst_at = 0;
  for (size_t i = 0; i < RADII; i++) {
    const bool own = approximate && (f == SAMPLE || (double)in[i] > range);
    const double right = own ? source[i] : given.truth[f][i];
    const double error = table_error(out[i], right);
    const double r = f == SAMPLE ? right : (double)in[i];
    const double stated = table->numerical_error + table->numerical_error_per_mm * r +
                          truth->numerical_error + truth->numerical_error_per_mm * r;
    record->claim = fmax(record->claim, error / stated);
    if (error > worst) {
      worst = error;
      worst_at = i;
    }
  }
  record->worst[f] = fmax(record->worst[f], worst / tolerance);
  if (worst > tolerance) {
    complaints++;
    const bool own = approximate && (f == SAMPLE || (double)in[worst_at] > range);
    complain(table, f, tolerance, (double)in[worst_at], (double)out[worst_at], own ? source[worst_at] : given.truth[f][worst_at]);
  }
}

static void try_table(unsigned model, const struct table_place *place, const core_profile *truth,
                      size_t t, struct record *record, bool must) {
  core_profile table;
  const double start = seconds();
  const core_fault fault = table_prepare(&table, model, place, tolerances[t]);
  const double took = seconds() - start;
  if (fault.field != NULL) {
    record->refused++;
    if (must) {
      complaints++;
    }
    const core_medium *m = &place->medium;
      print_error("%s %s at %g: sigma_a %.9g sigma_s %.9g g %g eta %g thick %g: %s: %s (%.3f s)\n", must ? "MUST NOT" : "refused", core_choice_by_id(core_models, model)->name, tolerances[t],
      m->sigma_a_per_mm, m->sigma_s_per_mm, m->g, m->eta, place->thickness_mfp, fault.field, fault.allowed, took);
    return;
  }
  record->built++;
  record->seconds = fmax(record->seconds, took);
  const size_t bytes = core_profile_bytes(&table) - core_profile_bytes(table.source);
  record->bytes = bytes > record->bytes ? bytes : record->bytes;
  for (int f = 0; f < FUNCTIONS; f++) {
    measure(&table, truth, f, tolerances[t], record);
  }
  core_profile_free(&table);
}

static void try_place(unsigned model, const struct table_place *place, bool ordinary,
                      uint64_t *random, struct record *record) {
  core_profile truth;
  const double start = seconds();
  const core_fault fault = table_truth(&truth, model, place);
  if (fault.field != NULL) {
    return;
  }
  const double prepared = seconds();
  give(&truth, random);
  const double evaluated = seconds();
  for (size_t t = 0; t < TOLERANCES; t++) {
    try_table(model, place, &truth, t, &record[t], ordinary);
  }
  fprintf(stderr, "%s: truth %.3f, given %.3f, tables %.3f\n", core_choice_by_id(core_models, model)->name, prepared - start, evaluated - prepared, seconds() - evaluated);
  core_profile_free(&truth);
}

int main(int argc, char **argv) {
  all_of_them = argc > 1;
  const char *only = argc > 2 ? argv[2] : NULL;
  const int which = argc > 3 ? atoi(argv[3]) : 3;
  const size_t stride = argc > 4 ? (size_t)atoi(argv[4]) : 1;
  uint64_t random = unit_seed();
  for (size_t m = 0; core_models[m].name != NULL; m++) {
    if (only != NULL && strcmp(only, "all") != 0 && strcmp(only, core_models[m].name) != 0) {
      continue;
    }
    for (size_t i = 0; (which & 2) && i < table_extremes_count; i += stride) {
      try_place(core_models[m].id, &table_extremes[i], false, &random, records[m]);
    }
    for (size_t i = 0; (which & 1) && i < table_ordinary_count(); i += stride) {
      const struct table_place place = table_ordinary(i);
      try_place(core_models[m].id, &place, true, &random, records[m]);
    }
    for (size_t t = 0; t < TOLERANCES; t++) {
      const struct record *r = &records[m][t];
      printf("%-28s %.0e built %zu refused %zu  R %.3f cdf %.3f pdf %.3f ring %.3f r %.3f  claim %.3f  %zu kB %.1f ms\n",
             core_models[m].name, tolerances[t], r->built, r->refused, r->worst[0], r->worst[1],
             r->worst[2], r->worst[3], r->worst[4], r->claim, r->bytes / 1024, r->seconds * 1e3);
    }
    fflush(stdout);
  }
  return complaints > 0;
}
