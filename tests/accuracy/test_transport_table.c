/* The table of transport against the solver, at media and radii of its own; and what is refused. */
#include <math.h>

#include "core/kernels.h"
#include "core/transport/table.h"
#include "core/transport/transport.h"
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
                              .tabulated = tabulated};
  core_preparation preparation = {.cost = 1};
  unit_assert_fault(core_transport_prepare(&inputs, &preparation), NULL, 0);
  assert_non_null(preparation.table);
  return preparation;
}

static double evaluate(const core_preparation *preparation, enum core_elementwise quantity,
                       double r) {
  const struct core_kernels *kernels =
      core_isa_kernels(core_isa_select(NULL), CORE_MODEL_TRANSPORT);
  double out;
  kernels->f64->evaluate[quantity](preparation->table, 1, &r, &out);
  return out;
}

static double shipped_error(void) {
  const transport_table *table = transport_table_shipped();
  assert_non_null(table);
  return transport_table_error(table);
}

/* ---- the error ---------------------------------------------------------------------------- */

enum { ETAS = 12, ALBEDOS = 8, RADII = 120 };

/* The ends of the domain and both sides of 1, then random ones. */
static const double fixed_etas[] = {0.7, 0.9999, 1, 1.0001, 2.2};
static const double fixed_albedos[] = {0.01, 1 - 1e-6};

struct worst {
  double error, albedo, eta, x;
  size_t count;
};

static void compare(struct worst *worst, double value, transport_number truth, double albedo,
                    double eta, double x) {
  const double error = fmax(0, fabs(value - truth.value) - truth.error) / truth.value;
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

static void compare_medium(struct worsts *worst, transport_boundary *boundary, double albedo,
                           double eta, uint64_t *random) {
  transport_solution *solution;
  unit_assert_fault(transport_solve(&solution, boundary, albedo), NULL, 0);
  core_preparation preparation = prepare(albedo, eta, 1e-4);
  compare(&worst->total, preparation.albedo, transport_total(solution), albedo, eta, 0);
  for (int i = 0; i < RADII; i++) {
    const double x = i == 0 ? 0.001 : i == 1 ? 30 : unit_random_log(random, 1e-8, 1e4);
    const transport_values truth = transport_at(solution, x);
    if (truth.R.value > TRANSPORT_TABLE_R_LEAST) {
      const double R = evaluate(&preparation, CORE_ELEMENTWISE_R, x);
      const double cdf = evaluate(&preparation, CORE_ELEMENTWISE_CDF, x);
      compare(&worst->R, R, truth.R, albedo, eta, x);
      compare(&worst->within, cdf * preparation.albedo, truth.within, albedo, eta, x);
    }
  }
  free(preparation.table);
  transport_solution_free(solution);
}

/* 1 - a equally dense in its logarithm, or a. */
static double random_albedo(uint64_t *random, size_t i) {
  return i % 2 == 0 ? 1 - unit_random_log(random, 1e-6, 0.99)
                    : unit_random_log(random, 0.01, 1 - 1e-6);
}

UNIT_TEST(the_quoted_error_holds) {
  struct worsts worst = {0};
  uint64_t random = unit_seed();
  for (size_t e = 0; e < ETAS; e++) {
    const double eta = e < sizeof fixed_etas / sizeof fixed_etas[0]
                           ? fixed_etas[e]
                           : unit_random_between(&random, 0.7, 2.2);
    transport_boundary *boundary;
    unit_assert_fault(transport_boundary_create(&boundary, eta, SOLVER_TOLERANCE), NULL, 0);
    for (size_t i = 0; i < ALBEDOS; i++) {
      const double albedo = i < 2 ? fixed_albedos[i] : random_albedo(&random, i);
      compare_medium(&worst, boundary, albedo, eta, &random);
    }
    transport_boundary_free(boundary);
  }
  report("R", &worst.R);
  report("total", &worst.total);
  report("within r", &worst.within);
  printf("quoted: %.2g\n", shipped_error());
  assert_true(worst.R.count > ETAS * ALBEDOS * RADII / 2);
  assert_true(worst.R.error <= shipped_error() + 1e-8);
  assert_true(worst.total.error <= shipped_error());
  assert_true(worst.within.error <= 2 * shipped_error() + 1e-8);
  assert_true(shipped_error() <= 1e-4);
}

/* 2 pi r R over all radii by the trapezoidal rule over ln r, which converges exponentially. */
static double ring_sum(const core_preparation *preparation) {
  double sum = 0;
  for (double y = -25; y < 25; y += 0.02) {
    const double r = exp(y);
    sum += 0.02 * r * evaluate(preparation, CORE_ELEMENTWISE_RING, r);
  }
  return sum;
}

UNIT_TEST(the_energy_is_the_albedo) {
  uint64_t random = unit_seed();
  for (size_t i = 0; i < 60; i++) {
    const double eta = unit_random_between(&random, 0.7, 2.2);
    const double albedo = i < 2 ? fixed_albedos[i] : random_albedo(&random, i);
    core_preparation preparation = prepare(albedo, eta, 1e-4);
    assert_true(fabs(evaluate(&preparation, CORE_ELEMENTWISE_CDF, (double)INFINITY) - 1) < 1e-12);
    assert_true(fabs(evaluate(&preparation, CORE_ELEMENTWISE_CDF, 1e6) - 1) < 1e-9);
    assert_true(evaluate(&preparation, CORE_ELEMENTWISE_CDF, 0) == 0);
    const double off = fabs(ring_sum(&preparation) / preparation.albedo - 1);
    if (!(off <= 2 * preparation.error + 1e-8)) {
      fail_msg("albedo %.17g, eta %.17g: the ring is off by %g", albedo, eta, off);
    }
    free(preparation.table);
  }
}

/* ---- what it is used for ------------------------------------------------------------------ */

static void assert_source(double albedo, double eta, double tabulated, bool from_table) {
  core_preparation preparation = prepare(albedo, eta, tabulated);
  const double by_default = 1e-5;
  const double quoted = shipped_error() + 1e-8;
  assert_true(preparation.error == (from_table ? quoted : by_default));
  free(preparation.table);
}

UNIT_TEST(the_table_serves_what_it_covers) {
  const double none = (double)NAN;
  assert_source(0.9, 1.4, 1e-4, true);
  assert_source(0.9, 1.4, 0.1, true);
  assert_source(0.9, 1.4, shipped_error(), false);
  assert_source(0.9, 1.4, 0, false);
  assert_source(0.01, 0.7, 1e-4, true);
  assert_source(1 - 1e-6, 2.2, 1e-4, true);
  assert_source(0.005, 1.4, 1e-4, false);
  assert_source(1 - 1e-7, 1.4, 1e-4, false);
  assert_source(0.9, 0.6, 1e-4, false);
  assert_source(0.9, 2.4, 1e-4, false);
  assert_source(1, 1, 1e-4, false);
  const transport_table *table = transport_table_shipped();
  assert_false(transport_table_covers(table, none, 1.4));
  assert_false(transport_table_covers(table, 0.9, none));
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
  const transport_table *table = transport_table_shipped();
  assert_non_null(table);
  const uint8_t *begin = table->side[0] - TRANSPORT_TABLE_HEADER_BYTES;
  const size_t length = (size_t)(table->side[TRANSPORT_TABLE_SIDES] - begin);
  *memory = malloc(length + 2);
  assert_non_null(*memory);
  memcpy(*memory + 1, begin, length);
  (*memory)[length + 1] = 0;
  return (struct copy){*memory + 1, length};
}

static bool opens(struct copy copy) {
  transport_table table;
  return transport_table_open(&table, copy.bytes, copy.length);
}

UNIT_TEST(damaged_tables_are_refused) {
  uint8_t *memory;
  const struct copy copy = copy_shipped(&memory);
  printf("%zu bytes\n", copy.length);
  assert_true(opens(copy));
  for (size_t i = 0; i < copy.length; i += i < TRANSPORT_TABLE_HEADER_BYTES ? 1 : 101) {
    for (int bit = 0; bit < 8; bit += 7) {
      copy.bytes[i] ^= (uint8_t)(1 << bit);
      assert_false(opens(copy));
      copy.bytes[i] ^= (uint8_t)(1 << bit);
    }
  }
  for (size_t length = 0; length < copy.length; length += length < 200 ? 1 : 997) {
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

static void seal(struct copy copy) {
  const uint64_t checksum = transport_table_checksum(copy.bytes + 24, copy.length - 24);
  for (int i = 0; i < 8; i++) {
    copy.bytes[16 + i] = (uint8_t)(checksum >> 8 * i);
  }
}

/* With the right checksum, the contents are still looked at. */
UNIT_TEST(nonsense_is_refused) {
  uint8_t *memory;
  const struct copy copy = copy_shipped(&memory);
  uint8_t *first_count = copy.bytes + TRANSPORT_TABLE_HEADER_BYTES;
  static const uint8_t counts[] = {0, 2, TRANSPORT_TABLE_TERMS_MAX + 1, 255};
  for (size_t i = 0; i < sizeof counts; i++) {
    const uint8_t before = *first_count;
    *first_count = counts[i];
    seal(copy);
    assert_false(opens(copy));
    *first_count = before;
  }
  memset(copy.bytes + TRANSPORT_TABLE_HEADER_BYTES + 100, 0xff, 200); /* integers without an end */
  seal(copy);
  assert_false(opens(copy));
  free(memory);
}
