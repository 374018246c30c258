/* The solver for any phase function against what it did not make: the solver for isotropic
 * scattering, totals by adding-doubling, walks; and against itself: a phase function given by
 * its moments, several boundaries at once. The long form has more media. */
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/fit/aperture.h"
#include "core/solver/solver.h"
#include "core/transport/single.h"
#include "tests/accuracy/isotropic/isotropic.h"
#include "tests/accuracy/montecarlo_run.h"
#include "tests/unit/unit.h"

/* of the solver */
#define TOLERANCE 1e-3

#define PI 3.14159265358979323846

static solver_solution *solve(double ratio, const solver_phase *phase, const double *etas,
                              size_t count, double tolerance) {
  solver_solution *solution;
  unit_accept(solver_solve(&solution, core_isa_select(NULL), ratio, phase, etas, count, tolerance));
  return solution;
}

static solver_total total_of(double ratio, const solver_phase *phase, double eta) {
  solver_total total;
  unit_accept(solver_totals(&total, core_isa_select(NULL), ratio, phase, &eta, 1));
  return total;
}

/* Asserts that a value of the solver is within `bound`, relative, of a true one, and that the error
 * that it states is not smaller than the true one. `off` is the relative
 * error of the true value itself. Returns the relative error. */
static double hold(const char *what, double r, transport_number number, double truth, double off,
                   double bound) {
  const double error = fabs(number.value / truth - 1);
  UNIT_FAIL_IF(!(error <= bound + off) || !(error <= number.error / number.value + off),
               "%s at %g: %.9g, not %.9g: off by %.2g, stated %.2g", what, r, number.value, truth,
               error, number.error / number.value);
  return error;
}

/* ---- isotropic scattering ------------------------------------------------------------------- */

UNIT_TEST(isotropic_scattering_is_that_of_the_other_solver) {
  static const double etas[] = {0.8, 1, 1.3, 2};
  enum { ETAS = sizeof etas / sizeof etas[0] };
  const double ratio = 0.03;
  const double albedo = 1 / (1 + ratio);
  const solver_phase phase = {0, 0, NULL};
  solver_solution *solution = solve(ratio, &phase, etas, ETAS, TOLERANCE);
  solver_total totals[ETAS];
  unit_accept(solver_totals(totals, core_isa_select(NULL), ratio, &phase, etas, ETAS));
  double worst = 0;
  for (size_t i = 0; i < ETAS; i++) {
    isotropic_solution *truth = isotropic_solve(etas[i], albedo, 1e-6, ISOTROPIC_REACH);
    for (double r = 0.01; r < 21; r *= 1.4) {
      const isotropic_values values = isotropic_at(truth, r);
      const double single = solver_single_at(solution, i, r);
      assert_true(fabs(single / values.single - 1) < 1e-9);
      if (values.R > 1e-12) {
        worst = fmax(worst, hold("isotropic", r, solver_at(solution, i, r), values.R, 2e-6, 1e-3));
      }
    }
    const double total = isotropic_total(truth);
    hold("isotropic total", etas[i], totals[i].normal, total, 1e-7, 1e-6);
    assert_true(isinf(solver_at(solution, i, 0).value));
    assert_true(solver_at(solution, i, INFINITY).value == 0);
    assert_true(solver_at(solution, i, 1e300).value == 0);
    isotropic_free(truth);
  }
  printf("g = 0, sigma_a / sigma_s' %g: R off by at most %.1e\n", ratio, worst);
  solver_free(solution);
}

/* ---- what holds for any medium --------------------------------------------------------------- */

/* Where nothing is absorbed, all light leaves, and R falls as r^-3 far away. */
UNIT_TEST(all_light_leaves_a_white_medium) {
  static const double gs[] = {0.8, -0.4}, etas[] = {1.4, 1};
  for (size_t i = 0; i < (unit_is_long() ? 2 : 1); i++) {
    enum { STEPS = 400 };
    const solver_phase phase = {gs[i], 0, NULL};
    solver_solution *solution = solve(0, &phase, &etas[i], 1, TOLERANCE);
    const double first = 1e-5, last = 300, ratio = pow(last / first, 1.0 / STEPS);
    double sum = 0, r = first * sqrt(ratio);
    for (size_t k = 0; k < STEPS; k++, r *= ratio) {
      sum += 2 * PI * r * r * log(ratio) * solver_at(solution, 0, r).value;
    }
    const double beyond = 2 * PI * last * last * solver_at(solution, 0, last).value;
    printf("white, g %g, eta %g: %.6f within 300, %.6f beyond\n", gs[i], etas[i], sum, beyond);
    assert_true(fabs(sum + beyond - 1) < 3e-4);
    const transport_number far = solver_at(solution, 0, 9999),
                           farther = solver_at(solution, 0, 1e12);
    assert_true(fabs(farther.value / pow(1e12 / 9999, -3) / far.value - 1) <=
                farther.error / farther.value);
    const solver_total total = total_of(0, &phase, etas[i]);
    assert_true(total.normal.value == 1 && total.diffuse.value == 1);
    solver_free(solution);
  }
}

/* White and black media, with narrow and backward scattering, against a finer grid. */
UNIT_TEST(stated_errors_are_those_against_a_finer_grid) {
  static const double media[][4] = {{0, 0.6, 1.55, 3},
                                    {1000, 0.8, 1.33, 3},
                                    {0.02, 0.99, 1.4, 4},
                                    {0.5, -0.7, 0.5, 3},
                                    {0.1, 0.9, 3.9, 3}};
  for (size_t i = 0; i < (unit_is_long() ? sizeof media / sizeof media[0] : 1); i++) {
    const solver_phase phase = {media[i][1], 0, NULL};
    const double *eta = &media[i][2], own = 3e-4;
    double worst = 0, stated = 0;
    solver_solution *solution = solve(media[i][0], &phase, eta, 1, 1e-2), *finer;
    unit_accept(solver_solve_level(&finer, core_isa_select(NULL), media[i][0], &phase, eta, 1,
                                   (size_t)media[i][3], NULL, false));
    for (double r = SOLVER_RADIUS_LEAST; r < SOLVER_RADIUS_MOST; r *= 1.3) {
      const transport_number R = solver_at(solution, 0, r);
      const double error = R.error / R.value;
      const double off = fabs(R.value / solver_at(finer, 0, r).value - 1);
      worst = R.value > 0 ? fmax(worst, off / (error + own)) : worst;
      stated = fmax(stated, error);
    }
    printf("ratio %g, g %g, eta %g: %.2f of what is stated, %.1e at most\n", media[i][0],
           media[i][1], *eta, worst, stated);
    assert_true(worst <= 1);
    solver_free(solution);
    solver_free(finer);
  }
}

/* As many grids are solved as the tolerance takes, up to four: the fourth states less even where it
 * misses the tolerance. */
UNIT_TEST(grids_are_solved_until_the_tolerance_is_kept) {
  static const struct {
    double ratio, g, eta, tolerance;
    size_t level;
  } media[] = {{1, 0.5, 3, 1e-2, 1}, {0.1, 0.97, 1.4, 1e-2, 3}, {0.03, 0.93, 3, 1e-2, 3}};
  for (size_t i = 0; i < (unit_is_long() ? sizeof media / sizeof media[0] : 1); i++) {
    const solver_phase phase = {media[i].g, 0, NULL};
    solver_solution *solution = solve(media[i].ratio, &phase, &media[i].eta, 1, media[i].tolerance);
    assert_int_equal(solver_level(solution), media[i].level);
    solver_free(solution);
  }
}

UNIT_TEST(a_solution_that_nobody_wants_stops) {
  const solver_phase phase = {.g = 0.9};
  const atomic_bool stop = true;
  solver_solution *solution;
  unit_assert_fault(
      solver_solve_until(&solution, core_isa_select(NULL), 1, &phase, 1.4, 1e-3, &stop),
      CORE_FIELD_STOPPED, 0);
  assert_null(solution);
}

/* ---- numbers of others ---------------------------------------------------------------------- */

/* Totals by adding-doubling, and by walks of 2e8 photons for g below 0, per launched power with the
 * specular reflection, and how far they may be off: their last digit, 3 standard errors. */
UNIT_TEST(totals_are_those_of_others) {
  static const struct {
    double albedo, g, eta, total, off;
  } known[] = {{0.9, 0.9, 1.4, 0.0573000, 3e-7},        {0.95, 0.8, 1, 0.238946, 1e-6},
               {0.9, 0, 1.5, 0.2599186, 1e-7},          {0.998003992, 0.8, 1.4, 0.63166, 1e-5},
               {0.99, 0.8, 1.4, 0.38586, 1e-5},         {0.91324201, -0.9, 1.4, 0.552220, 8e-5},
               {0.91116173, -0.95, 1.4, 0.589058, 8e-5}};
  for (size_t i = 0; i < sizeof known / sizeof known[0]; i++) {
    const solver_phase phase = {known[i].g, 0, NULL};
    const double ratio = (1 - known[i].albedo) / (known[i].albedo * (1 - known[i].g));
    const double specular = pow((known[i].eta - 1) / (known[i].eta + 1), 2);
    const solver_total total = total_of(ratio, &phase, known[i].eta);
    assert_true(total.normal.error < fmax(1e-6 * total.normal.value, known[i].off));
    const double launched = specular + (1 - specular) * total.normal.value;
    assert_true(fabs(launched - known[i].total) < known[i].off);
  }
}

/* The albedo for diffuse light of isotropic scatterers without a boundary is 1 - 2 sqrt(1 - a)
 * times the first moment of Chandrasekhar's H function (1960). H was computed by iteration, with
 * 100 nodes.
 */
UNIT_TEST(diffuse_light_is_reflected_as_h_functions_say) {
  static const double known[][2] = {{0.9, 0.478024489}, {0.5, 0.146544381}};
  const solver_phase phase = {0, 0, NULL};
  for (size_t i = 0; i < 2; i++) {
    const solver_total total = total_of(1 / known[i][0] - 1, &phase, 1);
    hold("diffuse total", known[i][0], total.diffuse, known[i][1], 1e-8, 1e-6);
  }
}

/* Diffuse light that is scattered once, by the midpoint rule over the cosines outside and over the
 * azimuth, with Henyey and Greenstein's function itself in place of its moments. */
static double single_by_midpoints(double eta, double g) {
  enum { COSINES = 80, AZIMUTHS = 60 };
  double mu[COSINES], weight[COSINES], entering = 0, sum = 0;
  for (size_t i = 0; i < COSINES; i++) {
    const double x = (i + 0.5) / COSINES;
    mu[i] = sqrt(1 - (1 - x * x) / (eta * eta));
    weight[i] = transport_transmittance(eta, mu[i], x) * x / (eta * eta) / COSINES;
    entering += weight[i];
  }
  for (size_t i = 0; i < COSINES; i++) {
    for (size_t j = 0; j < COSINES; j++) {
      const double sines = sqrt((1 - mu[i] * mu[i]) * (1 - mu[j] * mu[j]));
      double p = 0;
      for (size_t k = 0; k < AZIMUTHS; k++) {
        const double cosine = sines * cos(3.14159265358979324 * (k + 0.5) / AZIMUTHS);
        p += (1 - g * g) / pow(1 + g * g - 2 * g * (cosine - mu[i] * mu[j]), 1.5) / AZIMUTHS;
      }
      sum += weight[i] * weight[j] * p / (mu[i] + mu[j]);
    }
  }
  return 0.5 * sum / entering;
}

UNIT_TEST(diffuse_light_scattered_once_is_what_integrals_say) {
  enum { MOMENTS = 200 };
  static const double media[][2] = {{1.4, 0.7}, {1.1, 0.5}, {2, -0.4}, {1.5, 0.85}};
  double moment[MOMENTS] = {1};
  /* isotropic scattering without a boundary: the integral of mu mu' / (mu + mu') */
  assert_true(fabs(transport_single_diffuse(1, 1, moment) / (2.0 / 3 * (1 - log(2))) - 1) < 1e-8);
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    for (size_t l = 1; l < MOMENTS; l++) {
      moment[l] = media[i][1] * moment[l - 1];
    }
    const double integral = single_by_midpoints(media[i][0], media[i][1]);
    const double off = transport_single_diffuse(media[i][0], MOMENTS, moment) / integral - 1;
    printf("diffuse light scattered once, eta %g, g %g: %.2g\n", media[i][0], media[i][1], off);
    assert_true(fabs(off) < 3e-4);
  }
}

/* A walk of 1e7 photons that enter in all directions, and 3 standard errors. */
UNIT_TEST(diffuse_light_that_is_scattered_back_is_as_it_is_walked) {
  const solver_phase phase = {-0.9, 0, NULL};
  const solver_total total = total_of(0.05, &phase, 1);
  assert_true(fabs(total.diffuse.value - 0.617752) < 3.4e-4);
}

/* Where light is scattered forward and absorbed, most of what leaves was scattered once. */
UNIT_TEST(diffuse_totals_are_known_to_1e5) {
  static const double media[][2] = {{0.1, 0.9}, {1, 0.9}, {8, 0.9}, {15, 0.945}, {30, -0.4}};
  static const double etas[] = {0.7, 1, 1.05, 1.4, 2.2};
  for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
    const solver_phase phase = {media[i][1], 0, NULL};
    solver_total totals[5];
    unit_accept(solver_totals(totals, core_isa_select(NULL), media[i][0], &phase, etas, 5));
    for (size_t eta = 0; eta < 5; eta++) {
      assert_true(totals[eta].diffuse.error < 2e-6 * totals[eta].diffuse.value);
    }
  }
}

/* ---- cones of angles ------------------------------------------------------------------------- */

/* The table that fits use is off from the solver by what it states at most. */
static void expect_share(double ratio, double g, double eta, double NA, double x, double share) {
  fit_aperture aperture;
  fit_aperture_row row;
  fit_aperture_prepare(&aperture, g, eta, NA);
  fit_aperture_medium(&aperture, ratio, &row);
  const double stated = fit_aperture_error(&aperture, ratio, x, x);
  UNIT_FAIL_IF(!(stated < 0.1 && fabs(fit_aperture_share(&row, log(x)) / share - 1) < stated),
               "eta %g, NA %g, x %g: share %g, not %g within %g", eta, NA, x,
               fit_aperture_share(&row, log(x)), share, stated);
  /* that of a range is the largest in it */
  assert_true(fit_aperture_error(&aperture, ratio, x, 3 * x) >= stated);
}

/* R of a walk that counts the light within a cone alone. It uses single precision and no Fourier
 * transform. The rings are so narrow that R in their middle is the mean. */
UNIT_TEST(light_within_cones_is_that_of_walks) {
  enum { RINGS = 24, CASES = 4, BATCHES = 60 };
  static const double etas[] = {0.8, 1.4}, sines[] = {0.25, 0.6};
  const double ratio = 0.1, g = 0.5, albedo = 1 / (1 + ratio * (1 - g));
  const double unit = 1 / (1 - albedo + albedo * (1 - g)); /* reduced mean free path, in paths */
  const solver_phase phase = {.g = g};
  solver_solution *solution;
  unit_accept(solver_solve_cones(&solution, core_isa_select(NULL), ratio, &phase, etas, 2, sines, 2,
                                 TOLERANCE));
  for (size_t k = 0; k < CASES; k++) {
    const size_t eta = k / 2, cone = k % 2;
    core_mc_request request = montecarlo_request(albedo, g, etas[eta]);
    montecarlo_rings(&request, RINGS, 0.05 * unit, 5 * unit);
    request.aperture = sines[cone] * fmin(etas[eta], 1);
    montecarlo_run run = montecarlo_run_batches(&request, BATCHES);
    core_mc_ring rings[RINGS];
    core_mc_total_rings(run.total, 0, CORE_MC_REFLECTED, rings);
    double squares = 0, shares[RINGS];
    for (size_t i = 0; i < RINGS; i++) {
      const double r = sqrt(rings[i].from_mm * rings[i].to_mm) / unit;
      shares[i] = solver_share_at(solution, eta, cone, r).value;
      const double R = shares[i] * solver_at(solution, eta, r).value / (unit * unit);
      const double off = (rings[i].R_per_mm2 - R) / hypot(rings[i].error_per_mm2, 0.005 * R);
      squares += off * off;
      expect_share(ratio, g, etas[eta], request.aperture, r, shares[i]);
      UNIT_FAIL_IF(!(fabs(off) < 4.5), "eta %g, sine %g, r %g: %g +- %g, not %g", etas[eta],
                   request.aperture, r, rings[i].R_per_mm2, rings[i].error_per_mm2, R);
    }
    printf("eta %g, sine %.2f: share %.4f to %.4f, chi-squared %.2f\n", etas[eta], request.aperture,
           shares[0], shares[RINGS - 1], squares / RINGS);
    assert_true(squares / RINGS < 1 + 4 * sqrt(2.0 / RINGS));
    montecarlo_run_free(&run);
  }
  solver_free(solution);
}

/* ---- the reference table -------------------------------------------------------------------- */

/* A row of core/transport/reference.csv; r is 0 in those of totals, and mc NaN where it is
 * empty. */
struct row {
  double ratio, g, eta, r, value, bound, mc, mc_error;
  char quantity[16];
};

/* sscanf() does not read empty cells. */
static bool read_row(const char *line, struct row *row) {
  double *const number[] = {&row->ratio, &row->g,     &row->eta, NULL,          &row->r,
                            &row->value, &row->bound, &row->mc,  &row->mc_error};
  for (size_t i = 0; i < sizeof number / sizeof number[0]; i++) {
    const size_t length = strcspn(line, ",");
    if (number[i] == NULL) {
      snprintf(row->quantity, sizeof row->quantity, "%.*s", (int)length, line);
    } else if (length == 0) {
      *number[i] = i == 4 ? 0 : (double)NAN;
    } else {
      char *end;
      *number[i] = strtod(line, &end);
      if (end != line + length) {
        return false;
      }
    }
    line += length + (line[length] == ',');
  }
  return true;
}

/* Returns the solver's own value of a row, by solutions for isotropic scattering. */
static double isotropic_value(const struct row *row, const isotropic_solution *solution) {
  return row->r > 0 ? isotropic_at(solution, row->r).R : isotropic_total(solution);
}

/* The rows for g = 0 are within their bounds of the solver for isotropic scattering, Monte Carlo is
 * within its standard errors of all rows, and each medium has all of its rows. */
UNIT_TEST(the_reference_table_holds) {
  enum { MEDIUM_ROWS = 19, MEDIA_LEAST = 64 };
  char *text = unit_read_file("core/transport/reference.csv");
  assert_non_null(text);
  isotropic_solution *solution = NULL;
  double chi_squared = 0, largest = 0, before[3] = {0};
  size_t rows = 0, walked = 0, isotropic = 0;
  strtok(text, "\n"); /* the names of the columns */
  for (char *line; (line = strtok(NULL, "\n")) != NULL; rows++) {
    struct row row;
    assert_true(read_row(line, &row));
    assert_true(row.value > 0 && row.bound > 0 && row.bound < (row.g < 0.95 ? 2e-3 : 6e-3));
    const double medium[] = {row.ratio, row.g, row.eta};
    assert_int_equal(memcmp(medium, before, sizeof medium) != 0, rows % MEDIUM_ROWS == 0);
    if (rows % MEDIUM_ROWS == 0 && row.g == 0) {
      isotropic_free(solution);
      solution = isotropic_solve(row.eta, 1 / (1 + row.ratio), 1e-8, ISOTROPIC_REACH);
    }
    memcpy(before, medium, sizeof medium);
    if (row.g == 0) {
      const double off = fabs(row.value / isotropic_value(&row, solution) - 1);
      UNIT_FAIL_IF(!(off <= row.bound), "%s of ratio %g, eta %g at %g: off by %g, stated %g",
                   row.quantity, row.ratio, row.eta, row.r, off, row.bound);
      isotropic++;
    }
    if (!isnan(row.mc)) {
      const double off = fabs(row.mc / row.value - 1) / hypot(row.mc_error, row.bound);
      chi_squared += off * off;
      largest = fmax(largest, off);
      walked++;
    }
  }
  printf("%zu media; Monte Carlo at %zu values: chi-squared per value %.2f, largest %.1f sigma\n",
         rows / MEDIUM_ROWS, walked, chi_squared / (double)walked, largest);
  assert_true(rows % MEDIUM_ROWS == 0 && rows / MEDIUM_ROWS >= MEDIA_LEAST && isotropic > 100);
  assert_true(walked > rows / 2 && chi_squared > 0.8 * (double)walked &&
              chi_squared < 1.2 * (double)walked && largest < 4.5);
  isotropic_free(solution);
  free(text);
}

/* ---- between and beyond the wavenumbers ------------------------------------------------------ */

/* Where R is small, a step of X(k) at the last wavenumber would be a wave in r: by the sixth difference
 * of ln R, whose radii are half a wavelength apart, of up to 1e-2 for this medium. */
UNIT_TEST(there_is_no_wave_of_the_last_wavenumber) {
  if (!unit_is_long()) {
    return;
  }
  const double eta = 2.18, last = 8, half_wave = PI / last;
  static const double binomial[] = {1, -6, 15, -20, 15, -6, 1};
  const solver_phase phase = {-0.5, 0, NULL};
  solver_solution *solution = solve(70, &phase, &eta, 1, TOLERANCE);
  double worst = 0;
  for (double r = 4; r < 6; r += 0.1) {
    double difference = 0;
    for (int i = 0; i < 7; i++) {
      difference += binomial[i] * log(solver_at(solution, 0, r + (i - 3) * half_wave).value);
    }
    worst = fmax(worst, fabs(difference) / 64);
  }
  printf("waves of %.1e at most\n", worst);
  assert_true(worst < 8e-4);
  solver_free(solution);
}

/* ---- the interface -------------------------------------------------------------------------- */

UNIT_TEST(kept_exitances_give_the_same_bits) {
  static const double etas[] = {0.8, 1.4};
  enum { LEVEL = 1, ETAS = 2, NUMBERS = ETAS * SOLVER_WAVENUMBERS_MAX };
  static double complex exitances[NUMBERS];
  const solver_phase phase = {0.7, 0, NULL};
  const core_isa *isa = core_isa_select(NULL);
  solver_solution *solutions[3];
  unit_accept(solver_solve_level(&solutions[0], isa, 0.1, &phase, etas, ETAS, LEVEL, NULL, false));
  for (int known = 0; known < 2; known++) {
    unit_accept(solver_solve_level(&solutions[1 + known], isa, 0.1, &phase, etas, ETAS, LEVEL,
                                   exitances, known));
  }
  for (size_t eta = 0; eta < ETAS; eta++) {
    for (double r = 1e-3; r < 30; r *= 3) {
      const double R = solver_at(solutions[0], eta, r).value;
      assert_true(R > 0);
      assert_true(solver_at(solutions[1], eta, r).value == R);
      assert_true(solver_at(solutions[2], eta, r).value == R);
    }
  }
  for (int i = 0; i < 3; i++) {
    solver_free(solutions[i]);
  }
}

UNIT_TEST(totals_by_moments_are_those_by_g) {
  enum { MOMENTS = 60 };
  double moment[MOMENTS];
  for (size_t l = 0; l < MOMENTS; l++) {
    moment[l] = pow(0.3, (double)l);
  }
  const solver_phase by_g = {0.3, 0, NULL}, by_moments = {0, MOMENTS, moment};
  for (double eta = 0.9; eta < 1.5; eta += 0.5) {
    const solver_total one = total_of(0.1, &by_g, eta), other = total_of(0.1, &by_moments, eta);
    assert_true(fabs(one.diffuse.value / other.diffuse.value - 1) < 1e-12);
  }
}

UNIT_TEST(faults_name_their_field) {
  const double eta = 1.4, bad_eta[] = {1.4, 4.1};
  const double moments[] = {0.5, 0};
  const solver_phase good = {0.9, 0, NULL}, peaked = {0.991, 0, NULL}, unknown = {NAN, 0, NULL};
  const solver_phase unnormalized = {0, 2, moments};
  solver_solution *solution;
  const struct {
    double ratio;
    const solver_phase *phase;
    const double *etas;
    size_t count;
    const char *field;
    size_t index;
  } faults[] = {
      {NAN, &good, &eta, 1, "sigma_a_ratio", 0},  {-1e-9, &good, &eta, 1, "sigma_a_ratio", 0},
      {1001, &good, &eta, 1, "sigma_a_ratio", 0}, {1, &peaked, &eta, 1, "phase", 0},
      {1, &unknown, &eta, 1, "phase", 0},         {1, &unnormalized, &eta, 1, "phase", 0},
      {1, &good, bad_eta, 2, "eta", 1},           {1, &good, &eta, 0, "eta", 0},
  };
  for (size_t i = 0; i < sizeof faults / sizeof faults[0]; i++) {
    unit_assert_fault(solver_solve(&solution, core_isa_select(NULL), faults[i].ratio,
                                   faults[i].phase, faults[i].etas, faults[i].count, TOLERANCE),
                      faults[i].field, faults[i].index);
    assert_null(solution);
  }
  const double sines[] = {0.5, 0};
  unit_assert_fault(
      solver_solve_cones(&solution, core_isa_select(NULL), 1, &good, &eta, 1, sines, 2, TOLERANCE),
      "sine", 1);
  assert_null(solution);
  unit_assert_fault(solver_solve(&solution, core_isa_select(NULL), 1, &good, &eta, 1, INFINITY),
                    "tolerance", 0);
  const solver_phase most = {0.99, 0, NULL};
  total_of(0, &most, eta); /* without absorption it takes no solution */
  solver_free(NULL);
}

/* 0.5 HG(0.8) + 0.5 HG(-0.8): every other moment is 0. */
UNIT_TEST(moments_behind_one_that_is_0_count) {
  double moment[64], power = 1;
  for (size_t l = 0; l < 64; l++, power *= 0.8) {
    moment[l] = l % 2 == 0 ? power : 0;
  }
  const solver_phase phase = {.moments = 64, .moment = moment};
  const solver_phase cut = {.moments = 3, .moment = moment}; /* 1, 0 and the next one */
  const solver_total total = total_of(1, &phase, 1.4), without = total_of(1, &cut, 1.4);
  assert_true(fabs(total.normal.value - without.normal.value) > 100 * total.normal.error);
}

UNIT_TEST(next_to_nothing_is_absorbed) {
  const solver_phase phase = {.g = 0.97};
  const solver_total total = total_of(3e-17, &phase, 1.4);
  assert_true(total.normal.value == 1 && total.normal.error > 0 && total.normal.error < 1e-6);
}
