/* Measures fits of sigma_a and sigma_s' on one core, from noisy readings (2 %) at ten distances, or at
 * two spatial frequencies as of a camera's pixel; and a whole image through a daemon with one worker.
 *
 *   fit.<model>.<axis>.sets      sets of readings                       1/s
 *   fit.<model>.<axis>.prepare   a design: its tables and grid          ms
 *   fit.image                    1,048,576 pixels of two frequencies through libdipole and a private
 *                                daemon with one worker, in requests of 65,536 that wait for one
 *                                another                                                           s
 *   ratio.fit.image              the time of a request over that of the same fits in this process
 */
#include "core/fit/fit.h"

#include <stdlib.h>

#include "clients/c/dipole.h"
#include "tests/accuracy/fit_model.h"
#include "tests/bench/bench.h"

enum { RUNS = 7, SETS = 4096, READINGS = 10 };
enum { PIXELS = 65536, REQUESTS = 16, FREQUENCIES = 2 };

#define NOISE 0.02

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
    fit_model_readings(fit, 0.02 * (1 + 0.5 * noise(&state)), 1.1 * (1 + 0.3 * noise(&state)),
                       values[i]);
    for (size_t k = 0; k < count; k++) {
      errors[i][k] = NOISE * values[i][k];
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
    bench_fail_if(core_fit_create(&fit, core_isa_select(NULL), &design).field != NULL,
                  "a design was refused");
    preparing[run] = (double)(bench_now_ns() - start) * 1e-6;
    draw(fit, count);
    const uint64_t begin = bench_now_ns();
    for (size_t i = 0; i < SETS; i++) {
      core_fit_run(fit, values[i], errors[i], &result, NULL);
      fitted += result.status == CORE_FIT_STATUS_FITTED;
    }
    seconds[run] = (double)(bench_now_ns() - begin) * 1e-9;
    core_fit_free(fit);
    bench_fail_if(fitted < SETS * 9 / 10, "fits were no success");
  }
  bench_figure(SETS / bench_median(seconds, RUNS), "1/s", "fit.%s.sets", name);
  bench_figure(bench_median(preparing, RUNS), "ms", "fit.%s.prepare", name);
}

/* ---- an image through a daemon ----------------------------------------------------------------- */

static double image[PIXELS][FREQUENCIES], image_errors[PIXELS][FREQUENCIES];

/* Fills in the pixels of the sets that draw() has drawn, each with noise of its own. */
static void draw_image(void) {
  uint64_t state = 2;
  for (size_t i = 0; i < PIXELS; i++) {
    for (size_t k = 0; k < FREQUENCIES; k++) {
      image[i][k] = values[i % SETS][k] * (1 + NOISE * noise(&state));
      image_errors[i][k] = NOISE * image[i][k];
    }
  }
}

/* Fits the pixels here. Returns how many seconds that took. */
static double fit_here(const core_fit *fit) {
  const uint64_t begin = bench_now_ns();
  core_fit_result result;
  for (size_t i = 0; i < PIXELS; i++) {
    core_fit_run(fit, image[i], image_errors[i], &result, NULL);
  }
  return (double)(bench_now_ns() - begin) * 1e-9;
}

static double fit_there(dipole_client *client) {
  const dipole_fit_query query = {.model = CORE_MODEL_TRANSPORT,
                                  .moments = DIPOLE_EXACT,
                                  .eta = 1.4,
                                  .axis = CORE_FIT_AXIS_FREQUENCY,
                                  .scale = DIPOLE_ABSOLUTE,
                                  .reading_count = FREQUENCIES,
                                  .at = frequencies,
                                  .set_count = PIXELS,
                                  .values = image[0],
                                  .errors = image_errors[0]};
  dipole_fits *fits;
  dipole_error error;
  const uint64_t begin = bench_now_ns();
  bench_fail_if(!dipole_fit(client, &query, &fits, &error), error.text);
  const double seconds = (double)(bench_now_ns() - begin) * 1e-9;
  bench_fail_if(fits->set_count != PIXELS || fits->fitted_count < PIXELS * UINT64_C(98) / 100,
                "pixels were no success");
  dipole_fits_free(fits);
  return seconds;
}

static void measure_image(void) {
  const core_fit_design design = {.model = CORE_MODEL_TRANSPORT,
                                  .moments = CORE_MOMENTS_EXACT,
                                  .eta = 1.4,
                                  .axis = CORE_FIT_AXIS_FREQUENCY,
                                  .count = FREQUENCIES,
                                  .at = frequencies,
                                  .scale = CORE_FIT_SCALE_ABSOLUTE};
  dipole_client *client;
  dipole_error error;
  core_fit *fit;
  bench_progress("fit: an image");
  bench_fail_if(core_fit_create(&fit, core_isa_select(NULL), &design).field != NULL,
                "a design was refused");
  draw(fit, FREQUENCIES);
  draw_image();
  bench_fail_if(setenv("DIPOLED_WORKERS", "1", true) != 0 ||
                    !dipole_open("private:", &client, &error),
                error.text);
  double seconds[REQUESTS], ratios[REQUESTS], sum = 0;
  fit_there(client); /* prepares the design */
  for (size_t i = 0; i < REQUESTS; i++) {
    seconds[i] = fit_there(client);
    ratios[i] = seconds[i] / fit_here(fit);
    sum += seconds[i];
  }
  bench_figure(sum, "s", "fit.image");
  bench_figure(bench_median(ratios, REQUESTS), "times", "ratio.fit.image");
  dipole_close(client);
  core_fit_free(fit);
  unsetenv("DIPOLED_WORKERS");
}

void bench_fit(void) {
  measure("transport.r", CORE_MODEL_TRANSPORT, CORE_FIT_AXIS_RADIUS, 0, distances, READINGS);
  measure("transport-g.r", CORE_MODEL_TRANSPORT, CORE_FIT_AXIS_RADIUS, 0.8, distances, READINGS);
  measure("transport.f", CORE_MODEL_TRANSPORT, CORE_FIT_AXIS_FREQUENCY, 0, frequencies, 2);
  measure("better.r", CORE_MODEL_BETTER, CORE_FIT_AXIS_RADIUS, 0, distances, READINGS);
  measure_image();
}
