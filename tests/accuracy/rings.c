/* rings MILLIONS: compares Monte Carlo with the solver for any phase function, ring by ring, with at
 * least MILLIONS of photons for each g and for each mixture of two functions. It exits with
 * EXIT_FAILURE if any ring or total is off by 4.5 standard errors or more, or if chi-squared per
 * ring is not between 0.8 and 1.2 for a g, or for all. `make rings` walks 100 millions each, `make
 * check-rings` 4.
 *
 * The standard errors are Monte Carlo's alone, as if the solver had no error: whatever error it has
 * raises chi-squared. The error that the solver states is a bound, not a standard error. What it
 * could add to chi-squared if all of it were there, the mean of its square in standard errors, is
 * printed beside it.
 *
 * Lengths are in reduced mean free paths. Rings are logarithmic, from 10^-2.05 to 10^1.35. */
#include <math.h>
#include <stdlib.h>

#include "core/montecarlo/montecarlo.h"
#include "core/solver/solver.h"
#include "core/tools/tools.h"
#include "core/transport/gauss.h"

#define SIGMAS_MOST 4.5
/* The standard errors of rings with few photons are known too badly. */
#define PHOTONS_LEAST 1000

static const struct subject {
  const char *name;
  double g;
  unsigned phase;
  double share, second;
} subjects[] = {
    {"g -0.3", -0.3, 0, 0, 0},
    {"g 0.3", 0.3, 0, 0, 0},
    {"g 0.7", 0.7, 0, 0, 0},
    {"g 0.8", 0.8, 0, 0, 0},
    {"g 0.9", 0.9, 0, 0, 0},
    {"g 0.95", 0.95, 0, 0, 0},
    {"g 0.8, modified 0.889", 0.8, CORE_PHASE_MODIFIED, 0.889, 0},
    {"g 0.9, two-term 0.95 and -0.3", 0.9, CORE_PHASE_TWO_TERM, 0.95, -0.3},
};
static const struct { double ratio, eta; } media[] = {{0.2, 1.4}, {1, 1}};

enum {
  SUBJECTS = sizeof subjects / sizeof subjects[0],
  MEDIA = sizeof media / sizeof media[0],
  RUNS = SUBJECTS * MEDIA,
  RINGS = 170,
  SEED = 20120101
};

/* With more photons, a smaller tolerance is asked for: the solver's error has to be small beside the
 * standard error of a ring, or chi-squared says nothing. */
#define FINEST_FROM_MILLIONS 20

struct run {
  double tolerance;
  uint64_t photons; /* of each medium */
  tools_progress progress;
  struct found {
    double chi_squared, worst, total; /* of rings; of the total, in standard errors */
    double bound_squared;             /* the solver's bounds in standard errors, squared, added */
    size_t rings;
  } found[RUNS];
};

/* ---- walks ------------------------------------------------------------------------------------ */

/* What is walked. */
typedef struct walks_medium {
  double ratio, g, eta; /* ratio: sigma_a / (sigma_s (1 - g)) */
  unsigned phase;       /* enum core_phase and its parameters, as in core_mc_request */
  double phase_share, phase_g;
} walks_medium;

typedef struct walks_result {
  core_mc_value total; /* light that left, per power that entered */
  core_mc_ring rings[RINGS];
} walks_result;

static const core_grid edges = {CORE_SPACING_LOGARITHMIC, RINGS + 1, 0.0089125093813374545,
                                22.387211385683397};

/* A reduced mean free path is 1 mm. */
static core_mc_request request_of(const walks_medium *of, uint64_t seed) {
  const core_medium medium = {of->ratio / (1 + of->ratio), 1 / ((1 + of->ratio) * (1 - of->g)),
                              of->g, of->eta};
  core_mc_request request = {.thickness_mm = (double)INFINITY,
                             .edges = edges,
                             .seed = seed,
                             .phase = of->phase,
                             .phase_share = of->phase_share,
                             .phase_g = of->phase_g};
  core_mc_request_medium(&request, &medium, 1);
  return request;
}

/* Walks photons, a multiple of CORE_MC_BATCH_PHOTONS, through a half space. */
static void walks_run(walks_result *result, const walks_medium *medium, uint64_t photons,
                      uint64_t seed) {
  const core_mc_request request = request_of(medium, seed);
  tools_check(core_mc_check(&request), "Monte Carlo");
  core_mc_plan *plan = core_mc_plan_create(&request);
  core_mc_total *total = plan != NULL ? core_mc_total_create(plan) : NULL;
  core_mc_batch *batch = plan != NULL ? core_mc_batch_create(plan) : NULL;
  if (total == NULL || batch == NULL) {
    tools_fail("out of memory");
  }
  const core_isa *isa = core_isa_select(NULL);
  for (uint64_t index = 0; index < photons / CORE_MC_BATCH_PHOTONS; index++) {
    core_mc_batch_start(batch, index);
    while (!core_mc_batch_walk(batch, isa, UINT64_MAX)) {
    }
    core_mc_total_merge(total, batch);
  }
  core_mc_energy energy;
  core_mc_total_energy(total, 0, &energy);
  result->total = energy.left[CORE_MC_REFLECTED];
  core_mc_total_rings(total, 0, CORE_MC_REFLECTED, result->rings);
  core_mc_batch_free(batch);
  core_mc_total_free(total);
  core_mc_plan_free(plan);
}

/* Returns the solver's mean of R over a ring, by quadrature in r^2, and the mean of its errors. */
static transport_number walks_mean(const solver_solution *solution, size_t ring) {
  enum { NODES = 4 };
  double edge[2];
  transport_number mean = {0, 0};
  gauss_rule rule;
  core_grid_radii(&edges, ring, 2, false, edge);
  transport_gauss(&rule, NODES);
  const double from = edge[0] * edge[0], to = edge[1] * edge[1];
  for (size_t i = 0; i < rule.n; i++) {
    const transport_number R = solver_at(solution, 0, sqrt(from + (to - from) * rule.x[i]));
    mean.value += rule.weight[i] * R.value;
    mean.error += rule.weight[i] * R.error;
  }
  return mean;
}

/* Sets *phase to the medium's phase function. The moments of a mixture go to moment[SOLVER_MOMENTS_MAX]:
 * those of 3 cos^2 / (4 pi) are 1, 0, 2/5, 0, ... Those that are left out are below 1e-12. */
static void walks_phase(const walks_medium *medium, double *moment, solver_phase *phase) {
  const core_mc_request request = request_of(medium, 0);
  const bool modified = medium->phase == CORE_PHASE_MODIFIED;
  const double share = medium->phase_share, first = core_mc_first_g(&request);
  double one = 1, other = 1;
  *phase = (solver_phase){medium->g, 0, moment};
  if (!modified && medium->phase != CORE_PHASE_TWO_TERM) {
    return;
  }
  while (phase->moments < SOLVER_MOMENTS_MAX &&
         (phase->moments < 3 || fabs(one) + fabs(other) > 1e-12)) {
    const size_t l = phase->moments++;
    const double second = !modified ? other : l == 0 ? 1 : l == 2 ? 0.4 : 0;
    moment[l] = l == 0 ? 1 : share * one + (1 - share) * second;
    one *= first;
    other *= modified ? 0 : medium->phase_g;
  }
}

/* ---- comparing -------------------------------------------------------------------------------- */

static void compare(struct found *to, const walks_result *walked, const solver_solution *solution,
                    transport_number total) {
  for (size_t i = 0; i < RINGS; i++) {
    const core_mc_ring *ring = &walked->rings[i];
    const transport_number R = walks_mean(solution, i);
    if (ring->photons >= PHOTONS_LEAST) {
      const double off = fabs(ring->R_per_mm2 - R.value) / ring->error_per_mm2;
      const double bound = R.error / ring->error_per_mm2;
      to->chi_squared += off * off;
      to->bound_squared += bound * bound;
      to->worst = fmax(to->worst, off);
      to->rings++;
    }
  }
  to->total = fabs(walked->total.value - total.value) / walked->total.error;
}

static void run_one(void *context, size_t i) {
  struct run *run = context;
  const struct subject *subject = &subjects[i / MEDIA];
  const walks_medium medium = {media[i % MEDIA].ratio, subject->g,     media[i % MEDIA].eta,
                               subject->phase,         subject->share, subject->second};
  static _Thread_local double moment[SOLVER_MOMENTS_MAX];
  solver_solution *solution;
  solver_phase phase;
  solver_total totals;
  walks_result walked;
  walks_phase(&medium, moment, &phase);
  tools_check(solver_solve(&solution, core_isa_select(NULL), medium.ratio, &phase, &medium.eta, 1,
                           run->tolerance),
              "the solver");
  tools_check(solver_totals(&totals, core_isa_select(NULL), medium.ratio, &phase, &medium.eta, 1),
              "the solver");
  walks_run(&walked, &medium, run->photons, SEED + i);
  compare(&run->found[i], &walked, solution, totals.normal);
  solver_free(solution);
  tools_progress_add(&run->progress, 1);
}

static void add(struct found *to, const struct found *from) {
  to->chi_squared += from->chi_squared;
  to->bound_squared += from->bound_squared;
  to->rings += from->rings;
  to->worst = fmax(to->worst, fmax(from->worst, from->total));
}

static bool judge(const char *name, const struct found *sum) {
  const double per_ring = sum->chi_squared / (double)sum->rings;
  const bool good = per_ring > 0.8 && per_ring < 1.2 && sum->worst < SIGMAS_MOST;
  printf("rings: %-30s %4zu rings, chi-squared per ring %.3f (the solver's bound: %.3f), at most "
         "%.2f standard errors%s\n",
         name, sum->rings, per_ring, sum->bound_squared / (double)sum->rings, sum->worst,
         good ? "" : ": BEYOND THE BOUNDS");
  return good;
}

int main(int argc, char **argv) {
  const double millions = argc == 2 ? atof(argv[1]) : 0;
  if (!(millions >= 0.1 && millions <= 1e6)) {
    tools_fail("usage: rings MILLIONS");
  }
  static struct run run;
  run.tolerance = millions < FINEST_FROM_MILLIONS ? 1e-3 : 1e-4;
  run.photons =
      ((uint64_t)(millions * 1e6 / MEDIA) / CORE_MC_BATCH_PHOTONS + 1) * CORE_MC_BATCH_PHOTONS;
  tools_progress_start(&run.progress, RUNS);
  tools_each(tools_processors(), RUNS, run_one, &run);
  tools_progress_end(&run.progress);
  bool good = true;
  struct found all = {0};
  for (size_t i = 0; i < SUBJECTS; i++) {
    struct found sum = {0};
    for (size_t j = i * MEDIA; j < (i + 1) * MEDIA; j++) {
      add(&sum, &run.found[j]);
    }
    good = judge(subjects[i].name, &sum) && good;
    add(&all, &sum);
  }
  good = judge("all", &all) && good;
  printf("(%.0f million photons for each)\n", (double)run.photons * MEDIA / 1e6);
  return good ? EXIT_SUCCESS : EXIT_FAILURE;
}
