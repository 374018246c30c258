/* build/bench [--long] [GROUP...]: runs these groups of benchmarks, or all. --long takes more
 * rounds and, in the group kernel, more lengths of arrays. */
#include "tests/bench/bench.h"

#include <assert.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static const struct {
  const char *name;
  const char *about;
  void (*run)(void);
} groups[] = {
#define BENCH_GROUP(name, about) {#name, about, bench_##name},
#include "tests/bench/groups.def"
#undef BENCH_GROUP
};
enum { GROUPS = sizeof groups / sizeof groups[0] };

bool bench_is_long = false;

/* ---- figures ------------------------------------------------------------------------------ */

void bench_figure(double value, const char *unit, const char *format, ...) {
  char name[256];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(name, sizeof name, format, arguments);
  va_end(arguments);
  bench_progress("");
  printf("%s\t%.6g\t%s\n", name, value, unit);
  fflush(stdout);
}

void bench_progress(const char *what) {
  if (isatty(STDERR_FILENO)) {
    fprintf(stderr, "\r\033[K%s", what);
    fflush(stderr);
  }
}

void bench_fail(const char *why) {
  bench_progress("");
  fprintf(stderr, "bench: %s\n", why);
  exit(EXIT_FAILURE);
}

void *bench_allocate(size_t bytes) {
  void *memory = malloc(bytes);
  bench_fail_if(memory == NULL, "out of memory");
  return memory;
}

/* ---- time --------------------------------------------------------------------------------- */

static uint64_t read_clock(clockid_t clock) {
  struct timespec now;
  clock_gettime(clock, &now);
  return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}

uint64_t bench_now_ns(void) {
  return read_clock(CLOCK_MONOTONIC);
}

uint64_t bench_own_ns(void) {
  return read_clock(CLOCK_THREAD_CPUTIME_ID);
}

static int compare_doubles(const void *a, const void *b) {
  const double x = *(const double *)a;
  const double y = *(const double *)b;
  return (x > y) - (x < y);
}

double bench_median(double *values, size_t n) {
  qsort(values, n, sizeof *values, compare_doubles);
  return n % 2 ? values[n / 2] : 0.5 * (values[n / 2 - 1] + values[n / 2]);
}

enum { ROUNDS_MOST = 15 };

double bench_median_of(const double *figures, size_t n) {
  double sorted[ROUNDS_MOST];
  assert(n <= ROUNDS_MOST);
  memcpy(sorted, figures, n * sizeof *sorted);
  return bench_median(sorted, n);
}

double bench_median_ratio(const double *over, const double *under, size_t n) {
  double ratios[ROUNDS_MOST];
  assert(n <= ROUNDS_MOST);
  for (size_t i = 0; i < n; i++) {
    ratios[i] = over[i] / under[i];
  }
  return bench_median(ratios, n);
}

/* ---- comparing ---------------------------------------------------------------------------- */

enum { CONTENDERS_MAX = 16, ROUNDS_MIN = 7, ROUNDS_MAX = 51 };
#define SAMPLE_NS                                                                                  \
  500000 /* long in comparison to reading the clock, and short in comparison to a time slice */
/* A comparison adds rounds until it has taken about this time. */
#define COMPARISON_NS 150000000
#define LONG_COMPARISON_NS 1000000000

static double sample_ns(const bench_contender *contender, uint64_t runs) {
  const uint64_t start = bench_own_ns();
  for (uint64_t i = 0; i < runs; i++) {
    contender->run(contender->context);
  }
  return (double)(bench_own_ns() - start);
}

/* Returns how many runs make a sample. Also warms caches and clocks up. */
static uint64_t calibrate(const bench_contender *contender) {
  uint64_t runs = 1;
  while (sample_ns(contender, runs) < SAMPLE_NS) {
    runs *= 2;
  }
  return runs;
}

void bench_compare(bench_contender *contenders, size_t count) {
  static double ns[CONTENDERS_MAX][ROUNDS_MAX];
  uint64_t runs[CONTENDERS_MAX];
  bench_fail_if(count > CONTENDERS_MAX, "too many contenders for one comparison");
  for (size_t i = 0; i < count; i++) {
    runs[i] = calibrate(&contenders[i]);
  }
  size_t rounds = 0;
  const uint64_t end = bench_now_ns() + (bench_is_long ? LONG_COMPARISON_NS : COMPARISON_NS);
  while (rounds < ROUNDS_MIN || (rounds < ROUNDS_MAX && bench_now_ns() < end)) {
    for (size_t i = 0; i < count; i++) {
      ns[i][rounds] = sample_ns(&contenders[i], runs[i]) / (double)runs[i];
    }
    rounds++;
  }
  for (size_t i = 0; i < count; i++) {
    contenders[i].ns = bench_median(ns[i], rounds);
  }
}

/* ---- what is evaluated -------------------------------------------------------------------- */

core_profile bench_profile(const core_isa *isa, unsigned model, unsigned evaluator) {
  core_medium medium = core_measured_medium_by_name("skin1")->channel[0];
  if (core_profile_check(model, CORE_MOMENTS_EXACT, evaluator, &medium, NULL, NULL).field != NULL) {
    medium.thickness_mm = 4;
  }
  core_profile profile;
  bench_fail_if(
      core_profile_prepare(&profile, isa, model, CORE_MOMENTS_EXACT, evaluator, &medium, NULL)
              .field != NULL,
      "a measured medium was refused");
  return profile;
}

void bench_fill_radii(size_t value_bytes, void *r, size_t n) {
  uint32_t random = 1;
  for (size_t i = 0; i < n; i++) {
    random = random * 1664525u + 1013904223u;
    const double radius = 0.01 + 9.99 * (random >> 8) * 0x1p-24;
    if (value_bytes == sizeof(float)) {
      ((float *)r)[i] = (float)radius;
    } else {
      ((double *)r)[i] = radius;
    }
  }
}

/* ---- the program -------------------------------------------------------------------------- */

static void usage(FILE *to) {
  fprintf(to, "Usage: bench [--long] [GROUP...]\n\n"
              "Runs the named groups of benchmarks, or all of them. Prints one figure on each\n"
              "line: its name, value and unit, separated by tabs. The contenders of a comparison\n"
              "take turns; a figure is the median over the rounds. A group takes less than a\n"
              "minute on a machine that does nothing else.\n\n"
              "  --long     more rounds and, in the group kernel, more array lengths\n"
              "  --help     this text\n\n"
              "Groups\n");
  for (size_t i = 0; i < GROUPS; i++) {
    fprintf(to, "  %-10s %s\n", groups[i].name, groups[i].about);
  }
}

static size_t find_group(const char *name) {
  size_t i = 0;
  while (i < GROUPS && strcmp(groups[i].name, name) != 0) {
    i++;
  }
  return i;
}

int main(int argc, char **argv) {
  size_t chosen[GROUPS];
  size_t count = 0;
  for (int i = 1; i < argc; i++) {
    const size_t group = find_group(argv[i]);
    if (strcmp(argv[i], "--help") == 0 || strcmp(argv[i], "-h") == 0) {
      usage(stdout);
      return EXIT_SUCCESS;
    } else if (strcmp(argv[i], "--long") == 0) {
      bench_is_long = true;
    } else if (group < GROUPS && count < GROUPS) {
      chosen[count++] = group;
    } else {
      fprintf(stderr, "bench: there is no group %s; see bench --help\n", argv[i]);
      return 2;
    }
  }
  for (size_t i = 0; i < (count == 0 ? GROUPS : count); i++) {
    groups[count == 0 ? i : chosen[i]].run();
  }
  bench_progress("");
  return EXIT_SUCCESS;
}
