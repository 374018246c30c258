/* Measures kernels where every value has a medium of its own, in single precision by the best
 * instruction set, in turn and in the same run: 4096 random media, radii, colours and numbers u.
 *
 *   varying.better, varying.transport, varying.sample, varying.invert     values/s
 *   varying.transport.f64, varying.gradient    values/s: R, and ln R with derivatives, of transport
 *   ratio.varying.better       time of a value of the better dipole over that of one medium's kernel
 *   ratio.varying.transport    time of a value of transport over a lookup in one medium's table
 *   ratio.varying.sample       the same for a sampled radius
 *   ratio.varying.invert       the same for a medium from a colour
 *   varying.surface.prepare.<g>   s, to make a surface of the default tolerance
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/varying.h"
#include "tests/bench/bench.h"

enum { VALUES = 4096, PREPARATIONS = 5 };

#define ETA 1.4

static _Alignas(BENCH_ALIGNMENT) float sigma_a[VALUES], sigma_s[VALUES], radii[VALUES];
static _Alignas(BENCH_ALIGNMENT) float numbers[VALUES], lengths[VALUES], values[VALUES];
static _Alignas(BENCH_ALIGNMENT) float found_a[VALUES], found_s[VALUES];
static _Alignas(BENCH_ALIGNMENT) double wide[3][VALUES], wide_out[3][VALUES];
static uint8_t status[VALUES];

/* ---- what is run ----------------------------------------------------------------------------- */

static void run_one_medium(const void *context) {
  core_eval_f32(context, CORE_QUANTITY_R, VALUES, radii, values);
}

static void run_R(const void *context) {
  core_varying_eval(context, CORE_QUANTITY_R, VALUES, sigma_a, sigma_s, radii, values);
}

static void run_R_f64(const void *context) {
  core_varying_eval(context, CORE_QUANTITY_R, VALUES, wide[0], wide[1], wide[2], wide_out[0]);
}

static void run_gradient(const void *context) {
  const core_gradient out = {wide_out[0], wide_out[1], wide_out[2]};
  core_varying_gradient_f64(context, VALUES, wide[0], wide[1], wide[2], &out);
}

static void run_sample(const void *context) {
  core_varying_eval(context, CORE_QUANTITY_RADIUS, VALUES, sigma_a, sigma_s, numbers, values);
}

static void run_invert(const void *context) {
  const core_colour what = {CORE_LIGHT_BEAM, false, CORE_LENGTH_FREE_PATH};
  core_varying_invert(context, &what, VALUES, numbers, lengths, found_a, found_s, values, status);
}

static core_varying prepare(unsigned model, unsigned evaluator, double g) {
  core_varying varying;
  bench_fail_if(core_varying_prepare(&varying, core_isa_select(NULL), model, CORE_MOMENTS_EXACT,
                                     evaluator, g, ETA, NULL)
                        .field != NULL,
                "media that vary were refused");
  return varying;
}

/* Fills in media with albedos as textures have them, 0.3 to 1, and mean free paths of 0.1 to 10 mm.
 */
static void fill(void) {
  uint32_t random = 1;
  float uniform[4];
  bench_fill_radii(sizeof *radii, radii, VALUES);
  for (int i = 0; i < VALUES; i++) {
    for (int k = 0; k < 4; k++) {
      random = random * 1664525u + 1013904223u;
      uniform[k] = (float)(random >> 8) * 0x1p-24f;
    }
    const float sigma_t = 0.1f + 9.9f * uniform[0], albedo = 0.3f + 0.7f * uniform[1];
    sigma_a[i] = sigma_t * (1 - albedo);
    sigma_s[i] = sigma_t * albedo;
    radii[i] = (0.01f + 15 * uniform[2]) / sigma_t;
    numbers[i] = 0.05f + 0.9f * uniform[3];
    lengths[i] = 1 / sigma_t;
    wide[0][i] = (double)sigma_a[i];
    wide[1][i] = (double)sigma_s[i];
    wide[2][i] = (double)radii[i];
  }
}

static void measure_preparation(double g) {
  double seconds[PREPARATIONS];
  for (int i = 0; i < PREPARATIONS; i++) {
    const uint64_t start = bench_now_ns();
    core_varying varying = prepare(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F32, g);
    seconds[i] = (double)(bench_now_ns() - start) * 1e-9;
    core_varying_free(&varying);
  }
  bench_figure(bench_median(seconds, PREPARATIONS), "s", "varying.surface.prepare.%g", g);
}

void bench_varying(void) {
  enum { LOOKUP, BETTER_1, BETTER, TRANSPORT, SAMPLE, INVERT, WIDE, GRADIENT, COUNT };
  static const char *const names[COUNT] = {
      [BETTER] = "better", [TRANSPORT] = "transport", [SAMPLE] = "sample",
      [INVERT] = "invert", [WIDE] = "transport.f64",  [GRADIENT] = "gradient"};
  bench_progress("varying");
  fill();
  core_profile table =
      bench_profile(core_isa_select(NULL), CORE_MODEL_TRANSPORT, CORE_EVALUATOR_LUT);
  core_profile better = bench_profile(core_isa_select(NULL), CORE_MODEL_BETTER, CORE_EVALUATOR_F32);
  core_varying dipole = prepare(CORE_MODEL_BETTER, CORE_EVALUATOR_F32, 0);
  core_varying surface = prepare(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F32, 0);
  core_varying surface_f64 = prepare(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, 0);
  bench_contender contenders[COUNT] = {
      [LOOKUP] = {run_one_medium, &table, 0}, [BETTER_1] = {run_one_medium, &better, 0},
      [BETTER] = {run_R, &dipole, 0},         [TRANSPORT] = {run_R, &surface, 0},
      [SAMPLE] = {run_sample, &surface, 0},   [INVERT] = {run_invert, &surface, 0},
      [WIDE] = {run_R_f64, &surface_f64, 0},  [GRADIENT] = {run_gradient, &surface_f64, 0}};
  bench_compare(contenders, COUNT);
  for (int i = BETTER; i < COUNT; i++) {
    bench_figure(VALUES / contenders[i].ns * 1e9, "values/s", "varying.%s", names[i]);
  }
  bench_figure(contenders[BETTER].ns / contenders[BETTER_1].ns, "times", "ratio.varying.better");
  for (int i = TRANSPORT; i <= INVERT; i++) {
    bench_figure(contenders[i].ns / contenders[LOOKUP].ns, "times", "ratio.varying.%s", names[i]);
  }
  measure_preparation(0);
  measure_preparation(0.8);
  core_profile_free(&table);
  core_profile_free(&better);
  core_varying_free(&dipole);
  core_varying_free(&surface);
  core_varying_free(&surface_f64);
}
