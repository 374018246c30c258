/* bench: functions that the groups of benchmarks share. Standard output gets one line for each
 * figure, with name, value and unit separated by tabs, and nothing else. */
#ifndef DIPOLED_BENCH_H
#define DIPOLED_BENCH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/core.h"

#define BENCH_GROUP(name, about) void bench_##name(void);
#include "tests/bench/groups.def"
#undef BENCH_GROUP

/* Whether the user asked for the long form (--long). In the short form a group takes less than 60 s
 * on a machine that does nothing else. */
extern bool bench_is_long;

/* Prints a figure; format and what follows make its name. */
__attribute__((format(printf, 3, 4))) void bench_figure(double value, const char *unit,
                                                        const char *format, ...);

/* Shows on standard error, if that is a terminal, what is being measured. "" clears the line. */
void bench_progress(const char *what);

/* Prints why the benchmark cannot go on and exits 1. */
_Noreturn void bench_fail(const char *why);
static inline void bench_fail_if(bool wrong, const char *why) {
  if (wrong) {
    bench_fail(why);
  }
}

/* Returns memory, or does not return. */
void *bench_allocate(size_t bytes);

uint64_t bench_now_ns(void);

/* The processor time of this thread: what work costs, on a machine that does other work too. */
uint64_t bench_own_ns(void);

/* Returns the median of n > 0 values and sorts them. */
double bench_median(double *values, size_t n);

/* The same of figures that are kept in their order, and of the ratios of two sides' figures, round by
 * round. n: at most 15. */
double bench_median_of(const double *figures, size_t n);
double bench_median_ratio(const double *over, const double *under, size_t n);

/* Prepares the red channel of skin1, as a slab of 4 mm for models that need a thickness. */
core_profile bench_profile(const core_isa *isa, unsigned model, unsigned evaluator);

/* The alignment of arrays for kernels: that of cache lines. */
enum { BENCH_ALIGNMENT = 64 };

/* Fills r[n], of floats or doubles by their size in bytes, with radii from 0.01 to 10 mm in an
 * order that no branch predictor learns. */
void bench_fill_radii(size_t value_bytes, void *r, size_t n);

/* One of the programs that bench_compare() compares. It runs them in turn, round after round, so
 * that other work of the machine slows all of them down alike. One call of run(context) is one unit
 * of work. bench_compare() sets ns to the median of the processor time of a unit. */
typedef struct bench_contender {
  void (*run)(const void *context);
  const void *context;
  double ns;
} bench_contender;

void bench_compare(bench_contender *contenders, size_t count);

#endif
