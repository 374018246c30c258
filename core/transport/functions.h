/* functions: the elementary functions of the transport solver, real and complex.
 *
 * Only IEEE additions, products, quotients and square roots are used, so that a solution has the
 * same bits on every machine; the C library's functions differ with its version and with what the
 * processor can do. Each is within a few epsilon of the exact value, relative to its modulus. NaN
 * for arguments out of range.
 */
#ifndef DIPOLED_CORE_TRANSPORT_FUNCTIONS_H
#define DIPOLED_CORE_TRANSPORT_FUNCTIONS_H

#include <complex.h>

#define FN_PI 3.14159265358979323846

/* e^x for |x| up to 700; 0 for smaller x. */
double fn_exp(double x);

/* ln x for a positive, normal x. */
double fn_log(double x);

/* Sine and cosine of x; |x| up to 1e5. */
void fn_sincos(double x, double *sine, double *cosine);

#ifndef CMPLX
#define CMPLX(x, y) __builtin_complex((double)(x), (double)(y))
#endif

/* 1 / z as textbooks have it; compilers' own quotients of complex numbers are made in many ways,
 * and slower. |z| from 1e-150 to 1e150. */
static inline double complex fn_inverse(double complex z) {
  const double scale = 1 / (creal(z) * creal(z) + cimag(z) * cimag(z));
  return CMPLX(creal(z) * scale, -cimag(z) * scale);
}

/* The modulus; of moderate numbers: neither its square nor a component's may overflow. */
double fn_abs(double complex z);

/* Principal branches: the cuts lie on the negative real axis (square root, logarithm). */
double complex fn_csqrt(double complex z);
double complex fn_clog(double complex z);
double complex fn_cexp(double complex z);

/* e^z - 1, without loss of digits near 0. */
double complex fn_cexpm1(double complex z);

/* sinh z and cosh z, the former without loss of digits near 0. */
void fn_csinhcosh(double complex z, double complex *sine, double complex *cosine);

#endif
