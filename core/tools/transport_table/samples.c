#include "core/tools/transport_table/samples.h"

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/tools/tools.h"
#include "core/transport/table.h"
#include "core/transport/transport.h"

enum { PATH_MAX_BYTES = 1024 };

#define MEDIUM_COST_US 150e3 /* estimated work, for the progress bar only */

/* ---- samples --------------------------------------------------------------------------------- */

void sample_make(table_sample *sample, double eta, size_t albedos, size_t radii) {
  const size_t numbers = 2 * albedos * (1 + radii);
  *sample = (struct table_sample){.eta = eta, .albedos = albedos, .radii = radii};
  sample->bytes = numbers * sizeof(double);
  sample->numbers = calloc(numbers, sizeof(double));
  if (sample->numbers == NULL) {
    tools_fail("out of memory");
  }
  sample->albedo = sample->numbers;
  sample->x = sample->albedo + albedos;
  sample->total = sample->x + albedos * radii;
  sample->R = sample->total + albedos;
}

void sample_free(table_sample *sample) {
  free(sample->numbers);
}

static void solve(table_sample *sample, double tolerance) {
  transport_boundary *boundary;
  tools_check(transport_boundary_create(&boundary, sample->eta, tolerance), "transport");
  for (size_t i = 0; i < sample->albedos; i++) {
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

/* ---- files ----------------------------------------------------------------------------------- */

/* Identifies the inputs and the solver that a file's results depend on. `probe` has the solver's
 * own results for one fixed medium, which change when the solver changes. */
struct key {
  double tolerance, eta;
  double probe[4];
  uint64_t inputs;
};

static void probe_solver(double tolerance, double probe[4]) {
  table_sample sample;
  sample_make(&sample, 1.3, 1, 3);
  sample.albedo[0] = 0.9;
  memcpy(sample.x, (double[]){1e-3, 1, 20}, 3 * sizeof(double));
  solve(&sample, tolerance);
  probe[0] = sample.total[0];
  memcpy(probe + 1, sample.R, 3 * sizeof(double));
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
  sample_make(&copy, sample->eta, sample->albedos, sample->radii);
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
  double tolerance;
  double probe[4];
  table_sample *samples;
  tools_progress progress;
};

static void solve_or_read(void *context, size_t i) {
  struct run *run = context;
  table_sample *sample = &run->samples[i];
  struct key key = {.tolerance = run->tolerance, .eta = sample->eta};
  memcpy(key.probe, run->probe, sizeof key.probe);
  key.inputs = transport_table_checksum((const uint8_t *)sample->numbers, input_bytes(sample));
  char path[PATH_MAX_BYTES];
  path_of(path, run->folder, &key);
  if (!read_sample(path, sample)) {
    solve(sample, run->tolerance);
    write_sample(path, sample);
  }
  tools_progress_add(&run->progress, (double)sample->albedos * MEDIUM_COST_US);
}

void samples_solve(const char *folder, double tolerance, table_sample *samples, size_t count) {
  struct run run = {.folder = folder, .tolerance = tolerance, .samples = samples};
  double media = 0;
  for (size_t i = 0; i < count; i++) {
    media += (double)samples[i].albedos;
  }
  tools_make_folder(folder);
  probe_solver(tolerance, run.probe);
  tools_progress_start(&run.progress, media * MEDIUM_COST_US);
  tools_each(tools_processors(), count, solve_or_read, &run);
  tools_progress_end(&run.progress);
}
