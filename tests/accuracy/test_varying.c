/* Media that vary: every value against the evaluator f64 of the same model and medium, within what
 * core_varying_error() states for it, and colours against the solver of transport. In the environment,
 * VARYING_MEDIA=N takes N media for each model and g, VARYING_SURFACES=N takes surfaces for N pairs
 * of g and eta with the least tolerance, and VARYING_SOLVED=N solves N colours; the defaults take
 * seconds. `make check-varying` sets them. */
#include <float.h>
#include <math.h>

#include "core/solver/solver.h"
#include "core/transport/table.h"
#include "core/varying.h"
#include "core/varying/rows.h"
#include "tests/unit/unit.h"

#define PI 3.14159265358979323846

enum { QUANTITIES = 4, RADII = 4, LENGTH_MAX = 67 };

static const enum core_quantity quantities[QUANTITIES] = {CORE_QUANTITY_R, CORE_QUANTITY_CDF,
                                                          CORE_QUANTITY_PDF, CORE_QUANTITY_RING};

static const unsigned dipoles[] = {CORE_MODEL_CLASSICAL,
                                   CORE_MODEL_BETTER,
                                   CORE_MODEL_GROSJEAN,
                                   CORE_MODEL_BOUNDARY,
                                   CORE_MODEL_EXITANCE,
                                   CORE_MODEL_GROSJEAN_BOUNDARY,
                                   CORE_MODEL_GROSJEAN_EXITANCE,
                                   CORE_MODEL_BOUNDARY_EXITANCE,
                                   CORE_MODEL_BURLEY,
                                   CORE_MODEL_BURLEY_DIFFUSE,
                                   CORE_MODEL_BURLEY_DMFP};
enum { DIPOLES = sizeof dipoles / sizeof dipoles[0] };

/* Returns the number that the environment gives, or another one. */
static size_t count_of(const char *name, size_t otherwise) {
  const char *given = getenv(name);
  return given != NULL ? (size_t)strtoull(given, NULL, 10) : otherwise;
}

static core_varying prepare(unsigned model, unsigned evaluator, double g, double eta,
                            const core_parameters *parameters) {
  core_varying varying;
  unit_accept(core_varying_prepare(&varying, core_isa_select(NULL), model, CORE_MOMENTS_EXACT,
                                   evaluator, g, eta, parameters));
  return varying;
}

/* A random value: its coefficients in single precision, so that both evaluators see the same. */
struct value {
  double sigma_a, sigma_s, r, u;
};

static double rounded(double x) {
  return (double)(float)x;
}

/* ratio_most: the largest sigma_a / sigma_s'. */
static struct value random_value(uint64_t *state, double g, double ratio_most) {
  const double sigma_t = unit_random_log(state, 1e-3, 1e3);
  const double any = unit_random_log(state, 1e-6, ratio_most);
  const double ratio = unit_random_below(state, 16) == 0 ? 0 : any;
  struct value value;
  value.sigma_s = rounded(sigma_t / (1 + ratio) / (1 - g));
  value.sigma_a = rounded(value.sigma_s * (1 - g) * ratio);
  value.r = rounded(unit_random_log(state, 1e-3, 40) / sigma_t);
  value.u = rounded(unit_random_between(state, 0, 1));
  return value;
}

/* For CORE_QUANTITY_RADIUS the radius that is drawn by u. */
static double eval(const core_varying *varying, enum core_quantity quantity,
                   const struct value *value) {
  const double in = quantity == CORE_QUANTITY_RADIUS ? value->u : value->r;
  if (varying->evaluator == CORE_EVALUATOR_F64) {
    double out;
    core_varying_eval(varying, quantity, 1, &value->sigma_a, &value->sigma_s, &in, &out);
    return out;
  }
  const float a = (float)value->sigma_a, s = (float)value->sigma_s, narrow = (float)in;
  float out;
  core_varying_eval(varying, quantity, 1, &a, &s, &narrow, &out);
  return (double)out;
}

static uint8_t check(const core_varying *varying, const struct value *value,
                     core_varying_range *range) {
  uint8_t status;
  core_varying_check(varying, false, 1, &value->sigma_a, &value->sigma_s, &value->r, &status,
                     range);
  return status;
}

/* Compares all quantities of one value with the profile of its medium. f32: of the same model, or
 * NULL. Returns the largest relative error of f64. */
static double compare(const core_varying *f64, const core_varying *f32, const struct value *value,
                      const core_profile *profile) {
  core_varying_range range;
  const uint8_t status = check(f64, value, &range);
  double worst = 0, R;
  if (status == CORE_VALUE_FAR) {
    return 0;
  }
  assert_int_equal(status, CORE_VALUE_OK);
  core_eval_f64(profile, CORE_QUANTITY_R, 1, &value->r, &R);
  for (int i = 0; i < QUANTITIES; i++) {
    double exact;
    core_eval_f64(profile, quantities[i], 1, &value->r, &exact);
    const double own = profile->numerical_error + profile->numerical_error_per_mm * value->r;
    for (int narrow = 0; narrow < (f32 != NULL ? 2 : 1); narrow++) {
      const core_varying *varying = narrow ? f32 : f64;
      /* 2 pi r R and the pdf lose what R loses by underflow, times their factor. */
      const bool follows =
          quantities[i] == CORE_QUANTITY_RING || quantities[i] == CORE_QUANTITY_PDF;
      const double factor = follows && R > 0 ? fmax(exact / R, 1) : 1;
      const double tiny = 64 * (narrow ? 0x1p-149 : 0x1p-1074) * factor;
      const double error = core_varying_error(varying, quantities[i], &range);
      /* Of transport only what the surface adds is allowed, as both come from the same table, whose
       * error, by test_transport_g.c against the solver, is stated besides. */
      const bool transport = f64->model == CORE_MODEL_TRANSPORT;
      const core_radii_range at = {value->r, value->r};
      const double of_table = core_profile_errors(profile, quantities[i], at).numerical;
      /* a medium without absorption is not from the table, but solved */
      assert_true(!transport || value->sigma_a <= 0 || error >= f64->surface_error + of_table);
      const double allowed = transport ? fmin(CORE_VARYING_TOLERANCE, error) : error + own;
      const double found = eval(varying, quantities[i], value);
      const double off = fabs(found - exact);
      if (!(off <= allowed * exact + tiny)) {
        print_message("model %d g %g eta %g sigma_a %g sigma_s %g r %g quantity %d narrow %d: %g "
                      "for %g, off by %g, allowed %g\n",
                      (int)f64->model, f64->g, f64->eta, value->sigma_a, value->sigma_s, value->r,
                      (int)quantities[i], narrow, found, exact, off / exact, allowed);
        fail();
      }
      worst = narrow || exact < 1e-300 ? worst : fmax(worst, off / exact);
    }
  }
  return worst;
}

/* ---- errors ---------------------------------------------------------------------------------- */

UNIT_TEST(dipoles_and_burley_are_within_the_stated_error) {
  uint64_t random = unit_seed();
  const size_t media = count_of("VARYING_MEDIA", 150);
  double worst = 0;
  for (size_t m = 0; m < DIPOLES; m++) {
    const double g = unit_random_between(&random, -0.9, 0.95);
    const double eta = unit_random_between(&random, 0.6, 2);
    core_varying f64 = prepare(dipoles[m], CORE_EVALUATOR_F64, g, eta, NULL);
    core_varying f32 = prepare(dipoles[m], CORE_EVALUATOR_F32, g, eta, NULL);
    for (size_t i = 0; i < media; i++) {
      struct value value = random_value(&random, g, 1e4);
      value.sigma_a =
          dipoles[m] == CORE_MODEL_BURLEY_DMFP ? fmax(value.sigma_a, 1e-9) : value.sigma_a;
      const core_medium medium = {value.sigma_a, value.sigma_s, g, eta};
      core_profile profile = unit_profile(dipoles[m], CORE_EVALUATOR_F64, &medium, NULL);
      worst = fmax(worst, compare(&f64, &f32, &value, &profile));
      double u;
      const double r = eval(&f64, CORE_QUANTITY_RADIUS, &value);
      const double r_f32 = eval(&f32, CORE_QUANTITY_RADIUS, &value);
      core_eval_f64(&profile, CORE_QUANTITY_CDF, 1, &r, &u);
      assert_true(fabs(u - value.u) <= 1e-13);
      core_eval_f64(&profile, CORE_QUANTITY_CDF, 1, &r_f32, &u);
      assert_true(fabs(u - value.u) <= 2 * CORE_SAMPLE_ERROR_F32);
    }
    core_varying_free(&f64);
    core_varying_free(&f32);
  }
  print_message("%zu media of each of %d models, f64: largest error %.2g\n", media, (int)DIPOLES,
                worst);
}

/* A profile of transport from the table of solutions. */
static core_profile tabulated(const core_medium *medium) {
  return unit_profile(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, medium, NULL);
}

UNIT_TEST(transport_is_within_its_tolerance) {
  static const double gs[] = {0, 0.3, 0.8, 0.93, -0.4};
  uint64_t random = unit_seed();
  const size_t media = count_of("VARYING_MEDIA", 40 * RADII) / RADII;
  for (size_t k = 0; k < sizeof gs / sizeof gs[0]; k++) {
    const double g = gs[k], eta = unit_random_between(&random, 0.75, 2.1);
    core_varying f64 = prepare(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, g, eta, NULL);
    core_varying f32 = prepare(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F32, g, eta, NULL);
    assert_true(f64.surface_error <= CORE_VARYING_TOLERANCE);
    double worst = 0, worst_radius = 0;
    for (size_t i = 0; i < media; i++) {
      struct value value = random_value(&random, g, 99);
      value.sigma_a = fmax(value.sigma_a, rounded(2e-6 * value.sigma_s * (1 - g)));
      const core_medium medium = {value.sigma_a, value.sigma_s, g, eta};
      core_profile profile = tabulated(&medium);
      for (int j = 0; j < RADII; j++) {
        worst = fmax(worst, compare(&f64, &f32, &value, &profile));
        double r;
        core_sample_f64(&profile, 1, &value.u, &r);
        if (r < profile.reach.most_mm) {
          worst_radius = fmax(worst_radius, fabs(eval(&f64, CORE_QUANTITY_RADIUS, &value) / r - 1));
        }
        const double sigma_t = value.sigma_a + value.sigma_s * (1 - g);
        value.r = rounded(unit_random_log(&random, 1e-3, 40) / sigma_t);
        value.u = rounded(unit_random_between(&random, 0, 1));
      }
      core_profile_free(&profile);
    }
    print_message("g %g eta %.3f: found %.2g, of sampled radii %.2g, stated for the surface %.2g\n",
                  g, eta, worst, worst_radius, f64.surface_error);
    assert_true(worst_radius <= CORE_VARYING_TOLERANCE);
    core_varying_free(&f64);
    core_varying_free(&f32);
  }
}

/* The surface ends at its least albedo, within a cell. With a small tolerance it is what the profile
 * of a medium is, which comes from the same table. */
UNIT_TEST(surfaces_are_right_at_the_least_albedo) {
  static const double gs[] = {0, 0.5, 0.93, -0.4};
  static const enum core_quantity of[] = {CORE_QUANTITY_R, CORE_QUANTITY_PDF, CORE_QUANTITY_CDF};
  uint64_t random = unit_seed();
  for (size_t i = 0; i < sizeof gs / sizeof gs[0]; i++) {
    core_parameters parameters = core_parameters_none();
    parameters.value[CORE_PARAMETER_TOLERANCE] = 1e-5;
    const double g = gs[i], eta = unit_random_between(&random, 0.75, 2.1);
    core_varying varying = prepare(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, g, eta, &parameters);
    double worst = 0;
    for (int m = 0; m < 24; m++) {
      const double albedo = varying.albedo_least * (1 + unit_random_log(&random, 1e-9, 0.05));
      const core_medium medium = {1 - albedo, albedo / (1 - g), g, eta};
      core_profile profile = tabulated(&medium);
      for (int k = 0; k < 30; k++) {
        const double r = unit_random_log(&random, 1e-4, 15);
        for (int q = 0; q < 3; q++) {
          double exact, found;
          core_eval_f64(&profile, of[q], 1, &r, &exact);
          core_varying_eval(&varying, of[q], 1, &medium.sigma_a_per_mm, &medium.sigma_s_per_mm, &r,
                            &found);
          const double off = fabs(found / exact - 1);
          worst = fmax(worst, off);
          /* the profile is within 3e-6 of the table (tests/accuracy/test_transport_g.c) */
          UNIT_FAIL_IF(!(off <= varying.surface_error + 3e-6),
                       "g %g, eta %g, albedo %.9g, r %g, quantity %d: off by %.3g, stated %.3g", g,
                       eta, albedo, r, (int)of[q], off, varying.surface_error);
        }
      }
      core_profile_free(&profile);
    }
    print_message("g %g: off by %.2g, stated %.2g\n", g, worst, varying.surface_error);
    core_varying_free(&varying);
  }
}

/* Compares a surface with the series of the table of solutions for one medium: R, the pdf, the cdf
 * and the sampled radius at random places. Returns the largest error over what is stated. */
static double compare_medium(const core_varying *varying, const rows *all, struct value value,
                             uint64_t *random) {
  static rows_row row;
  const double sigma_t = value.sigma_a + value.sigma_s * (1 - varying->g);
  const double s = sqrt(value.sigma_a / sigma_t);
  rows_fill(all, s, value.sigma_s * (1 - varying->g) / sigma_t / (1 + s), &row);
  double share = 0;
  for (int j = 0; j < 4 * RADII; j++) {
    core_varying_range range;
    double Q, x = unit_random_log(random, 1e-5, 60);
    const double ln_x = log(x), u = unit_random_between(random, 0, 1);
    value.r = x / sigma_t;
    value.u = u;
    if (check(varying, &value, &range) == CORE_VALUE_OK) {
      rows_Q(&row, 1, &ln_x, &Q);
      const double kx = row.kappa * x;
      const double R = sigma_t * sigma_t * row.albedo * (1 + kx) / x * exp(Q - kx);
      const double pdf = 2 * PI * value.r * R / row.total;
      const double off[] = {eval(varying, CORE_QUANTITY_R, &value) / R - 1,
                            eval(varying, CORE_QUANTITY_CDF, &value) / rows_cdf(&row, x) - 1,
                            0.5 * (eval(varying, CORE_QUANTITY_PDF, &value) / pdf - 1)};
      for (int i = 0; i < 3; i++) { /* half of a pdf's, which has the total's error besides */
        share = fmax(share, fabs(off[i]) / varying->surface_error);
      }
    }
    rows_found found = {0};
    x = u <= 0.5 ? rows_radius(&row, u, &found) : rows_radius_of_rest(&row, 1 - u, &found);
    value.r = x / sigma_t;
    if (check(varying, &value, &range) == CORE_VALUE_OK) {
      const double drawn = eval(varying, CORE_QUANTITY_RADIUS, &value);
      share = fmax(share, fabs(drawn / value.r - 1) / varying->surface_error);
    }
  }
  return share;
}

/* A grid of 24 g and 8 eta, between the ends of the table. */
UNIT_TEST(surfaces_of_each_g_and_eta_keep_the_least_tolerance) {
  enum { GS = 24, ETAS = 8, MEDIA = 40 };
  uint64_t random = unit_seed();
  const size_t count = count_of("VARYING_SURFACES", 2);
  double worst = 0, most = 0;
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = CORE_VARYING_TOLERANCE_MIN;
  for (size_t k = 0; k < count; k++) {
    const size_t at = count < GS * ETAS ? unit_random_below(&random, GS * ETAS) : k;
    const double g = -0.5 + 1.45 * (double)(at % GS) / (GS - 1);
    const double eta = 0.7 + 1.5 * (double)(at / GS % ETAS) / (ETAS - 1);
    core_varying varying = prepare(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, g, eta, &parameters);
    assert_true(varying.table_g >= g && varying.table_g <= g);
    assert_true(varying.surface_error > 0 && varying.surface_error <= CORE_VARYING_TOLERANCE_MIN);
    rows *all = rows_create(transport_table_shipped(), g, eta, CORE_VARYING_TOLERANCE_MIN);
    assert_non_null(all);
    double share = 0;
    for (int i = 0; i < MEDIA; i++) {
      share = fmax(share, compare_medium(&varying, all, random_value(&random, g, 99), &random));
    }
    rows_free(all);
    UNIT_FAIL_IF(!(share <= 1), "g %g eta %g: %.2f of what is stated, %g", g, eta, share,
                 varying.surface_error);
    worst = fmax(worst, share);
    most = fmax(most, varying.surface_error);
    core_varying_free(&varying);
  }
  print_message("%zu surfaces: at most %.2f of what is stated, at most %.2g\n", count, worst, most);
}

UNIT_TEST(transport_without_absorption_is_continued_to_the_limit) {
  core_varying varying = prepare(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, 0, 1.4, NULL);
  const struct value value = {0, 1, 3, 0.5};
  const core_medium medium = {0, 1, 0, 1.4};
  core_profile profile = unit_profile(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, &medium, NULL);
  compare(&varying, NULL, &value, &profile);
  core_profile_free(&profile);
  core_varying_free(&varying);
}

/* ---- colours --------------------------------------------------------------------------------- */

/* The albedo of a medium under the model itself: for g = 0, transport is solved. */
static double albedo_of(unsigned model, const core_medium *medium) {
  core_profile profile = unit_profile(model, CORE_EVALUATOR_F64, medium, NULL);
  const double albedo = profile.albedo;
  core_profile_free(&profile);
  return albedo;
}

static void round_trips(unsigned model, double g, double eta, size_t count, uint64_t *state) {
  core_varying varying = prepare(model, CORE_EVALUATOR_F64, g, eta, NULL);
  const core_colour what = {CORE_LIGHT_BEAM, true, CORE_LENGTH_DIFFUSE};
  const double rho = varying.specular[CORE_LIGHT_BEAM];
  double worst = 0;
  for (size_t i = 0; i < count; i++) {
    const double most = fmin(0.999 * varying.colour_most[CORE_LIGHT_BEAM], 0.999);
    const double entered = unit_random_between(state, 0.01, most), length = 0.7;
    const double colour = rho + (1 - rho) * entered;
    double a, s, albedo;
    uint8_t status;
    core_varying_invert(&varying, &what, 1, &colour, &length, &a, &s, &albedo, &status);
    assert_int_equal(status, CORE_VALUE_OK);
    const core_medium medium = {a, s, g, eta};
    worst = fmax(worst, fabs(albedo_of(model, &medium) - entered));
    assert_true(fabs(albedo - s / (a + s)) < 1e-12);
    const double sigma_t = a + s * (1 - g), absorbed = a / sigma_t;
    assert_true(fabs(length * sigma_t * sqrt(3 * absorbed / (1 + absorbed)) - 1) < 1e-6);
  }
  print_message("model %u, g %g, eta %.3f: %zu colours, albedo off by %.2g at most\n", model, g,
                eta, count, worst);
  assert_true(worst < CORE_COLOUR_ERROR);
  core_varying_free(&varying);
}

UNIT_TEST(colours_lead_to_media_that_have_them) {
  uint64_t random = unit_seed();
  for (size_t m = 0; m < DIPOLES; m++) {
    round_trips(dipoles[m], 0.5,
                unit_random_between(&random, CORE_COLOUR_ETA_MIN, CORE_COLOUR_ETA_MAX), 200,
                &random);
  }
  round_trips(CORE_MODEL_TRANSPORT, 0, 1.4, count_of("VARYING_SOLVED", 10), &random);
  round_trips(CORE_MODEL_TRANSPORT, 0.8, 2.1, 200, &random);
  round_trips(CORE_MODEL_TRANSPORT, -0.3, 1.1, 200, &random);
}

/* The same by the solver, for any g and both lights. */
UNIT_TEST(colours_lead_to_media_that_have_them_by_the_solver) {
  uint64_t random = unit_seed();
  const size_t count = count_of("VARYING_SOLVED", 4);
  double worst = 0;
  for (size_t i = 0; i < count; i++) {
    const double g = i % 2 == 0 ? 0.8 : unit_random_between(&random, -0.5, 0.95);
    const double eta = unit_random_between(&random, 0.7, 2.2), length = 0.3;
    const double colour = unit_random_between(&random, 0.01, 0.97);
    const core_colour what = {i % 4 < 2 ? CORE_LIGHT_BEAM : CORE_LIGHT_DIFFUSE, false,
                              CORE_LENGTH_EXTINCTION};
    const solver_phase phase = {g, 0, NULL};
    core_varying varying = prepare(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, g, eta, NULL);
    solver_total totals;
    double a, s, albedo;
    uint8_t status;
    core_varying_invert(&varying, &what, 1, &colour, &length, &a, &s, &albedo, &status);
    assert_int_equal(status, CORE_VALUE_OK);
    unit_accept(solver_totals(&totals, core_isa_select(NULL), a / (s * (1 - g)), &phase, &eta, 1));
    assert_true(fabs((a + s) * length - 1) < 1e-6);
    const double found = what.light == CORE_LIGHT_BEAM ? totals.normal.value : totals.diffuse.value;
    UNIT_FAIL_IF(!(fabs(found - colour) < CORE_COLOUR_ERROR), "g %g eta %g light %d: %g for %g", g,
                 eta, (int)what.light, found, colour);
    worst = fmax(worst, fabs(found - colour));
    core_varying_free(&varying);
  }
  print_message("%zu colours, albedo by the solver off by %.2g at most\n", count, worst);
}

/* ---- bits and words -------------------------------------------------------------------------- */

/* Asserts that the errors of a range of albedos are the largest ones of media in it. */
static void compare_errors_of_range(const core_varying *varying, enum core_quantity quantity,
                                    core_varying_range range) {
  enum { COUNT = 3000 };
  double numerical = 0;
  const double least = range.albedo_least, most = range.albedo_most;
  const double stated = core_varying_error(varying, (unsigned)quantity, &range);
  for (int i = 0; i < COUNT; i++) {
    range.albedo_least = range.albedo_most = i == 0 ? least : most - (most - least) * i / COUNT;
    numerical = fmax(numerical, core_varying_error(varying, (unsigned)quantity, &range));
  }
  assert_true(numerical <= stated && numerical >= 0.99 * stated);
}

UNIT_TEST(the_errors_of_a_range_are_the_largest_of_its_media) {
  static const unsigned models[] = {CORE_MODEL_BETTER, CORE_MODEL_BURLEY, CORE_MODEL_TRANSPORT};
  static const double gs[] = {0, 0.7, 0.95};
  uint64_t random = unit_seed();
  for (int i = 0; i < 9; i++) {
    core_varying varying = prepare(models[i / 3], CORE_EVALUATOR_F64, gs[i % 3], 1.4, NULL);
    for (int k = 0; k < 6; k++) {
      const double most = 1 - unit_random_log(&random, 1e-3, 0.3);
      const double reach = unit_random_log(&random, 0.1, 19);
      compare_errors_of_range(&varying, quantities[k % QUANTITIES],
                              (core_varying_range){.computed = 2,
                                                   .albedo_least = most * (k < 3 ? 0.9 : 0.2),
                                                   .albedo_most = most,
                                                   .mfp_least = 0.011,
                                                   .mfp_most = reach});
    }
    core_varying_free(&varying);
  }
}

/* Compares the bits of all kernels of one preparation with those of another, in two pieces: for
 * each place of the cut that is a multiple of `step`. */
static void compare_bits(const core_varying *whole, const core_varying *pieces, size_t step,
                         uint64_t *state) {
  float a[LENGTH_MAX + 1], s[LENGTH_MAX + 1], r[LENGTH_MAX + 1], u[LENGTH_MAX + 1];
  float one[LENGTH_MAX], other[LENGTH_MAX];
  for (int i = 0; i < LENGTH_MAX; i++) {
    const struct value value = random_value(state, whole->g, 50);
    a[i + 1] = (float)value.sigma_a;
    s[i + 1] = (float)value.sigma_s;
    r[i + 1] = i == 0 ? 0 : (float)value.r;
    u[i + 1] = (float)value.u;
  }
  for (int i = 0; i <= QUANTITIES; i++) {
    const enum core_quantity quantity = i < QUANTITIES ? quantities[i] : CORE_QUANTITY_RADIUS;
    const float *in = i < QUANTITIES ? r : u;
    for (size_t cut = 0; cut <= LENGTH_MAX; cut += step) {
      for (int piece = 0; piece < 2; piece++) {
        const size_t at = 1 + (piece == 0 ? 0 : cut), n = piece == 0 ? cut : LENGTH_MAX - cut;
        core_varying_eval(pieces, quantity, n, a + at, s + at, in + at, other + at - 1);
      }
      core_varying_eval(whole, quantity, LENGTH_MAX, a + 1, s + 1, in + 1, one);
      assert_memory_equal(one, other, sizeof one);
    }
  }
}

UNIT_TEST(copied_words_give_the_same_bits_and_wrong_ones_are_refused) {
  uint64_t random = unit_seed();
  core_varying made = prepare(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F32, 0.6, 1.4, NULL);
  core_varying opened;
  const size_t count = made.words_count;
  float *words = malloc(count * sizeof *words);
  memcpy(words, made.words, count * sizeof *words);
  unit_accept(core_varying_open(&opened, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                                CORE_MOMENTS_EXACT, CORE_EVALUATOR_F32, 0.6, 1.4, NULL, words,
                                count));
  compare_bits(&made, &opened, 1, &random);
  core_varying_free(&opened);
  unit_assert_fault(core_varying_open(&opened, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                                      CORE_MOMENTS_EXACT, CORE_EVALUATOR_F32, 0.6, 1.4, NULL, words,
                                      count - 1),
                    "table", 0);
  /* Any bits in the words lead to a fault or to values, never to a read outside of them. */
  for (int i = 0; i < 300; i++) {
    const size_t at = unit_random_below(&random, unit_random_below(&random, 2) ? 512 : count);
    unit_random_bytes(&random, &words[at], sizeof *words);
    if (core_varying_open(&opened, core_isa_select(NULL), CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT,
                          CORE_EVALUATOR_F32, 0.6, 1.4, NULL, words, count)
            .field == NULL) {
      compare_bits(&opened, &opened, LENGTH_MAX, &random);
      core_varying_free(&opened);
    }
    words[at] = made.words[at];
  }
  free(words);
  core_varying_free(&made);
}

/* ---- derivatives ----------------------------------------------------------------------------- */

UNIT_TEST(derivatives_are_those_of_ln_R) {
  static const unsigned models[] = {CORE_MODEL_BETTER, CORE_MODEL_BURLEY, CORE_MODEL_TRANSPORT};
  uint64_t random = unit_seed();
  for (size_t m = 0; m < sizeof models / sizeof models[0]; m++) {
    core_varying varying = prepare(models[m], CORE_EVALUATOR_F64, 0.4, 1.4, NULL);
    for (int i = 0; i < 300; i++) {
      const struct value value = random_value(&random, 0.4, 50);
      double ln_R[3], by[2], other[2];
      for (int k = -1; k <= 1; k++) {
        /* Along sigma_a = sigma_a0 e^t, sigma_s = sigma_s0 e^(-2 t). */
        const double t = 1e-6 * k, a = value.sigma_a * (1 + t), s = value.sigma_s * (1 - 2 * t);
        double *const to = k == 0 ? by : other;
        const core_gradient out = {&ln_R[k + 1], &to[0], &to[1]};
        core_varying_gradient_f64(&varying, 1, &a, &s, &value.r, &out);
      }
      struct value same = value;
      assert_true(fabs(ln_R[1] - log(eval(&varying, CORE_QUANTITY_R, &same))) < 1e-9 ||
                  ln_R[1] < -600);
      /* Cells of a surface meet up to single precision: where an edge lies between two of the values,
       * one side is the slope. */
      const double slope = by[0] - 2 * by[1];
      const double off = fmin(
          fabs(ln_R[2] - ln_R[0] - 2e-6 * slope) / 2,
          fmin(fabs(ln_R[2] - ln_R[1] - 1e-6 * slope), fabs(ln_R[1] - ln_R[0] - 1e-6 * slope)));
      assert_true(off < 1e-11 * (1 + fabs(slope)));
    }
    core_varying_free(&varying);
  }
}
