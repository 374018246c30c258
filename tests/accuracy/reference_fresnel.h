/* reference_fresnel: the moments of the Fresnel reflectance with many digits, from their
 * definition. */
#ifndef DIPOLED_TESTS_REFERENCE_FRESNEL_H
#define DIPOLED_TESTS_REFERENCE_FRESNEL_H

#include "core/core.h"

typedef _Float128 quad;

typedef struct reference_fresnel {
  quad one_minus_2c1, one_minus_3c2;
} reference_fresnel;

/* eta: any positive number with exact moments; with fitted ones wherever the polynomials are
 * wanted. Exact moments are good to 1e-27, relative. Only one thread of a process may call this
 * function, which keeps what it has integrated. */
reference_fresnel reference_fresnel_moments(enum core_moments moments, double eta);

#endif
