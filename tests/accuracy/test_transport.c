/* The solver of tests/accuracy/isotropic/, which other tests take for the truth, against published
 * values and totals by H functions, and its error estimates at loose tolerances against its values at
 * the tightest. */
#include <math.h>

#include "tests/accuracy/isotropic/isotropic.h"
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

/* At the tightest tolerance the solver is right by the values above. */
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
