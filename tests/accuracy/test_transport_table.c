/* The table of transport against the solver, at media and radii of its own; and what is refused. */
#include <math.h>

#include "core/kernels.h"
#include "core/solver/solver.h"
#include "core/transport/table.h"
#include "tests/accuracy/isotropic/isotropic.h"
#include "tests/unit/unit.h"

#define PI 3.14159265358979323846
#define SOLVER_TOLERANCE 1e-7

extern core_prepare_function core_transport_prepare;

/* ---- profiles from the table -------------------------------------------------------------- */

/* A profile in mean free paths; tabulated: how far a table may be off. */
static core_preparation prepare(double albedo, double eta, double tabulated) {
  const core_medium medium = {1 - albedo, albedo, 0, eta};
  const core_parameters parameters = core_parameters_none();
  const core_inputs inputs = {.moments = CORE_MOMENTS_EXACT,
                              .medium = &medium,
                              .parameters = &parameters,
                              .isa = core_isa_select(NULL),
                              .accepted = tabulated};
  core_preparation preparation = {.cost = 1};
  unit_accept(core_transport_prepare(&inputs, &preparation));
  assert_non_null(preparation.table);
  return preparation;
}

static double evaluate(const core_preparation *preparation, enum core_elementwise quantity,
                       double r) {
  const struct core_kernels *kernels =
      core_isa_kernels(core_isa_select(NULL), CORE_MODEL_TRANSPORT);
  double out;
  core_run_f64(kernels->f64, kernels->f64->evaluate[quantity], preparation->table, 1, &r, &out);
  return out;
}

static double shipped_error(void) {
  const transport_table *table = transport_table_shipped();
  assert_non_null(table);
  return transport_table_error(table, 0.5, 0, 1, 0, (double)INFINITY);
}

/* ---- the error ---------------------------------------------------------------------------- */

enum { ETAS = 6, ETAS_LONG = 12, ALBEDOS = 5, RADII = 120 };

/* The ends of the domain and both sides of 1, then random ones. */
static const double fixed_etas[] = {0.7, 0.9999, 1, 1.0001, 2.2};
static const double fixed_albedos[] = {0.01, 1 - 1e-6};

struct worst {
  double error, albedo, eta, x;
  size_t count;
};

static void compare(struct worst *worst, double value, double truth, double albedo, double eta,
                    double x) {
  const double error = fmax(0, fabs(value / truth - 1) - SOLVER_TOLERANCE);
  if (!(error <= worst->error)) {
    *worst = (struct worst){error, albedo, eta, x, worst->count};
  }
  worst->count++;
}

static void report(const char *what, const struct worst *worst) {
  printf("%-8s %6zu values, error at most %.2g: albedo %.8g, eta %.6g, x %.4g\n", what,
         worst->count, worst->error, worst->albedo, worst->eta, worst->x);
}

struct worsts {
  struct worst R, total, within;
};

static void compare_medium(struct worsts *worst, double albedo, double eta, uint64_t *random) {
  isotropic_solution *solution = isotropic_solve(eta, albedo, SOLVER_TOLERANCE, ISOTROPIC_REACH);
  core_preparation preparation = prepare(albedo, eta, 1e-4);
  compare(&worst->total, preparation.albedo, isotropic_total(solution), albedo, eta, 0);
  for (int i = 0; i < RADII; i++) {
    const double x = i == 0 ? 0.001 : i == 1 ? 30 : unit_random_log(random, 1e-8, 1e4);
    const isotropic_values truth = isotropic_at(solution, x);
    if (truth.R > TRANSPORT_TABLE_R_LEAST) {
      const double R = evaluate(&preparation, CORE_ELEMENTWISE_R, x);
      const double cdf = evaluate(&preparation, CORE_ELEMENTWISE_CDF, x);
      compare(&worst->R, R, truth.R, albedo, eta, x);
      compare(&worst->within, cdf * preparation.albedo, truth.within, albedo, eta, x);
    }
  }
  free(preparation.table);
  isotropic_free(solution);
}

/* Draws an albedo. For even i the logarithm of 1 - albedo is uniform, for odd i that of the albedo.
 */
static double random_albedo(uint64_t *random, size_t i) {
  return i % 2 == 0 ? 1 - unit_random_log(random, 1e-6, 0.99)
                    : unit_random_log(random, 0.01, 1 - 1e-6);
}

/* Returns the error that the table states of the total for diffuse light. */
static double diffuse_error(const transport_table *table, double albedo) {
  return table->field[TRANSPORT_TABLE_DIFFUSE_ERRORS + transport_table_albedo_band(albedo)];
}

UNIT_TEST(the_quoted_error_holds) {
  struct worsts worst = {0};
  uint64_t random = unit_seed();
  const size_t etas = unit_is_long() ? ETAS_LONG : ETAS;
  for (size_t e = 0; e < etas; e++) {
    const double eta = e < sizeof fixed_etas / sizeof fixed_etas[0]
                           ? fixed_etas[e]
                           : unit_random_between(&random, 0.7, 2.2);
    for (size_t i = 0; i < ALBEDOS; i++) {
      const double albedo = i < 2 ? fixed_albedos[i] : random_albedo(&random, i);
      compare_medium(&worst, albedo, eta, &random);
    }
  }
  report("R", &worst.R);
  report("total", &worst.total);
  report("within r", &worst.within);
  printf("quoted: %.2g\n", shipped_error());
  assert_true(worst.R.count > etas * ALBEDOS * RADII / 2);
  assert_true(worst.R.error <= shipped_error() + 1e-8);
  assert_true(worst.total.error <= shipped_error());
  assert_true(worst.within.error <= 2 * shipped_error() + 1e-8);
  assert_true(shipped_error() <= 1e-4);
}

/* ---- scattering that is not isotropic ------------------------------------------------------- */

static double hold_total(double total, transport_number truth, double stated) {
  const double error = fabs(total - truth.value) / truth.value;
  assert_true(error <= stated + truth.error / truth.value);
  return error;
}

UNIT_TEST(totals_of_all_g_hold) {
  uint64_t random = unit_seed();
  double worst = 0;
  for (size_t i = 0; i < 40; i++) {
    const double eta = unit_random_between(&random, 0.7, 2.2), albedo = random_albedo(&random, i);
    const solver_phase phase = {unit_random_between(&random, -0.5, 0.95), 0, NULL};
    solver_total truth;
    unit_accept(
        solver_totals(&truth, core_isa_select(NULL), (1 - albedo) / albedo, &phase, &eta, 1));
    transport_slice *slice = transport_slice_create(transport_table_shipped(), phase.g, eta);
    assert_non_null(slice);
    const double beam = transport_slice_total(slice, false, albedo);
    const double diffuse = transport_slice_total(slice, true, albedo);
    free(slice);
    const double stated = transport_table_total_error(transport_table_shipped(), phase.g);
    worst = fmax(worst, hold_total(beam, truth.normal, stated));
    worst = fmax(worst, hold_total(diffuse, truth.diffuse,
                                   diffuse_error(transport_table_shipped(), albedo)));
  }
  printf("totals: off by at most %.2g\n", worst);
}

/* The difference vanishes with g, and albedo 1 is included. */
UNIT_TEST(the_difference_is_continuous) {
  const transport_table *table = transport_table_shipped();
  transport_series isotropic, series;
  transport_table_look_up(table, 0.97, 0, 1.4, &isotropic);
  transport_table_look_up(table, 0.97, 1e-9, 1.4, &series);
  for (double y = isotropic.edge[0]; y < isotropic.edge[TRANSPORT_TABLE_PANELS]; y += 0.5) {
    const double off = transport_series_at(&series, y) - transport_series_at(&isotropic, y);
    assert_true(fabs(off) < transport_table_error(table, 0.97, 1e-9, 1.4, exp(y), exp(y)));
  }
  transport_series conservative, nearly;
  transport_table_look_up(table, 1, 0.9, 1.4, &conservative);
  transport_table_look_up(table, 1 - 1e-9, 0.9, 1.4, &nearly);
  assert_true(conservative.kappa == 0 && fabs(conservative.total - 1) < 1e-4);
  for (double y = -25; y < 15; y += 0.5) {
    double one, other;
    transport_series_Q(&conservative, 1, &y, &one);
    transport_series_Q(&nearly, 1, &y, &other);
    assert_true(fabs(one - other) < 1e-3);
  }
}

UNIT_TEST(the_table_says_what_it_covers) {
  const transport_table *table = transport_table_shipped();
  const double none = (double)NAN;
  assert_true(transport_table_covers(table, 0.01, -0.5, 0.7));
  assert_true(transport_table_covers(table, 1 - 1e-6, 0.95, 2.2));
  assert_true(transport_table_covers(table, 1, 0.9, 1.4));
  assert_true(transport_table_covers(table, 1, 0, 0.7));
  assert_false(transport_table_covers(table, 0.9, 0.96, 1.4));
  assert_false(transport_table_covers(table, 0.9, -0.6, 1.4));
  assert_false(transport_table_covers(table, 0.005, 0.9, 1.4));
  assert_false(transport_table_covers(table, 0.9, none, 1.4));
  const double nearest = transport_table_error(table, 0.9, 0.9, 1.4, 0, 0.01);
  const double far = transport_table_error(table, 0.9, 0.9, 1.4, 2, 3);
  assert_true(nearest > 0 && far > 0);
  assert_true(transport_table_error(table, 0.9, 0.9, 1.4, 0, 3) >= fmax(nearest, far));
  assert_true(transport_table_error(table, 0.95, 0.8, 1.4, 0.05, 20) <= 4.5e-4);
  assert_true(transport_table_error(table, 0.6, 0.95, 2.2, 0.01, 20) <= 1.3001e-3);
  assert_true(transport_table_error(table, 0.01, -0.5, 2.2, 0, (double)INFINITY) <= 1.2001e-3);
  static const double gs[] = {-0.5, -0.21, 0.08, 0.37, 0.66, 0.9, 0.95};
  for (int step = 1; step <= 100; step++) {
    const double albedo = step < 100 ? 0.01 * step : 1 - 1e-6;
    for (size_t i = 0; i < sizeof gs / sizeof gs[0]; i++) {
      for (double eta = 0.7; eta < 2.2; eta += 0.4) { /* as README.md has it, or less */
        const double g = gs[i];
        const double near = transport_table_error(table, albedo, g, eta, 0, 0.049);
        const double middle = transport_table_error(table, albedo, g, eta, 0.05, 10);
        const double further = transport_table_error(table, albedo, g, eta, 10, 100);
        const double beyond = transport_table_error(table, albedo, g, eta, 100, (double)INFINITY);
        assert_true(fmax(near, fmax(middle, further)) <= 1.3001e-3);
        assert_true(g > 0.85 || near <= 8.5001e-4);
        assert_true(g > 0.85 || middle <= (g < -0.25 && albedo < 0.1 ? 1.2001e-3 : 7.5001e-4));
        assert_true(g < 0.85 || albedo < 0.5 || (middle <= 1.1001e-3 && further <= 8.5001e-4));
        assert_true(g > 0.85 || further <= (g < -0.25 ? 1.2001e-3 : 7.7001e-4));
        assert_true(beyond <= (g < -0.25 ? 3.5001e-3 : g > 0.85 ? 3.0001e-3 : 2.2001e-3));
      }
    }
  }
  assert_true(transport_table_total_error(table, 0.8) <= 2e-6);
  assert_true(diffuse_error(table, 0.95) <= 1e-6);
  assert_true(diffuse_error(table, 0.6) <= 3e-6);
  assert_true(diffuse_error(table, 0.2) <= 1e-6);
  assert_true(diffuse_error(table, 0.05) <= 4e-6);
}

/* ---- what it is used for ------------------------------------------------------------------ */

UNIT_TEST(the_table_serves_what_it_covers) {
  static const struct {
    double albedo, eta, more; /* than the table's error */
  } media[] = {{0.9, 1.4, 0}, {0.01, 0.7, 0}, {1 - 1e-6, 2.2, 0}, {1, 1.4, 6e-6}, {0.9, 1, 1.6e-5}};
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    core_preparation preparation = prepare(media[i].albedo, media[i].eta, 0);
    assert_true(fabs(preparation.error - media[i].more - shipped_error() - 1e-8) < 1e-15);
    assert_true(preparation.slope_error > preparation.error);
    free(preparation.table);
  }
  const double none = (double)NAN;
  const transport_table *table = transport_table_shipped();
  assert_false(transport_table_covers(table, none, 0, 1.4));
  assert_false(transport_table_covers(table, 0.9, 0, none));
}

/* Far outside, where only the asymptotics are left, nothing is lost but light. */
UNIT_TEST(radii_outside_are_continued) {
  for (int i = 0; i < 2; i++) {
    core_preparation preparation = prepare(fixed_albedos[i], 1.4, 1e-4);
    double before = (double)INFINITY;
    for (double r = 1e-14; r < 1e6; r *= 1.1) {
      const double R = evaluate(&preparation, CORE_ELEMENTWISE_R, r);
      assert_true(R >= 0 && R <= before);
      before = R;
    }
    free(preparation.table);
  }
}

/* ---- what is refused ---------------------------------------------------------------------- */

struct copy {
  uint8_t *bytes;
  size_t length;
};

/* Of the shipped table, at an odd address. */
static struct copy copy_shipped(uint8_t **memory) {
  const size_t length = (size_t)(transport_table_data_end - transport_table_data);
  *memory = malloc(length + 2);
  assert_non_null(*memory);
  memcpy(*memory + 1, transport_table_data, length);
  (*memory)[length + 1] = 0;
  return (struct copy){*memory + 1, length};
}

static bool opens(struct copy copy) {
  transport_table table;
  const bool good = transport_table_open(&table, copy.bytes, copy.length);
  if (good) {
    transport_table_close(&table);
  }
  return good;
}

UNIT_TEST(damaged_tables_are_refused) {
  uint8_t *memory;
  const struct copy copy = copy_shipped(&memory);
  const size_t step = unit_is_long() ? 101 : 1009;
  printf("%zu bytes\n", copy.length);
  assert_true(opens(copy));
  for (size_t i = 0; i < copy.length; i += i < TRANSPORT_TABLE_HEADER_BYTES ? 1 : step) {
    for (int bit = 0; bit < 8; bit += 7) {
      copy.bytes[i] ^= (uint8_t)(1 << bit);
      assert_false(opens(copy));
      copy.bytes[i] ^= (uint8_t)(1 << bit);
    }
  }
  for (size_t length = 0; length < copy.length; length += length < 200 ? 1 : 10 * step) {
    assert_false(opens((struct copy){copy.bytes, length}));
  }
  assert_false(opens((struct copy){copy.bytes, copy.length - 1}));
  assert_false(opens((struct copy){copy.bytes, copy.length + 1}));
  copy.bytes[8]++;
  assert_false(opens(copy));
  copy.bytes[8]--;
  assert_true(opens(copy));
  free(memory);
}
