#include "core/transport/bessel.h"

#include <math.h>

#include "core/transport/functions.h"

#define EULER_GAMMA 0.57721566490153286061
#define EPSILON 0x1p-52
#define SERIES_UP_TO 2.0
/* limit of the continued fraction's terms: it needs 60 at |w| = 2 and fewer for larger |w| */
enum { TERMS_MAX = 200 };

/* The ascending series (Abramowitz and Stegun, 9.6.10, 9.6.11 and 9.6.13). With t = w^2 / 4 and the
 * harmonic numbers h_m,
 *
 *   I0 = sum t^m / m!^2,  I1 = w / 2 sum t^m / (m! (m + 1)!)
 *   K0 = -(ln(w / 2) + gamma) I0 + sum h_m t^m / m!^2
 *   K1 = 1 / w + ln(w / 2) I1 - w / 4 sum (h_m + h_(m+1) - 2 gamma) t^m / (m! (m + 1)!)
 */
static bessel_k ascending(double complex w) {
  const double complex t = 0.25 * w * w;
  double complex power = 1; /* t^m / m!^2 */
  double complex i0 = 0, i1 = 0, sum0 = 0, sum1 = 0;
  double harmonic = 0;
#pragma GCC unroll 15 /* |t| is at most 1: 1 / 15!^2 changes no bit. Factors are constants then. */
  for (int m = 0; m < 15; m++) {
    const double next = harmonic + 1.0 / (m + 1);
    i0 += power;
    sum0 += harmonic * power;
    i1 += power / (m + 1);
    sum1 += (harmonic + next - 2 * EULER_GAMMA) * power / (m + 1);
    harmonic = next;
    power *= t / ((m + 1.0) * (m + 1.0));
  }
  const double complex logarithm = fn_clog(0.5 * w);
  bessel_k k;
  k.k0 = sum0 - (logarithm + EULER_GAMMA) * i0;
  k.pole_less_k1 = 0.25 * w * sum1 - 0.5 * w * logarithm * i1;
  k.k1 = fn_inverse(w) - k.pole_less_k1;
  return k;
}

/* Temme's continued fraction by Steed's algorithm (N. M. Temme, "On the numerical evaluation of the
 * modified Bessel function of the third kind", 1975; order 0). With z_n = U(n + 1/2, 1, 2 w) the
 * fraction gives K1 / K0. Summed with the coefficients c_n it gives K0 itself. */
static bessel_k continued_fraction(double complex w) {
  double complex b = 2 * (1 + w);
  double complex d = fn_inverse(b);
  double complex step = d;
  double complex ratio = d;
  double complex before = 0, now = 1;
  double a = -0.25;
  double c = 0.25;
  double complex q = 0.25;
  double complex sum = 1 + q * step;
  for (int i = 2; i < TERMS_MAX; i++) {
    a -= 2 * (i - 1);
    c *= -a / i;
    const double complex next = (before - b * now) / a;
    before = now;
    now = next;
    q += c * next;
    b += 2;
    d = fn_inverse(b + a * d);
    step *= b * d - 1;
    ratio += step;
    sum += q * step;
    if (fn_abs(q * step) < 0.5 * EPSILON * fn_abs(sum)) {
      break;
    }
  }
  bessel_k k;
  const double complex inverse_w = fn_inverse(w);
  k.k0 = fn_csqrt(0.5 * FN_PI * inverse_w) * fn_cexp(-w) * fn_inverse(sum);
  k.k1 = k.k0 * (w + 0.5 - 0.25 * ratio) * inverse_w;
  k.pole_less_k1 = inverse_w - k.k1;
  return k;
}

bessel_k transport_bessel_k(double complex w) {
  if (creal(w) > 690) {
    return (bessel_k){0, 0, fn_inverse(w)};
  }
  return fn_abs(w) < SERIES_UP_TO ? ascending(w) : continued_fraction(w);
}
