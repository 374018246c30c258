/* bessel: modified Bessel functions of the second kind, orders 0 and 1, of complex arguments. */
#ifndef DIPOLED_CORE_TRANSPORT_BESSEL_H
#define DIPOLED_CORE_TRANSPORT_BESSEL_H

#include <complex.h>

typedef struct bessel_k {
  double complex k0;
  double complex k1;
  double complex pole_less_k1; /* 1 / w - K1(w), small where w is */
} bessel_k;

/* Re w >= 0, |w| > 1e-100. Relative error 1e-14; values below 1e-300 are 0. */
bessel_k transport_bessel_k(double complex w);

#endif
