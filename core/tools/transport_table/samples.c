#include "core/tools/transport_table/samples.h"

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/solver/solver.h"
#include "core/tools/tools.h"
#include "core/transport/table.h"
#include "tests/accuracy/isotropic/isotropic.h"

enum { PATH_MAX_BYTES = 1024 };

#define TOLERANCE 1e-8 /* of the solver for isotropic scattering */

/* estimated work, for the progress bar only: of a medium that scatters isotropically, and of a
 * sample of others */
#define MEDIUM_COST_US 150e3
#define SAMPLE_COST_US 6e6
#define FINEST_COST_US 25e6

/* From this g on, the normal grids are up to 3e-3 off near the source. */
#define FINEST_FROM 0.85

/* ---- samples --------------------------------------------------------------------------------- */

size_t sample_level(double g) {
  return g >= FINEST_FROM ? SAMPLE_FINEST : SAMPLE_NORMAL;
}

void sample_make(table_sample *sample, double g, size_t media, size_t radii) {
  const size_t numbers = media * (3 + 2 * radii);
  *sample = (struct table_sample){.g = g, .level = SAMPLE_NORMAL, .media = media, .radii = radii};
  sample->bytes = numbers * sizeof(double);
  sample->numbers = calloc(numbers, sizeof(double));
  if (sample->numbers == NULL) {
    tools_fail("out of memory");
  }
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
  isotropic_boundary *boundary;
  tools_check(isotropic_boundary_create(&boundary, sample->eta[0], TOLERANCE), "transport");
  for (size_t i = 0; i < sample->media; i++) {
    isotropic_solution *solution;
    tools_check(isotropic_solve(&solution, boundary, sample->albedo[i]), "transport");
    sample->total[i] = isotropic_total(solution).value;
    for (size_t j = i * sample->radii; j < (i + 1) * sample->radii; j++) {
      sample->R[j] = isotropic_at(solution, sample->x[j]).R.value;
    }
    isotropic_solution_free(solution);
  }
  isotropic_boundary_free(boundary);
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

/* ---- what a file keeps ------------------------------------------------------------------------ */

/* Numbers that a file keeps: the inputs that a sample was solved for, then what was solved. Of
 * isotropic scattering these are all numbers of the sample. Of others they are the albedos, the etas
 * and the exitances, so that R at other radii needs no new solution. */
struct kept {
  size_t inputs, count;
  double *numbers;
};

static struct kept kept_of(const table_sample *sample) {
  if (sample->g == 0) {
    return (struct kept){(size_t)(sample->total - sample->numbers), sample->bytes / sizeof(double),
                         sample->numbers};
  }
  const size_t inputs = 2 * sample->media;
  const size_t count = inputs + 2 * sample->media * SOLVER_WAVENUMBERS_MAX;
  const struct kept kept = {inputs, count, calloc(count, sizeof(double))};
  if (kept.numbers == NULL) {
    tools_fail("out of memory");
  }
  memcpy(kept.numbers, sample->albedo, inputs * sizeof(double));
  return kept;
}

static void free_kept(struct kept kept, const table_sample *sample) {
  if (kept.numbers != sample->numbers) {
    free(kept.numbers);
  }
}

/* Solves, unless what the file keeps is known. */
static void solve(table_sample *sample, struct kept kept, bool known) {
  if (sample->g != 0) {
    solve_anisotropic(sample, (double complex *)(kept.numbers + kept.inputs), known);
  } else if (!known) {
    solve_isotropic(sample);
  }
}

static uint64_t checksum_of(const double *numbers, size_t count) {
  return transport_table_checksum((const uint8_t *)numbers, count * sizeof *numbers);
}

/* Identifies the inputs and the solver that a file's results depend on. `probe` is a checksum of what
 * is kept of one fixed medium, which changes when the solver changes. */
struct key {
  double g, level;
  uint64_t probe, inputs;
};

/* Solvers that a sample may need: that for isotropic scattering, then one for each level. */
enum { SOLVERS = 1 + SAMPLE_FINEST + 1 };

static size_t solver_of(const table_sample *sample) {
  return sample->g == 0 ? 0 : 1 + sample->level;
}

/* Solves one medium with a solver, for the keys of its samples. */
static void probe_solver(void *context, size_t solver) {
  uint64_t *probe = context;
  table_sample sample;
  sample_make(&sample, solver == 0 ? 0 : 0.1, 1, 3);
  sample.level = solver == 0 ? sample.level : solver - 1;
  sample.albedo[0] = 0.9;
  sample.eta[0] = 1.3;
  memcpy(sample.x, (double[]){1e-3, 1, 20}, 3 * sizeof(double));
  const struct kept kept = kept_of(&sample);
  solve(&sample, kept, false);
  probe[solver] = checksum_of(kept.numbers, kept.count);
  free_kept(kept, &sample);
  sample_free(&sample);
}

/* ---- files ----------------------------------------------------------------------------------- */

static void path_of(char path[PATH_MAX_BYTES], const char *folder, const struct key *key) {
  const uint64_t name = transport_table_checksum((const uint8_t *)key, sizeof *key);
  if (snprintf(path, PATH_MAX_BYTES, "%s/%016llx", folder, (unsigned long long)name) >=
      PATH_MAX_BYTES) {
    tools_fail("the folder's name is too long");
  }
}

/* A file holds the numbers and their checksum. Returns whether there is one for these inputs. */
static bool read_kept(const char *path, struct kept kept) {
  FILE *file = fopen(path, "rb");
  double *copy = malloc(kept.count * sizeof *copy);
  if (copy == NULL) {
    tools_fail("out of memory");
  }
  uint64_t checksum;
  const bool good = file != NULL && fread(copy, sizeof *copy, kept.count, file) == kept.count &&
                    fread(&checksum, sizeof checksum, 1, file) == 1 &&
                    checksum == checksum_of(copy, kept.count) &&
                    memcmp(copy, kept.numbers, kept.inputs * sizeof *copy) == 0;
  if (good) {
    memcpy(kept.numbers, copy, kept.count * sizeof *copy);
  }
  free(copy);
  if (file != NULL) {
    fclose(file);
  }
  return good;
}

static void write_kept(const char *path, struct kept kept) {
  const uint64_t checksum = checksum_of(kept.numbers, kept.count);
  FILE *file = tools_open(path);
  fwrite(kept.numbers, sizeof *kept.numbers, kept.count, file);
  fwrite(&checksum, sizeof checksum, 1, file);
  tools_close(file, path);
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
  const struct kept kept = kept_of(sample);
  const struct key key = {sample->g, (double)sample->level, run->probe[solver_of(sample)],
                          checksum_of(kept.numbers, kept.inputs)};
  char path[PATH_MAX_BYTES];
  path_of(path, run->folder, &key);
  const bool known = read_kept(path, kept);
  solve(sample, kept, known);
  if (!known) {
    write_kept(path, kept);
  }
  free_kept(kept, sample);
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
