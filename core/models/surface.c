/* The kernels of a surface (core/varying/surface.h): `transport` where every value has a medium of
 * its own.
 *
 * Error: the one that was measured when the surface was made, and rounding, which is at most 8
 * epsilon (4 + k x).
 */
#ifdef CORE_ISA

#include "core/cells/find.h"
#include "core/models/lanes.h"

#if CORE_REAL == 64
#define EXP_LEAST (-1400.0)
#define EXP_LN2_HI 0x1.62e42feep-1
#define EXP_LN2_LO 0x1.a39ef35793c76p-33
enum { EXP_TERMS = 14 };
#else
#define EXP_LEAST (-174.0f)
#define EXP_LN2_HI 0x1.63p-1f
#define EXP_LN2_LO (-0x1.bd0106p-13f)
enum { EXP_TERMS = 8 };
#endif

/* Larger numbers of mean free paths are taken as this; R has underflowed there, or its surface ends
 * long before. */
#define X_MOST REAL(1e15)

/* Taylor coefficients 1 / k! of e^f, highest power first. */
static const real series[] = {
#if CORE_REAL == 64
    1 / 6227020800.0,
    1 / 479001600.0,
    1 / 39916800.0,
    1 / 3628800.0,
    1 / 362880.0,
    1 / 40320.0,
#endif
    REAL(1.0) / 5040,
    REAL(1.0) / 720,
    REAL(1.0) / 120,
    REAL(1.0) / 24,
    REAL(1.0) / 6,
    REAL(0.5),
    1,
    1};
_Static_assert(sizeof series / sizeof series[0] == EXP_TERMS, "as many as the precision needs");

/* Returns scale e^z with gradual underflow, in plain sums and products. */
static inline real times_exp(real scale, real z) {
  const real kept = real_max(z, EXP_LEAST);
  const real k = (kept * REAL(1.44269504088896340736) + REAL_ROUND_MAGIC) - REAL_ROUND_MAGIC;
  const real f = (kept - k * EXP_LN2_HI) - k * EXP_LN2_LO;
  real e = series[0];
  for (int i = 1; i < EXP_TERMS; i++) {
    e = series[i] + f * e;
  }
  /* 2^k as two factors, since 2^k alone may underflow */
  const real_bits both = real_to_bits(k + (2 * REAL_EXPONENT_BIAS + REAL_ROUND_MAGIC));
  const real_bits half = both >> 1;
  return scale * e * real_from_bits(half << REAL_MANTISSA_BITS) *
         real_from_bits((both - half) << REAL_MANTISSA_BITS);
}

/* A medium, and its place on the axis of albedos. */
struct row {
  struct lane lane;
  real s;
  real k;
  struct cells_place place;
};

static inline struct row row_of(const real *shared, const real *words, real sigma_a, real sigma_s) {
  struct row row;
  row.lane = lane_of(shared, sigma_a, sigma_s);
  row.s = real_sqrt(row.lane.absorbed);
  const real w = row.lane.scattered / (1 + row.s);
  const cells_integer by_w = row.s < REAL(0.5) ? 0 : 1;
  const cells_integer axis = CORE_SURFACE_S + by_w;
  row.place = cells_find(words, axis, cells_kept(words, axis, row.s < REAL(0.5) ? row.s : w));
  /* a product in place of a branch, so that the loop is vectorized */
  row.place.cell += by_w * cells_word(words, CORE_SURFACE_CELLS + CORE_SURFACE_S);
  real k = words[CORE_SURFACE_KAPPA + CORE_SURFACE_KAPPA_TERMS - 1];
  for (int i = CORE_SURFACE_KAPPA_TERMS - 2; i >= 0; i--) {
    k = words[CORE_SURFACE_KAPPA + i] + row.s * k;
  }
  row.k = row.s * k;
  return row;
}

/* Returns the position of a function's patch among the words. */
static inline cells_integer patch_at(const real *words, cells_integer function, cells_integer axis,
                                     cells_integer row, cells_integer column) {
  return cells_word(words, CORE_SURFACE_AT + function) +
         16 * (row * cells_word(words, CORE_SURFACE_CELLS + axis) + column);
}

/* Returns scale times x R / sigma_t'^2. */
static inline real x_R(const real *words, struct row row, real true_x, real scale) {
  const real x = real_min(true_x, X_MOST);
  const real kept = cells_kept(words, CORE_SURFACE_RADIUS, x);
  const struct cells_place place = cells_find(words, CORE_SURFACE_RADIUS, kept);
  const real Q = cells_patch(
      words, patch_at(words, CORE_SURFACE_Q, CORE_SURFACE_RADIUS, row.place.cell, place.cell),
      row.place.t, place.t);
  const real kx = row.k * x;
  /* Beyond the axis x R falls by another factor of 1 / x^2. */
  const real beyond = real_min(kept / x, 1);
  const real far = x > kept ? beyond * beyond : 1;
  return times_exp(scale * row.lane.scattered * (1 + kx) * far, Q - kx);
}

static inline real surface_R(const real *shared, const real *words, real sigma_a, real sigma_s,
                             real r) {
  const struct row row = row_of(shared, words, sigma_a, sigma_s);
  const real x = r * row.lane.sigma_t;
  const real R = x_R(words, row, x, row.lane.sigma_t * row.lane.sigma_t) / x;
  return ((row.lane.scattered > 0) & (r < (real)INFINITY)) ? R : 0;
}

static inline real surface_albedo(const real *shared, const real *words, real sigma_a, real sigma_s,
                                  real r) {
  (void)r;
  const struct row row = row_of(shared, words, sigma_a, sigma_s);
  const real total = cells_line(
      words, cells_word(words, CORE_SURFACE_AT + CORE_SURFACE_TOTAL) + 4 * row.place.cell,
      row.place.t);
  return row.lane.scattered > 0 ? total : 0;
}

static inline real surface_cdf(const real *shared, const real *words, real sigma_a, real sigma_s,
                               real r) {
  const struct row row = row_of(shared, words, sigma_a, sigma_s);
  const real x = r * row.lane.sigma_t;
  const real kept = cells_kept(words, CORE_SURFACE_RADIUS, x);
  const struct cells_place place = cells_find(words, CORE_SURFACE_RADIUS, kept);
  const real cdf = cells_patch(
      words, patch_at(words, CORE_SURFACE_CDF, CORE_SURFACE_RADIUS, row.place.cell, place.cell),
      row.place.t, place.t);
  const real bounded = real_min(cdf * real_min(x / kept, 1), REAL_BELOW_1);
  return row.lane.scattered > 0 ? (r < (real)INFINITY ? bounded : 1) : 0;
}

static inline real surface_radius(const real *shared, const real *words, real sigma_a, real sigma_s,
                                  real u) {
  const struct row row = row_of(shared, words, sigma_a, sigma_s);
  const int near = u <= REAL(0.5);
  const real wanted = near ? u : 1 - u;
  const cells_integer rest = near ? 0 : 1;
  const cells_integer axis = CORE_SURFACE_U + rest;
  const real kept = cells_kept(words, axis, wanted);
  const struct cells_place place = cells_find(words, axis, kept);
  const real x = cells_patch(
      words, patch_at(words, CORE_SURFACE_X_OF_U + rest, axis, row.place.cell, place.cell),
      row.place.t, place.t);
  const real below = near ? real_min(wanted / kept, 1) : 1;
  const real r = x * below * row.lane.mfp;
  return ((row.lane.scattered > 0) & (u > 0)) ? (u < 1 ? r : (real)INFINITY) : 0;
}

#define SURFACE_KERNEL(name, element, most)                                                        \
  static void name(const real *restrict shared, const real *restrict words, size_t n,              \
                   const real *restrict sigma_a, const real *restrict sigma_s,                     \
                   const real *restrict in, real *restrict out) {                                  \
    CORE_FOR_LANES(i, n) {                                                                         \
      const int good =                                                                             \
          lane_good(shared, sigma_a[i], sigma_s[i]) & (in[i] >= 0) & (in[i] <= (real)(most));      \
      const real value = element(shared, words, sigma_a[i], sigma_s[i], in[i] + 0);                \
      out[i] = good ? value : (real)NAN;                                                           \
    }                                                                                              \
  }

SURFACE_KERNEL(varying_R, surface_R, INFINITY)
SURFACE_KERNEL(varying_cdf, surface_cdf, INFINITY)
SURFACE_KERNEL(varying_albedo, surface_albedo, INFINITY)
SURFACE_KERNEL(varying_sample, surface_radius, 1)

#if CORE_REAL == 64

/* ln R and its derivatives. */
struct gradient {
  double ln_R;
  double by_sigma_a;
  double by_sigma_s;
};

/* With s^2 = sigma_a / sigma_t' = e and x = r sigma_t', the logarithm of sigma_a changes ln s by
 * a / 2, ln a by -e and ln x by e; that of sigma_s' changes ln s by -a / 2, ln a by e and ln x by
 * a.
 */
static inline struct gradient surface_gradient(const double *shared, const double *words,
                                               double sigma_a, double sigma_s, double r) {
  const struct row row = row_of(shared, words, sigma_a, sigma_s);
  const double a = row.lane.scattered, e = row.lane.absorbed;
  const double x = real_max(real_min(r * row.lane.sigma_t, X_MOST), 1e-300);
  const double kept = cells_kept(words, CORE_SURFACE_RADIUS, x);
  const struct cells_place place = cells_find(words, CORE_SURFACE_RADIUS, kept);
  const cells_integer at =
      patch_at(words, CORE_SURFACE_Q, CORE_SURFACE_RADIUS, row.place.cell, place.cell);
  const double p = row.place.t;
  const double Q = cells_patch(words, at, p, place.t);
  const double by_p =
      cells_line(words, at + 4, place.t) +
      p * (2 * cells_line(words, at + 8, place.t) + p * (3 * cells_line(words, at + 12, place.t)));
  const double by_t =
      cells_slope(words, at, place.t) +
      p * (cells_slope(words, at + 4, place.t) +
           p * (cells_slope(words, at + 8, place.t) + p * cells_slope(words, at + 12, place.t)));
  /* Outside the axis of radii, Q falls like 2 ln x at large x and is constant at small x. */
  const double by_ln_x = x > kept ? -2 : x < kept ? 0 : by_t * place.per_unit * x;
  /* for s of at least 0.5 the axis is that of w = 1 - s */
  const double s_sign = row.s < 0.5 ? 1 : -1;
  const double by_ln_s = by_p * row.place.per_unit * s_sign * row.s;
  double k_slope = 0; /* derivative of k by s */
  for (int i = CORE_SURFACE_KAPPA_TERMS - 1; i >= 0; i--) {
    k_slope = (i + 1) * words[CORE_SURFACE_KAPPA + i] + row.s * k_slope;
  }
  const double kx = row.k * x;
  const double by_kx = -kx / (1 + kx); /* k x times the derivative of ln(1 + k x) - k x by k x */
  const double beyond = x > kept ? 2 * (real_log(kept, 0) - real_log(x, 0)) : 0;
  const double ln_st = real_log(row.lane.sigma_t, 0);
  const double through_s = by_ln_s + by_kx * k_slope * row.s * x;
  const double through_x = by_ln_x + by_kx * kx - 1;
  return (struct gradient){
      .ln_R = 2 * ln_st + real_log(a, 0) + real_log(1 + kx, 0) - real_log(x, 0) + Q + beyond - kx,
      .by_sigma_a = 2 * e - e + 0.5 * a * through_s + e * through_x,
      .by_sigma_s = 2 * a + e - 0.5 * a * through_s + a * through_x,
  };
}

static void gradient(const double *restrict shared, const double *restrict words, size_t n,
                     const double *restrict sigma_a, const double *restrict sigma_s,
                     const double *restrict r, double *restrict ln_R, double *restrict by_sigma_a,
                     double *restrict by_sigma_s) {
  CORE_FOR_LANES(i, n) {
    const int good = lane_good(shared, sigma_a[i], sigma_s[i]) & (r[i] >= 0);
    const struct gradient found = surface_gradient(shared, words, sigma_a[i], sigma_s[i], r[i] + 0);
    const int some = good & (sigma_s[i] > 0);
    const double none = good ? -INFINITY : (double)NAN;
    ln_R[i] = some ? (r[i] > 0 ? (r[i] < INFINITY ? found.ln_R : -INFINITY) : INFINITY) : none;
    by_sigma_a[i] = some ? found.by_sigma_a : (double)NAN;
    by_sigma_s[i] = some ? found.by_sigma_s : (double)NAN;
  }
}

#endif

CORE_KERNEL_TABLE(surface,
#if CORE_REAL == 64
                  .varying_gradient = gradient,
#endif
                  .varying_sample = varying_sample, .varying_albedo = varying_albedo,
                  .varying = {
                      [CORE_ELEMENTWISE_R] = varying_R, [CORE_ELEMENTWISE_CDF] = varying_cdf});

#endif
