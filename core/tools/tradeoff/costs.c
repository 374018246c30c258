#include "core/tools/tradeoff/costs.h"
#include "core/tools/tools.h"

#include <math.h>
#include <stdlib.h>
#include <time.h>

enum {
  ROUNDS = 31,
  EVALUATION_MEDIA = 3,
  PREPARATION_MEDIA = 12,
  PREPARATIONS_MAX = 5,
  DECADES = 12,
};

/* A sample takes at least this: far longer than reading the clock, far shorter than a time slice.
 */
#define SAMPLE_NS 100000.0
#define PREPARING_NS 20e6      /* preparing is repeated for about this time */
#define EVALUATING_COST_US 4e6 /* estimated work, for the progress bar only */
#define PREPARING_COST_US 12e6

double costs_cost_us(void) {
  return CORE_CHOOSE_TOLERANCE_COUNT *
         (EVALUATION_MEDIA * EVALUATING_COST_US + PREPARATION_MEDIA * PREPARING_COST_US);
}

static const core_medium evaluation_media[EVALUATION_MEDIA] = {
    {0.001, 1, 0, 1.4}, {0.05, 1, 0, 1.4}, {0.5, 0.5, 0, 1.4}};

/* Returns the processor time of this thread, so that other programs do not count. */
static double now_ns(void) {
  struct timespec now;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return (double)now.tv_sec * 1e9 + (double)now.tv_nsec;
}

static const double tolerances[CORE_CHOOSE_TOLERANCE_COUNT] = CORE_CHOOSE_TOLERANCES;

/* Prepares a subject's profile. Returns false if the subject refuses the medium. */
static bool prepare(core_profile *profile, const subjects *of, size_t s, const core_medium *medium,
                    double tolerance) {
  return subjects_prepare(profile, of, &of->all[s], medium, tolerance).field == NULL;
}

/* Returns the median of the values that are numbers, or NaN if there are none. */
static double median_of_numbers(const double *values, size_t n) {
  double numbers[PREPARATION_MEDIA];
  size_t count = 0;
  for (size_t i = 0; i < n; i++) {
    if (!isnan(values[i])) {
      numbers[count++] = values[i];
    }
  }
  return count > 0 ? tools_median(numbers, count) : (double)NAN;
}

/* ---- evaluating ------------------------------------------------------------------------------ */

static struct {
  double f64[COSTS_LENGTH];
  float f32[COSTS_LENGTH];
  double out_f64[COSTS_LENGTH];
  float out_f32[COSTS_LENGTH];
} arrays;

/* Fills in radii with a uniform density in ln r from 0.01 to 20 mm. Their order is random, so that
 * branch predictors cannot learn it. */
static void fill_arrays(void) {
  uint32_t random = 1;
  for (size_t i = 0; i < COSTS_LENGTH; i++) {
    random = random * 1664525u + 1013904223u;
    arrays.f32[i] = (float)(0.01 * pow(2000, (random >> 8) * 0x1p-24));
    arrays.f64[i] = (double)arrays.f32[i];
  }
}

static double run_ns(const core_profile *profile, size_t runs) {
  const double start = now_ns();
  for (size_t i = 0; i < runs; i++) {
    if (profile->evaluator == CORE_EVALUATOR_F64) {
      core_eval_f64(profile, CORE_QUANTITY_R, COSTS_LENGTH, arrays.f64, arrays.out_f64);
    } else {
      core_eval_f32(profile, CORE_QUANTITY_R, COSTS_LENGTH, arrays.f32, arrays.out_f32);
    }
  }
  return now_ns() - start;
}

/* Returns the number of runs for one sample. The runs also fill caches and raise the clock rate. */
static size_t calibrate(const core_profile *profile) {
  size_t runs = 1;
  while (run_ns(profile, runs) < SAMPLE_NS) {
    runs *= 2;
  }
  return runs;
}

/* Times evaluating one medium: writes ns[subject], which is NaN if the subject refuses the medium.
 */
static void evaluate_all(const subjects *of, const core_medium *medium, double tolerance,
                         double *ns) {
  static core_profile profiles[SUBJECTS_MAX];
  static double samples[SUBJECTS_MAX][ROUNDS];
  size_t runs[SUBJECTS_MAX];
  for (size_t s = 0; s < of->count; s++) {
    runs[s] = prepare(&profiles[s], of, s, medium, tolerance) ? calibrate(&profiles[s]) : 0;
  }
  for (size_t round = 0; round < ROUNDS; round++) {
    for (size_t s = 0; s < of->count; s++) {
      if (runs[s] > 0) {
        run_ns(&profiles[s], 1); /* loads its tables into the nearest cache */
        samples[s][round] = run_ns(&profiles[s], runs[s]) / (double)(runs[s] * COSTS_LENGTH);
      }
    }
  }
  for (size_t s = 0; s < of->count; s++) {
    ns[s] = (double)NAN;
    if (runs[s] > 0) {
      ns[s] = tools_median(samples[s], ROUNDS);
      core_profile_free(&profiles[s]);
    }
  }
}

/* ---- preparing ------------------------------------------------------------------------------- */

static double prepare_ns(const subjects *of, size_t s, const core_medium *medium,
                         double tolerance) {
  double samples[PREPARATIONS_MAX];
  size_t count = 0;
  const double start = now_ns();
  do {
    core_profile profile;
    const double begin = now_ns();
    if (!prepare(&profile, of, s, medium, tolerance)) {
      return (double)NAN;
    }
    samples[count++] = now_ns() - begin;
    core_profile_free(&profile);
  } while (count < PREPARATIONS_MAX && now_ns() - start < PREPARING_NS);
  return tools_median(samples, count);
}

/* Returns medium i of the twelve pairs of four ratios and three eta. */
static core_medium preparation_medium(size_t i, double g) {
  static const double ratios[] = {1e-3, 1e-2, 0.1, 1}, etas[] = {1.1, 1.4, 1.8};
  const double ratio = ratios[i % 4];
  return (core_medium){ratio / (1 + ratio), 1 / (1 + ratio) / (1 - g), g, etas[i / 4]};
}

/* Returns the largest numerical error that profiles with this tolerance state, or NaN if refused.
 */
static double stated(const subjects *of, size_t s, double tolerance) {
  double worst = 0;
  for (size_t m = 0; m < EVALUATION_MEDIA; m++) {
    core_profile profile;
    if (subjects_prepare(&profile, of, &of->all[s], &evaluation_media[m], tolerance).field !=
        NULL) {
      return (double)NAN;
    }
    worst = fmax(worst, profile.numerical_error + 20 * profile.numerical_error_per_mm);
    core_profile_free(&profile);
  }
  return worst;
}

static void find_least(costs_of *cost, const subjects *of, size_t s) {
  static const double powers[DECADES] = {1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-7,
                                         1e-6,  1e-5,  1e-4,  1e-3, 1e-2, 1e-1};
  cost->numerical_least = (double)NAN;
  for (size_t i = 0; i < DECADES && isnan(cost->numerical_least); i++) {
    cost->tolerance_least = powers[i];
    cost->numerical_least = stated(of, s, powers[i]);
  }
}

/* ---- all of them ----------------------------------------------------------------------------- */

/* Measures the costs with one of the tolerances. */
static void measure(costs_of *costs, const subjects *of, size_t k, tools_progress *progress) {
  static double ns[EVALUATION_MEDIA][SUBJECTS_MAX];
  tools_progress_stage(progress, "cost of evaluating");
  for (size_t m = 0; m < EVALUATION_MEDIA; m++) {
    evaluate_all(of, &evaluation_media[m], tolerances[k], ns[m]);
    tools_progress_add(progress, EVALUATING_COST_US);
  }
  tools_progress_stage(progress, "cost of preparing");
  for (size_t s = 0; s < of->count; s++) {
    double over_media[PREPARATION_MEDIA];
    for (size_t m = 0; m < EVALUATION_MEDIA; m++) {
      over_media[m] = ns[m][s];
    }
    costs[s].evaluate_ns[k] = median_of_numbers(over_media, EVALUATION_MEDIA);
    for (size_t m = 0; m < PREPARATION_MEDIA; m++) {
      const core_medium medium = preparation_medium(m, 0);
      over_media[m] = prepare_ns(of, s, &medium, tolerances[k]);
    }
    costs[s].prepare_ns[k] = median_of_numbers(over_media, PREPARATION_MEDIA);
    tools_progress_add(progress, PREPARATION_MEDIA * PREPARING_COST_US / (double)of->count);
  }
}

void costs_measure(costs_of *costs, const subjects *of, tools_progress *progress) {
  fill_arrays();
  for (size_t k = 0; k < CORE_CHOOSE_TOLERANCE_COUNT; k++) {
    measure(costs, of, k, progress);
  }
  for (size_t s = 0; s < of->count; s++) {
    double over_media[PREPARATION_MEDIA];
    const bool transport = of->models[of->all[s].model].model->id == CORE_MODEL_TRANSPORT;
    for (size_t m = 0; m < PREPARATION_MEDIA; m++) {
      const core_medium medium = preparation_medium(m, m % 2 ? 0.9 : 0.5);
      over_media[m] = transport ? prepare_ns(of, s, &medium, (double)NAN) : (double)NAN;
    }
    costs[s].prepare_with_g_ns = median_of_numbers(over_media, PREPARATION_MEDIA);
    find_least(&costs[s], of, s);
  }
}
