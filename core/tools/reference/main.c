/* reference FOLDER FILE: writes the table core/transport/reference.csv: R(r) and totals of
 * media with Henyey and Greenstein's phase function by the solver's finest grids, each with an
 * error bound, and by Monte Carlo beside it. core/transport/REFERENCE.md says more. It keeps
 * results in FOLDER, so that an interrupted run continues where it stopped. Every machine writes
 * the same file. */
#include <math.h>
#include <stdlib.h>

#include "core/tools/reference/walks.h"
#include "core/tools/tools.h"

/* ---- the media ------------------------------------------------------------------------------ */

static const struct pair {
  double ratio, g;
} pairs[] = {
    {0.01, -0.5}, {0.3, -0.5}, {0.001, 0},   {0.1, 0},     {0.03, 0.3}, {1, 0.3},
    {0.1, 0.5},   {0.01, 0.7}, {0.3, 0.7},   {0.001, 0.8}, {0.1, 0.8},  {0.001, 0.9},
    {0.03, 0.9},  {1, 0.9},    {0.01, 0.95}, {0.3, 0.95},
};
static const double etas[] = {1, 1.33, 1.4, 2};
static const double radii[] = {0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.2, 0.3, 0.5,
                               0.7,  1,    2,    3,    5,    7,   10,  14,  20};

enum {
  PAIRS = sizeof pairs / sizeof pairs[0],
  ETAS = sizeof etas / sizeof etas[0],
  RADII = sizeof radii / sizeof radii[0],
  PHOTONS = 256 * CORE_MC_BATCH_PHOTONS, /* of each medium; a quarter up to RATIO_SLOW */
  PHOTONS_LEAST = 100,                   /* a ring with fewer photons has no value */
  SEED = 17
};

#define TOLERANCE 1e-4 /* of the solver: its finest grids */

/* Photons take long with little absorption. */
#define RATIO_SLOW 0.01

/* A value with its absolute error bound or standard error; NaN where there is none. */
struct number {
  double value, error;
};

/* What a step has found. The mean of R over a ring, by the solver, goes with each radius. */
struct solved {
  struct number R[ETAS][RADII];
  double mean[ETAS][RADII];
};

struct walked {
  struct number total, mean[RADII];
};

enum { KEY_BYTES = 256 };

/* ---- the steps ------------------------------------------------------------------------------ */

/* First every pair is solved, for all boundaries together; then each medium is walked. */
enum { STEPS = PAIRS + PAIRS * ETAS };

struct run {
  const char *folder;
  struct solved solved[PAIRS];
  solver_total totals[PAIRS][ETAS]; /* which take milliseconds and are in no file */
  struct walked walked[PAIRS * ETAS];
  tools_progress progress;
};

/* estimated times, for the progress bar only */
#define SOLVING_US 120e6
#define WALKING_US 6e6

static struct number number_of(transport_number from) {
  return (struct number){from.value, from.error};
}

static void solve(struct solved *to, const struct pair *pair) {
  const solver_phase phase = {pair->g, 0, NULL};
  solver_solution *solution;
  tools_check(
      solver_solve(&solution, core_isa_select(NULL), pair->ratio, &phase, etas, ETAS, TOLERANCE),
      "the solver");
  for (size_t eta = 0; eta < ETAS; eta++) {
    for (size_t i = 0; i < RADII; i++) {
      to->R[eta][i] = number_of(solver_at(solution, eta, radii[i]));
      to->mean[eta][i] =
          walks_mean(solution, eta, WALKS_TENTHS, walks_ring_of(WALKS_TENTHS, radii[i]), NULL);
    }
  }
  solver_free(solution);
}

/* The key has totals of the beam, which change when the solver does. */
static void solve_or_read(struct run *run, size_t i) {
  const struct pair *pair = &pairs[i];
  const solver_phase phase = {pair->g, 0, NULL};
  solver_total *totals = run->totals[i];
  char key[KEY_BYTES];
  tools_check(solver_totals(totals, core_isa_select(NULL), pair->ratio, &phase, etas, ETAS),
              "the solver");
  snprintf(key, sizeof key, "solved %g %g, %d eta from %g to %g: %a %a", pair->ratio, pair->g, ETAS,
           etas[0], etas[ETAS - 1], totals[0].normal.value, totals[ETAS - 1].normal.value);
  if (!tools_kept(run->folder, key, &run->solved[i], sizeof run->solved[i])) {
    solve(&run->solved[i], pair);
    tools_keep(run->folder, key, &run->solved[i], sizeof run->solved[i]);
  }
  tools_progress_add(&run->progress, SOLVING_US);
}

static void walk(struct walked *to, const walks_medium *medium, int photons, uint64_t seed) {
  walks_result result;
  walks_run(&result, medium, WALKS_TENTHS, (uint64_t)photons, seed);
  to->total = (struct number){result.total.value, result.total.error};
  for (size_t i = 0; i < RADII; i++) {
    const core_mc_ring *ring = &result.rings[walks_ring_of(WALKS_TENTHS, radii[i])];
    to->mean[i] = ring->photons >= PHOTONS_LEAST
                      ? (struct number){ring->R_per_mm2, ring->error_per_mm2}
                      : (struct number){(double)NAN, (double)NAN};
  }
}

/* The key has the total of one batch, which changes when the walk does. */
static void walk_or_read(struct run *run, size_t i) {
  const struct pair *pair = &pairs[i / ETAS];
  const walks_medium medium = {.ratio = pair->ratio, .g = pair->g, .eta = etas[i % ETAS]};
  char key[KEY_BYTES];
  const int photons = medium.ratio > RATIO_SLOW ? PHOTONS : PHOTONS / 4;
  walks_result probe;
  walks_run(&probe, &medium, WALKS_TENTHS, CORE_MC_BATCH_PHOTONS, SEED + i);
  snprintf(key, sizeof key, "walked %g %g %g, %d photons: %a", medium.ratio, medium.g, medium.eta,
           photons, probe.total.value);
  if (!tools_kept(run->folder, key, &run->walked[i], sizeof run->walked[i])) {
    walk(&run->walked[i], &medium, photons, SEED + i);
    tools_keep(run->folder, key, &run->walked[i], sizeof run->walked[i]);
  }
  tools_progress_add(&run->progress, WALKING_US);
}

static void step(void *context, size_t i) {
  if (i < PAIRS) {
    solve_or_read(context, i);
  } else {
    walk_or_read(context, i - PAIRS);
  }
}

/* ---- the table ------------------------------------------------------------------------------- */

/* The bound is written with two digits, rounded up. */
#define UP 1.053
/* Least relative error bounds: two grids share a part of their errors. For g = 0 the normal grids
 * were off by up to 1.7e-5 where they agreed better. */
#define R_ERROR_LEAST 5e-5
#define TOTAL_ERROR_LEAST 1e-7

static void write_row(FILE *file, const struct pair *pair, double eta, const char *quantity,
                      double r, struct number by_solver, struct number by_walk) {
  fprintf(file, "%g,%g,%g,%s,", pair->ratio, pair->g, eta, quantity);
  if (!isnan(r)) {
    fprintf(file, "%g", r);
  }
  const double error = by_solver.error / by_solver.value;
  fprintf(file, ",%.9e,%.1e,", by_solver.value,
          UP * (isnan(r) ? fmax(error, TOTAL_ERROR_LEAST) : fmax(error, R_ERROR_LEAST)));
  if (isnan(by_walk.value)) {
    fputs(",\n", file);
  } else {
    fprintf(file, "%.5e,%.1e\n", by_walk.value, by_walk.error / by_walk.value);
  }
}

static void write_medium(FILE *file, const struct run *run, size_t pair, size_t eta) {
  const struct solved *solved = &run->solved[pair];
  const struct walked *walked = &run->walked[pair * ETAS + eta];
  const solver_total *totals = &run->totals[pair][eta];
  const struct number none = {(double)NAN, (double)NAN};
  write_row(file, &pairs[pair], etas[eta], "total", (double)NAN, number_of(totals->normal),
            walked->total);
  write_row(file, &pairs[pair], etas[eta], "total_diffuse", (double)NAN, number_of(totals->diffuse),
            none);
  for (size_t i = 0; i < RADII; i++) {
    /* from the mean over the ring to the radius */
    const double shape = solved->R[eta][i].value / solved->mean[eta][i];
    const struct number at = {walked->mean[i].value * shape, walked->mean[i].error * shape};
    write_row(file, &pairs[pair], etas[eta], "R", radii[i], solved->R[eta][i], at);
  }
}

int main(int argc, char **argv) {
  if (argc != 3) {
    tools_fail("usage: reference FOLDER FILE");
  }
  static struct run run;
  run.folder = argv[1];
  tools_make_folder(argv[1]);
  tools_progress_start(&run.progress, PAIRS * SOLVING_US + PAIRS * ETAS * WALKING_US);
  tools_each(tools_processors(), STEPS, step, &run);
  tools_progress_end(&run.progress);
  FILE *file = tools_open(argv[2]);
  fputs("sigma_a_over_sigma_s_prime,g,eta,quantity,r_in_mfp_prime,value,relative_error_bound,"
        "mc_value,mc_relative_standard_error\n",
        file);
  for (size_t i = 0; i < PAIRS * ETAS; i++) {
    write_medium(file, &run, i / ETAS, i % ETAS);
  }
  tools_close(file, argv[2]);
  return EXIT_SUCCESS;
}
