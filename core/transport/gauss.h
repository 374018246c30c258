/* gauss: Gauss-Legendre rules of any order. */
#ifndef DIPOLED_CORE_TRANSPORT_GAUSS_H
#define DIPOLED_CORE_TRANSPORT_GAUSS_H

#include <stddef.h>

enum { GAUSS_MAX = 256 };

/* A rule for integrals from 0 to 1: n nodes in ascending order, and weights that add up to 1. Both
 * are within a few epsilon. */
typedef struct gauss_rule {
  size_t n;
  double x[GAUSS_MAX];
  double weight[GAUSS_MAX];
} gauss_rule;

/* Sets *rule to the Gauss-Legendre rule with n nodes. n: 1 to GAUSS_MAX (asserted). */
void transport_gauss(gauss_rule *rule, size_t n);

#endif
