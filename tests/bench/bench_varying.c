/* Measures kernels where every value has a medium of its own, in single precision by the best
 * instruction set, in turn and in the same run: 4096 random media, radii, colours and numbers u.
 *
 *   varying.better, varying.transport, varying.sample, varying.invert, varying.bicubic     values/s
 *   varying.transport.f64, varying.gradient    values/s: R, and ln R with derivatives, of transport
 *   ratio.varying.better       time of a value of the better dipole over that of one medium's kernel
 *   ratio.varying.transport    time of a value of transport over a lookup in one medium's table
 *   ratio.varying.sample       the same for a sampled radius
 *   ratio.varying.invert       the same for a medium from a colour
 *   ratio.varying.bicubic      how many times longer a bicubic interpolation takes than a value of
 *                              transport, in a table of 100 x 64 nodes that a binary search finds
 *   varying.surface.prepare.<g>   s, to make a surface of the default tolerance
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/varying.h"
#include "tests/bench/bench.h"

enum { VALUES = 4096, ALBEDOS = 100, RADII = 64, PREPARATIONS = 5 };

#define ETA 1.4

static _Alignas(BENCH_ALIGNMENT) float sigma_a[VALUES], sigma_s[VALUES], radii[VALUES];
static _Alignas(BENCH_ALIGNMENT) float numbers[VALUES], lengths[VALUES], values[VALUES];
static _Alignas(BENCH_ALIGNMENT) float found_a[VALUES], found_s[VALUES];
static _Alignas(BENCH_ALIGNMENT) double wide[3][VALUES], wide_out[3][VALUES];
static uint8_t status[VALUES];

/* ---- the plain interpolation ------------------------------------------------------------------ */

/* A table of R sigma_t'^-2 over albedo and radius in mean free paths, as renderers hold it. */
static struct {
  float albedo[ALBEDOS];
  float radius[RADII];
  float value[ALBEDOS][RADII];
} plain;

static void make_plain(const core_varying *varying) {
  for (int i = 0; i < ALBEDOS; i++) {
    plain.albedo[i] = (float)(0.02 + 0.98 * (1 - exp(-8.0 * i / (ALBEDOS - 1))) / (1 - exp(-8.0)));
  }
  for (int i = 0; i < RADII; i++) {
    plain.radius[i] = i == 0 ? 0 : (float)(0.0025 * pow(1.2, i - 1));
  }
  for (int i = 0; i < ALBEDOS; i++) {
    for (int k = 0; k < RADII; k++) {
      const float a = 1 - plain.albedo[i], s = plain.albedo[i];
      const float r = k == 0 ? 0.00125f : plain.radius[k];
      core_varying_eval_f32(varying, CORE_QUANTITY_R, 1, &a, &s, &r, &plain.value[i][k]);
    }
  }
}

/* Finds the interval of x by binary search and sets the weights of the four nodes around it, of the
 * cubic whose slopes are differences of the neighbours (Catmull, Rom 1974). Returns the first of the
 * four nodes, which may be -1, or -2 if x is outside. */
static int spline_weights(const float *nodes, int count, float x, float weights[4]) {
  if (!(x >= nodes[0] && x <= nodes[count - 1])) {
    return -2;
  }
  int low = 0, size = count - 1;
  while (size > 1) {
    const int half = size / 2;
    if (nodes[low + half] <= x) {
      low += half;
      size -= half;
    } else {
      size = half;
    }
  }
  const float x0 = nodes[low], x1 = nodes[low + 1];
  const float t = (x - x0) / (x1 - x0), t2 = t * t, t3 = t2 * t;
  weights[1] = 2 * t3 - 3 * t2 + 1;
  weights[2] = -2 * t3 + 3 * t2;
  const float begin = t3 - 2 * t2 + t, end = t3 - t2;
  if (low > 0) {
    const float weight = begin * (x1 - x0) / (x1 - nodes[low - 1]);
    weights[0] = -weight;
    weights[2] += weight;
  } else {
    weights[0] = 0;
    weights[1] -= begin;
    weights[2] += begin;
  }
  if (low + 2 < count) {
    const float weight = end * (x1 - x0) / (nodes[low + 2] - x0);
    weights[1] -= weight;
    weights[3] = weight;
  } else {
    weights[1] -= end;
    weights[2] += end;
    weights[3] = 0;
  }
  return low - 1;
}

static float interpolate(float a, float s, float r) {
  const float sigma_t = a + s;
  float of_albedo[4], of_radius[4];
  const int row = spline_weights(plain.albedo, ALBEDOS, s / sigma_t, of_albedo);
  const int column = spline_weights(plain.radius, RADII, r * sigma_t, of_radius);
  float sum = 0;
  for (int i = 0; row > -2 && column > -2 && i < 4; i++) {
    for (int k = 0; k < 4; k++) {
      const float weight = of_albedo[i] * of_radius[k];
      if (weight != 0) {
        sum += weight * plain.value[row + i][column + k];
      }
    }
  }
  return sum * sigma_t * sigma_t;
}

/* ---- what is run ----------------------------------------------------------------------------- */

static void run_one_medium(const void *context) {
  core_eval_f32(context, CORE_QUANTITY_R, VALUES, radii, values);
}

static void run_R(const void *context) {
  core_varying_eval_f32(context, CORE_QUANTITY_R, VALUES, sigma_a, sigma_s, radii, values);
}

static void run_R_f64(const void *context) {
  core_varying_eval_f64(context, CORE_QUANTITY_R, VALUES, wide[0], wide[1], wide[2], wide_out[0]);
}

static void run_gradient(const void *context) {
  const core_gradient out = {wide_out[0], wide_out[1], wide_out[2]};
  core_varying_gradient_f64(context, VALUES, wide[0], wide[1], wide[2], &out);
}

static void run_sample(const void *context) {
  core_varying_sample_f32(context, VALUES, sigma_a, sigma_s, numbers, values);
}

static void run_invert(const void *context) {
  const core_colour what = {CORE_LIGHT_BEAM, false, CORE_LENGTH_FREE_PATH};
  core_varying_invert_f32(context, &what, VALUES, numbers, lengths, found_a, found_s, values,
                          status);
}

static void run_bicubic(const void *context) {
  (void)context;
  for (int i = 0; i < VALUES; i++) {
    values[i] = interpolate(sigma_a[i], sigma_s[i], radii[i]);
  }
}

static core_varying prepare(unsigned model, unsigned evaluator, double g) {
  core_varying varying;
  if (core_varying_prepare(&varying, core_isa_select(NULL), model, CORE_MOMENTS_EXACT, evaluator, g,
                           ETA, NULL)
          .field != NULL) {
    bench_fail("media that vary were refused");
  }
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
  enum { LOOKUP, BETTER_1, BETTER, TRANSPORT, SAMPLE, INVERT, BICUBIC, WIDE, GRADIENT, COUNT };
  static const char *const names[COUNT] = {
      [BETTER] = "better",   [TRANSPORT] = "transport", [SAMPLE] = "sample",    [INVERT] = "invert",
      [BICUBIC] = "bicubic", [WIDE] = "transport.f64",  [GRADIENT] = "gradient"};
  bench_progress("varying");
  fill();
  core_profile table =
      bench_profile(core_isa_select(NULL), CORE_MODEL_TRANSPORT, CORE_EVALUATOR_LUT);
  core_profile better = bench_profile(core_isa_select(NULL), CORE_MODEL_BETTER, CORE_EVALUATOR_F32);
  core_varying dipole = prepare(CORE_MODEL_BETTER, CORE_EVALUATOR_F32, 0);
  core_varying surface = prepare(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F32, 0);
  core_varying surface_f64 = prepare(CORE_MODEL_TRANSPORT, CORE_EVALUATOR_F64, 0);
  make_plain(&surface);
  bench_contender contenders[COUNT] = {[LOOKUP] = {run_one_medium, &table, 0},
                                       [BETTER_1] = {run_one_medium, &better, 0},
                                       [BETTER] = {run_R, &dipole, 0},
                                       [TRANSPORT] = {run_R, &surface, 0},
                                       [SAMPLE] = {run_sample, &surface, 0},
                                       [INVERT] = {run_invert, &surface, 0},
                                       [BICUBIC] = {run_bicubic, NULL, 0},
                                       [WIDE] = {run_R_f64, &surface_f64, 0},
                                       [GRADIENT] = {run_gradient, &surface_f64, 0}};
  bench_compare(contenders, COUNT);
  for (int i = BETTER; i < COUNT; i++) {
    bench_figure(VALUES / contenders[i].ns * 1e9, "values/s", "varying.%s", names[i]);
  }
  bench_figure(contenders[BETTER].ns / contenders[BETTER_1].ns, "times", "ratio.varying.better");
  for (int i = TRANSPORT; i <= INVERT; i++) {
    bench_figure(contenders[i].ns / contenders[LOOKUP].ns, "times", "ratio.varying.%s", names[i]);
  }
  bench_figure(contenders[BICUBIC].ns / contenders[TRANSPORT].ns, "times", "ratio.varying.bicubic");
  measure_preparation(0);
  measure_preparation(0.8);
  core_profile_free(&table);
  core_profile_free(&better);
  core_varying_free(&dipole);
  core_varying_free(&surface);
  core_varying_free(&surface_f64);
}
