/* Tables keep what they were asked for: every function that they hold, for every model, at media
 * all over the domain, against the model in double precision. Where a table cannot, it is refused.
 *
 * The default run tries a few media for each model, at half as many radii (in its long form at all),
 * costly models at fewer;
 * `test_lut all` tries every medium at all RADII (an hour), `test_lut all MODEL` those of one model.
 */
#include <float.h>
#include <math.h>
#include <time.h>

#include "core/kernels.h"
#include "core/transport/decay.h"
#include "tests/accuracy/table_case.h"
#include "tests/unit/unit.h"

enum { RADII = 100000, RADII_COSTLY = 10000, TOLERANCES = 4, MODELS_MAX = 64 };

static const double tolerances[TOLERANCES] = {1e-3, 1e-4, 1e-5, 1e-6};

/* What the arguments `all [MODEL]` choose. */
static bool all_of_them;
static const char *only_model; /* NULL: every one */

UNIT_SETUP(read_arguments) {
  all_of_them = unit_arguments[0] != NULL && strcmp(unit_arguments[0], "all") == 0;
  only_model = all_of_them ? unit_arguments[1] : NULL;
}

/* ---- what is measured --------------------------------------------------------------------- */

enum function { R, CDF, PDF, RING, SAMPLE, FUNCTIONS };

static const unsigned quantities[FUNCTIONS] = {CORE_QUANTITY_R, CORE_QUANTITY_CDF,
                                               CORE_QUANTITY_PDF, CORE_QUANTITY_RING,
                                               0 /* radii for given cdf */};
static const char *const names[FUNCTIONS] = {"R", "cdf", "pdf", "2 pi r R", "radius for cdf"};

/* Of all tables of a model and a tolerance. */
struct record {
  size_t built;
  size_t refused;
  double worst[FUNCTIONS]; /* the error found, over the tolerance */
  double worst_stated;     /* and over the numerical error that is stated */
  size_t bytes;
  double seconds;
};

static struct record records[MODELS_MAX][TOLERANCES];

/* A model at a medium: arguments, and what is right for them. */
static struct subject {
  unsigned model;
  struct table_place place;
  core_profile truth;
  size_t count;
  double radius_most; /* beyond, the table's own source is right: see range_of() */
  float in[FUNCTIONS][RADII];
  double right[FUNCTIONS][RADII];
} subject;

static double wide[RADII];

static void evaluate(const core_profile *profile, enum function f, double *out) {
  for (size_t i = 0; i < subject.count; i++) {
    wide[i] = (double)subject.in[f][i];
  }
  if (f == SAMPLE) {
    core_sample_f64(profile, subject.count, wide, out);
  } else {
    core_eval_f64(profile, quantities[f], subject.count, wide, out);
  }
}

static void evaluate_table(const core_profile *table, enum function f, float *out) {
  if (f == SAMPLE) {
    core_sample_f32(table, subject.count, subject.in[f], out);
  } else {
    core_eval_f32(table, quantities[f], subject.count, subject.in[f], out);
  }
}

/* ---- the subject -------------------------------------------------------------------------- */

/* From far below a table's first radius to beyond its last, mostly where there is light. */
static float random_radius(uint64_t *random, size_t i, double mfp_mm) {
  static const double ranges[4][2] = {{1e-14, 1e4}, {1e-14, 1e4}, {1e-3, 1e2}, {1e4, 1e16}};
  const double r = unit_random_log(random, ranges[i % 4][0], ranges[i % 4][1]) * mfp_mm;
  return (float)fmin(fmax(r, (double)FLT_MIN), (double)FLT_MAX);
}

static float random_cdf(uint64_t *random, size_t i) {
  const double u = i % 3 == 0   ? unit_random_between(random, 0, 1)
                   : i % 3 == 1 ? unit_random_log(random, 1e-44, 1)
                                : 1 - unit_random_log(random, 0x1p-24, 1);
  return (float)fmin(u, 1 - 0x1p-24);
}

/* How far a model's own tolerance holds, which beyond is not the same for two of them: transport's
 * solver has no digits left, quantized diffusion no Gaussians. */
static double range_of(unsigned model, const core_medium *medium) {
  const double mfp_mm = table_mfp_mm(medium);
  if (model == CORE_MODEL_TRANSPORT) {
    return 30 / transport_kappa(medium->sigma_s_per_mm * (1 - medium->g) * mfp_mm) * mfp_mm;
  }
  return table_is_approximate(model) && medium->sigma_a_per_mm * mfp_mm < 1e-28 ? 1e13 * mfp_mm
                                                                                : (double)INFINITY;
}

/* False: the medium is outside the model's domain. */
static bool make_subject(unsigned model, const struct table_place *place, uint64_t *random) {
  subject.model = model;
  subject.place = *place;
  if (model == CORE_MODEL_TRANSPORT && !core_transport_is_stored(&place->medium)) {
    return false; /* solving takes seconds */
  }
  if (table_truth(&subject.truth, model, place).field != NULL) {
    return false;
  }
  const bool costly = !all_of_them && subject.truth.cost > 20;
  subject.count = costly ? RADII_COSTLY : all_of_them || unit_is_long() ? RADII : RADII / 2;
  subject.radius_most = range_of(model, &place->medium);
  const double mfp_mm = table_mfp_mm(&place->medium);
  for (size_t i = 0; i < subject.count; i++) {
    const float r = random_radius(random, i, mfp_mm);
    for (int f = 0; f < FUNCTIONS; f++) {
      subject.in[f][i] = f == SAMPLE ? random_cdf(random, i) : r;
    }
  }
  for (int f = 0; f < FUNCTIONS; f++) {
    evaluate(&subject.truth, f, subject.right[f]);
  }
  return true;
}

/* ---- one table ---------------------------------------------------------------------------- */

static void describe(double tolerance) {
  const core_medium *m = &subject.place.medium;
  print_message("%s to %g, sigma_a %.9g sigma_s %.9g g %.9g eta %g thickness %g: ",
                core_choice_by_id(core_models, subject.model)->name, tolerance, m->sigma_a_per_mm,
                m->sigma_s_per_mm, m->g, m->eta, subject.place.thickness_mfp);
}

/* What is right for one argument: the truth, or what the table was made from. */
static double right_of(enum function f, size_t i, const double *source) {
  const bool beyond = f != SAMPLE && (double)subject.in[f][i] > subject.radius_most;
  /* At the ends of the cdf a radius says more of the tolerance of the cdf than of the table. */
  const bool from_source = beyond || (f == SAMPLE && table_is_approximate(subject.model));
  return from_source ? source[i] : subject.right[f][i];
}

static void measure(const core_profile *table, enum function f, double tolerance,
                    struct record *record) {
  static float out[RADII];
  static double source[RADII];
  evaluate_table(table, f, out);
  if (table_is_approximate(subject.model)) {
    evaluate(table->source, f, source);
  }
  double worst = 0;
  size_t at = 0;
  for (size_t i = 0; i < subject.count; i++) {
    const double right = right_of(f, i, source);
    const double error = table_error(out[i], right);
    const double r = f == SAMPLE ? right : (double)subject.in[f][i];
    const double stated = table->numerical_error + table->numerical_error_per_mm * r +
                          subject.truth.numerical_error + subject.truth.numerical_error_per_mm * r;
    record->worst_stated = fmax(record->worst_stated, error / stated);
    at = error > worst ? i : at;
    worst = fmax(worst, error);
  }
  record->worst[f] = fmax(record->worst[f], worst / tolerance);
  if (worst > tolerance) {
    describe(tolerance);
    print_message("%s at %.9g is %.9g, not %.9g: off by %.3g\n", names[f],
                  (double)subject.in[f][at], (double)out[at], right_of(f, at, source), worst);
  }
}

static double cpu_seconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void try_table(double tolerance, struct record *record) {
  core_profile table;
  const double start = cpu_seconds();
  const core_fault fault = table_prepare(&table, subject.model, &subject.place, tolerance);
  if (fault.field != NULL) {
    describe(tolerance);
    print_message("refused: %s: %s\n", fault.field, fault.allowed);
    assert_string_equal(fault.field, "tolerance");
    record->refused++;
    return;
  }
  record->seconds = fmax(record->seconds, cpu_seconds() - start);
  record->built++;
  const size_t bytes = table.lut_count * sizeof *table.lut;
  record->bytes = bytes > record->bytes ? bytes : record->bytes;
  /* That of a fit is stated beside the table's, and that of transport's solutions with it. */
  const bool transport = subject.model == CORE_MODEL_TRANSPORT;
  assert_true(subject.model == CORE_MODEL_GAUSSIANS || transport ||
              table.numerical_error <= tolerance);
  for (int f = 0; f < FUNCTIONS; f++) {
    measure(&table, f, transport ? fmax(tolerance, table.numerical_error) : tolerance, record);
  }
  core_profile_free(&table);
}

/* ---- all of them -------------------------------------------------------------------------- */

/* Every step-th tolerance, from a first one on. */
static void try_place(size_t model, const struct table_place *place, size_t first, size_t step,
                      uint64_t *random) {
  if (!make_subject(core_models[model].id, place, random)) {
    return;
  }
  for (size_t t = first % step; t < TOLERANCES; t += step) {
    try_table(tolerances[t], &records[model][t]);
  }
  core_profile_free(&subject.truth);
}

static bool is_due(size_t model) {
  assert_true(model < MODELS_MAX);
  return only_model == NULL || strcmp(only_model, core_models[model].name) == 0;
}

static void report(size_t model) {
  for (size_t t = 0; t < TOLERANCES; t++) {
    const struct record *r = &records[model][t];
    printf("%-28s %.0e: %2zu built, %zu refused; error over tolerance:", core_models[model].name,
           tolerances[t], r->built, r->refused);
    for (int f = 0; f < FUNCTIONS; f++) {
      printf(" %s %.2f", names[f], r->worst[f]);
    }
    printf("; over stated %.2f; %zu bytes, %.3f s at most\n", r->worst_stated, r->bytes,
           r->seconds);
  }
}

static void assert_kept(size_t model, bool refusable) {
  for (size_t t = 0; t < TOLERANCES; t++) {
    const struct record *r = &records[model][t];
    for (int f = 0; f < FUNCTIONS; f++) {
      assert_true(r->worst[f] <= 1);
    }
    assert_true(r->worst_stated <= 1);
    assert_true(refusable || r->refused == 0);
  }
}

/* Whatever is met with in use, at every tolerance. */
UNIT_TEST(ordinary_media_are_never_refused) {
  uint64_t random = unit_seed();
  const size_t count = table_ordinary_count();
  memset(records, 0, sizeof records);
  for (size_t m = 0; core_models[m].name != NULL; m++) {
    for (size_t i = 0; is_due(m) && i < (all_of_them ? count : 1); i++) {
      const struct table_place place = table_ordinary((i + m) % count);
      try_place(m, &place, 0, 1, &random);
    }
    if (is_due(m)) {
      report(m);
      assert_kept(m, false);
    }
  }
}

/* Pieces of these media's tables keep the tolerance at the places where a fit looks, and miss it by a
 * little between them. */
UNIT_TEST(pieces_that_miss_between_their_places_are_cut_again) {
  const double sigma_a_per_mm[] = {0.11286881739557351, 0.11611040316130428};
  for (size_t i = 0; i < 2; i++) {
    const core_medium medium = {sigma_a_per_mm[i], 1, 0, 1.4};
    core_profile table;
    const core_fault fault =
        core_profile_prepare(&table, core_isa_select(NULL), CORE_MODEL_BEAM, CORE_MOMENTS_EXACT,
                             CORE_EVALUATOR_LUT, &medium, NULL);
    assert_null(fault.field);
    assert_true(table.numerical_error <= 1e-4);
    core_profile_free(&table);
  }
}

UNIT_TEST(at_extremes_tolerances_are_kept_or_refused) {
  uint64_t random = unit_seed();
  size_t built = 0, refused = 0;
  memset(records, 0, sizeof records);
  for (size_t m = 0; core_models[m].name != NULL; m++) {
    for (size_t i = 0; is_due(m) && i < (all_of_them ? table_extremes_count : 1); i++) {
      const struct table_place *place = &table_extremes[(i + m) % table_extremes_count];
      try_place(m, place, m, all_of_them ? 1 : 2, &random);
    }
    if (is_due(m)) {
      report(m);
      assert_kept(m, true);
    }
    for (size_t t = 0; t < TOLERANCES; t++) {
      built += records[m][t].built;
      refused += records[m][t].refused;
    }
  }
  printf("%zu tables at extremes, %zu refused\n", built, refused);
  assert_true(built > 3 * refused);
}
