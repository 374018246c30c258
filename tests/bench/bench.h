/* bench: what groups of benchmarks share. One figure a line on standard output, name, value and
 * unit, separated by tabs; nothing else goes there. */
#ifndef DIPOLED_BENCH_H
#define DIPOLED_BENCH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define BENCH_GROUP(name, about) void bench_##name(void);
#include "tests/bench/groups.def"
#undef BENCH_GROUP

/* Prints a figure; format and what follows make its name. */
__attribute__((format(printf, 3, 4))) void bench_figure(double value, const char *unit,
                                                        const char *format, ...);

/* What is being measured now; shown on standard error when that is a terminal. "" clears it. */
void bench_progress(const char *what);

/* Prints why the benchmark cannot go on and exits 1. */
_Noreturn void bench_fail(const char *why);

uint64_t bench_now_ns(void);

/* The middle one of n > 0 values, which are sorted. */
double bench_median(double *values, size_t n);

/* Things that are compared: each is run in turn, round after round, so that whatever else the
 * machine does meets all of them alike. run(context) once is one unit of work; ns: the median time
 * that one takes. */
typedef struct bench_contender {
  void (*run)(const void *context);
  const void *context;
  double ns;
} bench_contender;

void bench_compare(bench_contender *contenders, size_t count);

#endif
