/* kernel: holds the functions and macros that kernels are written with. Each file of core/models is
 * compiled once for each instruction set (CORE_ISA) and precision (CORE_REAL, 32 or 64); `real` is
 * its number type.
 *
 * All functions are elementwise and branch-free, so that compilers vectorize them. They use IEEE
 * operations and explicit fused multiply-adds only, so that all instruction sets give the same
 * bits. Setup code that needs the same functions defines CORE_REAL as 64 and includes this file.
 */
#ifndef DIPOLED_CORE_KERNEL_H
#define DIPOLED_CORE_KERNEL_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#if CORE_REAL == 64
typedef double real;
typedef uint64_t real_bits;
#define REAL(x) x
#define real_fma fma
#define real_sqrt sqrt
#define REAL_MANTISSA_BITS 52
#define REAL_EXPONENT_BIAS 1023
#define REAL_ROUND_MAGIC 0x1.8p52
#define REAL_LN2_HI 0x1.62e42fefa39efp-1
#define REAL_LN2_LO 0x1.abc9e3b39803fp-56
#define REAL_HALF_EPSILON 0x1p-53
#define REAL_BELOW_1 0x1.fffffffffffffp-1 /* the largest number below 1 */
#define REAL_SQRT_HALF_BITS UINT64_C(0x3fe6a09e667f3bcd)
#define REAL_ONE_BITS UINT64_C(0x3ff0000000000000)
/* real_exp() raises x to at least this: e^x is then still a normal number, yet 1 + e^x rounds to 1.
 */
#define REAL_EXP_MIN (-700.0)
#elif CORE_REAL == 32
typedef float real;
typedef uint32_t real_bits;
#define REAL(x) x##f
#define real_fma fmaf
#define real_sqrt sqrtf
#define REAL_MANTISSA_BITS 23
#define REAL_EXPONENT_BIAS 127
#define REAL_ROUND_MAGIC 0x1.8p23f
#define REAL_LN2_HI 0x1.62e430p-1f
#define REAL_LN2_LO (-0x1.05c610p-29f)
#define REAL_HALF_EPSILON 0x1p-24f
#define REAL_BELOW_1 0x1.fffffep-1f
#define REAL_SQRT_HALF_BITS UINT32_C(0x3f3504f3)
#define REAL_ONE_BITS UINT32_C(0x3f800000)
#define REAL_EXP_MIN (-86.0f)
#else
#error "CORE_REAL is 32 or 64"
#endif

static inline real real_min(real a, real b) {
  return a < b ? a : b;
}
static inline real real_max(real a, real b) {
  return a > b ? a : b;
}

static inline real_bits real_to_bits(real x) {
  real_bits bits;
  memcpy(&bits, &x, sizeof bits);
  return bits;
}

static inline real real_from_bits(real_bits bits) {
  real x;
  memcpy(&x, &bits, sizeof x);
  return x;
}

/* Returns the one nearer to 0 of two numbers with the same sign. A minimum of integers does it in
 * one instruction; compilers need two for a minimum of floating-point numbers. */
static inline real real_nearer_zero(real a, real b) {
  const real_bits a_bits = real_to_bits(a);
  const real_bits b_bits = real_to_bits(b);
  return real_from_bits(a_bits < b_bits ? a_bits : b_bits);
}

/* Adding REAL_ROUND_MAGIC rounds a number to an integer k: the last bits of the sum are k. */

/* Returns 2^k for an integral k in the exponent range of normal numbers. */
static inline real real_power_of_two(real k) {
  return real_from_bits((real_to_bits(k + REAL_ROUND_MAGIC) + REAL_EXPONENT_BIAS)
                        << REAL_MANTISSA_BITS);
}

/* Returns the largest integer up to x, which is from 0 to 2^31. */
static inline real real_floor(real x) {
  const real nearest = (x + REAL_ROUND_MAGIC) - REAL_ROUND_MAGIC;
  return nearest - (nearest > x ? 1 : 0);
}

/* Returns the integer x, from 0 to 2^31, as an index. */
static inline int64_t real_index(real x) {
  return (int64_t)(real_to_bits(x + REAL_ROUND_MAGIC) - real_to_bits(REAL_ROUND_MAGIC));
}

/* The parts of e^x = 2^k (1 + m), where reduced = x - k ln(2), |reduced| <= ln(2) / 2, and m =
 * e^reduced - 1 = reduced (1 + reduced quotient). */
typedef struct real_exp_parts {
  real shifted; /* k + REAL_ROUND_MAGIC */
  real k;
  real m;
  real reduced;
  real quotient;
} real_exp_parts;

/* The quotient (e^t - 1 - t) / t^2 is a polynomial that interpolates it at the Chebyshev points of
 * the reduced range; its error relative to m is below 4e-17 in double and 2.3e-8 in single
 * precision. Even and odd powers are summed separately, because two short chains keep the pipelines
 * busier than one long one. */
static inline real_exp_parts real_exp_split(real x) {
  real_exp_parts parts;
  parts.shifted = real_fma(x, REAL(1.44269504088896340736), REAL_ROUND_MAGIC);
  parts.k = parts.shifted - REAL_ROUND_MAGIC;
  const real t = real_fma(-parts.k, REAL_LN2_LO, real_fma(-parts.k, REAL_LN2_HI, x));
  const real t2 = t * t;
#if CORE_REAL == 64
  real even = real_fma(0x1.289185613a3d6p-22, t2, 0x1.a019b90d2ae7ap-16);
  real odd = real_fma(0x1.af38a9b0ec855p-26, t2, 0x1.71de0dae63bb3p-19);
  even = real_fma(even, t2, 0x1.6c16c1788bd90p-10);
  odd = real_fma(odd, t2, 0x1.a01a01a7c41d5p-13);
  even = real_fma(even, t2, 0x1.5555555553d63p-5);
  odd = real_fma(odd, t2, 0x1.11111111109b3p-7);
  even = real_fma(even, t2, 0x1.0000000000001p-1);
  odd = real_fma(odd, t2, 0x1.5555555555556p-3);
  const real q = real_fma(odd, t, even);
#else
  const real q01 = real_fma(0x1.5554dcp-3f, t, 0.5f);
  const real q23 = real_fma(0x1.120b6ep-7f, t, 0x1.55551ap-5f);
  const real q = real_fma(real_fma(0x1.6d110ap-10f, t2, q23), t2, q01);
#endif
  parts.reduced = t;
  parts.quotient = q;
  parts.m = real_fma(t2, q, t);
  return parts;
}

/* Returns v e^x 2^exponent with gradual underflow. The power of two is applied last and in two
 * factors, so that neither e^x alone nor a factor of it leaves the normal range. x <= 0. The
 * exponent is integral, 2^exponent lies within the square of the normal range, and v e^x 2^exponent
 * is finite. x is raised to a limit at which the result has already underflowed to 0. The error is
 * that of v plus 1 ulp. */
static inline real real_times_exp(real v, real x, real exponent) {
#if CORE_REAL == 64
  /* Computes 2^800 times the power, so that it is a normal number, and removes this factor at the
   * end. */
  const real least_x = (2 - REAL_EXPONENT_BIAS - 800 - exponent) * 0.69314718055994530942;
  const real_exp_parts parts = real_exp_split(real_nearer_zero(x, least_x));
  const real biased = parts.shifted + (exponent + REAL_EXPONENT_BIAS + 800);
  const real power = real_from_bits(real_to_bits(biased) << REAL_MANTISSA_BITS);
  return real_fma(v, parts.m, v) * power * 0x1p-800;
#else
  const real least_x = (3 - 2 * REAL_EXPONENT_BIAS - exponent) * 0.69314718f;
  const real_exp_parts parts = real_exp_split(real_nearer_zero(x, least_x));
  const real biased = parts.shifted + (exponent + 2 * REAL_EXPONENT_BIAS);
  /* The last bits are the biased power; the shifts to the left drop all other bits. */
  const real_bits both = real_to_bits(biased);
  const real_bits half = both >> 1;
  return real_fma(v, parts.m, v) * real_from_bits(half << REAL_MANTISSA_BITS) *
         real_from_bits((both - half) << REAL_MANTISSA_BITS);
#endif
}

/* For finite x <= 0: e^x (which stays in the normal range), 1 - e^x, and the quotient (1 - e^x) /
 * -x, which is 1 at x = 0. The error is 1 ulp, or 1.5 ulp for the quotient. The compiler removes
 * values that the caller does not use. */
typedef struct real_exp_values {
  real exp;
  real one_minus_exp;
  real quotient;
} real_exp_values;

static inline real_exp_values real_exp(real x) {
  const real bounded = real_nearer_zero(x, REAL_EXP_MIN);
  const real_exp_parts parts = real_exp_split(bounded);
  const real power =
      real_from_bits((real_to_bits(parts.shifted) + REAL_EXPONENT_BIAS) << REAL_MANTISSA_BITS);
  real_exp_values values;
  values.exp = real_fma(power, parts.m, power);
  values.one_minus_exp = real_fma(-power, parts.m, 1 - power);
  const int reduced_only = parts.k == 0;
  const real divisor = reduced_only ? REAL(1.0) : -x;
  const real near_zero = real_fma(parts.reduced, parts.quotient, REAL(1.0));
  values.quotient = reduced_only ? near_zero : values.one_minus_exp / divisor;
  return values;
}

/* Returns e^x for x of either sign; neither e^x nor e^-x may overflow. */
static inline real real_exp_signed(real x) {
  const real e = real_exp(x < 0 ? x : -x).exp;
  return x > 0 ? 1 / e : e;
}

/* Returns ln(x 2^exponent) for a positive, normal x and an integral exponent. With x = 2^k m, and m
 * from 1 / sqrt(2) to sqrt(2), ln(m) is 2 artanh(s) for s = (m - 1) / (m + 1). The first neglected
 * term of the series, relative to ln(m), is below 1e-17 in double and 4e-9 in single precision. The
 * error is 2 ulp of the largest of |ln(x 2^exponent)|, |exponent| and 1. */
static inline real real_log(real x, real exponent) {
  const real_bits bits = real_to_bits(x);
  const real_bits biased = (bits + (REAL_ONE_BITS - REAL_SQRT_HALF_BITS)) >> REAL_MANTISSA_BITS;
  const real mantissa =
      real_from_bits(bits - ((biased - REAL_EXPONENT_BIAS) << REAL_MANTISSA_BITS));
  const real shifted = real_from_bits(real_to_bits(REAL_ROUND_MAGIC) + biased);
  const real k = (shifted - REAL_ROUND_MAGIC) + (exponent - REAL_EXPONENT_BIAS);
  const real s = (mantissa - 1) / (mantissa + 1);
  const real t = s * s;
#if CORE_REAL == 64
  real series = 1.0 / 21;
  series = real_fma(series, t, 1.0 / 19);
  series = real_fma(series, t, 1.0 / 17);
  series = real_fma(series, t, 1.0 / 15);
  series = real_fma(series, t, 1.0 / 13);
  series = real_fma(series, t, 1.0 / 11);
#else
  real series = 1.0f / 11;
#endif
  series = real_fma(series, t, REAL(1.0) / 9);
  series = real_fma(series, t, REAL(1.0) / 7);
  series = real_fma(series, t, REAL(1.0) / 5);
  series = real_fma(series, t, REAL(1.0) / 3);
  const real twice_s = s + s;
  const real logarithm = real_fma(twice_s * t, series, twice_s);
  return real_fma(k, REAL_LN2_HI, real_fma(k, REAL_LN2_LO, logarithm));
}

/* ---- a family's table of kernels ------------------------------------------------------------- */

#ifdef CORE_ISA

#include "core/kernels.h"

#define CORE_PASTE5_(a, b, c, d, e) a##b##c##d##e
#define CORE_PASTE5(a, b, c, d, e) CORE_PASTE5_(a, b, c, d, e)

/* How many numbers a vector holds; 1 where loops with an fma are not vectorized. Kernels take whole
 * vectors (core/kernels.h), so that the compiler makes no second loop for the rest. */
#if defined(__AVX512F__)
#define CORE_LANES (64 / sizeof(real))
#elif defined(__AVX2__)
#define CORE_LANES (32 / sizeof(real))
#elif defined(__aarch64__)
#define CORE_LANES (16 / sizeof(real))
#else
#define CORE_LANES 1
#endif
_Static_assert(CORE_LANES <= CORE_LANES_MOST, "core_run_f64() and others have room for a vector");
/* n, which is a multiple of CORE_LANES, in a form from which compilers see it */
#define CORE_WHOLE(n) ((n) / CORE_LANES * CORE_LANES)

/* CORE_FOR_LANES(i, n) is a loop over n numbers, i from 0 on, a vector at a time. */
#define CORE_FOR_LANES(i, n)                                                                       \
  for (size_t i##_done = 0; i##_done < (n); i##_done += CORE_LANES)                                \
    for (size_t i = i##_done, i##_lane = 0; i##_lane < CORE_LANES; i##_lane++, i++)

/* CORE_KERNEL_TABLE(family, ...) defines the table of kernels, the only symbol that the object
 * exports. */
#define CORE_KERNEL_TABLE(family, ...)                                                             \
  extern const CORE_PASTE2(core_kernels_f, CORE_REAL)                                              \
      CORE_PASTE5(core_kernels_, family, _, CORE_ISA, CORE_PASTE2(_f, CORE_REAL));                 \
  const CORE_PASTE2(core_kernels_f, CORE_REAL)                                                     \
      CORE_PASTE5(core_kernels_, family, _, CORE_ISA,                                              \
                  CORE_PASTE2(_f, CORE_REAL)) = {.lanes = CORE_LANES, __VA_ARGS__}

/* The member of the table for a family with kernels eval_R, eval_cdf, eval_slope and eval_ln_R. */
#define CORE_KERNELS_OF_ALL                                                                        \
  .evaluate = {[CORE_ELEMENTWISE_R] = eval_R,                                                      \
               [CORE_ELEMENTWISE_CDF] = eval_cdf,                                                  \
               [CORE_ELEMENTWISE_SLOPE] = eval_slope,                                              \
               [CORE_ELEMENTWISE_LN_R] = eval_ln_R}

/* Defines an empty single precision table for a family whose single precision values are its double
 * precision ones, rounded. The file is compiled for both but has kernels only where CORE_REAL is
 * 64. */
#define CORE_KERNEL_TABLE_NONE(family)                                                             \
  extern const core_kernels_f32 CORE_PASTE5(core_kernels_, family, _, CORE_ISA, _f32);             \
  const core_kernels_f32 CORE_PASTE5(core_kernels_, family, _, CORE_ISA, _f32) = {.sample = NULL}

/* CORE_KERNEL(name, element) defines a kernel that applies element(coefficients, x) to every
 * number. */
#define CORE_KERNEL(name, element)                                                                 \
  static void name(const real *restrict coefficients, size_t n, const real *restrict in,           \
                   real *restrict out) {                                                           \
    CORE_FOR_LANES(i, n) {                                                                         \
      out[i] = element(coefficients, in[i]);                                                       \
    }                                                                                              \
  }

#endif
#endif
