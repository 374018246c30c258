#include "core/tools/transport_table/samples.h"

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/tools/tools.h"
#include "core/transport/anisotropic.h"
#include "core/transport/table.h"
#include "core/transport/transport.h"

enum { PATH_MAX_BYTES = 1024 };

#define TOLERANCE 1e-8 /* of the solver for isotropic scattering */

/* estimated work, for the progress bar only: of a medium that scatters isotropically, and of a
 * sample of others */
#define MEDIUM_COST_US 150e3
#define SAMPLE_COST_US 6e6
#define FINEST_COST_US 25e6

/* From this g on, the normal grids are up to 3e-3 off near the source. */
#define FINEST_FROM 0.85
/* Below this g, they are up to 4e-3 off where sigma_a is above 0.33 sigma_s'. */
#define BACKWARD (-0.2)
#define BACKWARD_ALBEDO 0.75

/* ---- samples --------------------------------------------------------------------------------- */

transport_effort sample_effort(double g, double albedo) {
  return g >= FINEST_FROM || (g < BACKWARD && albedo < BACKWARD_ALBEDO) ? TRANSPORT_EFFORT_FINEST
                                                                        : TRANSPORT_EFFORT_NORMAL;
}

void sample_make(table_sample *sample, double g, size_t media, size_t radii) {
  const size_t numbers = media * (3 + 2 * radii);
  *sample = (struct table_sample){
      .g = g, .effort = TRANSPORT_EFFORT_NORMAL, .media = media, .radii = radii};
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
  transport_boundary *boundary;
  tools_check(transport_boundary_create(&boundary, sample->eta[0], TOLERANCE), "transport");
  for (size_t i = 0; i < sample->media; i++) {
    transport_solution *solution;
    tools_check(transport_solve(&solution, boundary, sample->albedo[i]), "transport");
    sample->total[i] = transport_total(solution).value;
    for (size_t j = i * sample->radii; j < (i + 1) * sample->radii; j++) {
      sample->R[j] = transport_at(solution, sample->x[j]).R.value;
    }
    transport_solution_free(solution);
  }
  transport_boundary_free(boundary);
}

static void solve_anisotropic(table_sample *sample) {
  const transport_phase phase = {sample->g, 0, NULL};
  const core_isa *isa = core_isa_select(NULL);
  const double ratio = (1 - sample->albedo[0]) / sample->albedo[0];
  transport_anisotropic *solution;
  tools_check(transport_anisotropic_solve_once(&solution, isa, ratio, &phase, sample->eta,
                                               sample->media, sample->effort),
              "transport");
  for (size_t i = 0; i < sample->media; i++) {
    for (size_t j = i * sample->radii; j < (i + 1) * sample->radii; j++) {
      sample->R[j] = transport_anisotropic_at(solution, i, sample->x[j]).value;
    }
  }
  transport_anisotropic_free(solution);
}

static void solve(table_sample *sample) {
  if (sample->g == 0) {
    solve_isotropic(sample);
  } else {
    solve_anisotropic(sample);
  }
}

static double cost_us(const table_sample *sample) {
  const bool finest = sample->effort == TRANSPORT_EFFORT_FINEST;
  return sample->g == 0 ? (double)sample->media * MEDIUM_COST_US
         : finest       ? FINEST_COST_US
                        : SAMPLE_COST_US;
}

/* ---- files ----------------------------------------------------------------------------------- */

/* Identifies the inputs and the solver that a file's results depend on. `probe` has the solver's
 * own results for one fixed medium, which change when the solver changes. */
struct key {
  double g, effort;
  double probe[4];
  uint64_t inputs;
};

/* Solvers that a sample may need: that for isotropic scattering, then one for each effort. */
enum { SOLVERS = 1 + TRANSPORT_EFFORT_FINEST + 1 };

static size_t solver_of(const table_sample *sample) {
  return sample->g == 0 ? 0 : 1 + (size_t)sample->effort;
}

/* Solves one medium with a solver, for the keys of its samples. */
static void probe_solver(void *context, size_t solver) {
  double(*probe)[4] = context;
  table_sample sample;
  sample_make(&sample, solver == 0 ? 0 : 0.1, 1, 3);
  sample.effort = solver == 0 ? sample.effort : (transport_effort)(solver - 1);
  sample.albedo[0] = 0.9;
  sample.eta[0] = 1.3;
  memcpy(sample.x, (double[]){1e-3, 1, 20}, 3 * sizeof(double));
  solve(&sample);
  probe[solver][0] = sample.total[0];
  memcpy(probe[solver] + 1, sample.R, 3 * sizeof(double));
  sample_free(&sample);
}

static size_t input_bytes(const table_sample *sample) {
  return (size_t)((const char *)sample->total - (const char *)sample->numbers);
}

static void path_of(char path[PATH_MAX_BYTES], const char *folder, const struct key *key) {
  const uint64_t name = transport_table_checksum((const uint8_t *)key, sizeof *key);
  if (snprintf(path, PATH_MAX_BYTES, "%s/%016llx", folder, (unsigned long long)name) >=
      PATH_MAX_BYTES) {
    tools_fail("the folder's name is too long");
  }
}

/* A file holds the sample's numbers and their checksum. */
static bool read_sample(const char *path, table_sample *sample) {
  FILE *file = fopen(path, "rb");
  if (file == NULL) {
    return false;
  }
  struct table_sample copy;
  uint64_t checksum;
  sample_make(&copy, sample->g, sample->media, sample->radii);
  const bool good =
      fread(copy.numbers, copy.bytes, 1, file) == 1 &&
      fread(&checksum, sizeof checksum, 1, file) == 1 &&
      checksum == transport_table_checksum((const uint8_t *)copy.numbers, copy.bytes) &&
      memcmp(copy.numbers, sample->numbers, input_bytes(sample)) == 0;
  if (good) {
    memcpy(sample->numbers, copy.numbers, copy.bytes);
  }
  sample_free(&copy);
  fclose(file);
  return good;
}

static void write_sample(const char *path, const table_sample *sample) {
  const uint64_t checksum =
      transport_table_checksum((const uint8_t *)sample->numbers, sample->bytes);
  FILE *file = tools_open(path);
  fwrite(sample->numbers, sample->bytes, 1, file);
  fwrite(&checksum, sizeof checksum, 1, file);
  tools_close(file, path);
}

/* ---- threads --------------------------------------------------------------------------------- */

struct run {
  const char *folder;
  double probe[SOLVERS][4];
  table_sample *samples;
  tools_progress progress;
};

static void solve_or_read(void *context, size_t i) {
  struct run *run = context;
  table_sample *sample = &run->samples[i];
  struct key key = {.g = sample->g, .effort = sample->effort};
  memcpy(key.probe, run->probe[solver_of(sample)], sizeof key.probe);
  key.inputs = transport_table_checksum((const uint8_t *)sample->numbers, input_bytes(sample));
  char path[PATH_MAX_BYTES];
  path_of(path, run->folder, &key);
  if (!read_sample(path, sample)) {
    solve(sample);
    write_sample(path, sample);
  }
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
