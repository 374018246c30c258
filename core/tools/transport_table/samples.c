#include "core/tools/transport_table/samples.h"

#include <errno.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "core/transport/table.h"
#include "core/transport/transport.h"

enum { THREADS_MAX = 16, BAR = 40, PATH_MAX_BYTES = 1024 };

_Noreturn void fail(const char *what) {
  fprintf(stderr, "transport-table: %s\n", what);
  exit(EXIT_FAILURE);
}

/* ---- samples -------------------------------------------------------------------------------- */

void sample_make(table_sample *sample, double eta, size_t albedos, size_t radii) {
  const size_t numbers = 2 * albedos * (1 + radii);
  *sample = (struct table_sample){.eta = eta, .albedos = albedos, .radii = radii};
  sample->bytes = numbers * sizeof(double);
  sample->numbers = calloc(numbers, sizeof(double));
  if (sample->numbers == NULL) {
    fail("out of memory");
  }
  sample->albedo = sample->numbers;
  sample->x = sample->albedo + albedos;
  sample->total = sample->x + albedos * radii;
  sample->R = sample->total + albedos;
}

void sample_free(table_sample *sample) {
  free(sample->numbers);
}

static void check(core_fault fault) {
  if (fault.field != NULL) {
    fprintf(stderr, "transport-table: %s: %s\n", fault.field, fault.allowed);
    exit(EXIT_FAILURE);
  }
}

static void solve(table_sample *sample, double tolerance) {
  transport_boundary *boundary;
  check(transport_boundary_create(&boundary, sample->eta, tolerance));
  for (size_t i = 0; i < sample->albedos; i++) {
    transport_solution *solution;
    check(transport_solve(&solution, boundary, sample->albedo[i]));
    sample->total[i] = transport_total(solution).value;
    for (size_t j = i * sample->radii; j < (i + 1) * sample->radii; j++) {
      sample->R[j] = transport_at(solution, sample->x[j]).R.value;
    }
    transport_solution_free(solution);
  }
  transport_boundary_free(boundary);
}

/* ---- files ---------------------------------------------------------------------------------- */

/* All that the results depend on: besides the inputs, what the solver itself makes of a medium. */
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

static void path_of(char path[PATH_MAX_BYTES], const char *folder, const struct key *key,
                    const char *end) {
  const uint64_t name = transport_table_checksum((const uint8_t *)key, sizeof *key);
  if (snprintf(path, PATH_MAX_BYTES, "%s/%016llx%s", folder, (unsigned long long)name, end) >=
      PATH_MAX_BYTES) {
    fail("the folder's name is too long");
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

/* Under another name first: a run that is killed leaves no half of a file. */
static void write_sample(const char *path, const char *unfinished, const table_sample *sample) {
  const uint64_t checksum =
      transport_table_checksum((const uint8_t *)sample->numbers, sample->bytes);
  FILE *file = fopen(unfinished, "wb");
  if (file == NULL || fwrite(sample->numbers, sample->bytes, 1, file) != 1 ||
      fwrite(&checksum, sizeof checksum, 1, file) != 1 || fclose(file) != 0 ||
      rename(unfinished, path) != 0) {
    fail("cannot write to the folder of solved media");
  }
}

/* ---- threads -------------------------------------------------------------------------------- */

struct run {
  pthread_mutex_t lock;
  const char *folder;
  double tolerance;
  double probe[4];
  table_sample *samples;
  size_t count, next;
  size_t media, done, read; /* media in all, done, and those of them that were in files */
  bool watched;
  time_t start;
};

static void show(const struct run *run) {
  static const char full[] = "########################################";
  if (!run->watched) {
    return;
  }
  const double share = (double)run->done / (double)run->media;
  fprintf(stderr, "\r[%-*.*s] %3.0f %%", BAR, (int)(share * BAR), full, share * 100);
  if (run->done > run->read) {
    const double per_medium = difftime(time(NULL), run->start) / (double)(run->done - run->read);
    const int seconds = (int)(per_medium * (double)(run->media - run->done));
    fprintf(stderr, "  %d:%02d left", seconds / 60, seconds % 60);
  }
  fprintf(stderr, "  solving %zu media\033[K", run->media);
}

static table_sample *next_sample(struct run *run) {
  pthread_mutex_lock(&run->lock);
  table_sample *sample = run->next < run->count ? &run->samples[run->next++] : NULL;
  pthread_mutex_unlock(&run->lock);
  return sample;
}

static void *work(void *argument) {
  struct run *run = argument;
  for (table_sample *sample = next_sample(run); sample != NULL; sample = next_sample(run)) {
    struct key key = {.tolerance = run->tolerance, .eta = sample->eta};
    memcpy(key.probe, run->probe, sizeof key.probe);
    key.inputs = transport_table_checksum((const uint8_t *)sample->numbers, input_bytes(sample));
    char path[PATH_MAX_BYTES], unfinished[PATH_MAX_BYTES];
    path_of(path, run->folder, &key, "");
    path_of(unfinished, run->folder, &key, ".unfinished");
    const bool there = read_sample(path, sample);
    if (!there) {
      solve(sample, run->tolerance);
      write_sample(path, unfinished, sample);
    }
    pthread_mutex_lock(&run->lock);
    run->done += sample->albedos;
    run->read += there ? sample->albedos : 0;
    show(run);
    pthread_mutex_unlock(&run->lock);
  }
  return NULL;
}

void samples_solve(const char *folder, double tolerance, table_sample *samples, size_t count) {
  if (mkdir(folder, 0777) != 0 && errno != EEXIST) {
    fail("cannot make the folder of solved media");
  }
  struct run run = {.folder = folder,
                    .tolerance = tolerance,
                    .samples = samples,
                    .count = count,
                    .watched = isatty(STDERR_FILENO) == 1,
                    .start = time(NULL)};
  for (size_t i = 0; i < count; i++) {
    run.media += samples[i].albedos;
  }
  probe_solver(tolerance, run.probe);
  pthread_mutex_init(&run.lock, NULL);
  const long cores = sysconf(_SC_NPROCESSORS_ONLN);
  const int threads = cores < 1 ? 1 : cores > THREADS_MAX ? THREADS_MAX : (int)cores;
  pthread_t thread[THREADS_MAX];
  for (int i = 0; i < threads; i++) {
    if (pthread_create(&thread[i], NULL, work, &run) != 0) {
      fail("cannot start a thread");
    }
  }
  for (int i = 0; i < threads; i++) {
    pthread_join(thread[i], NULL);
  }
  pthread_mutex_destroy(&run.lock);
  if (run.watched) {
    fputs("\r\033[K", stderr);
  }
}
