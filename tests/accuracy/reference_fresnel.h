/* reference_fresnel: the moments of the Fresnel reflectance with many digits, from their
 * definition. */
#ifndef DIPOLED_TESTS_REFERENCE_FRESNEL_H
#define DIPOLED_TESTS_REFERENCE_FRESNEL_H

#include <stdint.h>
#include <stdio.h>

#include <mpfr.h>

#include "core/core.h"

enum { REFERENCE_BITS = 384 };

typedef struct reference_fresnel {
  mpfr_t one_minus_2c1;
  mpfr_t one_minus_3c2;
} reference_fresnel;

/* eta: any positive number with exact moments; with fitted ones wherever the polynomials are
 * wanted. Exact moments are good to 1e-33, relative. What is returned is kept for the next call
 * with the same arguments, and valid until reference_fresnel_forget(). Only one thread may call
 * this function. */
const reference_fresnel *reference_fresnel_moments(enum core_moments moments, double eta);

/* Frees everything that this file keeps. */
void reference_fresnel_forget(void);

#endif
