/* With X(k) the exitance of light scattered more than once, Fourier transformed over the plane,
 *
 *   R(r) = 1 / (2 pi) Re int X(k) H0(kr) k dk,   k = s + i c, s from 0 to infinity,
 *
 * where 0 <= c < kappa, so that R keeps its digits where it decays as e^(-kappa r). exitance.c has
 * the way from X to R. For wavenumbers above all that are solved it has to know `far`, the limit
 * of k^2 X. */
#include "core/solver/solver.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/solver/exitance.h"
#include "core/solver/layer.h"
#include "core/solver/level.h"
#include "core/transport/decay.h"
#include "core/transport/functions.h"
#include "core/transport/gauss.h"
#include "core/transport/single.h"

#define SINGLE_STEP 0.3

/* ---- the medium ----------------------------------------------------------------------------- */

/* A medium after its phase function has been truncated. */
struct scaled {
  expansion_medium medium;
  double moment[EXPANSION_MOMENTS_MAX];
  double unit;   /* one scaled mean free path, in reduced mean free paths */
  double kappa;  /* decay rate, per scaled mean free path */
  double single; /* the albedo to which light scattered once is proportional, per scaled path */
};

/* Light that decays more slowly, per scaled mean free path, does not decay. */
#define KAPPA_LEAST 1e-9

static void truncate_phase(struct scaled *to, double ratio, const solver_phase *phase,
                           double moment_least, size_t moments_most, size_t degrees) {
  const double g = solver_moment_at(phase, 1);
  /* In reduced mean free paths sigma_a + sigma_s (1 - g) is 1. */
  const double sigma_s = 1 / (1 + ratio) / (1 - g), sigma_t = ratio / (1 + ratio) + sigma_s;
  const double albedo = sigma_s / sigma_t;
  const size_t count = solver_moments_kept(phase, moment_least, moments_most, degrees);
  const double kept = solver_truncate(&to->medium, to->moment, phase, count, albedo);
  to->unit = 1 / (kept * sigma_t);
  to->single = albedo / kept;
  to->kappa = transport_decay_rate(to->medium.moment, to->medium.moments, to->medium.albedo,
                                   to->medium.reversed, ratio / (1 + ratio) * to->unit);
  to->kappa = to->kappa < KAPPA_LEAST ? 0 : to->kappa;
}

/* ---- one grid ------------------------------------------------------------------------------- */

struct grid {
  struct scaled scaled;
  exitance_grid wavenumbers;
  exitance_series *exitance; /* [part], see parts_of() */
};

/* Returns how many X there are. X number i is of the boundary i % count, and of light of all angles
 * for i < count, else of the cone i / count - 1. */
static size_t parts_of(const expansion_boundaries *of) {
  return of->count * (1 + of->cones);
}

/* Returns the sine of the largest angle outside of a part's light. */
static double sine_of(const expansion_boundaries *of, size_t part) {
  return part < of->count ? 1
                          : of->sines[part / of->count - 1] * fmin(of->etas[part % of->count], 1);
}

enum { PARTS_MAX = SOLVER_ETAS_MAX * (1 + SOLVER_CONES_MAX) };
_Static_assert((int)EXITANCE_PANELS_MAX *EXITANCE_NODES_MAX == (int)SOLVER_WAVENUMBERS_MAX,
               "a caller keeps all wavenumbers");

struct solver_solution {
  size_t count;
  size_t parts;
  double eta[SOLVER_ETAS_MAX];
  size_t level;                        /* level of the finest grid */
  size_t grids;                        /* 1, or 2 if the next coarser grid is known */
  single_rule *single;                 /* [part], with the phase function in its weights */
  struct grid grid[2];                 /* [0]: the finest grid; [1]: the next coarser one */
  const double *floor;                 /* least relative errors: next to the source, and far away */
  double least;                        /* factor of these errors */
  double margin;                       /* relative error / difference of the grids */
  double (*error)[SOLVER_ERROR_RADII]; /* [boundary] relative error at each radius */
};

/* What the caller of a solution provides. */
struct way {
  /* [part][SOLVER_WAVENUMBERS_MAX]: X at all nodes; NULL: it is not kept */
  double complex *exitances;
  bool known;              /* whether exitances are an input; else they are an output */
  const atomic_bool *stop; /* NULL, or true as soon as the solution is not wanted any more */
};

/* Solves the wavenumbers that belong to one tier. values: [part][node of all panels]. Returns
 * false if memory runs out, an equation is singular or the caller stops. */
static bool solve_tier(struct grid *of, const core_isa *isa, const struct level *by, size_t tier,
                       const solver_phase *phase, const expansion_boundaries *boundaries,
                       double complex **values, const struct way *way) {
  const expansion_rules rules = solver_rules_at(by, tier, solver_is_backward(phase));
  expansion *expanded = solver_expansion_new(isa, &rules, &of->scaled.medium, boundaries);
  bool ok = expanded != NULL;
  const size_t end = solver_exitance_end(&of->wavenumbers, tier);
  for (size_t node = tier > 0 ? solver_exitance_end(&of->wavenumbers, tier - 1) : 0;
       node < end && ok; node++) {
    layer_exitance exitance[SOLVER_ETAS_MAX];
    ok = !solver_stops(way->stop) &&
         solver_layer_halfspace(expanded, solver_exitance_wavenumber(&of->wavenumbers, node),
                                of->scaled.kappa, exitance);
    for (size_t part = 0; part < parts_of(boundaries) && ok; part++) {
      values[part][node] = exitance[part % boundaries->count].part[part / boundaries->count];
    }
  }
  solver_expansion_free(expanded);
  return ok;
}

static bool solve_grid(struct grid *to, const core_isa *isa, const struct level *by, double ratio,
                       const solver_phase *phase, const expansion_boundaries *boundaries,
                       const struct way *way) {
  const size_t parts = parts_of(boundaries);
  double tier_end[TIERS];
  for (size_t tier = 0; tier < TIERS; tier++) {
    tier_end[tier] = by->tier[tier].k_most;
  }
  truncate_phase(&to->scaled, ratio, phase, by->moment_least, by->moments_most,
                 by->tier[TIERS - 1].rules.degrees);
  solver_exitance_place(&to->wavenumbers, isa, to->scaled.kappa, by->share, 1, by->nodes, tier_end);
  to->exitance = calloc(parts, sizeof *to->exitance);
  double complex *values[PARTS_MAX];
  const size_t nodes = solver_exitance_end(&to->wavenumbers, TIERS - 1);
  double complex *memory = calloc(nodes * parts, sizeof *memory);
  bool ok = to->exitance != NULL && memory != NULL;
  for (size_t part = 0; part < parts && ok; part++) {
    values[part] = way->exitances == NULL ? memory + part * nodes
                                          : way->exitances + part * SOLVER_WAVENUMBERS_MAX;
  }
  for (size_t tier = 0; tier < TIERS && ok && !way->known; tier++) {
    ok = solve_tier(to, isa, by, tier, phase, boundaries, values, way);
  }
  for (size_t part = 0; part < parts && ok; part++) {
    const double far =
        solver_far(to->scaled.single, phase, boundaries->etas[part % boundaries->count],
                   sine_of(boundaries, part), false);
    ok = solver_exitance_make(&to->exitance[part], &to->wavenumbers, far, solver_peak_at(phase),
                              values[part], values[part]);
  }
  free(memory);
  return ok;
}

/* ---- solutions ------------------------------------------------------------------------------ */

/* Multiplies the weights of light scattered once, which leaves at the cosine mu = (E^2 - 1) / (E^2
 * + 1), by the phase function. */
static void weigh_single(single_rule *rule, const solver_phase *phase) {
  for (size_t i = 0; i < rule->n; i++) {
    const double e2 = rule->rate[i] * rule->rate[i];
    rule->weight[i] *= solver_phase_at(phase, -(e2 - 1) / (e2 + 1));
  }
}

static const core_fault no_fault = {NULL, NULL, 0};
static const core_fault memory_fault = {CORE_FIELD_MEMORY, "enough for the solution", 0};

static core_fault check(double ratio, const solver_phase *phase, const double *etas, size_t count) {
  if (!(ratio >= 0 && ratio <= 1000)) {
    return (core_fault){"sigma_a_ratio", "0 to 1000", 0};
  }
  const bool is_series = phase->moments != 0;
  if (is_series ? phase->moments < 2 || phase->moments > SOLVER_MOMENTS_MAX ||
                      phase->moment[0] != 1 || !(fabs(phase->moment[1]) <= 0.99)
                : !(fabs(phase->g) <= 0.99)) {
    return (core_fault){"phase", "a mean cosine from -0.99 to 0.99", 0};
  }
  if (count < 1 || count > SOLVER_ETAS_MAX) {
    return (core_fault){"eta", "1 to 32 of them", 0};
  }
  for (size_t i = 0; i < count; i++) {
    if (!(etas[i] >= TRANSPORT_ETA_MIN && etas[i] <= TRANSPORT_ETA_MAX)) {
      return (core_fault){"eta", "0.25 to 4", i};
    }
  }
  return no_fault;
}

static double reduced_single(const solver_solution *of, const struct grid *grid, size_t part,
                             double r) {
  const double unit = grid->scaled.unit;
  return grid->scaled.single * transport_single_at(&of->single[part], r / unit).r / (unit * unit);
}

static double value_at(const solver_solution *of, const struct grid *grid, size_t part, double r) {
  const double unit = grid->scaled.unit;
  double size;
  return reduced_single(of, grid, part, r) +
         solver_exitance_at(&grid->exitance[part], &grid->wavenumbers, r / unit, &size) /
             (unit * unit);
}

/* Stated errors over the grids' difference. Where light is scattered back, grids share more of
 * their errors: below BACKWARD they were up to 2.8 times as far off as they differ, above it 1.5
 * times. */
#define MARGIN 1.6
#define MARGIN_BACKWARD 4.0
#define BACKWARD (-0.3)
#define FLOOR_BACKWARD 2.0

/* Sets the errors from the difference of the two grids. Returns the largest at radii for which a
 * tolerance holds. */
static double find_errors(solver_solution *of, const solver_phase *phase) {
  of->least = solver_is_backward(phase) ? FLOOR_BACKWARD : 1;
  of->margin = (solver_moment_at(phase, 1) < BACKWARD ? MARGIN_BACKWARD : MARGIN) *
               solver_shared_by_cuts(phase, of->grid[0].scaled.medium.moments,
                                     of->grid[1].scaled.medium.moments);
  double worst = 0;
  for (size_t eta = 0; eta < of->count; eta++) {
    double r = SOLVER_ERROR_LEAST;
    for (size_t i = 0; i < SOLVER_ERROR_RADII; i++, r *= SOLVER_ERROR_RATIO) {
      const double fine = value_at(of, &of->grid[0], eta, r);
      const double coarse = value_at(of, &of->grid[1], eta, r);
      of->error[eta][i] = solver_error_between(of->margin, fine, coarse);
      const bool counts =
          r >= SOLVER_RADIUS_LEAST && r <= SOLVER_RADIUS_MOST &&
          r * of->grid[0].scaled.kappa / of->grid[0].scaled.unit < SOLVER_DECAYS_MOST;
      worst = counts ? fmax(worst, of->error[eta][i]) : worst;
    }
  }
  return worst;
}

static core_fault solve(solver_solution **solution, const core_isa *isa, double sigma_a_ratio,
                        const solver_phase *phase, const expansion_boundaries *boundaries,
                        size_t first, size_t last, double tolerance, struct way way) {
  *solution = NULL;
  const core_fault fault = check(sigma_a_ratio, phase, boundaries->etas, boundaries->count);
  if (fault.field != NULL) {
    return fault;
  }
  solver_solution *made = calloc(1, sizeof *made);
  if (made == NULL) {
    return memory_fault;
  }
  made->count = boundaries->count;
  made->parts = parts_of(boundaries);
  memcpy(made->eta, boundaries->etas, made->count * sizeof *made->eta);
  made->single = malloc(made->parts * sizeof *made->single);
  made->error = calloc(made->count, sizeof *made->error);
  bool ok = made->single != NULL && made->error != NULL;
  for (size_t i = 0; i < made->parts && ok; i++) {
    transport_single_rule(&made->single[i], boundaries->etas[i % made->count],
                          sine_of(boundaries, i), SINGLE_STEP);
    weigh_single(&made->single[i], phase);
  }
  double worst = (double)INFINITY, before = worst;
  for (size_t level = first; level <= last && ok && solver_goes_on(level, worst, before, tolerance);
       level++) {
    free(made->grid[1].exitance);
    made->grid[1] = made->grid[0];
    made->grid[0] = (struct grid){.exitance = NULL};
    ok = solve_grid(&made->grid[0], isa, &solver_levels[level], sigma_a_ratio, phase, boundaries,
                    &way);
    made->grids = level > first ? 2 : 1;
    made->floor = solver_levels[level].floor;
    made->level = level;
    if (ok && level > first) {
      before = worst;
      worst = fmax(find_errors(made, phase), made->least * made->floor[1]);
    }
  }
  if (!ok) {
    solver_free(made);
    return solver_stops(way.stop) ? (core_fault){CORE_FIELD_STOPPED, "to be waited for", 0}
                                  : memory_fault;
  }
  *solution = made;
  return no_fault;
}

core_fault solver_solve(solver_solution **solution, const core_isa *isa, double sigma_a_ratio,
                        const solver_phase *phase, const double *etas, size_t count,
                        double tolerance) {
  return solver_solve_cones(solution, isa, sigma_a_ratio, phase, etas, count, NULL, 0, tolerance);
}

core_fault solver_solve_cones(solver_solution **solution, const core_isa *isa, double sigma_a_ratio,
                              const solver_phase *phase, const double *etas, size_t count,
                              const double *sines, size_t cones, double tolerance) {
  *solution = NULL;
  if (cones > SOLVER_CONES_MAX) {
    return (core_fault){"sine", "at most 8 sines", 0};
  }
  for (size_t i = 0; i < cones; i++) {
    if (!(sines[i] > 0 && sines[i] <= 1)) {
      return (core_fault){"sine", "above 0, up to 1", i};
    }
  }
  if (!(tolerance >= 0 && tolerance < (double)INFINITY)) {
    return (core_fault){"tolerance", "not negative, finite", 0};
  }
  const expansion_boundaries boundaries = {
      .count = count, .etas = etas, .cones = cones, .sines = sines};
  const size_t first = solver_first_level(tolerance);
  return solve(solution, isa, sigma_a_ratio, phase, &boundaries, first, first + 3, tolerance,
               (struct way){.stop = NULL});
}

core_fault solver_solve_until(solver_solution **solution, const core_isa *isa, double sigma_a_ratio,
                              const solver_phase *phase, double eta, double tolerance,
                              const atomic_bool *stop) {
  const expansion_boundaries boundaries = {.count = 1, .etas = &eta};
  const size_t first = solver_first_level(tolerance);
  return solve(solution, isa, sigma_a_ratio, phase, &boundaries, first, first + 3, tolerance,
               (struct way){.stop = stop});
}

core_fault solver_solve_level(solver_solution **solution, const core_isa *isa, double sigma_a_ratio,
                              const solver_phase *phase, const double *etas, size_t count,
                              size_t level, double complex *exitances, bool known) {
  assert(level < SOLVER_LEVELS && (exitances != NULL || !known));
  const expansion_boundaries boundaries = {.count = count, .etas = etas};
  return solve(solution, isa, sigma_a_ratio, phase, &boundaries, level, level, 0,
               (struct way){.exitances = exitances, .known = known});
}

void solver_free(solver_solution *solution) {
  if (solution != NULL) {
    free(solution->grid[0].exitance);
    free(solution->grid[1].exitance);
    free(solution->error);
    free(solution->single);
    free(solution);
  }
}

size_t solver_level(const solver_solution *solution) {
  return solution->level;
}

/* ---- values --------------------------------------------------------------------------------- */

double solver_single_at(const solver_solution *solution, size_t eta, double r) {
  return reduced_single(solution, &solution->grid[0], eta, r);
}

/* Beyond this many reduced mean free paths R is that of diffusion, within FARTHER_OFF, relative: a
 * source at a depth of some mean free paths changes it by kappa / r, and where that is larger
 * nothing is left of R. */
#define FARTHER 1e4
#define FARTHER_OFF 1e-5

static transport_number beyond(const solver_solution *solution, size_t eta, double r) {
  const transport_number last = solver_at(solution, eta, FARTHER);
  const double kappa = solution->grid[0].scaled.kappa / solution->grid[0].scaled.unit;
  const double decay = kappa * (r - FARTHER), near = FARTHER / r;
  if (decay > 700) {
    return (transport_number){0, 0};
  }
  const double fall =
      fn_exp(-decay) * near * near * ((1 + kappa * r) / (1 + kappa * FARTHER) * near);
  return (transport_number){last.value * fall, (last.error + FARTHER_OFF * last.value) * fall};
}

#define NEARER 1.2

/* The error is at least that of the floor, since the two grids share a part of their errors. */
transport_number solver_at(const solver_solution *solution, size_t eta, double r) {
  assert(eta < solution->count && r >= 0);
  if (r == 0) {
    return (transport_number){INFINITY, INFINITY};
  }
  if (isinf(r)) {
    return (transport_number){0, 0};
  }
  if (r > FARTHER) {
    return beyond(solution, eta, r);
  }
  const double value = value_at(solution, &solution->grid[0], eta, r);
  if (solution->grids == 1) {
    return (transport_number){fmax(value, 0), (double)NAN};
  }
  if (isnan(value)) {
    return (transport_number){0, (double)INFINITY};
  }
  const double unit = solution->grid[0].scaled.unit;
  const double error =
      fmax(solution->least * solver_floor_at(solution->floor, unit, solution->eta[eta], r),
           solver_error_near(solution->error[eta], r, SOLVER_ERROR_RADII));
  if (value > 0 && error < 1) {
    return (transport_number){value, error * value};
  }
  if (r < SOLVER_ERROR_LEAST) {
    return (transport_number){fmax(value, 0), (double)INFINITY};
  }
  /* If no digit of R is known, all that is known is that R decreases. */
  const transport_number nearer = solver_at(solution, eta, r / NEARER);
  return (transport_number){fmax(value, 0), nearer.value + nearer.error};
}

transport_number solver_share_at(const solver_solution *solution, size_t eta, size_t cone,
                                 double r) {
  const size_t part = solution->count * (1 + cone) + eta;
  assert(eta < solution->count && part < solution->parts && r > 0 && r < (double)INFINITY);
  double share[2] = {(double)NAN, (double)NAN};
  for (size_t i = 0; i < solution->grids; i++) {
    const struct grid *grid = &solution->grid[i];
    share[i] = value_at(solution, grid, part, r) / value_at(solution, grid, eta, r);
  }
  return (transport_number){share[0], solution->margin * fabs(share[0] - share[1])};
}

/* ---- totals --------------------------------------------------------------------------------- */

/* Where light is scattered back, two grids are off alike: stated errors over their difference. */
#define TOTALS_MARGIN 2.0

/* Moments below this are neglected for light scattered once. */
#define MOMENT_LEAST 1e-13

/* Records a value of grid i. That of grid 0 is the value; the difference of grid 1, times a margin, is the
 * error. */
static void enter(transport_number *to, size_t i, double value, double margin) {
  *to = i == 0 ? (transport_number){value, 0}
               : (transport_number){to->value, margin * fabs(to->value - value)};
}

/* Sets moment[] to the moments of the phase function that are not negligible, and returns their
 * number. */
static size_t find_moments(const solver_phase *phase, double moment[SOLVER_MOMENTS_MAX]) {
  size_t count = 0;
  double power = 1;
  while (count < SOLVER_MOMENTS_MAX &&
         (phase->moments > 0 ? count < phase->moments : fabs(power) > MOMENT_LEAST)) {
    moment[count] = phase->moments > 0 ? phase->moment[count] : power;
    power *= phase->g;
    count++;
  }
  return count;
}

/* Solves at k = 0. Of diffuse light, that which was scattered once is taken off: what leaves if
 * the albedo is SMALL times as large, less what leaves if it is -SMALL times, over 2 SMALL; but not where
 * light is scattered back, for which it has no quadrature. */
#define SMALL 1e-4
static bool solve_total(const core_isa *isa, const expansion_rules *rules,
                        const struct scaled *scaled, const expansion_boundaries *boundaries,
                        bool backward, layer_exitance *exitance) {
  static const double albedo[] = {1, SMALL, -SMALL}, weight[] = {0, -0.5 / SMALL, 0.5 / SMALL};
  bool ok = true;
  for (size_t i = 0; i < (backward ? 1 : 3) && ok; i++) {
    layer_exitance at[SOLVER_ETAS_MAX];
    expansion_medium medium = scaled->medium;
    medium.albedo *= albedo[i];
    medium.reversed *= albedo[i];
    expansion *expanded = solver_expansion_new(isa, rules, &medium, boundaries);
    ok = expanded != NULL && solver_layer_halfspace(expanded, 0, i == 0 ? scaled->kappa : 1, at);
    for (size_t eta = 0; eta < boundaries->count && ok; eta++) {
      exitance[eta] = i == 0 ? at[eta] : exitance[eta];
      exitance[eta].diffuse += weight[i] * at[eta].diffuse;
    }
    solver_expansion_free(expanded);
  }
  return ok;
}

core_fault solver_totals(solver_total *totals, const core_isa *isa, double sigma_a_ratio,
                         const solver_phase *phase, const double *etas, size_t count) {
  const core_fault fault = check(sigma_a_ratio, phase, etas, count);
  if (fault.field != NULL) {
    return fault;
  }
  static const struct {
    expansion_rules rules;
    double moment_least;
    size_t moments_most;
  } grids[2] = {{{0, 72, 3}, 1e-8, 250}, {{0, 56, 3}, 1e-7, 220}};
  if (sigma_a_ratio == 0) {
    for (size_t eta = 0; eta < count; eta++) {
      totals[eta] = (solver_total){{1, 0}, {1, 0}};
    }
    return no_fault;
  }
  double moment[SOLVER_MOMENTS_MAX];
  const size_t moments = find_moments(phase, moment);
  const expansion_boundaries boundaries = {.count = count, .etas = etas};
  const bool backward = solver_is_backward(phase);
  const double margin = backward ? TOTALS_MARGIN : 1;
  for (size_t i = 0; i < 2; i++) {
    struct scaled scaled;
    const expansion_rules *rules = &grids[i].rules;
    truncate_phase(&scaled, sigma_a_ratio, phase, grids[i].moment_least, grids[i].moments_most,
                   rules->degrees);
    if (scaled.kappa == 0) { /* Nothing is absorbed: the absorbed share is proportional to kappa. */
      for (size_t eta = 0; eta < count; eta++) {
        totals[eta] = (solver_total){{1, 100 * KAPPA_LEAST}, {1, 100 * KAPPA_LEAST}};
      }
      return no_fault;
    }
    layer_exitance exitance[SOLVER_ETAS_MAX];
    if (!solve_total(isa, rules, &scaled, &boundaries, backward, exitance)) {
      return memory_fault;
    }
    for (size_t eta = 0; eta < count; eta++) {
      single_rule rule;
      const double once = backward ? 0 : transport_single_diffuse(etas[eta], moments, moment);
      transport_single_rule(&rule, etas[eta], 1, SINGLE_STEP);
      weigh_single(&rule, phase);
      enter(&totals[eta].normal, i,
            creal(exitance[eta].part[0]) + exitance[eta].beam +
                scaled.single * transport_single_at(&rule, INFINITY).within,
            margin);
      enter(&totals[eta].diffuse, i, creal(exitance[eta].diffuse) + scaled.single * once, margin);
    }
  }
  return no_fault;
}
