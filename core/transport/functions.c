#include "core/transport/functions.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

#define LN2 0.69314718055994530942
/* Adding ROUND_MAGIC to a number rounds the number to an integer, which then stands in the last
 * bits of the sum. */
#define ROUND_MAGIC 0x1.8p52

static uint64_t to_bits(double x) {
  uint64_t bits;
  memcpy(&bits, &x, sizeof bits);
  return bits;
}

static double from_bits(uint64_t bits) {
  double x;
  memcpy(&x, &bits, sizeof x);
  return x;
}

/* Returns the sum of coefficients[i] x^i over i from 0 to count - 1. */
static double polynomial(double x, const double *coefficients, int count) {
  double sum = coefficients[count - 1];
  for (int i = count - 2; i >= 0; i--) {
    sum = sum * x + coefficients[i];
  }
  return sum;
}

/* e^x = 2^k e^t with |t| <= ln(2) / 2, where 14 terms of Taylor's series are exact to rounding. The
 * product of k and ln2_high is exact. */
double fn_exp(double x) {
  static const double terms[] = {1,
                                 1,
                                 1.0 / 2,
                                 1.0 / 6,
                                 1.0 / 24,
                                 1.0 / 120,
                                 1.0 / 720,
                                 1.0 / 5040,
                                 1.0 / 40320,
                                 1.0 / 362880,
                                 1.0 / 3628800,
                                 1.0 / 39916800,
                                 1.0 / 479001600,
                                 1.0 / 6227020800};
  static const double ln2_high = 0x1.62e42fee00000p-1;
  static const double ln2_low = 0x1.a39ef35793c76p-33;
  if (!(fabs(x) <= 700)) {
    return x < 0 ? 0 : NAN;
  }
  const double shifted = x / LN2 + ROUND_MAGIC;
  const double k = shifted - ROUND_MAGIC;
  const double t = (x - k * ln2_high) - k * ln2_low;
  const double power = from_bits((to_bits(shifted) + 1023) << 52);
  return power * polynomial(t, terms, sizeof terms / sizeof terms[0]);
}

/* x = 2^k m with m within a factor sqrt(2) of 1, and ln m = 2 artanh(s) with s = (m - 1) / (m + 1),
 * s^2 < 0.03. */
double fn_log(double x) {
  static const double terms[] = {2,        2.0 / 3,  2.0 / 5,  2.0 / 7,  2.0 / 9,
                                 2.0 / 11, 2.0 / 13, 2.0 / 15, 2.0 / 17, 2.0 / 19};
  if (!(x > 0) || isinf(x)) {
    return NAN;
  }
  const uint64_t bits = to_bits(x);
  const uint64_t biased = (bits + (to_bits(1.0) - to_bits(0.70710678118654752440))) >> 52;
  const double m = from_bits(bits - ((biased - 1023) << 52));
  const double s = (m - 1) / (m + 1);
  return s * polynomial(s * s, terms, sizeof terms / sizeof terms[0]) +
         ((double)biased - 1023) * LN2;
}

/* x = k pi / 2 + t with |t| <= pi / 4. pi / 2 is split into three parts; the products of k with the
 * first two are exact. */
void fn_sincos(double x, double *sine, double *cosine) {
  static const double sine_terms[] = {1,
                                      -1.0 / 6,
                                      1.0 / 120,
                                      -1.0 / 5040,
                                      1.0 / 362880,
                                      -1.0 / 39916800,
                                      1.0 / 6227020800,
                                      -1.0 / 1307674368000};
  static const double cosine_terms[] = {1,
                                        -1.0 / 2,
                                        1.0 / 24,
                                        -1.0 / 720,
                                        1.0 / 40320,
                                        -1.0 / 3628800,
                                        1.0 / 479001600,
                                        -1.0 / 87178291200,
                                        1.0 / 20922789888000};
  static const double first = 0x1.921fb54400000p0;
  static const double second = 0x1.0b4611a600000p-34;
  static const double third = 0x1.3198a2e037073p-69;
  if (!(fabs(x) <= 1e5)) {
    *sine = *cosine = NAN;
    return;
  }
  const double shifted = x / (FN_PI / 2) + ROUND_MAGIC;
  const double k = shifted - ROUND_MAGIC;
  const double t = ((x - k * first) - k * second) - k * third;
  const double s = t * polynomial(t * t, sine_terms, sizeof sine_terms / sizeof sine_terms[0]);
  const double c = polynomial(t * t, cosine_terms, sizeof cosine_terms / sizeof cosine_terms[0]);
  const uint64_t quarter = to_bits(shifted) & 3;
  *sine = quarter == 0 ? s : quarter == 1 ? c : quarter == 2 ? -s : -c;
  *cosine = quarter == 0 ? c : quarter == 1 ? -s : quarter == 2 ? -c : s;
}

/* Returns atan t for t in [0, 1]. The code subtracts the angle i pi / 16, i = 0, 1, ..., 4, that is
 * nearest, so that the series gets at most tan(pi / 32) = 0.0985. */
static double atan_up_to_1(double t) {
  static const double tangents[] = {0, 0.19891236737965800691, 0.41421356237309504880,
                                    0.66817863791929891999, 1};
  static const double terms[] = {1,       -1.0 / 3,  1.0 / 5,  -1.0 / 7,
                                 1.0 / 9, -1.0 / 11, 1.0 / 13, -1.0 / 15};
  const int i = t < 0.09849140335716425   ? 0
                : t < 0.30334668360734237 ? 1
                : t < 0.53451113595079165 ? 2
                : t < 0.82067879082866037 ? 3
                                          : 4;
  const double rest = (t - tangents[i]) / (1 + t * tangents[i]);
  return i * (FN_PI / 16) + rest * polynomial(rest * rest, terms, sizeof terms / sizeof terms[0]);
}

static double argument(double complex z) {
  const double x = fabs(creal(z));
  const double y = fabs(cimag(z));
  if (x == 0 && y == 0) {
    return 0;
  }
  const double first = y <= x ? atan_up_to_1(y / x) : FN_PI / 2 - atan_up_to_1(x / y);
  const double upper = creal(z) < 0 ? FN_PI - first : first;
  return cimag(z) < 0 ? -upper : upper;
}

double fn_abs(double complex z) {
  return sqrt(creal(z) * creal(z) + cimag(z) * cimag(z));
}

double complex fn_csqrt(double complex z) {
  const double larger = sqrt(0.5 * (fn_abs(z) + fabs(creal(z))));
  if (larger == 0) {
    return 0;
  }
  const double smaller = 0.5 * fabs(cimag(z)) / larger;
  const double x = creal(z) < 0 ? smaller : larger;
  const double y = creal(z) < 0 ? larger : smaller;
  return CMPLX(x, cimag(z) < 0 ? -y : y);
}

double complex fn_clog(double complex z) {
  return CMPLX(0.5 * fn_log(creal(z) * creal(z) + cimag(z) * cimag(z)), argument(z));
}

double complex fn_cexp(double complex z) {
  const double modulus = fn_exp(creal(z));
  double sine, cosine;
  fn_sincos(cimag(z), &sine, &cosine);
  return CMPLX(modulus * cosine, modulus * sine);
}

double complex fn_cexpm1(double complex z) {
  if (fn_abs(z) > 0.5) {
    return fn_cexp(z) - 1;
  }
  double complex sum = 1;
  for (int i = 16; i >= 2; i--) {
    sum = 1 + sum * z / i;
  }
  return sum * z;
}
