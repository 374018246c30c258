/* legendre: the Legendre series of a function that is known at the nodes of the Gauss rule
 * (core/gauss.h). */
#ifndef DIPOLED_CORE_LEGENDRE_H
#define DIPOLED_CORE_LEGENDRE_H

#include "core/gauss.h"

enum { CORE_LEGENDRE_TERMS = 2 * CORE_GAUSS_HALF };

/* Sets series to the coefficients of P_0 to P_15 on -1 to 1 of the polynomial through value[i] at the
 * nodes 2 core_gauss_node(i) - 1. Any thread may call this at any time. */
void core_legendre_fit(const double value[CORE_LEGENDRE_TERMS], double series[CORE_LEGENDRE_TERMS]);

#endif
