/* single: light that is scattered exactly once, without approximation, in real space. */
#ifndef DIPOLED_CORE_TRANSPORT_SINGLE_H
#define DIPOLED_CORE_TRANSPORT_SINGLE_H

#include <stddef.h>

enum { SINGLE_MAX = 320 };

/* Returns Fresnel's transmittance of the boundary for unpolarized light. eta: index inside over
 * index outside, positive. mu and mu_outside: the cosines inside and outside, 0 to 1, of which one
 * at most is 0. */
double transport_transmittance(double eta, double mu, double mu_outside);

/* Light that leaves at the cosine mu inside, for the distance of E from its least value E0, that of the
 * critical angle: E0 = eta + sqrt(eta^2 - 1), or 1 if eta < 1. weight is w(E) of core/transport/single.c. */
typedef struct single_node {
  double rate; /* E */
  double mu;
  double weight;
} single_node;

single_node transport_single_node(double eta, double e0, double distance);

/* A quadrature rule for one eta, which serves all radii and albedos. */
typedef struct single_rule {
  size_t n;
  double rate[SINGLE_MAX];
  double weight[SINGLE_MAX];
} single_rule;

/* Sets *rule up for the light that leaves at angles to the normal outside whose sine is at most
 * `sine`, above 0; that of all angles if it is at least 1. eta: 0.05 to 20; step: the step of the trapezoidal rule, 0.25 to 0.6. The relative
 * error of values is below e^(-7 / step). */
void transport_single_rule(single_rule *rule, double eta, double sine, double step);

/* R(r) of light scattered once, per squared mean free path, and the energy of this light within r,
 * per power entered, both for albedo 1. Both are proportional to the albedo. r: 0 (where R is
 * infinite) to infinity, in mean free paths. */
typedef struct single_values {
  double r;
  double within;
} single_values;

single_values transport_single_at(const single_rule *rule, double r);

/* Returns the energy of light scattered once that leaves, per power that has entered, if diffuse
 * light (of the same radiance from all directions) strikes the boundary, for albedo 1. It is in
 * proportion to the albedo. eta: 0.2 to 5. moment[l], l < moments: the Legendre moments of the phase
 * function, as in core/solver/solver.h. The relative error is below 1e-8. */
double transport_single_diffuse(double eta, size_t moments, const double *moment);

#endif
