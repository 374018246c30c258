/* With Q^2 = k^2 + w^2 and the dispersion function L(w) = ln(1 - a atan(Q) / Q),
 *
 *   ln H(p) = -(1 / pi) int_0^inf p L(w) / (p^2 + w^2) dw.
 *
 * L is even, so the integral is half of that over the whole line w = sigma sinh(y). The trapezoidal
 * rule with step h over y is exact up to e^(-2 pi d / h), where d is the distance from the real
 * axis to the next singularity in y. The singularities are the zero of the logarithm's argument at
 * w = +-i p0 with p0 = sqrt(k^2 + kappa^2), the branch points of atan at w = +-i sqrt(1 + k^2), and
 * the poles w = +-i p. sigma has the modulus of p0, and its direction lies half way between those
 * of the first two singularities; this keeps both at d > 1. The poles may come arbitrarily near,
 * because their contribution is known. By the theorem of residues (Trefethen and Weideman 2014 for
 * trapezoidal rules),
 *
 *   ln H(p) = -(h / 2 pi) sum over all j of p L(w_j) w'_j / (p^2 + w_j^2)
 *             + L(i p) / (e^(-2 pi i y* / h) - 1),     sinh(y*) = i p / sigma.
 */
#include "tests/accuracy/isotropic/h_function.h"

#include <math.h>
#include <stdlib.h>

#include "core/transport/functions.h"

/* least distance d from the line to a singularity other than the poles */
#define STRIP 1.05
#define BEYOND_LARGEST 100.0 /* the line ends at this multiple of the largest decay rate */
#define POLES_UP_TO 1.3      /* poles at a larger distance from the line are negligible */
enum { STEPS_MAX = 1024 };   /* the line needs at most about ln(1e12) / 0.2 steps */

struct h_function {
  double albedo;
  double complex k;
  double complex sigma;
  double cut; /* argument of sigma */
  double h;
  size_t n;
  /* The terms of the sum for ln H(p) at the top of this file, for j >= 0. square is w_j^2.
   * For j > 0, weight is -(h / pi) L(w_j) w'_j, which counts the terms of j and -j. For j = 0,
   * weight is half of that. */
  double square_re[STEPS_MAX];
  double square_im[STEPS_MAX];
  double weight_re[STEPS_MAX];
  double weight_im[STEPS_MAX];
};

/* Returns ln(1 - a atan(Q) / Q) from Q^2. The principal branch of atan has its cut along Q^2 < -1.
 * This function turns the cut by 2 cut > 0 about Q^2 = -1, as far as isotropic_h_set() turns the
 * line w: between the old cut and the new one it uses another branch of atan. Near Q = 0, where a
 * may be 1, it uses a series for 1 - atan(Q) / Q. */
static double complex dispersion(double albedo, double complex q2, double cut) {
  if (fabs(creal(q2)) + fabs(cimag(q2)) < 0.06) {
    double complex series = 0;
    for (int j = 13; j >= 1; j--) {
      series = q2 * ((j % 2 ? 1.0 : -1.0) / (2 * j + 1) + series);
    }
    return fn_clog((1 - albedo) + albedo * series);
  }
  const double complex q = fn_csqrt(q2);
  const double complex iq = CMPLX(-cimag(q), creal(q));
  double complex angle = CMPLX(0, -0.5) * (fn_clog(1 + iq) - fn_clog(1 - iq));
  if (cut > 0 && cimag(q2) < 0 && cimag(fn_clog(q2 + 1)) < 2 * cut - FN_PI) {
    angle -= FN_PI;
  }
  return fn_clog(1 - albedo * angle * fn_inverse(q));
}

h_function *isotropic_h_new(void) {
  return malloc(sizeof(h_function));
}

void isotropic_h_free(h_function *of) {
  free(of);
}

void isotropic_h_set(h_function *to, double albedo, double kappa, double complex k, double p_max,
                     double accuracy) {
  const double complex log_p0 = 0.5 * fn_clog(k * k + kappa * kappa);
  const double scale = fn_exp(creal(log_p0));
  to->albedo = albedo;
  to->k = k;
  to->cut = 0.5 * (cimag(log_p0) + 0.5 * cimag(fn_clog(1 + k * k)));
  to->sigma = scale * fn_cexp(CMPLX(0, to->cut));
  to->h = 2 * FN_PI * STRIP / (2 - fn_log(accuracy));
  const double steps = 1 + fn_log(2 * BEYOND_LARGEST * fmax(p_max, 1) / scale) / to->h;
  to->n = steps < STEPS_MAX ? (size_t)steps : STEPS_MAX;
  for (size_t j = 0; j < to->n; j++) {
    const double e = fn_exp((double)j * to->h);
    const double complex w = to->sigma * (0.5 * (e - 1 / e));
    const double complex slope = to->sigma * (0.5 * (e + 1 / e));
    const double complex l = dispersion(albedo, k * k + w * w, 0);
    const double complex weight = (j == 0 ? -0.5 : -1.0) * to->h / FN_PI * l * slope;
    to->square_re[j] = creal(w * w);
    to->square_im[j] = cimag(w * w);
    to->weight_re[j] = creal(weight);
    to->weight_im[j] = cimag(weight);
  }
}

/* line_sums() sets sums[i] to the sum over j of weight_j / (p^2 + w_j^2) at p = p[i], for n <=
 * LANES. */
enum { LANES = 16 };

static void line_sums(const h_function *of, size_t n, const double complex *p,
                      double complex *sums) {
  double p2_re[LANES] = {0}, p2_im[LANES] = {0}, sum_re[LANES] = {0}, sum_im[LANES] = {0};
  for (size_t i = 0; i < LANES; i++) {
    const double complex p2 = i < n ? p[i] * p[i] : 1;
    p2_re[i] = creal(p2);
    p2_im[i] = cimag(p2);
  }
  for (size_t j = 0; j < of->n; j++) {
    const double square_re = of->square_re[j];
    const double square_im = of->square_im[j];
    const double weight_re = of->weight_re[j];
    const double weight_im = of->weight_im[j];
    for (size_t i = 0; i < LANES; i++) {
      const double re = p2_re[i] + square_re;
      const double im = p2_im[i] + square_im;
      const double inverse = 1 / (re * re + im * im);
      sum_re[i] += (weight_re * re + weight_im * im) * inverse;
      sum_im[i] += (weight_im * re - weight_re * im) * inverse;
    }
  }
  for (size_t i = 0; i < n; i++) {
    sums[i] = CMPLX(sum_re[i], sum_im[i]);
  }
}

/* Returns the contribution of the pole, L(i p) / (e^(-2 pi i y* / h) - 1) with -i y* = asin(zeta)
 * and zeta = p / sigma. Of the two forms of asin, -+i ln(+-i zeta + sqrt(1 - zeta^2)), the code
 * uses the one whose sum does not cancel. */
static double complex pole(const h_function *of, double complex p) {
  const double complex zeta = p * fn_inverse(of->sigma);
  const double sign = cimag(zeta) > 0 ? -1 : 1;
  const double complex root = fn_csqrt(1 - zeta) * fn_csqrt(1 + zeta);
  const double complex asin_zeta = CMPLX(0, -sign) * fn_clog(CMPLX(0, sign) * zeta + root);
  if (creal(asin_zeta) > POLES_UP_TO) {
    return 0;
  }
  const double complex exponent = 2 * FN_PI / of->h * asin_zeta;
  return dispersion(of->albedo, of->k * of->k - p * p, of->cut) * fn_inverse(fn_cexpm1(exponent));
}

void isotropic_h_log(const h_function *of, size_t n, const double complex *p,
                     double complex *log_h) {
  for (size_t from = 0; from < n; from += LANES) {
    line_sums(of, n - from < LANES ? n - from : LANES, p + from, log_h + from);
  }
  for (size_t i = 0; i < n; i++) {
    log_h[i] = p[i] * log_h[i] + pole(of, p[i]);
  }
}
