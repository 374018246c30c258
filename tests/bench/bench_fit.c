/* Measures fits of sigma_a and sigma_s' on one core, from noisy readings (2 %) at ten distances, or at
 * two spatial frequencies as of a camera's pixel.
 *
 *   fit.<model>.<axis>.sets      sets of readings                       1/s
 *   fit.<model>.<axis>.prepare   a design: its tables and grid          ms
 */
#include "core/fit/fit.h"

#include "tests/bench/bench.h"

enum { RUNS = 7, SETS = 4096, READINGS = 10 };

static const double distances[READINGS] = {.3, .42, .6, .85, 1.2, 1.7, 2.4, 3.4, 4.8, 6.8};
static const double frequencies[] = {0, 0.2};

static double values[SETS][READINGS], errors[SETS][READINGS];

/* A number from -1 to 1 that is the same in each run. */
static double noise(uint64_t *state) {
  *state = *state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
  return (double)(*state >> 11) * 0x1p-52 - 1;
}

/* Fills in the readings: media of an image, each a bit different. */
static void draw(const core_fit *fit, size_t count) {
  uint64_t state = 1;
  for (size_t i = 0; i < SETS; i++) {
    core_fit_model(fit, 0.02 * (1 + 0.5 * noise(&state)), 1.1 * (1 + 0.3 * noise(&state)),
                   values[i]);
    for (size_t k = 0; k < count; k++) {
      errors[i][k] = 0.02 * values[i][k];
      values[i][k] += 1.7 * errors[i][k] * noise(&state);
    }
  }
}

static void measure(const char *name, unsigned model, unsigned axis, double g, const double *at,
                    size_t count) {
  double seconds[RUNS], preparing[RUNS];
  const core_fit_design design = {.model = model,
                                  .moments = CORE_MOMENTS_EXACT,
                                  .g = g,
                                  .eta = 1.4,
                                  .axis = axis,
                                  .count = count,
                                  .at = at,
                                  .scale = CORE_FIT_SCALE_ABSOLUTE};
  for (int run = 0; run < RUNS; run++) {
    core_fit *fit;
    core_fit_result result;
    size_t fitted = 0;
    bench_progress(name);
    const uint64_t start = bench_now_ns();
    if (core_fit_create(&fit, core_isa_select(NULL), &design).field != NULL) {
      bench_fail("a design was refused");
    }
    preparing[run] = (double)(bench_now_ns() - start) * 1e-6;
    draw(fit, count);
    const uint64_t begin = bench_now_ns();
    for (size_t i = 0; i < SETS; i++) {
      core_fit_run(fit, values[i], errors[i], &result, NULL);
      fitted += result.status == CORE_FIT_STATUS_FITTED;
    }
    seconds[run] = (double)(bench_now_ns() - begin) * 1e-9;
    core_fit_free(fit);
    if (fitted < SETS * 9 / 10) {
      bench_fail("fits were no success");
    }
  }
  bench_figure(SETS / bench_median(seconds, RUNS), "1/s", "fit.%s.sets", name);
  bench_figure(bench_median(preparing, RUNS), "ms", "fit.%s.prepare", name);
}

void bench_fit(void) {
  measure("transport.r", CORE_MODEL_TRANSPORT, CORE_FIT_AXIS_RADIUS, 0, distances, READINGS);
  measure("transport-g.r", CORE_MODEL_TRANSPORT, CORE_FIT_AXIS_RADIUS, 0.8, distances, READINGS);
  measure("transport.f", CORE_MODEL_TRANSPORT, CORE_FIT_AXIS_FREQUENCY, 0, frequencies, 2);
  measure("better.r", CORE_MODEL_BETTER, CORE_FIT_AXIS_RADIUS, 0, distances, READINGS);
}
