/* With X(k) the exitance of light scattered more than once, Fourier transformed over the plane,
 *
 *   R(r) = 1 / (2 pi) Re int X(k) H0(kr) k dk,   k = s + i c, s from 0 to infinity,
 *
 * where 0 <= c < kappa, so that R keeps its digits where it decays as e^(-kappa r). exitance.c has the way
 * from X to R. For wavenumbers above all that are solved it has to know `far`, the limit of k^2 X.
 *
 * `far`: light that is scattered twice and comes back to where it entered runs along a triangle.
 * The number of triangles of size l is in proportion to dl / l, so that R2(r) = far / (2 pi) ln(1 /
 * r) + ..., with
 *
 *   far = (2 pi a)^2 int_0^pi/2 T(mu) mu dtheta int_theta^pi p(cos t) p(-cos(t - theta)) dt,
 *
 * mu = cos(theta), theta the angle at which the light leaves, t the angle by which it is deflected
 * first. The light that leaves within a cone of angles has an X of its own, whose integral over theta
 * ends at the cone's edge.
 */
#include "core/transport/anisotropic.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/transport/decay.h"
#include "core/transport/exitance.h"
#include "core/transport/functions.h"
#include "core/transport/gauss.h"
#include "core/transport/halfspace.h"
#include "core/transport/single.h"

#define SINGLE_STEP 0.3

/* ---- how finely ----------------------------------------------------------------------------- */

enum {
  TIERS = EXITANCE_TIERS,
  GRIDS = 2,
  PARTS_MAX = TRANSPORT_ANISOTROPIC_ETAS_MAX * (1 + TRANSPORT_ANISOTROPIC_CONES_MAX),
};

/* Up to the wavenumber k_most, two expansions are averaged: the rules' own, and the one with an order
 * and a degree more. Their errors have opposite signs. */
struct tier {
  double k_most;
  halfspace_rules rules;
};

struct grid_rules {
  double moment_least; /* the series of the phase function ends at a moment as small as this */
  size_t moments_most;
  double floor;            /* least relative error that is stated */
  double margin[2];        /* stated errors over the grids' difference: below r = NEAR, beyond */
  double shift;            /* c / kappa */
  size_t nodes;            /* on each panel */
  struct tier tier[TIERS]; /* the last one's k_most is K */
};

static const struct grid_rules rules[] = {
    {1e-4,
     40,
     1e-3,
     {16, 3},
     0.80,
     8,
     {{0.3, {4, 9, 3}}, {1, {6, 10, 3}}, {3, {7, 12, 4}}, {6, {8, 14, 5}}}},
    {1e-4,
     48,
     6e-5,
     {16, 3},
     0.85,
     9,
     {{0.3, {5, 11, 4}}, {1, {7, 12, 4}}, {3, {9, 15, 5}}, {8, {10, 18, 6}}}},
    {1e-5,
     64,
     3e-5,
     {10, 3},
     0.88,
     10,
     {{0.3, {6, 13, 5}}, {1, {8, 14, 5}}, {4, {11, 17, 6}}, {12, {12, 23, 8}}}},
    {1e-6,
     96,
     1e-5,
     {2, 2},
     0.86,
     12,
     {{0.3, {6, 26, 8}}, {1, {8, 26, 8}}, {4, {10, 26, 8}}, {16, {12, 30, 8}}}},
};

/* ---- the medium ----------------------------------------------------------------------------- */

/* A medium after its phase function has been truncated. */
struct scaled {
  halfspace_medium medium;
  double moment[HALFSPACE_MOMENTS_MAX];
  double unit;   /* scaled mean free path in reduced mean free paths */
  double kappa;  /* per scaled mean free path */
  double single; /* albedo by which light scattered once is in proportion, per scaled path */
};

static double moment_at(const transport_phase *phase, size_t l) {
  if (phase->moments > 0) {
    return l < phase->moments ? phase->moment[l] : 0;
  }
  double power = 1;
  for (size_t i = 0; i < l; i++) {
    power *= phase->g;
  }
  return power;
}

/* Returns the phase function, normalized to 1 over the sphere, times 4 pi. */
static double phase_at(const transport_phase *phase, double cosine) {
  if (phase->moments == 0) {
    const double g = phase->g, base = 1 + g * g - 2 * g * cosine;
    return (1 - g) * (1 + g) / (base * sqrt(base));
  }
  double before = 0, here = 1, sum = 0;
  for (size_t l = 0; l < phase->moments; l++) {
    sum += (double)(2 * l + 1) * phase->moment[l] * here;
    const double next =
        ((double)(2 * l + 1) * cosine * here - (double)l * before) / (double)(l + 1);
    before = here;
    here = next;
  }
  return sum;
}

static void truncate_phase(struct scaled *to, double ratio, const transport_phase *phase,
                           double moment_least, size_t moments_most) {
  const double g = moment_at(phase, 1);
  /* In reduced mean free paths sigma_a + sigma_s (1 - g) is 1. */
  const double sigma_s = 1 / (1 + ratio) / (1 - g), sigma_t = ratio / (1 + ratio) + sigma_s;
  const double albedo = sigma_s / sigma_t;
  size_t count = 2;
  while (count < moments_most && fabs(moment_at(phase, count)) > moment_least) {
    count++;
  }
  /* An odd moment of a backward phase function is negative, and nothing is left out then. */
  const double forward = fmax(0, moment_at(phase, count));
  for (size_t l = 0; l < count; l++) {
    to->moment[l] = (moment_at(phase, l) - forward) / (1 - forward);
  }
  const double kept = 1 - albedo * forward;
  to->medium = (halfspace_medium){albedo * (1 - forward) / kept, count, to->moment};
  to->unit = 1 / (kept * sigma_t);
  to->single = albedo / kept;
  to->kappa = transport_decay_rate(to->medium.moment, to->medium.moments, to->medium.albedo,
                                   1 - to->medium.albedo);
}

/* ---- light that is scattered twice near the source -------------------------------------------- */

/* Returns arcsin(x) for 0 < x <= 1. */
static double arcsine(double x) {
  return cimag(fn_clog(CMPLX(sqrt((1 - x) * (1 + x)), x)));
}

/* Returns the integral over t from theta to pi of p(cos t) p(-cos(t - theta)) (4 pi)^2. The panels
 * halve towards both ends, where p may be narrow. */
static double second_deflections(const transport_phase *phase, const gauss_rule *rule,
                                 double theta) {
  enum { HALVINGS = 9 };
  const double length = FN_PI - theta;
  double sum = 0, end = 0.5;
  for (size_t panel = 0; panel < HALVINGS; panel++) {
    const double begin = panel + 1 < HALVINGS ? end / 2 : 0;
    for (size_t i = 0; i < rule->n; i++) {
      const double x = length * (begin + (end - begin) * rule->x[i]);
      const double weight = length * (end - begin) * rule->weight[i];
      for (int side = 0; side < 2; side++) {
        double sine, first, second;
        fn_sincos(side == 0 ? theta + x : FN_PI - x, &sine, &first);
        fn_sincos(side == 0 ? x : length - x, &sine, &second);
        sum += weight * phase_at(phase, first) * phase_at(phase, -second);
      }
    }
    end = begin;
  }
  return sum;
}

/* edge: the sine of the cone's edge outside, 1 for light of all angles. */
static double far_of(const struct scaled *scaled, const transport_phase *phase, double eta,
                     double edge) {
  enum { ANGLES = 40, DEFLECTIONS = 12 };
  gauss_rule angles, deflections;
  transport_gauss(&angles, ANGLES);
  transport_gauss(&deflections, DEFLECTIONS);
  const double most = edge < eta ? arcsine(edge / eta) : 0.5 * FN_PI;
  double sum = 0;
  for (size_t i = 0; i < angles.n; i++) {
    const double v = angles.x[i];
    double sine, mu;
    fn_sincos(most * (1 - v * v), &sine, &mu);
    const double mu_outside = sqrt(fmax(0, 1 - eta * eta * (1 - mu) * (1 + mu)));
    const double t = eta == 1 ? 1 : transport_transmittance(eta, mu, mu_outside);
    sum += 2 * v * most * angles.weight[i] * t * mu *
           second_deflections(phase, &deflections, most * (1 - v * v));
  }
  return 0.25 * scaled->single * scaled->single * sum;
}

/* ---- one grid ------------------------------------------------------------------------------- */

struct grid {
  const struct grid_rules *rules;
  struct scaled scaled;
  exitance_grid wavenumbers;
  exitance_series *exitance; /* one for each boundary, then one for each boundary and cone */
};

/* The boundaries and cones of a solution. */
struct boundaries {
  size_t count;
  const double *etas;
  size_t cones;
  const double *sines;
};

/* Returns how many X there are. X number i is of the boundary i % count, and of light of all angles
 * for i < count, else of the cone i / count - 1. */
static size_t parts_of(const struct boundaries *of) {
  return of->count * (1 + of->cones);
}

/* Returns the sine of the largest angle outside. */
static double sine_of(const struct boundaries *of, size_t part) {
  return part < of->count ? 1
                          : of->sines[part / of->count - 1] * fmin(of->etas[part % of->count], 1);
}

_Static_assert((int)EXITANCE_PANELS_MAX *EXITANCE_NODES_MAX ==
                   (int)TRANSPORT_ANISOTROPIC_WAVENUMBERS_MAX,
               "a caller keeps all wavenumbers");

struct transport_anisotropic {
  size_t count;
  size_t parts;
  size_t grids;        /* number of grids that were solved, 1 or GRIDS */
  single_rule *single; /* one for each part, with the phase function in its weights */
  struct grid grid[GRIDS];
};

/* Solves the wavenumbers that belong to one tier. values: [part][node of all panels]. Returns false if
 * memory runs out or an equation is singular. */
static bool solve_tier(struct grid *of, const core_isa *isa, size_t tier,
                       const struct boundaries *by, double complex **values) {
  halfspace *expansion[2] = {NULL, NULL};
  bool ok = true;
  for (size_t i = 0; i < 2 && ok; i++) {
    halfspace_rules at = of->rules->tier[tier].rules;
    at.orders += i;
    at.degrees += i;
    expansion[i] = transport_halfspace_new(isa, &at, &of->scaled.medium, by->etas, by->count,
                                           by->sines, by->cones);
    ok = expansion[i] != NULL;
  }
  const size_t end = transport_exitance_end(&of->wavenumbers, tier);
  for (size_t node = tier > 0 ? transport_exitance_end(&of->wavenumbers, tier - 1) : 0;
       node < end && ok; node++) {
    const double complex k = transport_exitance_wavenumber(&of->wavenumbers, node);
    for (size_t i = 0; i < 2 && ok; i++) {
      halfspace_exitance at[TRANSPORT_ANISOTROPIC_ETAS_MAX];
      ok = transport_halfspace_solve(expansion[i], k, of->scaled.kappa, at);
      for (size_t eta = 0; eta < by->count && ok; eta++) {
        values[eta][node] += 0.5 * (at[eta].all - at[eta].single);
        for (size_t cone = 0; cone < by->cones; cone++) {
          values[(cone + 1) * by->count + eta][node] += 0.5 * at[eta].cone[cone];
        }
      }
    }
  }
  transport_halfspace_free(expansion[0]);
  transport_halfspace_free(expansion[1]);
  return ok;
}

/* X at all nodes that a caller keeps: [part][TRANSPORT_ANISOTROPIC_WAVENUMBERS_MAX]. */
struct kept {
  double complex *exitances;
  bool known; /* whether they are given, else they are set */
};

/* kept: NULL, or where X is kept. */
static bool solve_grid(struct grid *to, const core_isa *isa, const struct grid_rules *by,
                       double ratio, const transport_phase *phase,
                       const struct boundaries *boundaries, const struct kept *kept) {
  const size_t parts = parts_of(boundaries);
  double tier_end[TIERS];
  for (size_t tier = 0; tier < TIERS; tier++) {
    tier_end[tier] = by->tier[tier].k_most;
  }
  to->rules = by;
  truncate_phase(&to->scaled, ratio, phase, by->moment_least, by->moments_most);
  transport_exitance_place(&to->wavenumbers, isa, to->scaled.kappa, by->shift, by->nodes, tier_end);
  to->exitance = calloc(parts, sizeof *to->exitance);
  double complex *values[PARTS_MAX];
  const size_t nodes = transport_exitance_end(&to->wavenumbers, TIERS - 1);
  values[0] = calloc(nodes * parts, sizeof **values);
  bool ok = to->exitance != NULL && values[0] != NULL;
  for (size_t part = 1; part < parts; part++) {
    values[part] = values[0] + part * nodes;
  }
  const bool known = kept != NULL && kept->known;
  for (size_t tier = 0; tier < TIERS && ok && !known; tier++) {
    ok = solve_tier(to, isa, tier, boundaries, values);
  }
  for (size_t part = 0; part < parts && ok && kept != NULL; part++) {
    double complex *at = kept->exitances + part * TRANSPORT_ANISOTROPIC_WAVENUMBERS_MAX;
    memcpy(known ? values[part] : at, known ? at : values[part], nodes * sizeof *at);
  }
  for (size_t part = 0; part < parts && ok; part++) {
    const double far = far_of(&to->scaled, phase, boundaries->etas[part % boundaries->count],
                              sine_of(boundaries, part));
    ok = transport_exitance_make(&to->exitance[part], &to->wavenumbers, far, values[part]);
  }
  free(values[0]);
  return ok;
}

/* ---- solutions ------------------------------------------------------------------------------ */

/* Puts the phase function into the weights of light that was scattered once, which leaves at the
 * cosine mu = (E^2 - 1) / (E^2 + 1). */
static void weigh_single(single_rule *rule, const transport_phase *phase) {
  for (size_t i = 0; i < rule->n; i++) {
    const double e2 = rule->rate[i] * rule->rate[i];
    rule->weight[i] *= phase_at(phase, -(e2 - 1) / (e2 + 1));
  }
}

static const core_fault no_fault = {NULL, NULL, 0};
static const core_fault memory_fault = {CORE_FIELD_MEMORY, "enough for the solution", 0};

static core_fault check(double ratio, const transport_phase *phase, const double *etas,
                        size_t count) {
  if (!(ratio >= 1e-6 && ratio <= 100)) {
    return (core_fault){"sigma_a_ratio", "1e-6 to 100", 0};
  }
  const bool is_series = phase->moments != 0;
  if (is_series ? phase->moments < 2 || phase->moments > TRANSPORT_PHASE_MOMENTS_MAX ||
                      phase->moment[0] != 1 || !(fabs(phase->moment[1]) <= 0.99)
                : !(fabs(phase->g) <= 0.99)) {
    return (core_fault){"phase", "a mean cosine from -0.99 to 0.99", 0};
  }
  if (count < 1 || count > TRANSPORT_ANISOTROPIC_ETAS_MAX) {
    return (core_fault){"eta", "1 to 32 of them", 0};
  }
  for (size_t i = 0; i < count; i++) {
    if (!(etas[i] >= TRANSPORT_ETA_MIN && etas[i] <= TRANSPORT_ETA_MAX)) {
      return (core_fault){"eta", "0.25 to 4", i};
    }
  }
  return no_fault;
}

static core_fault solve(transport_anisotropic **solution, const core_isa *isa, double sigma_a_ratio,
                        const transport_phase *phase, const struct boundaries *boundaries,
                        transport_effort effort, size_t grids, const struct kept *kept) {
  *solution = NULL;
  const core_fault fault = check(sigma_a_ratio, phase, boundaries->etas, boundaries->count);
  if (fault.field != NULL) {
    return fault;
  }
  transport_anisotropic *made = calloc(1, sizeof *made);
  if (made == NULL) {
    return memory_fault;
  }
  made->count = boundaries->count;
  made->parts = parts_of(boundaries);
  made->grids = grids;
  made->single = malloc(made->parts * sizeof *made->single);
  bool ok = made->single != NULL;
  for (size_t i = 0; i < made->parts && ok; i++) {
    transport_single_rule(&made->single[i], boundaries->etas[i % made->count],
                          sine_of(boundaries, i), SINGLE_STEP);
    weigh_single(&made->single[i], phase);
  }
  for (size_t i = 0; i < grids && ok; i++) {
    ok = solve_grid(&made->grid[i], isa, &rules[effort + 1 - i], sigma_a_ratio, phase, boundaries,
                    kept);
  }
  if (!ok) {
    transport_anisotropic_free(made);
    return memory_fault;
  }
  *solution = made;
  return no_fault;
}

core_fault transport_anisotropic_solve(transport_anisotropic **solution, const core_isa *isa,
                                       double sigma_a_ratio, const transport_phase *phase,
                                       const double *etas, size_t count, transport_effort effort) {
  const struct boundaries boundaries = {.count = count, .etas = etas};
  return solve(solution, isa, sigma_a_ratio, phase, &boundaries, effort, GRIDS, NULL);
}

core_fault transport_anisotropic_solve_once(transport_anisotropic **solution, const core_isa *isa,
                                            double sigma_a_ratio, const transport_phase *phase,
                                            const double *etas, size_t count,
                                            transport_effort effort) {
  const struct boundaries boundaries = {.count = count, .etas = etas};
  return solve(solution, isa, sigma_a_ratio, phase, &boundaries, effort, 1, NULL);
}

core_fault transport_anisotropic_solve_kept(transport_anisotropic **solution, const core_isa *isa,
                                            double sigma_a_ratio, const transport_phase *phase,
                                            const double *etas, size_t count,
                                            transport_effort effort, double complex *exitances,
                                            bool known) {
  const struct boundaries boundaries = {.count = count, .etas = etas};
  const struct kept kept = {exitances, known};
  return solve(solution, isa, sigma_a_ratio, phase, &boundaries, effort, 1, &kept);
}

core_fault transport_anisotropic_solve_cones(transport_anisotropic **solution, const core_isa *isa,
                                             double sigma_a_ratio, const transport_phase *phase,
                                             const double *etas, size_t count, const double *sines,
                                             size_t cones, transport_effort effort, bool once) {
  *solution = NULL;
  if (cones > TRANSPORT_ANISOTROPIC_CONES_MAX) {
    return (core_fault){"sine", "0 to 8 of them", 0};
  }
  for (size_t i = 0; i < cones; i++) {
    if (!(sines[i] > 0 && sines[i] <= 1)) {
      return (core_fault){"sine", "above 0, up to 1", i};
    }
  }
  const struct boundaries boundaries = {count, etas, cones, sines};
  return solve(solution, isa, sigma_a_ratio, phase, &boundaries, effort, once ? 1 : GRIDS, NULL);
}

void transport_anisotropic_free(transport_anisotropic *solution) {
  if (solution != NULL) {
    for (size_t i = 0; i < GRIDS; i++) {
      free(solution->grid[i].exitance);
    }
    free(solution->single);
    free(solution);
  }
}

/* ---- values --------------------------------------------------------------------------------- */

static double reduced_single(const transport_anisotropic *of, const struct grid *grid, size_t eta,
                             double r) {
  const double unit = grid->scaled.unit;
  return grid->scaled.single * transport_single_at(&of->single[eta], r / unit).r / (unit * unit);
}

double transport_anisotropic_single_at(const transport_anisotropic *solution, size_t eta,
                                       double r) {
  return reduced_single(solution, &solution->grid[0], eta, r);
}

static double value_at(const transport_anisotropic *of, const struct grid *grid, size_t eta,
                       double r) {
  const double unit = grid->scaled.unit;
  return reduced_single(of, grid, eta, r) +
         transport_exitance_at(&grid->exitance[eta], &grid->wavenumbers, r / unit) / (unit * unit);
}

/* Near the source two grids share more of their errors: at 1152 values of 64 media (reference.csv, by the
 * finest grids) the normal ones were up to 6.7 times, and the quick ones up to 11 times as far off as
 * they differ from the next coarser ones. */
#define NEAR 0.3

/* The grids' difference changes its sign here and there as r grows. The error estimate is therefore
 * made from the largest relative difference at r and at its two neighbours. It is at least `floor`,
 * since the two grids share a part of their errors: comparisons with the solver for isotropic
 * scattering found up to a third of it. */
transport_number transport_anisotropic_at(const transport_anisotropic *solution, size_t eta,
                                          double r) {
  static const double neighbour[] = {1, 0.75, 1.3};
  assert(eta < solution->count && r >= 0);
  if (r == 0) {
    return (transport_number){INFINITY, INFINITY};
  }
  if (isinf(r)) {
    return (transport_number){0, 0};
  }
  if (solution->grids == 1) {
    return (transport_number){fmax(value_at(solution, &solution->grid[0], eta, r), 0), (double)NAN};
  }
  double value = 0, error = 0;
  for (size_t i = 0; i < sizeof neighbour / sizeof neighbour[0]; i++) {
    const double fine = value_at(solution, &solution->grid[0], eta, r * neighbour[i]);
    const double coarse = value_at(solution, &solution->grid[1], eta, r * neighbour[i]);
    value = i == 0 ? fmax(fine, 0) : value;
    error = fmax(error, fine > 0 ? fabs(1 - coarse / fine) : 1);
  }
  const struct grid_rules *by = solution->grid[0].rules;
  error = fmax(by->margin[r >= NEAR] * error, by->floor);
  return (transport_number){value, error * value};
}

transport_number transport_anisotropic_share_at(const transport_anisotropic *solution, size_t eta,
                                                size_t cone, double r) {
  const size_t part = solution->count * (1 + cone) + eta;
  assert(eta < solution->count && part < solution->parts && r > 0 && r < (double)INFINITY);
  double share[GRIDS] = {(double)NAN, (double)NAN};
  for (size_t i = 0; i < solution->grids; i++) {
    const struct grid *grid = &solution->grid[i];
    share[i] = value_at(solution, grid, part, r) / value_at(solution, grid, eta, r);
  }
  return (transport_number){share[0], fabs(share[0] - share[1])};
}

/* ---- totals --------------------------------------------------------------------------------- */

/* Moments of light that is scattered once are left out below this. */
#define MOMENT_LEAST 1e-13

/* Enters a value of grid i: the first grid's is the value, and the next one's difference from it is
 * the error. */
static void enter(transport_number *to, size_t i, double value) {
  *to = i == 0 ? (transport_number){value, 0}
               : (transport_number){to->value, fabs(to->value - value)};
}

/* Sets moment[] to the moments of the true phase function, except those that are negligible, and
 * returns their number. */
static size_t find_moments(const transport_phase *phase,
                           double moment[TRANSPORT_PHASE_MOMENTS_MAX]) {
  size_t count = 0;
  double power = 1;
  while (count < TRANSPORT_PHASE_MOMENTS_MAX &&
         (phase->moments > 0 ? count < phase->moments : fabs(power) > MOMENT_LEAST)) {
    moment[count] = phase->moments > 0 ? phase->moment[count] : power;
    power *= phase->g;
    count++;
  }
  return count;
}

core_fault transport_anisotropic_totals(transport_totals *totals, const core_isa *isa,
                                        double sigma_a_ratio, const transport_phase *phase,
                                        const double *etas, size_t count) {
  const core_fault fault = check(sigma_a_ratio, phase, etas, count);
  if (fault.field != NULL) {
    return fault;
  }
  static const struct {
    halfspace_rules rules;
    double moment_least;
    size_t moments_most;
  } by[GRIDS] = {{{0, 72, 3}, 1e-8, 250}, {{0, 56, 3}, 1e-7, 220}};
  double moment[TRANSPORT_PHASE_MOMENTS_MAX], once[TRANSPORT_ANISOTROPIC_ETAS_MAX];
  const size_t moments = find_moments(phase, moment);
  for (size_t eta = 0; eta < count; eta++) {
    once[eta] = transport_single_diffuse(etas[eta], moments, moment);
  }
  for (size_t i = 0; i < GRIDS; i++) {
    struct scaled scaled;
    truncate_phase(&scaled, sigma_a_ratio, phase, by[i].moment_least, by[i].moments_most);
    halfspace *expansion =
        transport_halfspace_new(isa, &by[i].rules, &scaled.medium, etas, count, NULL, 0);
    halfspace_exitance exitance[TRANSPORT_ANISOTROPIC_ETAS_MAX];
    double single[TRANSPORT_ANISOTROPIC_ETAS_MAX];
    const bool ok = expansion != NULL &&
                    transport_halfspace_solve(expansion, 0, scaled.kappa, exitance) &&
                    transport_halfspace_diffuse_single(expansion, single);
    transport_halfspace_free(expansion);
    if (!ok) {
      return memory_fault;
    }
    for (size_t eta = 0; eta < count; eta++) {
      single_rule rule;
      transport_single_rule(&rule, etas[eta], 1, SINGLE_STEP);
      weigh_single(&rule, phase);
      enter(&totals[eta].normal, i,
            creal(exitance[eta].all - exitance[eta].single) +
                scaled.single * transport_single_at(&rule, INFINITY).within);
      enter(&totals[eta].diffuse, i,
            creal(exitance[eta].diffuse) - single[eta] + scaled.single * once[eta]);
    }
  }
  return no_fault;
}
