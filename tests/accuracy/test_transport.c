/* The transport solver against what it did not make: vectors of another implementation, totals by H
 * functions, MCML's tables, a plain random walk; and against itself where nothing else is as exact:
 * its error estimates at loose tolerances against its values at the tightest.
 */
#include <float.h>
#include <math.h>
#include <pthread.h>

#include "tests/accuracy/isotropic/isotropic.h"
#include "tests/bench/plain_walk.h"
#include "tests/unit/unit.h"

#define PI 3.14159265358979323846
#define ESTIMATE_FACTOR 3.0 /* no estimate may be smaller than the true error over this */

/* ---- solving ------------------------------------------------------------------------------ */

static isotropic_boundary *boundary_for(double eta, double tolerance) {
  isotropic_boundary *boundary;
  unit_assert_fault(isotropic_boundary_create(&boundary, eta, tolerance), NULL, 0);
  return boundary;
}

static isotropic_solution *solve_with(isotropic_boundary *boundary, double albedo) {
  isotropic_solution *solution;
  unit_assert_fault(isotropic_solve(&solution, boundary, albedo), NULL, 0);
  return solution;
}

static isotropic_solution *solve(double eta, double albedo, double tolerance) {
  isotropic_boundary *boundary = boundary_for(eta, tolerance);
  isotropic_solution *solution = solve_with(boundary, albedo);
  isotropic_boundary_free(boundary);
  return solution;
}

/* ---- comparing ---------------------------------------------------------------------------- */

/* The worst that was seen of a quantity. */
struct worst {
  const char *what;
  double error;    /* relative to the truth */
  double estimate; /* likewise */
  double ratio;    /* of the true error to the estimate */
  size_t count;
};

/* off: the largest absolute error of the truth itself. */
static void compare(struct worst *to, transport_number number, double truth, double off) {
  const double error = fmax(0, fabs(number.value - truth) - off);
  assert_true(isfinite(number.value) && number.value >= 0 && number.error >= 0);
  if (error > 0) {
    to->error = fmax(to->error, error / truth);
    to->ratio = fmax(to->ratio, error / number.error);
  }
  to->estimate = fmax(to->estimate, number.error / truth);
  to->count++;
}

static void report(const struct worst *worst) {
  printf("%-34s %6zu values  error %7.1e  estimate %7.1e  error/estimate %5.2f\n", worst->what,
         worst->count, worst->error, worst->estimate, worst->ratio);
}

static void assert_worst(const struct worst *worst, double bound) {
  report(worst);
  assert_true(worst->count > 0);
  assert_true(worst->error <= bound);
  assert_true(worst->ratio <= ESTIMATE_FACTOR);
}

/* ---- vectors of another implementation ---------------------------------------------------- */

#define VECTORS "../shared/vectors/transport.csv"
#define PRINTED_DIGITS 5.1e-11 /* 11 digits: half of the last one, relative */
#define PRINTED_TOTAL 5.1e-12  /* 12 digits */

/* One row: ratio, eta, albedo, total, r, R, single, multiple, error. */
enum { RATIO, ETA, ALBEDO, TOTAL, RADIUS, VALUE, SINGLE, MULTIPLE, ERROR, COLUMNS };

static bool read_row(char **text, double row[COLUMNS]) {
  for (int i = 0; i < COLUMNS; i++) {
    char *end;
    row[i] = strtod(*text, &end);
    if (end == *text) {
      return false;
    }
    *text = end + 1;
  }
  return true;
}

struct vector_worst {
  struct worst R, single, multiple, total;
};

static void compare_row(struct vector_worst *worst, const isotropic_solution *solution,
                        const double row[COLUMNS]) {
  const isotropic_values values = isotropic_at(solution, row[RADIUS]);
  compare(&worst->R, values.R, row[VALUE], row[ERROR] + PRINTED_DIGITS * row[VALUE]);
  compare(&worst->single, values.single, row[SINGLE], PRINTED_DIGITS * row[SINGLE]);
  compare(&worst->multiple, values.multiple, row[MULTIPLE],
          row[ERROR] + PRINTED_DIGITS * row[MULTIPLE]);
  compare(&worst->total, isotropic_total(solution), row[TOTAL], PRINTED_TOTAL);
}

static void hold_vectors(const char *text, double tolerance) {
  struct vector_worst worst = {{.what = "vectors: R"},
                               {.what = "vectors: single"},
                               {.what = "vectors: multiple"},
                               {.what = "vectors: total"}};
  char *copy = strdup(text);
  char *at = strchr(copy, '\n') + 1;
  double row[COLUMNS], before[COLUMNS] = {0};
  isotropic_solution *solution = NULL;
  while (read_row(&at, row)) {
    if (row[ETA] != before[ETA] || row[ALBEDO] != before[ALBEDO]) {
      isotropic_solution_free(solution);
      solution = solve(row[ETA], row[ALBEDO], tolerance);
    }
    compare_row(&worst, solution, row);
    memcpy(before, row, sizeof row);
  }
  isotropic_solution_free(solution);
  free(copy);
  printf("tolerance %g\n", tolerance);
  assert_worst(&worst.R, tolerance);
  assert_worst(&worst.multiple, tolerance);
  assert_worst(&worst.single, 1e-11);
  assert_worst(&worst.total, 1e-11);
  assert_true(worst.R.count == 64 * 18);
}

UNIT_TEST(vectors_hold) {
  char *text = unit_read_file(VECTORS);
  if (text == NULL) {
    printf("skipped: there is no %s\n", VECTORS);
    skip();
  }
  hold_vectors(text, 1e-7);
  free(text);
}

/* ---- published numbers -------------------------------------------------------------------- */

/* Total reflectance per launched power, specular included, by H functions (10 digits). */
static const double total_etas[] = {1, 1.33, 1.5};
static const double known_totals[][4] = {
    {.1, .01639034215, .02768625739, .04560923231},
    {.3, .05721435060, .04780882670, .06055011684},
    {.5, .11522587771, .07918033337, .08424589385},
    {.7, .20867995212, .13665860713, .12890516220},
    {.9, .41494747913, .29479138060, .25991856992},
    {.95, .53554098917, .40803585632, .36111781836},
    {.99, .75272071716, .65295790940, .60198078570},
    {.999, .91284533480, .86908178965, .84145847579},
};

UNIT_TEST(totals_hold) {
  struct worst worst = {.what = "totals by H functions"};
  for (size_t i = 0; i < 3; i++) {
    const double eta = total_etas[i];
    const double specular = (eta - 1) / (eta + 1) * ((eta - 1) / (eta + 1));
    isotropic_boundary *boundary = boundary_for(eta, 1e-3);
    for (size_t j = 0; j < sizeof known_totals / sizeof known_totals[0]; j++) {
      isotropic_solution *solution = solve_with(boundary, known_totals[j][0]);
      const double entered = (known_totals[j][i + 1] - specular) / (1 - specular);
      compare(&worst, isotropic_total(solution), entered, 5.1e-12 / (1 - specular));
      isotropic_solution_free(solution);
    }
    isotropic_boundary_free(boundary);
  }
  assert_worst(&worst, 1e-9);
}

/* R(r) without a boundary, by Hankel inversion (8 digits): r, then a = .5, .9, .99. */
static const double unbounded_albedos[] = {.5, .9, .99};
static const double unbounded[][4] = {
    {.1, 2.7160357e-1, 5.6107803e-1, 6.4361447e-1}, {.5, 2.3164264e-2, 6.7096093e-2, 8.6855766e-2},
    {1, 5.2531991e-3, 2.1217650e-2, 3.1387826e-2},  {2, 7.0457166e-4, 4.9406107e-3, 9.4042074e-3},
    {5, 9.8241658e-6, 2.6224896e-4, 1.0995469e-3},  {10, 2.8957658e-8, 5.7670504e-6, 1.1009614e-4},
};
/* Light scattered once at a = .9. */
static const double unbounded_single[][2] = {
    {.1, .42742248}, {1, 4.7113124e-3}, {10, 2.4556137e-9}};

UNIT_TEST(media_without_a_boundary_hold) {
  struct worst worst = {.what = "R at eta = 1"};
  for (size_t i = 0; i < 3; i++) {
    isotropic_solution *solution = solve(1, unbounded_albedos[i], 1e-7);
    for (size_t j = 0; j < sizeof unbounded / sizeof unbounded[0]; j++) {
      const double truth = unbounded[j][i + 1];
      compare(&worst, isotropic_at(solution, unbounded[j][0]).R, truth, 5.1e-8 * truth);
    }
    for (size_t j = 0; i == 1 && j < 3; j++) {
      const double truth = unbounded_single[j][1];
      compare(&worst, isotropic_at(solution, unbounded_single[j][0]).single, truth, 5.1e-8 * truth);
    }
    isotropic_solution_free(solution);
  }
  assert_worst(&worst, 1e-7);
}

/* ---- MCML --------------------------------------------------------------------------------- */

#define MCML_FOLDER "../shared/mcml/"
#define MCML_SIGMA_MAX 0.05
#define MCML_SIGMAS 4.0
#define MCML_SYSTEMATIC 0.003

/* The isotropic media among them. */
static const struct {
  const char *file;
  double ratio; /* sigma_a / sigma_s */
  double eta;
} mcml[] = {
    {"r0.0001_n1.4_g0.0.csv", 0.0001, 1.4}, {"r0.001_n1.3_g0.0.csv", 0.001, 1.3},
    {"r0.001_n2.0_g0.0.csv", 0.001, 2},     {"r0.01_n1.0_g0.0.csv", 0.01, 1},
    {"r0.01_n1.5_g0.0.csv", 0.01, 1.5},     {"r0.1_n1.0_g0.0.csv", 0.1, 1},
    {"r0.1_n1.4_g0.0.csv", 0.1, 1.4},       {"r0.2_n1.7_g0.0.csv", 0.2, 1.7},
    {"r1_n1.3_g0.0.csv", 1, 1.3},           {"r10_n1.5_g0.0.csv", 10, 1.5},
};

/* Rings: r_from, r_to, mean R, its relative standard error. Returns how many were held. */
static size_t hold_rings(const char *text, const isotropic_solution *solution) {
  size_t rings = 0;
  for (const char *line = strstr(text, "r_from"); line != NULL; line = strchr(line, '\n')) {
    line += *line == '\n';
    double from, to, mean, sigma;
    if (sscanf(line, "%lf,%lf,%lf,%lf", &from, &to, &mean, &sigma) == 4 && sigma < MCML_SIGMA_MAX) {
      const double energy =
          isotropic_at(solution, to).within.value - isotropic_at(solution, from).within.value;
      const double R = energy / (PI * (to * to - from * from));
      if (fabs(mean / R - 1) > MCML_SIGMAS * sigma + MCML_SYSTEMATIC) {
        fail_msg("ring from %g to %g: MCML %g, transport %g", from, to, mean, R);
      }
      rings++;
    }
  }
  return rings;
}

UNIT_TEST(mcml_agrees) {
  size_t rings = 0;
  for (size_t i = 0; i < sizeof mcml / sizeof mcml[0]; i++) {
    char path[256];
    snprintf(path, sizeof path, MCML_FOLDER "%s", mcml[i].file);
    char *text = unit_read_file(path);
    if (text == NULL) {
      printf("skipped: there is no %s\n", path);
      skip();
    }
    isotropic_solution *solution = solve(mcml[i].eta, 1 / (1 + mcml[i].ratio), 1e-5);
    rings += hold_rings(text, solution);
    isotropic_solution_free(solution);
    free(text);
  }
  printf("%zu rings of MCML\n", rings);
  assert_true(rings > 1000);
}

/* ---- a plain walk ------------------------------------------------------------------------- */

enum { WALK_EDGES = 6, WALK_PHOTONS = 200000 };
static const double walk_edges[WALK_EDGES] = {0.03, 0.1, 0.3, 1, 3, 10};

/* The energy within each edge and its standard error. */
static void walk(double eta, double albedo, transport_number within[WALK_EDGES]) {
  const plain_medium medium = {albedo, 0, eta, (double)INFINITY};
  double sum[WALK_EDGES] = {0}, squares[WALK_EDGES] = {0};
  uint64_t random = 2012;
  for (int i = 0; i < WALK_PHOTONS; i++) {
    const plain_photon p = plain_walk(&medium, &random);
    const double r = sqrt(p.x * p.x + p.y * p.y);
    for (size_t j = 0; p.fate == PLAIN_REFLECTED && p.scattered && j < WALK_EDGES; j++) {
      sum[j] += r < walk_edges[j] ? p.weight : 0;
      squares[j] += r < walk_edges[j] ? p.weight * p.weight : 0;
    }
  }
  for (size_t j = 0; j < WALK_EDGES; j++) {
    const double mean = sum[j] / WALK_PHOTONS;
    const double variance = squares[j] / WALK_PHOTONS - mean * mean;
    within[j] = (transport_number){mean, sqrt(variance / WALK_PHOTONS)};
  }
}

/* Where the medium is thinner than its surroundings there are no other numbers; and for all. */
UNIT_TEST(a_plain_walk_agrees) {
  static const double media[][2] = {{0.7, 0.9}, {0.4, 0.99}, {0.97, 0.6}, {1.03, 0.95}, {3, 0.99}};
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    transport_number walked[WALK_EDGES];
    walk(media[i][0], media[i][1], walked);
    isotropic_solution *solution = solve(media[i][0], media[i][1], 1e-5);
    for (size_t j = 0; j < WALK_EDGES; j++) {
      const double within = isotropic_at(solution, walk_edges[j]).within.value;
      if (fabs(within - walked[j].value) > 4 * walked[j].error) {
        fail_msg("eta %g, albedo %g, within %g: walk %g +- %g, transport %g", media[i][0],
                 media[i][1], walk_edges[j], walked[j].value, walked[j].error, within);
      }
    }
    isotropic_solution_free(solution);
  }
}

/* ---- energy ------------------------------------------------------------------------------- */

UNIT_TEST(all_energy_leaves_where_none_is_absorbed) {
  static const double etas[] = {0.25,  0.5, 0.7, 0.9, 0.999, 1 - 1e-7, 1, 1 + 1e-7,
                                1.001, 1.1, 1.3, 1.5, 1.8,   2.2,      3, 4};
  struct worst worst = {.what = "totals without absorption"};
  for (size_t i = 0; i < sizeof etas / sizeof etas[0]; i++) {
    isotropic_solution *solution = solve(etas[i], 1, 1e-3);
    compare(&worst, isotropic_total(solution), 1, 0);
    assert_true(isotropic_at(solution, 100).within.value < 1);
    isotropic_solution_free(solution);
  }
  assert_worst(&worst, 1e-11);
}

/* The energy between two radii, which comes from other integrals, is that of R; it never decreases,
 * and reaches the total. */
UNIT_TEST(energy_is_the_integral_of_R) {
  static const double media[][2] = {{0.8, 0.5}, {1, 0.99}, {1.4, 0.9}, {1.4, 1}, {2, 0.05}};
  static const double gauss[][2] = {
      {0.5, 4.0 / 9}, {0.11270166537925831, 5.0 / 18}, {0.88729833462074169, 5.0 / 18}};
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    isotropic_solution *solution = solve(media[i][0], media[i][1], 1e-7);
    double before = isotropic_at(solution, 1e-4).within.value;
    for (double r = 1e-4; r < 20; r *= 1.05) {
      double energy = 0;
      for (size_t j = 0; j < 3; j++) {
        const double at = r * (1 + 0.05 * gauss[j][0]);
        energy += gauss[j][1] * 0.05 * r * 2 * PI * at * isotropic_at(solution, at).R.value;
      }
      const transport_number within = isotropic_at(solution, r * 1.05).within;
      assert_true(within.value >= before - within.error);
      assert_true(fabs(within.value - before - energy) <= 1e-7 * energy + 2 * within.error);
      before = within.value;
    }
    const transport_number total = isotropic_total(solution);
    assert_true(isotropic_at(solution, INFINITY).within.value == total.value);
    const transport_number all = isotropic_at(solution, 1e5).within;
    assert_true(fabs(all.value - total.value) <= 1e-4);
    isotropic_solution_free(solution);
  }
}

/* ---- error estimates ---------------------------------------------------------------------- */

enum { MEDIA = 12, RADII = 150 };
static const double tolerances[] = {1e-3, 1e-5, 1e-7};
enum { TOLERANCES = sizeof tolerances / sizeof tolerances[0] };

/* Within the range that is asked for everywhere: to 30 mean free paths. */
static void compare_solutions(struct worst worst[3], uint64_t *random,
                              const isotropic_solution *solution, const isotropic_solution *truth) {
  for (int i = 0; i < RADII; i++) {
    const double r = unit_random_log(random, 1e-3, 30);
    const isotropic_values values = isotropic_at(solution, r);
    const isotropic_values true_values = isotropic_at(truth, r);
    compare(&worst[0], values.R, true_values.R.value, true_values.R.error);
    compare(&worst[1], values.multiple, true_values.multiple.value, true_values.multiple.error);
    compare(&worst[2], values.within, true_values.within.value, true_values.within.error);
  }
}

static void random_medium(uint64_t *random, int i, double *eta, double *albedo) {
  *eta = i == 0   ? 0.7
         : i == 1 ? 2.2
         : i == 2 ? 1
         : i == 3 ? 1 + unit_random_log(random, 1e-6, 1e-2)
         : i == 4 ? 1 - unit_random_log(random, 1e-6, 1e-2)
         : i == 5 ? unit_random_between(random, 0.25, 0.7)
         : i == 6 ? unit_random_between(random, 2.2, 4)
                  : unit_random_between(random, 0.7, 2.2);
  *albedo = i % 3 == 0   ? unit_random_log(random, 0.01, 1)
            : i % 3 == 1 ? 1 - unit_random_log(random, 1e-6, 1)
                         : unit_random_between(random, 0.01, 1);
}

/* At the tightest tolerance the solver is right by the vectors above. */
UNIT_TEST(estimates_are_honest) {
  struct worst worst[TOLERANCES][3];
  uint64_t random = unit_seed();
  for (size_t t = 0; t < TOLERANCES; t++) {
    worst[t][0] = (struct worst){.what = "random media: R"};
    worst[t][1] = (struct worst){.what = "random media: multiple"};
    worst[t][2] = (struct worst){.what = "random media: within"};
  }
  for (int i = 0; i < MEDIA; i++) {
    double eta, albedo;
    random_medium(&random, i, &eta, &albedo);
    isotropic_solution *truth = solve(eta, albedo, ISOTROPIC_TOLERANCE_MIN);
    for (size_t t = 0; t < TOLERANCES; t++) {
      isotropic_solution *solution = solve(eta, albedo, tolerances[t]);
      compare_solutions(worst[t], &random, solution, truth);
      isotropic_solution_free(solution);
    }
    isotropic_solution_free(truth);
  }
  for (size_t t = 0; t < TOLERANCES; t++) {
    printf("tolerance %g\n", tolerances[t]);
    for (size_t q = 0; q < 3; q++) {
      assert_worst(&worst[t][q], tolerances[t]);
    }
    assert_true(worst[t][0].estimate <= tolerances[t]);
  }
}

/* Radii far outside, where digits must go: the value may, the honesty may not. */
UNIT_TEST(far_radii_are_honest) {
  static const double media[][2] = {{1.4, 0.2}, {1, 0.9}, {0.7, 0.999}};
  struct worst worst = {.what = "far radii: R"};
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    isotropic_solution *truth = solve(media[i][0], media[i][1], ISOTROPIC_TOLERANCE_MIN);
    isotropic_solution *solution = solve(media[i][0], media[i][1], 1e-4);
    for (double r = 30; r < 1e4; r *= 1.1) {
      const transport_number value = isotropic_at(solution, r).R;
      const transport_number close = isotropic_at(truth, r).R;
      assert_true(isfinite(value.value) && value.value >= 0);
      assert_true(fabs(value.value - close.value) <= ESTIMATE_FACTOR * value.error + close.error);
      if (close.error < 1e-3 * close.value) {
        compare(&worst, value, close.value, close.error);
      }
    }
    isotropic_solution_free(solution);
    isotropic_solution_free(truth);
  }
  report(&worst);
  assert_true(worst.count >= 40 && worst.ratio <= ESTIMATE_FACTOR);
}

/* Near the source R is a T / (4 pi r) of light scattered once; what is scattered more often grows
 * like ln(1 / r), down to radii far below the finest wavelength that is solved for. */
UNIT_TEST(the_source_has_its_limits) {
  isotropic_solution *solution = solve(1.4, 0.9, 1e-7);
  const double near = isotropic_at(solution, 1e-12).single.value * 1e-12;
  const double nearer = isotropic_at(solution, 1e-15).single.value * 1e-15;
  assert_true(fabs(near / nearer - 1) < 1e-10);
  double slope = 0;
  for (double r = 1e-5; r > 1e-20; r /= 10) {
    const double step =
        isotropic_at(solution, r / 10).multiple.value - isotropic_at(solution, r).multiple.value;
    assert_true(step > 0 && (slope == 0 || fabs(step / slope - 1) < 1e-3));
    slope = step;
  }
  assert_true(isfinite(isotropic_at(solution, 1e-280).R.value));
  isotropic_solution_free(solution);
}

/* ---- inputs ------------------------------------------------------------------------------- */

UNIT_TEST(bad_inputs_are_named) {
  isotropic_boundary *boundary = NULL;
  static const double etas[] = {0, -1, 0.249, 4.01, NAN, INFINITY};
  for (size_t i = 0; i < sizeof etas / sizeof etas[0]; i++) {
    unit_assert_fault(isotropic_boundary_create(&boundary, etas[i], 1e-5), "eta", 0);
    assert_null(boundary);
  }
  static const double bad_tolerances[] = {0, -1, 9e-10, 2e-3, NAN, INFINITY};
  for (size_t i = 0; i < sizeof bad_tolerances / sizeof bad_tolerances[0]; i++) {
    unit_assert_fault(isotropic_boundary_create(&boundary, 1.4, bad_tolerances[i]), "tolerance", 0);
    assert_null(boundary);
  }
  boundary = boundary_for(1.4, 1e-3);
  static const double albedos[] = {-1e-300, 1 + DBL_EPSILON, NAN, INFINITY, -INFINITY};
  for (size_t i = 0; i < sizeof albedos / sizeof albedos[0]; i++) {
    isotropic_solution *solution;
    unit_assert_fault(isotropic_solve(&solution, boundary, albedos[i]), "albedo", 0);
    assert_null(solution);
  }
  isotropic_boundary_free(boundary);
  isotropic_boundary_free(NULL);
  isotropic_solution_free(NULL);
}

UNIT_TEST(extremes_end) {
  static const double etas[] = {TRANSPORT_ETA_MIN, 1, TRANSPORT_ETA_MAX};
  static const double albedos[] = {
      0, 5e-324, 1e-300, 1e-10, 1e-3, 1 - 1e-10, 1 - 1e-15, 1 - DBL_EPSILON / 2, 1};
  static const double radii[] = {0, 5e-324, 1e-300, 1e-9, 1, 1e5, 1e8, 1e59, 1e61, DBL_MAX};
  for (size_t i = 0; i < 3; i++) {
    isotropic_boundary *boundary = boundary_for(etas[i], 1e-3);
    for (size_t j = 0; j < sizeof albedos / sizeof albedos[0]; j++) {
      isotropic_solution *solution = solve_with(boundary, albedos[j]);
      const double total = isotropic_total(solution).value;
      assert_true(total >= 0 && total <= 1 + 1e-11 && (total > 0 || albedos[j] < 1e-300));
      for (size_t k = 0; k < sizeof radii / sizeof radii[0]; k++) {
        const isotropic_values values = isotropic_at(solution, radii[k]);
        assert_true(values.R.value >= 0 && values.R.error >= 0);
        assert_true(values.within.value >= 0 && values.within.value <= total + values.within.error);
      }
      const isotropic_values nowhere = isotropic_at(solution, INFINITY);
      assert_true(nowhere.R.value == 0 && nowhere.R.error == 0);
      assert_true(nowhere.within.value == total);
      isotropic_solution_free(solution);
    }
    isotropic_boundary_free(boundary);
  }
}

/* ---- bits --------------------------------------------------------------------------------- */

struct job {
  isotropic_boundary *boundary;
  double albedo;
  isotropic_solution *solution;
};

static void *run_job(void *argument) {
  struct job *job = argument;
  const core_fault fault = isotropic_solve(&job->solution, job->boundary, job->albedo);
  return fault.field == NULL ? job : NULL;
}

static void assert_same_bits(const isotropic_solution *one, const isotropic_solution *other) {
  for (double r = 1e-4; r < 100; r *= 3) {
    const isotropic_values a = isotropic_at(one, r);
    const isotropic_values b = isotropic_at(other, r);
    assert_memory_equal(&a, &b, sizeof a);
  }
}

/* Threads that share a boundary, in whatever order they come, and one that does not. */
UNIT_TEST(threads_get_the_same_bits) {
  enum { JOBS = 4 };
  static const double albedos[JOBS] = {0.5, 0.9, 0.91, 0.5};
  isotropic_boundary *shared = boundary_for(1.5, 1e-3);
  struct job jobs[JOBS];
  pthread_t threads[JOBS];
  for (int i = 0; i < JOBS; i++) {
    jobs[i] = (struct job){shared, albedos[i], NULL};
    assert_int_equal(pthread_create(&threads[i], NULL, run_job, &jobs[i]), 0);
  }
  for (int i = 0; i < JOBS; i++) {
    void *done;
    assert_int_equal(pthread_join(threads[i], &done), 0);
    assert_non_null(done);
    isotropic_solution *alone = solve(1.5, albedos[i], 1e-3);
    assert_same_bits(alone, jobs[i].solution);
    isotropic_solution_free(alone);
    isotropic_solution_free(jobs[i].solution);
  }
  isotropic_boundary_free(shared);
}

/* What this machine and compiler make is what any other made. */
UNIT_TEST(bits_are_the_same_everywhere) {
  static const double known[][3] = {
      {0.01, 0x1.208c72834081ep+2, 0x1.7f4a2bec22f2dp-9},
      {1, 0x1.7be9c17e90e1ep-7, 0x1.009e9811d0c1ep-3},
      {20, 0x1.d2ac929e0a916p-27, 0x1.07f0516d1909ap-2},
  };
  isotropic_solution *solution = solve(1.4, 0.9, 1e-5);
  for (size_t i = 0; i < sizeof known / sizeof known[0]; i++) {
    const isotropic_values values = isotropic_at(solution, known[i][0]);
    if (values.R.value != known[i][1] || values.within.value != known[i][2]) {
      fail_msg("at r = %g: {%a, %a}", known[i][0], values.R.value, values.within.value);
    }
  }
  isotropic_solution_free(solution);
}
