/* bessel: modified Bessel functions of the second kind, orders 0 and 1, of complex arguments. */
#ifndef DIPOLED_CORE_TRANSPORT_BESSEL_H
#define DIPOLED_CORE_TRANSPORT_BESSEL_H

#include <complex.h>

typedef struct bessel_k {
  double complex k0;
  double complex k1;
  double complex pole_less_k1; /* 1 / w - K1(w) without cancellation for small w */
} bessel_k;

/* Returns K0(w), K1(w) and 1 / w - K1(w) for Re w >= 0 and |w| > 1e-100. The relative error is
 * 1e-14. K0 and K1 are returned as 0 for Re w > 690, where they are below 1e-300. */
bessel_k transport_bessel_k(double complex w);

#endif
