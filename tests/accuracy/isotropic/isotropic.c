/* The solver computes every number twice, on two contours with two sets of nodes. The finer one is
 * the answer, and SAFETY times their difference is the error estimate. */
#include "tests/accuracy/isotropic/isotropic.h"

#include <assert.h>
#include <math.h>
#include <pthread.h>
#include <stdlib.h>

#include "core/transport/decay.h"
#include "core/transport/functions.h"
#include "core/transport/single.h"
#include "tests/accuracy/isotropic/equation.h"
#include "tests/accuracy/isotropic/nodes.h"
#include "tests/accuracy/isotropic/spectrum.h"

#define ETA_ALLOWED "from 0.25 to 4"
#define TOLERANCE_ALLOWED "from 1e-9 to 1e-3"
#define ALBEDO_ALLOWED "from 0 to 1"
#define MEMORY_ALLOWED "enough of it"

enum { FINE, COARSE, BOTH };

/* The rules are more accurate than the tolerance by these factors, so that the error estimate also
 * stays below the tolerance. */
static const double finer[BOTH] = {200, 12};
/* factors of lambda for contours that many media share */
static const double shrink[BOTH] = {1, 0.97};
/* factors of kappa, which give lambda, for contours made for one medium */
static const double shrink_far[BOTH] = {0.999, 0.98};
static const double single_step[BOTH] = {0.27, 0.33};
/* The total needs only one wavenumber, K_TOTAL, which stands for 0. */
static const double total_accuracy[BOTH] = {1e-14, 1e-12};
#define K_TOTAL 1e-15
#define TOTAL_ROUNDING 1e-13
#define SAFETY 3.0

/* ---- boundaries ----------------------------------------------------------------------------- */

/* What totals need of a boundary. */
struct totals {
  nodes_rules rules[BOTH];
  equation equation[BOTH];
  single_rule single[BOTH];
};

struct isotropic_boundary {
  double reach_decays;
  spectrum_rules rules[BOTH];
  struct totals totals;
  pthread_mutex_t lock; /* protects `grids` */
  spectrum_grid *grids[SPECTRUM_LEVEL_MAX + 1][BOTH];
};

static const core_fault no_fault = {NULL, NULL, 0};
static const core_fault memory_fault = {"memory", MEMORY_ALLOWED, 0};

static bool make_totals(struct totals *totals, double eta) {
  bool made = true;
  for (size_t i = 0; i < BOTH; i++) {
    isotropic_nodes_rules(&totals->rules[i], eta, total_accuracy[i]);
    transport_single_rule(&totals->single[i], eta, 1, single_step[i]);
    made &= isotropic_equation_make(&totals->equation[i], &totals->rules[i], K_TOTAL);
  }
  return made;
}

static void free_totals(struct totals *totals) {
  for (size_t i = 0; i < BOTH; i++) {
    isotropic_equation_free(&totals->equation[i]);
  }
}

static core_fault check_boundary(double eta, double tolerance) {
  if (!(eta >= TRANSPORT_ETA_MIN && eta <= TRANSPORT_ETA_MAX)) {
    return (core_fault){"eta", ETA_ALLOWED, 0};
  }
  if (!(tolerance >= ISOTROPIC_TOLERANCE_MIN && tolerance <= ISOTROPIC_TOLERANCE_MAX)) {
    return (core_fault){"tolerance", TOLERANCE_ALLOWED, 0};
  }
  return no_fault;
}

static core_fault create(isotropic_boundary **boundary, double eta, double tolerance,
                         double reach_decays) {
  *boundary = NULL;
  const core_fault fault = check_boundary(eta, tolerance);
  if (fault.field != NULL) {
    return fault;
  }
  isotropic_boundary *made = calloc(1, sizeof *made);
  if (made == NULL) {
    return memory_fault;
  }
  made->reach_decays = reach_decays;
  pthread_mutex_init(&made->lock, NULL);
  for (size_t i = 0; i < BOTH; i++) {
    isotropic_spectrum_rules(&made->rules[i], eta, tolerance / finer[i], reach_decays);
  }
  if (!make_totals(&made->totals, eta)) {
    isotropic_boundary_free(made);
    return memory_fault;
  }
  *boundary = made;
  return no_fault;
}

core_fault isotropic_boundary_create(isotropic_boundary **boundary, double eta, double tolerance) {
  return create(boundary, eta, tolerance, ISOTROPIC_REACH_DECAYS);
}

core_fault isotropic_boundary_create_far(isotropic_boundary **boundary, double eta,
                                         double tolerance) {
  return create(boundary, eta, tolerance, ISOTROPIC_REACH_DECAYS_FAR);
}

void isotropic_boundary_free(isotropic_boundary *boundary) {
  if (boundary == NULL) {
    return;
  }
  free_totals(&boundary->totals);
  for (size_t i = 0; i < BOTH; i++) {
    for (size_t level = 0; level <= SPECTRUM_LEVEL_MAX; level++) {
      isotropic_grid_free(boundary->grids[level][i]);
    }
  }
  pthread_mutex_destroy(&boundary->lock);
  free(boundary);
}

/* Returns the grid of a level, and makes it on the first call for that level. Returns NULL if
 * memory runs out. */
static const spectrum_grid *grid_of(isotropic_boundary *boundary, size_t level, size_t i) {
  pthread_mutex_lock(&boundary->lock);
  if (boundary->grids[level][i] == NULL) {
    boundary->grids[level][i] =
        isotropic_grid_new(&boundary->rules[i], isotropic_spectrum_lambda(level, shrink[i]));
  }
  const spectrum_grid *grid = boundary->grids[level][i];
  pthread_mutex_unlock(&boundary->lock);
  return grid;
}

/* ---- solutions ------------------------------------------------------------------------------ */

/* A solution holds a table of the relative errors of light scattered more than once, at the radii
 * TABLE_FIRST e^(i TABLE_STEP). Between these radii the code uses the largest of the neighbouring
 * errors, because a difference of two results may be 0 where their errors are not. */
#define TABLE_FIRST 1e-7
#define TABLE_STEP 0.2
/* the table ends at this many reaches, or at TABLE_LAST where that is less */
#define TABLE_REACHES 1.5
#define TABLE_LAST 1e7 /* largest last radius of the table, in mean free paths */
enum { TABLE_MAX = 164 };

struct errors {
  double R;
  double within;
  double beyond;
};

struct isotropic_solution {
  double albedo;
  double kappa;
  /* relative accuracy that the rules for light scattered more than once are made for */
  double least_error;
  transport_number total;
  double multiple_total;
  single_rule single[BOTH];
  spectrum spectra[BOTH];
  size_t table_count;
  struct errors table[TABLE_MAX];
  spectrum_values last; /* values of light scattered more than once at the last radius of `table` */
};

static double table_radius(size_t i) {
  return TABLE_FIRST * fn_exp(TABLE_STEP * (double)i);
}

static double relative(double fine, double coarse) {
  return fine == coarse ? 0 : fmin(1, SAFETY * fabs(fine - coarse) / fabs(fine));
}

static void fill_table(isotropic_solution *solution, double reach_decays) {
  const double last = fmin(TABLE_LAST, TABLE_REACHES * reach_decays / fmax(solution->kappa, 1e-30));
  for (size_t i = 0; i < TABLE_MAX && table_radius(i) <= last; i++) {
    const spectrum_values fine = isotropic_spectrum_at(&solution->spectra[FINE], table_radius(i));
    const spectrum_values coarse =
        isotropic_spectrum_at(&solution->spectra[COARSE], table_radius(i));
    solution->table[i] =
        (struct errors){relative(fine.r, coarse.r), relative(fine.within, coarse.within),
                        relative(fine.beyond, coarse.beyond)};
    solution->last = fine;
    solution->table_count = i + 1;
  }
}

/* Sets *multiple and *total to the energy that leaves after it was scattered more than once, and to
 * all that leaves. */
static bool solve_total(const struct totals *totals, isotropic_work *work, double albedo,
                        double kappa, double *multiple, transport_number *total) {
  double twice[BOTH];
  for (size_t i = 0; i < BOTH; i++) {
    double complex exitance;
    if (!isotropic_equation_solve(&totals->equation[i], work, albedo, kappa, &exitance)) {
      return false;
    }
    twice[i] = creal(exitance);
  }
  const double single = transport_single_at(&totals->single[FINE], INFINITY).within;
  const double single_coarse = transport_single_at(&totals->single[COARSE], INFINITY).within;
  *multiple = twice[FINE];
  total->value = twice[FINE] + albedo * single;
  total->error = fabs(twice[FINE] - twice[COARSE]) + albedo * fabs(single - single_coarse) +
                 TOTAL_ROUNDING * total->value;
  return true;
}

static bool solve(isotropic_solution *solution, isotropic_boundary *boundary,
                  isotropic_work *work) {
  const bool far = boundary->reach_decays > ISOTROPIC_REACH_DECAYS;
  const size_t level = isotropic_spectrum_level(solution->kappa);
  for (size_t i = 0; i < BOTH; i++) {
    spectrum_grid *own =
        far ? isotropic_grid_new(&boundary->rules[i], shrink_far[i] * solution->kappa) : NULL;
    const spectrum_grid *grid = far ? own : grid_of(boundary, level, i);
    const bool made = grid != NULL && isotropic_spectrum_make(&solution->spectra[i], grid, work,
                                                              solution->albedo, solution->kappa);
    isotropic_grid_free(own);
    if (!made) {
      return false;
    }
  }
  if (!solve_total(&boundary->totals, work, solution->albedo, solution->kappa,
                   &solution->multiple_total, &solution->total)) {
    return false;
  }
  fill_table(solution, boundary->reach_decays);
  return true;
}

core_fault isotropic_solve(isotropic_solution **solution, isotropic_boundary *boundary,
                           double albedo) {
  *solution = NULL;
  if (!(albedo >= 0 && albedo <= 1)) {
    return (core_fault){"albedo", ALBEDO_ALLOWED, 0};
  }
  isotropic_solution *made = calloc(1, sizeof *made);
  isotropic_work *work = isotropic_work_new();
  bool solved = made != NULL && work != NULL;
  if (solved && albedo > 0) {
    made->albedo = albedo;
    made->kappa = transport_kappa(albedo);
    made->least_error = boundary->rules[FINE].accuracy;
    made->single[FINE] = boundary->totals.single[FINE];
    made->single[COARSE] = boundary->totals.single[COARSE];
    solved = solve(made, boundary, work);
  }
  isotropic_work_free(work);
  if (!solved) {
    free(made);
    return memory_fault;
  }
  *solution = made;
  return no_fault;
}

void isotropic_solution_free(isotropic_solution *solution) {
  free(solution);
}

transport_number isotropic_total(const isotropic_solution *solution) {
  return solution->total;
}

/* ---- values --------------------------------------------------------------------------------- */

/* Radii below R_SMALLEST are taken as 0 and above R_LARGEST as infinity, because R or its products
 * might overflow. */
#define R_SMALLEST 1e-290
#define R_LARGEST 1e60

static double off_by(double value, double fraction, double absolute) {
  return fabs(value) * fraction + absolute;
}

/* Returns the largest relative errors that the table holds around the radius r. */
static struct errors errors_around(const isotropic_solution *solution, double r) {
  const double place = (fn_log(fmax(r, TABLE_FIRST)) - fn_log(TABLE_FIRST)) / TABLE_STEP;
  const size_t before = (size_t)place;
  struct errors most = {0, 0, 0};
  for (size_t i = before > 0 ? before - 1 : 0; i <= before + 1 && i < solution->table_count; i++) {
    most.R = fmax(most.R, solution->table[i].R);
    most.within = fmax(most.within, solution->table[i].within);
    most.beyond = fmax(most.beyond, solution->table[i].beyond);
  }
  return most;
}

/* Returns the absolute errors of the values at r. Beyond the table, the only known bound is that
 * light decays at least as fast as e^(-kappa r). So there the errors of R and of the energy beyond
 * r are these values themselves plus that bound. */
static struct errors errors_at(const isotropic_solution *solution, double r,
                               const spectrum_values *values) {
  const double least = solution->least_error;
  const double last_r = table_radius(solution->table_count - 1);
  if (r > last_r) {
    const double decay = fn_exp(fmax(-700, -solution->kappa * (r - last_r)));
    return (struct errors){off_by(values->r, 1, decay * fabs(solution->last.r)),
                           off_by(values->within, least, off_by(solution->last.beyond, decay, 0)),
                           off_by(values->beyond, 1, decay * fabs(solution->last.beyond))};
  }
  /* On the level with the smallest lambda, the path leaves out the wavenumbers nearer to 0 than
   * lambda; see spectrum.c. */
  const double lambda = solution->spectra[FINE].lambda;
  const double missing = solution->kappa < lambda ? lambda * r : 0;
  const struct errors around = errors_around(solution, r);
  return (struct errors){off_by(values->r, around.R + missing + least, values->r_rounding),
                         off_by(values->within, around.within + missing + least, 0),
                         off_by(values->beyond, around.beyond + missing + least, 0)};
}

/* Returns the energy within r of light scattered more than once. Far away the energy beyond r is
 * small and more accurate, so the code subtracts it from the total there. */
static transport_number multiple_within(const isotropic_solution *solution,
                                        const spectrum_values *values,
                                        const struct errors *errors) {
  if (values->beyond < values->within) {
    return (transport_number){solution->multiple_total - values->beyond,
                              errors->beyond + solution->total.error};
  }
  return (transport_number){values->within, errors->within};
}

static transport_number single_number(double albedo, double fine, double coarse) {
  return (transport_number){albedo * fine, albedo * (fabs(fine - coarse) + 1e-13 * fine)};
}

static transport_number sum_of(transport_number one, transport_number other) {
  return (transport_number){one.value + other.value, one.error + other.error};
}

/* Returns the number with a negative value replaced by 0, which is nearer to the exact value. */
static transport_number not_negative(transport_number number) {
  return (transport_number){number.value < 0 ? 0 : number.value, number.error};
}

static isotropic_values finite_values(const isotropic_solution *solution, double r) {
  const single_values single = transport_single_at(&solution->single[FINE], r);
  const single_values coarse = transport_single_at(&solution->single[COARSE], r);
  const spectrum_values multiple = isotropic_spectrum_at(&solution->spectra[FINE], r);
  const struct errors errors = errors_at(solution, r, &multiple);
  const double albedo = solution->albedo;
  isotropic_values values;
  values.single = single_number(albedo, single.r, coarse.r);
  values.multiple = not_negative((transport_number){multiple.r, errors.R});
  values.R = sum_of(values.single, values.multiple);
  values.within = sum_of(single_number(albedo, single.within, coarse.within),
                         not_negative(multiple_within(solution, &multiple, &errors)));
  return values;
}

isotropic_values isotropic_at(const isotropic_solution *solution, double r) {
  assert(r >= 0);
  const transport_number none = {0, 0};
  if (solution->albedo == 0) {
    return (isotropic_values){none, none, none, none};
  }
  if (r < R_SMALLEST) {
    const transport_number infinite = {INFINITY, 0};
    return (isotropic_values){infinite, infinite, infinite, none};
  }
  if (r > R_LARGEST) {
    /* The bound follows since R decreases, and at most all the energy leaves beyond r / 2. */
    const transport_number next_to_none = {0, 2 * solution->total.value / (r * r)};
    return (isotropic_values){next_to_none, next_to_none, next_to_none, solution->total};
  }
  return finite_values(solution, r);
}
