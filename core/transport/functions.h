/* functions: the elementary functions of the transport solver, real and complex.
 *
 * They use only IEEE additions, products, quotients and square roots, so that a solution has the
 * same bits on every machine; the functions of C libraries differ with their version and with the
 * processor. Each result is within a few epsilon of the exact value, relative to its modulus. The
 * real functions return NaN for arguments out of range.
 */
#ifndef DIPOLED_CORE_TRANSPORT_FUNCTIONS_H
#define DIPOLED_CORE_TRANSPORT_FUNCTIONS_H

#include <complex.h>

#define FN_PI 3.14159265358979323846
#define FN_LN2 0.693147180559945309417

/* Returns e^x for |x| up to 700, and 0 for x below -700. */
double fn_exp(double x);

/* Returns ln x for a positive, normal x. */
double fn_log(double x);

/* Sets *sine and *cosine to those of x, for |x| up to 1e5. */
void fn_sincos(double x, double *sine, double *cosine);

#ifndef CMPLX
#define CMPLX(x, y) __builtin_complex((double)(x), (double)(y))
#endif

/* Returns 1 / z by the textbook formula, for |z| from 1e-150 to 1e150. Compilers compute quotients
 * of complex numbers in different ways, and more slowly. */
static inline double complex fn_inverse(double complex z) {
  const double scale = 1 / (creal(z) * creal(z) + cimag(z) * cimag(z));
  return CMPLX(creal(z) * scale, -cimag(z) * scale);
}

/* Returns the square of |z|. */
static inline double fn_norm2(double complex z) {
  return creal(z) * creal(z) + cimag(z) * cimag(z);
}

/* Returns |z|. The square of |z| must not overflow. */
double fn_abs(double complex z);

/* Square root, logarithm and exponential of z. The first two are principal branches, with cuts
 * along the negative real axis. */
double complex fn_csqrt(double complex z);
double complex fn_clog(double complex z);
double complex fn_cexp(double complex z);

/* Returns e^z - 1 without loss of digits near z = 0. */
double complex fn_cexpm1(double complex z);

#endif
