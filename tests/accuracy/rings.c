/* rings MILLIONS: Monte Carlo against the solver for any phase function, ring by ring, with at
 * least MILLIONS of photons for each g and for each mixture of two functions. Exits with
 * EXIT_FAILURE if any ring or total is off by 4.5 standard errors or more, or if chi-squared per
 * ring is not between 0.8 and 1.2 for a g, or for all. `make rings` walks 100 millions each, `make
 * check-rings` 4.
 *
 * The standard errors are Monte Carlo's alone, as if the solver had no error: whatever error it has
 * raises chi-squared. The error that the solver states is a bound, not a standard error. What it
 * could add to chi-squared if all of it were there, the mean of its square in standard errors, is
 * printed beside it. */
#include <math.h>
#include <stdlib.h>

#include "core/tools/reference/walks.h"
#include "core/tools/tools.h"

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

static void compare(struct found *to, const walks_result *walked, const solver_solution *solution,
                    transport_number total) {
  for (size_t i = 0; i < walked->count; i++) {
    const core_mc_ring *ring = &walked->rings[i];
    double error;
    const double R = walks_mean(solution, 0, walked->count, i, &error);
    if (ring->photons >= PHOTONS_LEAST) {
      const double off = fabs(ring->R_per_mm2 - R) / ring->error_per_mm2;
      const double bound = error / ring->error_per_mm2;
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
  walks_run(&walked, &medium, RINGS, run->photons, SEED + i);
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
