/* nodes: the measures of the transport equation, as points and weights.
 *
 * All kernels are means of exponentials e^(-pt) over complex decay rates p, where t is a sum or a
 * difference of depths in mean free paths. For a wavenumber k across the plane, with mu the cosine
 * and x the tangent of the angle to the normal, and C = 1 / mu:
 *
 *   K(t)   = 1/2 int dmu / mu        J0(k t x) e^(-C t)   light that reaches another depth
 *   K_T(t) = 1/2 int dmu / mu T(mu)  J0(k t x) e^(-C t)   the part that the boundary lets out
 *   X(t)   = 1/2 int dmu      T(mu)  J0(k t x) e^(-C t)   the exitance of a source at depth t
 *
 * T = 1 - F is Fresnel's transmittance from inside. The kernel of the light that the boundary
 * reflects is K - K_T. The weights `kernel` represent it and the weights `exit` represent X: K -
 * K_T = sum of kernel[i] e^(-p[i] t) and X = sum of exit[i] e^(-p[i] t).
 */
#ifndef DIPOLED_TESTS_ISOTROPIC_NODES_H
#define DIPOLED_TESTS_ISOTROPIC_NODES_H

#include <complex.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/transport/gauss.h"

/* Sets *sine to sinh z and *cosine to cosh z. sinh z loses no digits near z = 0. */
void isotropic_sinhcosh(double complex z, double complex *sine, double complex *cosine);

/* Quadrature rules for one eta and accuracy. */
typedef struct nodes_rules {
  double eta;
  double accuracy; /* largest relative error of a kernel or exitance */
  gauss_rule scattered;
  gauss_rule chords;
  gauss_rule transmitted;
  size_t chord_points;
} nodes_rules;

typedef struct nodes {
  size_t n;
  double complex *p;
  double complex *kernel;
  double complex *exit;
} nodes;

/* Sets *rules up. eta: 0.05 to 20; accuracy: 1e-14 to 1e-2. */
void isotropic_nodes_rules(nodes_rules *rules, double eta, double accuracy);

/* Makes the nodes for the wavenumber k, in radians per mean free path. k lies in the first
 * quadrant, with Im k < 1 or Re k > Im k / 3. No two of the decay rates have the sum 0. The caller
 * frees the arrays, which are one block, with isotropic_nodes_free(). Returns false if memory runs
 * out; then there is nothing to free. */
bool isotropic_nodes_make(nodes *to, const nodes_rules *rules, double complex k);

void isotropic_nodes_free(nodes *of);

#endif
