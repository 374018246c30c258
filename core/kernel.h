/* kernel: what kernels are written with. Each file of core/models is compiled once for each
 * instruction set (CORE_ISA) and precision (CORE_REAL, 32 or 64); `real` is its number type.
 *
 * Everything here is elementwise and branch-free, so that compilers vectorize it, and uses IEEE
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
/* Arguments below are as good as minus infinity for real_times_exp, for real_exp. */
#define REAL_HALF_EPSILON 0x1p-53
#define REAL_SQRT_HALF_BITS UINT64_C(0x3fe6a09e667f3bcd)
#define REAL_ONE_BITS UINT64_C(0x3ff0000000000000)
#define REAL_EXP_SCALED_MIN (-2000.0)
#define REAL_EXP_MIN (-700.0)
#define REAL_POWER_MIN (-2040.0)
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
#define REAL_SQRT_HALF_BITS UINT32_C(0x3f3504f3)
#define REAL_ONE_BITS UINT32_C(0x3f800000)
#define REAL_EXP_SCALED_MIN (-300.0f)
#define REAL_EXP_MIN (-86.0f)
#define REAL_POWER_MIN (-250.0f)
#else
#error "CORE_REAL is 32 or 64"
#endif

static inline real real_min(real a, real b) {
  return a < b ? a : b;
}
static inline real real_max(real a, real b) {
  return a > b ? a : b;
}

/* 2^k for an integral k in the exponent range of normal numbers. */
static inline real real_power_of_two(real k) {
  const real shifted = k + REAL_ROUND_MAGIC;
  real_bits bits;
  memcpy(&bits, &shifted, sizeof bits);
  bits = (bits + REAL_EXPONENT_BIAS) << REAL_MANTISSA_BITS;
  real power;
  memcpy(&power, &bits, sizeof power);
  return power;
}

/* e^x = 2^k (1 + m), with |reduced| <= ln(2) / 2 the rest of the argument and
 * m = e^reduced - 1 = reduced (1 + reduced quotient). */
typedef struct real_exp_parts {
  real k;
  real m;
  real reduced;
  real quotient;
} real_exp_parts;

/* The Taylor polynomial of (e^x - 1 - x) / x^2: its first neglected term is, relative to e^x - 1,
 * below 4e-18 in double and 6e-10 in single precision on the reduced range. */
static inline real_exp_parts real_exp_split(real x) {
  real_exp_parts parts;
  parts.k = (x * REAL(1.44269504088896340736) + REAL_ROUND_MAGIC) - REAL_ROUND_MAGIC;
  const real high = real_fma(-parts.k, REAL_LN2_HI, x);
  const real t = real_fma(-parts.k, REAL_LN2_LO, high);
#if CORE_REAL == 64
  real q = 1.0 / 6227020800;
  q = real_fma(q, t, 1.0 / 479001600);
  q = real_fma(q, t, 1.0 / 39916800);
  q = real_fma(q, t, 1.0 / 3628800);
  q = real_fma(q, t, 1.0 / 362880);
  q = real_fma(q, t, 1.0 / 40320);
#else
  real q = 1.0f / 40320;
#endif
  q = real_fma(q, t, REAL(1.0) / 5040);
  q = real_fma(q, t, REAL(1.0) / 720);
  q = real_fma(q, t, REAL(1.0) / 120);
  q = real_fma(q, t, REAL(1.0) / 24);
  q = real_fma(q, t, REAL(1.0) / 6);
  q = real_fma(q, t, REAL(0.5));
  parts.reduced = t;
  parts.quotient = q;
  parts.m = real_fma(t * t, q, t);
  return parts;
}

/* v e^x 2^exponent, with gradual underflow: the power of two is applied last and in two halves, so
 * that neither e^x alone nor a half of the power leaves the normal range. exponent: integral;
 * v at most about 1e30. Error: that of v and 1 ulp. */
static inline real real_times_exp(real v, real x, real exponent) {
  const real_exp_parts parts = real_exp_split(real_max(x, REAL_EXP_SCALED_MIN));
  const real k = real_max(parts.k + exponent, REAL_POWER_MIN);
  const real half = (k * REAL(0.5) + REAL_ROUND_MAGIC) - REAL_ROUND_MAGIC;
  return real_fma(v, parts.m, v) * real_power_of_two(half) * real_power_of_two(k - half);
}

/* x <= 0, finite: e^x (never below the normal range), 1 - e^x, and (1 - e^x) / -x, 1 at x = 0.
 * Error: 1 ulp; 1.5 ulp for the quotient. What is not used costs nothing. */
typedef struct real_exp_values {
  real exp;
  real one_minus_exp;
  real quotient;
} real_exp_values;

static inline real_exp_values real_exp(real x) {
  const real bounded = real_max(x, REAL_EXP_MIN);
  const real_exp_parts parts = real_exp_split(bounded);
  const real power = real_power_of_two(parts.k);
  real_exp_values values;
  values.exp = real_fma(power, parts.m, power);
  values.one_minus_exp = real_fma(-power, parts.m, 1 - power);
  const int reduced_only = parts.k == 0;
  const real divisor = reduced_only ? REAL(1.0) : -x;
  const real near_zero = real_fma(parts.reduced, parts.quotient, REAL(1.0));
  values.quotient = reduced_only ? near_zero : values.one_minus_exp / divisor;
  return values;
}

/* ln(x 2^exponent) for a positive, normal x and an integral exponent. With x = 2^k m, m within
 * sqrt(2) of 1, ln(m) = 2 artanh(s), s = (m - 1) / (m + 1); the series' first neglected term is,
 * relative to it, below 1e-17 in double and 4e-9 in single precision. Error: 2 ulp of the largest
 * of |ln(x 2^exponent)|, |exponent| and 1. */
static inline real real_log(real x, real exponent) {
  real_bits bits;
  memcpy(&bits, &x, sizeof bits);
  const real_bits offset = bits + (REAL_ONE_BITS - REAL_SQRT_HALF_BITS);
  const real_bits biased = offset >> REAL_MANTISSA_BITS;
  const real_bits mantissa_bits = bits - ((biased - REAL_EXPONENT_BIAS) << REAL_MANTISSA_BITS);
  real mantissa;
  memcpy(&mantissa, &mantissa_bits, sizeof mantissa);
  /* The biased exponent as a number, by the way of its digits in the mantissa of 2^bits. */
  const real ulps_from = REAL_ROUND_MAGIC;
  real_bits as_bits;
  memcpy(&as_bits, &ulps_from, sizeof as_bits);
  as_bits += biased;
  real as_number;
  memcpy(&as_number, &as_bits, sizeof as_number);
  const real k = (as_number - REAL_ROUND_MAGIC) - REAL_EXPONENT_BIAS + exponent;
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

/* ---- a family's table of kernels --------------------------------------------------------------
 */

#ifdef CORE_ISA

#include "core/kernels.h"

#define CORE_PASTE5_(a, b, c, d, e) a##b##c##d##e
#define CORE_PASTE5(a, b, c, d, e) CORE_PASTE5_(a, b, c, d, e)
#define CORE_PASTE2_(a, b) a##b
#define CORE_PASTE2(a, b) CORE_PASTE2_(a, b)

/* CORE_KERNEL_TABLE(family, ...): the one symbol that this object exports. */
#define CORE_KERNEL_TABLE(family, ...)                                                             \
  extern const CORE_PASTE2(core_kernels_f, CORE_REAL)                                              \
      CORE_PASTE5(core_kernels_, family, _, CORE_ISA, CORE_PASTE2(_f, CORE_REAL));                 \
  const CORE_PASTE2(core_kernels_f, CORE_REAL)                                                     \
      CORE_PASTE5(core_kernels_, family, _, CORE_ISA, CORE_PASTE2(_f, CORE_REAL)) = {__VA_ARGS__}

/* CORE_KERNEL(name, element): a loop that applies element(coefficients, x) to every number. */
#define CORE_KERNEL(name, element)                                                                 \
  static void name(const real *restrict coefficients, size_t n, const real *restrict in,           \
                   real *restrict out) {                                                           \
    for (size_t i = 0; i < n; i++) {                                                               \
      out[i] = element(coefficients, in[i]);                                                       \
    }                                                                                              \
  }

#endif
#endif
