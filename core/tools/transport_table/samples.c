#include "core/tools/transport_table/samples.h"

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/solver/solver.h"
#include "core/tools/tools.h"
#include "core/transport/table.h"
#include "tests/accuracy/isotropic/isotropic.h"

enum { KEY_BYTES = 256 };

#define TOLERANCE 1e-8 /* tolerance of the solver for isotropic scattering */

/* estimated work, for the progress bar only: of a medium that scatters isotropically, and of a
 * sample of others */
#define MEDIUM_COST_US 150e3
#define SAMPLE_COST_US 6e6
#define FINEST_COST_US 25e6

/* For g from here on, normal grids have errors up to 3e-3 near the source. */
#define FINEST_FROM 0.85

/* ---- samples --------------------------------------------------------------------------------- */

size_t sample_level(double g) {
  return g >= FINEST_FROM ? SAMPLE_FINEST : SAMPLE_NORMAL;
}

void sample_make(table_sample *sample, double g, size_t media, size_t radii) {
  const size_t numbers = media * (3 + 2 * radii);
  *sample = (struct table_sample){.g = g, .level = SAMPLE_NORMAL, .media = media, .radii = radii};
  sample->numbers = tools_allocate(numbers, sizeof(double));
  sample->albedo = sample->numbers;
  sample->eta = sample->albedo + media;
  sample->x = sample->eta + media;
  sample->total = sample->x + media * radii;
  sample->R = sample->total + media;
}

void sample_free(table_sample *sample) {
  free(sample->numbers);
}

static void solve_isotropic(table_sample *sample) {
  for (size_t i = 0; i < sample->media; i++) {
    isotropic_solution *solution =
        isotropic_solve(sample->eta[0], sample->albedo[i], TOLERANCE, ISOTROPIC_REACH);
    sample->total[i] = isotropic_total(solution);
    for (size_t j = i * sample->radii; j < (i + 1) * sample->radii; j++) {
      sample->R[j] = isotropic_at(solution, sample->x[j]).R;
    }
    isotropic_free(solution);
  }
}

/* Sets the exitances, see solver_solve_level(), or makes R from them if they are known. */
static void solve_anisotropic(table_sample *sample, double complex *exitances, bool known) {
  const solver_phase phase = {sample->g, 0, NULL};
  const core_isa *isa = core_isa_select(NULL);
  const double ratio = (1 - sample->albedo[0]) / sample->albedo[0];
  solver_solution *solution;
  tools_check(solver_solve_level(&solution, isa, ratio, &phase, sample->eta, sample->media,
                                 sample->level, exitances, known),
              "transport");
  for (size_t i = 0; i < sample->media; i++) {
    for (size_t j = i * sample->radii; j < (i + 1) * sample->radii; j++) {
      sample->R[j] = solver_at(solution, i, sample->x[j]).value;
    }
  }
  solver_free(solution);
}

static double cost_us(const table_sample *sample) {
  const bool finest = sample->level == SAMPLE_FINEST;
  return sample->g == 0 ? (double)sample->media * MEDIUM_COST_US
         : finest       ? FINEST_COST_US
                        : SAMPLE_COST_US;
}

/* ---- what is kept ----------------------------------------------------------------------------- */

/* Returns memory for what is kept of a sample, and sets *count: of isotropic scattering the totals and
 * R in the sample itself; of others the exitances, so that R at other radii needs no new solution. */
static double *results_of(const table_sample *sample, size_t *count) {
  if (sample->g == 0) {
    *count = sample->media * (1 + sample->radii);
    return sample->total;
  }
  *count = 2 * sample->media * SOLVER_WAVENUMBERS_MAX;
  return tools_allocate(*count, sizeof(double));
}

static void free_results(double *results, const table_sample *sample) {
  if (results != sample->total) {
    free(results);
  }
}

/* Computes the results of a sample, unless they are known. */
static void solve(table_sample *sample, double *results, bool known) {
  if (sample->g != 0) {
    solve_anisotropic(sample, (double complex *)results, known);
  } else if (!known) {
    solve_isotropic(sample);
  }
}

static uint64_t checksum_of(const double *numbers, size_t count) {
  return transport_table_checksum((const uint8_t *)numbers, count * sizeof *numbers);
}

/* Solvers that a sample may need: that for isotropic scattering, then one for each level. */
enum { SOLVERS = 1 + SAMPLE_FINEST + 1 };

static size_t solver_of(const table_sample *sample) {
  return sample->g == 0 ? 0 : 1 + sample->level;
}

/* Solves one medium with a solver, for the keys of its samples: they change when the solver does. */
static void probe_solver(void *context, size_t solver) {
  uint64_t *probe = context;
  table_sample sample;
  sample_make(&sample, solver == 0 ? 0 : 0.1, 1, 3);
  sample.level = solver == 0 ? sample.level : solver - 1;
  sample.albedo[0] = 0.9;
  sample.eta[0] = 1.3;
  memcpy(sample.x, (double[]){1e-3, 1, 20}, 3 * sizeof(double));
  size_t count;
  double *results = results_of(&sample, &count);
  solve(&sample, results, false);
  probe[solver] = checksum_of(results, count);
  free_results(results, &sample);
  sample_free(&sample);
}

/* ---- threads --------------------------------------------------------------------------------- */

struct run {
  const char *folder;
  uint64_t probe[SOLVERS];
  table_sample *samples;
  tools_progress progress;
};

static void solve_or_read(void *context, size_t i) {
  struct run *run = context;
  table_sample *sample = &run->samples[i];
  const size_t inputs = sample->media * (sample->g == 0 ? 2 + sample->radii : 2);
  size_t count;
  double *results = results_of(sample, &count);
  char key[KEY_BYTES];
  snprintf(key, sizeof key, "g %a, level %zu, solver %016llx, inputs %016llx", sample->g,
           sample->level, (unsigned long long)run->probe[solver_of(sample)],
           (unsigned long long)checksum_of(sample->numbers, inputs));
  const bool known = tools_kept(run->folder, key, results, count * sizeof *results);
  solve(sample, results, known);
  if (!known) {
    tools_keep(run->folder, key, results, count * sizeof *results);
  }
  free_results(results, sample);
  tools_progress_add(&run->progress, cost_us(sample));
}

void samples_solve(const char *folder, table_sample *samples, size_t count) {
  struct run run = {.folder = folder, .samples = samples};
  double work_us = 0;
  for (size_t i = 0; i < count; i++) {
    work_us += cost_us(&samples[i]);
  }
  tools_make_folder(folder);
  tools_each(tools_processors(), SOLVERS, probe_solver, run.probe);
  tools_progress_start(&run.progress, work_us);
  tools_each(tools_processors(), count, solve_or_read, &run);
  tools_progress_end(&run.progress);
}
