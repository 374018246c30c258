/* Sums of Gaussians: the kernels of every model that is such a sum, and the published skin.
 *
 *   R(r) = sum w_i e^(-b_i r^2),  w_i >= 0
 *   energy within r = sum pi w_i / b_i (1 - e^(-b_i r^2))
 *
 * Domain: radii from 0 to infinity. For a model that diverges like 1 / r at the source, the sum
 * holds from a least radius on, and below that radius R is continued in proportion to 1 / r.
 * core/models/gaussians.h says how the sum is continued at the other ends.
 *
 * Error: 16 epsilon plus 2 epsilon b r^2 with the smallest b, in addition to the error of the
 * weights.
 *
 * Skin: d'Eon, Luebke 2007, "Advanced techniques for realistic real-time skin rendering" (GPU Gems
 * 3, chapter 14): six Gaussians w e^(-r^2 / (2 v)) / (2 pi v) with given variances v, fitted to a
 * three-layer model. The variants 0, 1 and 2 are red, green and blue. The medium does not matter.
 */
#include "core/models/gaussians.h"

#ifdef CORE_ISA

#include "core/kernel.h"

#if CORE_REAL == 64

#include "core/models/blocks.h"

static inline size_t term_count(const double *c) {
  return (size_t)c[GAUSSIANS_COUNT];
}

static inline double term(const double *c, size_t k, int field) {
  return c[GAUSSIANS_TERMS + k * GAUSSIANS_FIELDS + (size_t)field];
}

/* Returns r kept between the least and the largest radius, and at most 1e150, where r^2 does not
 * overflow but every Gaussian has underflowed. */
static inline double radius_in_range(const double *c, double r) {
  return real_min(real_min(real_max(r, c[GAUSSIANS_LEAST_MM]), c[GAUSSIANS_MOST_MM]), 1e150);
}

static inline double R_term(const double *c, size_t k, double x) {
  return term(c, k, GAUSSIANS_WEIGHT) * real_exp(-(x * x) * term(c, k, GAUSSIANS_FASTER)).exp;
}

static inline double slope_term(const double *c, size_t k, double x) {
  const double rate = c[GAUSSIANS_SLOWEST] + term(c, k, GAUSSIANS_FASTER);
  return rate * R_term(c, k, x);
}

static inline double energy_term(const double *c, size_t k, double x) {
  const double rate = c[GAUSSIANS_SLOWEST] + term(c, k, GAUSSIANS_FASTER);
  const double least = c[GAUSSIANS_LEAST_MM];
  const double squares = (x - least) * (x + least);
  return term(c, k, GAUSSIANS_SHARE) * real_exp(-rate * squares).one_minus_exp;
}

BLOCK_SUM(sum_R, term_count, R_term)
BLOCK_SUM(sum_slope, term_count, slope_term)
BLOCK_SUM(sum_energy, term_count, energy_term)

static inline double exponent_of(const double *c, double x) {
  return real_fma(x * x, c[GAUSSIANS_SLOWEST], c[GAUSSIANS_SHIFT]);
}

/* Returns sum times e^(-shift) and times the slowest Gaussian, which is a factor of every term. */
static inline double shared(const double *c, double x, double sum) {
  return real_times_exp(sum, -exponent_of(c, x), 0);
}

/* Returns 2^64 x e^(-exponent) sum; the factor 2^64 prevents e^(-exponent) sum from underflowing
 * before the product. */
static inline double times_radius(double x, double sum, double exponent) {
  return x * real_times_exp(sum, -exponent, 64);
}

/* Returns x / r, which is less than 1 if r lies beyond the largest radius, else 1. */
static inline double beyond(double r, double x) {
  return r > x ? x / r : 1;
}

static inline double finish_R(const double *c, double r, double x, double sum) {
  const double R = shared(c, x, sum);
  const double far = beyond(r, x);
  return R > 0 ? R * (r < x ? x / r : 1) * (far * far * far) : 0;
}

static inline double finish_slope(const double *c, double r, double x, double sum) {
  const double far = beyond(r, x);
  /* The factor 2^64 of times_radius() must not make a sum overflow: the largest sums, next to the
   * source, are made smaller before. */
  const bool large = sum > 0x1p100;
  const double falling = 2 * times_radius(x, large ? sum * 0x1p-160 : sum, exponent_of(c, x));
  return -falling * (far * far) * (far * far) * (large ? 0x1p96 : 0x1p-64);
}

static inline double finish_ln_R(const double *c, double r, double x, double sum) {
  const double ln_R = real_log(real_max(sum, 1e-300), 0) - exponent_of(c, x);
  const double nearer = r < x ? real_log(x / real_max(r, 1e-300), 0) : 0;
  const double further = r > x ? 3 * real_log(real_min(r, 1e300) / x, 0) : 0;
  const double bounded = x < 1e150 && r < 1e300 ? ln_R + nearer - further : -(double)INFINITY;
  const double limited = r > 0 || c[GAUSSIANS_LEAST_MM] <= 0 ? bounded : (double)INFINITY;
  return sum > 0 ? limited : -(double)INFINITY;
}

static inline double finish_cdf(const double *c, double r, double x, double sum) {
  const double inside = c[GAUSSIANS_LEAST_CDF] * (r < x ? r / x : 1);
  /* from here on 1 - cdf is less than a rounding error */
  const bool whole = x * x * c[GAUSSIANS_SLOWEST] > 40;
  const double less = c[GAUSSIANS_LIMIT] > 0 ? real_min(inside + sum, REAL_BELOW_1) : 0;
  /* where R falls like 1 / r^3 the energy beyond r falls like 1 / r */
  const double further = 1 - (1 - less) * beyond(r, x);
  return whole || !(c[GAUSSIANS_LIMIT] > 0) ? c[GAUSSIANS_LIMIT] : r > x ? further : less;
}

/* Returns dR/dr below the least radius, where R is in proportion to 1 / r: -R / r. */
static inline double finish_steep(const double *c, double r, double x, double sum) {
  const double R = finish_R(c, r, x, sum);
  return R > 0 ? -R / r : 0;
}

BLOCK_KERNEL(eval_R, radius_in_range, sum_R, finish_R)
BLOCK_KERNEL(eval_ln_sum, radius_in_range, sum_R, finish_ln_R)
BLOCK_KERNEL(eval_cdf, radius_in_range, sum_energy, finish_cdf)
BLOCK_KERNEL(eval_sum_slope, radius_in_range, sum_slope, finish_slope)
BLOCK_KERNEL(eval_steep, radius_in_range, sum_R, finish_steep)

static void eval_ln_R(const double *restrict c, size_t n, const double *restrict r,
                      double *restrict out) {
  eval_ln_sum(c, n, r, out);
  for (size_t i = 0; i < n; i++) {
    if (r[i] > c[GAUSSIANS_FAR_MM]) {
      out[i] = core_cloud_ln_R(&c[GAUSSIANS_FAR], r[i]);
    }
  }
}

static void eval_slope(const double *restrict c, size_t n, const double *restrict r,
                       double *restrict out) {
  double steep[BLOCK_LANES];
  eval_sum_slope(c, n, r, out);
  for (size_t done = 0; c[GAUSSIANS_LEAST_MM] > 0 && done < n; done += BLOCK_LANES) {
    const size_t count = CORE_WHOLE(n - done < BLOCK_LANES ? n - done : BLOCK_LANES);
    eval_steep(c, count, r + done, steep);
    for (size_t i = 0; i < count; i++) {
      const bool below = r[done + i] < c[GAUSSIANS_LEAST_MM] && c[GAUSSIANS_LIMIT] > 0;
      out[done + i] = below ? steep[i] : out[done + i];
    }
  }
}

CORE_KERNEL_TABLE(gaussians, CORE_KERNELS_OF_ALL);

#else
CORE_KERNEL_TABLE_NONE(gaussians);
#endif

#else /* what follows prepares a profile, and is compiled once for all instruction sets */

#include <stdlib.h>
#include <string.h>

#define CORE_REAL 64
#include "core/kernel.h"

/* The cost of one term in kernel evaluations of a dipole, measured with `build/bench kernel`. */
#define COST_PER_TERM 0.25

/* A sum with a smaller energy than this is taken as 0. */
#define ALBEDO_LEAST 1e-250

/* Returns the smallest rate of the Gaussians with a positive weight. */
static double slowest_of(const core_gaussian *gaussians, size_t count) {
  double slowest = (double)INFINITY;
  for (size_t i = 0; i < count; i++) {
    slowest = gaussians[i].weight > 0 ? fmin(slowest, gaussians[i].rate) : slowest;
  }
  return slowest < (double)INFINITY ? slowest : gaussians[0].rate;
}

/* Returns the energy beyond the least radius: that of the Gaussians up to the largest radius, plus
 * 2 pi R r^2 there, the energy of a tail that falls like 1 / r^3. */
static double energy_with_tail(const core_gaussian *gaussians, size_t count,
                               const core_gaussian_ends *ends) {
  const double pi = 3.14159265358979323846;
  const double least = ends->least_mm, most = ends->most_mm;
  double energy = 0;
  for (size_t i = 0; i < count; i++) {
    const double rate = gaussians[i].rate;
    const double left = gaussians[i].weight * real_exp(-rate * least * least).exp;
    const double at_most = gaussians[i].weight * real_exp(-rate * most * most).exp;
    const double within = real_exp(-rate * (most - least) * (most + least)).one_minus_exp;
    energy += pi * left / rate * within + 2 * pi * at_most * (most * most);
  }
  return energy;
}

core_fault core_gaussians_table(const core_gaussian *gaussians, size_t count,
                                const core_gaussian_ends *ends, core_preparation *preparation) {
  static const core_gaussian_ends none = {.most_mm = (double)INFINITY, .far_mm = (double)INFINITY};
  const core_gaussian_ends *given = ends != NULL ? ends : &none;
  const double least_mm = given->least_mm;
  const double pi = 3.14159265358979323846;
  preparation->table_bytes = (GAUSSIANS_TERMS + count * GAUSSIANS_FIELDS) * sizeof(double);
  double *c = malloc(preparation->table_bytes);
  if (c == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  const double slowest = slowest_of(gaussians, count);
  double at_least = 0; /* R at the least radius */
  /* energy beyond the least radius; at_least and energy are multiplied by e^shift */
  double energy = 0;
  for (size_t i = 0; i < count; i++) {
    double *to = &c[GAUSSIANS_TERMS + i * GAUSSIANS_FIELDS];
    const double left =
        gaussians[i].weight * real_exp(-gaussians[i].rate * least_mm * least_mm).exp;
    to[GAUSSIANS_WEIGHT] = gaussians[i].weight;
    to[GAUSSIANS_FASTER] = fmax(gaussians[i].rate - slowest, 0);
    to[GAUSSIANS_SHARE] = pi * left / gaussians[i].rate;
    at_least += left;
    energy += to[GAUSSIANS_SHARE];
  }
  const double near_energy = 2 * pi * least_mm * least_mm * at_least;
  const double whole =
      near_energy +
      (given->most_mm < (double)INFINITY ? energy_with_tail(gaussians, count, given) : energy);
  const double albedo = real_times_exp(whole, -given->shift, 0);
  const bool shines = whole >= ALBEDO_LEAST;
  const bool scatters = shines && albedo > 0; /* if false, the shares of the terms are unknown */
  const double per_whole = scatters ? 1 / whole : 0;
  for (size_t i = 0; i < count; i++) {
    double *to = &c[GAUSSIANS_TERMS + i * GAUSSIANS_FIELDS];
    to[GAUSSIANS_WEIGHT] = shines ? to[GAUSSIANS_WEIGHT] : 0;
    to[GAUSSIANS_SHARE] *= per_whole;
  }
  c[GAUSSIANS_COUNT] = (double)count;
  c[GAUSSIANS_SLOWEST] = slowest;
  c[GAUSSIANS_SHIFT] = given->shift;
  c[GAUSSIANS_LEAST_MM] = least_mm;
  c[GAUSSIANS_LEAST_CDF] = near_energy * per_whole;
  c[GAUSSIANS_LIMIT] = scatters;
  c[GAUSSIANS_MOST_MM] = given->most_mm;
  c[GAUSSIANS_FAR_MM] = shines ? given->far_mm : (double)INFINITY;
  memcpy(&c[GAUSSIANS_FAR], given->far, sizeof given->far);
  preparation->table = c;
  preparation->albedo = scatters ? albedo : 0;
  preparation->cost = 1 + COST_PER_TERM * (double)count;
  preparation->error_epsilons = 16;
  /* Where R has not underflowed, slowest r^2 < 745, so slowest r^2 < r sqrt(745 slowest). */
  preparation->error_epsilons_per_mm = 2 * sqrt(745 * slowest);
  return (core_fault){0};
}

enum { SKIN_GAUSSIANS = 6 };

static const struct {
  double variance_mm2;
  double weight[3]; /* weights of the Gaussian for red, green and blue */
} skin[SKIN_GAUSSIANS] = {
    {0.0064, {0.233, 0.455, 0.649}}, {0.0484, {0.100, 0.336, 0.344}}, {0.187, {0.118, 0.198, 0}},
    {0.567, {0.113, 0.007, 0.007}},  {1.99, {0.358, 0.004, 0}},       {7.41, {0.078, 0, 0}},
};

core_fault core_gaussians_check(const core_inputs *inputs, core_radii_range *radii) {
  (void)inputs;
  (void)radii;
  return (core_fault){0};
}

core_fault core_gaussians_prepare(const core_inputs *inputs, core_preparation *preparation) {
  core_gaussian gaussians[SKIN_GAUSSIANS];
  for (int i = 0; i < SKIN_GAUSSIANS; i++) {
    const double twice = 2 * skin[i].variance_mm2;
    gaussians[i].weight = skin[i].weight[inputs->variant] / (3.14159265358979323846 * twice);
    gaussians[i].rate = 1 / twice;
  }
  preparation->notes = CORE_NOTE_MEDIUM_UNUSED;
  preparation->scale_mm = 0.5;
  return core_gaussians_table(gaussians, SKIN_GAUSSIANS, NULL, preparation);
}

#endif
