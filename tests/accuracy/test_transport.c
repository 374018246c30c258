/* The solver of tests/accuracy/isotropic/, which other tests take for the truth, against published
 * values and totals by H functions, and its values at loose tolerances against those at the tightest.
 */
#include <math.h>

#include "tests/accuracy/isotropic/isotropic.h"
#include "tests/unit/unit.h"

/* Raises *worst to the relative error. off: the largest absolute error of the truth itself. */
static void compare(double *worst, double value, double truth, double off) {
  assert_true(isfinite(value) && value >= 0);
  *worst = fmax(*worst, (fabs(value - truth) - off) / truth);
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
  double worst = 0;
  for (size_t i = 0; i < 3; i++) {
    const double eta = total_etas[i];
    const double specular = (eta - 1) / (eta + 1) * ((eta - 1) / (eta + 1));
    for (size_t j = 0; j < sizeof known_totals / sizeof known_totals[0]; j++) {
      isotropic_solution *solution =
          isotropic_solve(eta, known_totals[j][0], 1e-3, ISOTROPIC_REACH);
      const double entered = (known_totals[j][i + 1] - specular) / (1 - specular);
      compare(&worst, isotropic_total(solution), entered, 5.1e-12 / (1 - specular));
      isotropic_free(solution);
    }
  }
  printf("totals: off by %.1e\n", worst);
  assert_true(worst <= 1e-9);
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
  double worst = 0;
  for (size_t i = 0; i < 3; i++) {
    isotropic_solution *solution = isotropic_solve(1, unbounded_albedos[i], 1e-7, ISOTROPIC_REACH);
    for (size_t j = 0; j < sizeof unbounded / sizeof unbounded[0]; j++) {
      const double truth = unbounded[j][i + 1];
      compare(&worst, isotropic_at(solution, unbounded[j][0]).R, truth, 5.1e-8 * truth);
    }
    for (size_t j = 0; i == 1 && j < 3; j++) {
      const double truth = unbounded_single[j][1];
      compare(&worst, isotropic_at(solution, unbounded_single[j][0]).single, truth, 5.1e-8 * truth);
    }
    isotropic_free(solution);
  }
  printf("R at eta 1: off by %.1e\n", worst);
  assert_true(worst <= 1e-7);
}

/* ---- tolerances --------------------------------------------------------------------------- */

enum { MEDIA = 12, RADII = 150, TOLERANCES = 3 };

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

/* At the tightest tolerance the solver is right by the values above. The range is that which is asked
 * for everywhere: to 30 mean free paths. */
UNIT_TEST(tolerances_are_kept) {
  static const double tolerances[TOLERANCES] = {1e-3, 1e-5, 1e-7};
  double worst[TOLERANCES] = {0};
  uint64_t random = unit_seed();
  for (int i = 0; i < MEDIA; i++) {
    double eta, albedo;
    random_medium(&random, i, &eta, &albedo);
    isotropic_solution *truth = isotropic_solve(eta, albedo, 1e-9, ISOTROPIC_REACH);
    for (size_t t = 0; t < TOLERANCES; t++) {
      isotropic_solution *solution = isotropic_solve(eta, albedo, tolerances[t], ISOTROPIC_REACH);
      for (int k = 0; k < RADII; k++) {
        const double r = unit_random_log(&random, 1e-3, 30);
        const isotropic_values values = isotropic_at(solution, r), right = isotropic_at(truth, r);
        compare(&worst[t], values.R, right.R, 1e-9 * right.R);
        compare(&worst[t], values.within, right.within, 1e-9 * right.within);
      }
      isotropic_free(solution);
    }
    isotropic_free(truth);
  }
  for (size_t t = 0; t < TOLERANCES; t++) {
    printf("tolerance %g: off by %.1e\n", tolerances[t], worst[t]);
    assert_true(worst[t] <= tolerances[t]);
  }
}
