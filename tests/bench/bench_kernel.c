/* Measures the evaluation of R for arrays of radii: by every instruction set of this machine, by a
 * plain loop over the C library's functions, and beside memcpy of the same bytes, in turn and in
 * the same run. Of tables, only that of the better dipole is measured: all models share its kernel.
 *
 *   kernel.<model>.<evaluator>.<instruction set, libm or memcpy>.<array length>   values/s
 *   ratio.kernel.<model>.<evaluator>    the best instruction set over libm, at 4096 values
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/core.h"
#include "tests/bench/bench.h"
#include "tests/bench/plain_dipole.h"

enum { LENGTH_MAX = 1048576, RATIO_LENGTH = 4096, CONTENDERS_MAX = 8 };

static const size_t lengths[] = {16, RATIO_LENGTH};
static const size_t long_lengths[] = {1, 16, 256, RATIO_LENGTH, LENGTH_MAX};

/* Arrays with room for the longest length in doubles. Floats fill half of them. */
struct arrays {
  void *r;
  void *R;
};

/* The argument of a run. The profile says the precision. */
struct work {
  const char *name;
  core_profile profile;
  plain_dipole plain;
  const struct arrays *arrays;
  size_t n;
};

/* ---- what is run -------------------------------------------------------------------------- */

static bool single(const struct work *work) {
  return work->profile.evaluator != CORE_EVALUATOR_F64;
}

static void run_kernel(const void *context) {
  const struct work *work = context;
  if (single(work)) {
    core_eval_f32(&work->profile, CORE_QUANTITY_R, work->n, work->arrays->r, work->arrays->R);
  } else {
    core_eval_f64(&work->profile, CORE_QUANTITY_R, work->n, work->arrays->r, work->arrays->R);
  }
}

static void run_libm(const void *context) {
  const struct work *work = context;
  if (single(work)) {
    plain_dipole_f32(&work->plain, work->n, work->arrays->r, work->arrays->R);
  } else {
    plain_dipole_f64(&work->plain, work->n, work->arrays->r, work->arrays->R);
  }
}

static void run_memcpy(const void *context) {
  const struct work *work = context;
  memcpy(work->arrays->R, work->arrays->r,
         work->n * (single(work) ? sizeof(float) : sizeof(double)));
}

/* ---- one model and evaluator -------------------------------------------------------------- */

struct comparison {
  struct work work[CONTENDERS_MAX];
  bench_contender contenders[CONTENDERS_MAX];
  size_t count;
  size_t kernels; /* how many contenders, from the first on, are kernels */
};

static struct work *add(struct comparison *comparison, const char *name,
                        void (*run)(const void *context), const core_profile *profile,
                        const struct arrays *arrays) {
  bench_fail_if(comparison->count == CONTENDERS_MAX,
                "more instruction sets than a comparison holds");
  struct work *work = &comparison->work[comparison->count];
  *work = (struct work){.name = name, .profile = *profile, .arrays = arrays};
  comparison->contenders[comparison->count++] = (bench_contender){.run = run, .context = work};
  return work;
}

/* Returns the switches of a dipole for the plain loop, or -1 for other models, which have no plain
 * loop. */
static int plain_switches(unsigned model) {
  switch (model) {
#define SWITCHES(id, IDENT, name, formula, kernels, variant, parameters, source)                   \
  case id:                                                                                         \
    return strcmp(#formula, "dipole") == 0 ? (variant) : -1;
    CORE_EACH_MODEL(SWITCHES, CORE_NO_SUM)
  default:
    return -1;
  }
}

static void make_comparison(struct comparison *comparison, unsigned model, unsigned evaluator,
                            const struct arrays *arrays) {
  const core_medium *medium = &core_measured_medium_by_name("skin1")->channel[0];
  core_profile profile;
  comparison->count = 0;
  for (size_t i = 0; core_isa_listed(i) != NULL; i++) {
    const core_isa *isa = core_isa_select(core_isa_listed(i));
    if (isa == NULL) {
      continue;
    }
    profile = bench_profile(isa, model, evaluator);
    add(comparison, core_isa_listed(i), run_kernel, &profile, arrays);
  }
  comparison->kernels = comparison->count;
  const int switches = plain_switches(model);
  if (switches >= 0) {
    add(comparison, "libm", run_libm, &profile, arrays)->plain =
        plain_dipole_prepare(switches, medium);
  }
  add(comparison, "memcpy", run_memcpy, &profile, arrays);
}

/* Checks that the plain loop computes the same values as the kernel. */
static void check_plain_loop(const struct work *plain) {
  enum { CHECKED = 64 };
  const size_t bytes = CHECKED * (single(plain) ? sizeof(float) : sizeof(double));
  double kept[CHECKED];
  struct work work = *plain;
  work.n = CHECKED;
  run_libm(&work);
  memcpy(kept, work.arrays->R, bytes);
  run_kernel(&work);
  for (size_t i = 0; i < CHECKED; i++) {
    const double a = single(plain) ? (double)((const float *)kept)[i] : kept[i];
    const double b = single(plain) ? (double)((const float *)work.arrays->R)[i]
                                   : ((const double *)work.arrays->R)[i];
    bench_fail_if(!(fabs(a - b) <= (single(plain) ? 1e-4 : 1e-12) * b),
                  "the plain loop and the kernel disagree");
  }
}

static void report_ratio(const struct comparison *comparison, const char *model,
                         const char *evaluator) {
  const size_t libm = comparison->kernels;
  double best_ns = INFINITY;
  for (size_t i = 0; i < comparison->kernels; i++) {
    best_ns = fmin(best_ns, comparison->contenders[i].ns);
  }
  bench_figure(comparison->contenders[libm].ns / best_ns, "times", "ratio.kernel.%s.%s", model,
               evaluator);
}

static void measure(const core_choice *model, const core_choice *evaluator,
                    const struct arrays *arrays) {
  struct comparison comparison;
  make_comparison(&comparison, model->id, evaluator->id, arrays);
  const bool has_plain = comparison.contenders[comparison.kernels].run == run_libm;
  if (has_plain) {
    check_plain_loop(&comparison.work[comparison.kernels]);
  }
  const size_t count = bench_is_long ? sizeof long_lengths / sizeof long_lengths[0]
                                     : sizeof lengths / sizeof lengths[0];
  for (size_t i = 0; i < count; i++) {
    const size_t n = bench_is_long ? long_lengths[i] : lengths[i];
    char what[128];
    snprintf(what, sizeof what, "kernel: %s, %s, arrays of %zu", model->name, evaluator->name, n);
    bench_progress(what);
    for (size_t j = 0; j < comparison.count; j++) {
      comparison.work[j].n = n;
    }
    bench_compare(comparison.contenders, comparison.count);
    for (size_t j = 0; j < comparison.count; j++) {
      bench_figure((double)n / comparison.contenders[j].ns * 1e9, "values/s", "kernel.%s.%s.%s.%zu",
                   model->name, evaluator->name, comparison.work[j].name, n);
    }
    if (n == RATIO_LENGTH && has_plain) {
      report_ratio(&comparison, model->name, evaluator->name);
    }
  }
}

/* ---- all figures -------------------------------------------------------------------------- */

void bench_kernel(void) {
  const struct arrays arrays = {aligned_alloc(BENCH_ALIGNMENT, LENGTH_MAX * sizeof(double)),
                                aligned_alloc(BENCH_ALIGNMENT, LENGTH_MAX * sizeof(double))};
  bench_fail_if(arrays.r == NULL || arrays.R == NULL, "out of memory");
  for (const core_choice *evaluator = core_evaluators; evaluator->name != NULL; evaluator++) {
    bench_fill_radii(core_evaluator_bytes(evaluator->id), arrays.r, LENGTH_MAX);
    for (const core_choice *model = core_models; model->name != NULL; model++) {
      if (evaluator->id != CORE_EVALUATOR_LUT || model->id == CORE_MODEL_BETTER) {
        measure(model, evaluator, &arrays);
      }
    }
  }
  free(arrays.r);
  free(arrays.R);
}
