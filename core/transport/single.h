/* single: light that is scattered once, exactly, in real space. */
#ifndef DIPOLED_CORE_TRANSPORT_SINGLE_H
#define DIPOLED_CORE_TRANSPORT_SINGLE_H

#include <stddef.h>

enum { SINGLE_MAX = 320 };

/* A rule for one eta, for all radii and albedos. */
typedef struct single_rule {
  size_t n;
  double rate[SINGLE_MAX];
  double weight[SINGLE_MAX];
} single_rule;

/* eta: 0.05 to 20; step of the rule: 0.25 to 0.6. The error is below e^(-7 / step), relative. */
void transport_single_rule(single_rule *rule, double eta, double step);

/* R(r) of light scattered once and the energy of it within r, per power entered, for albedo 1; both
 * are proportional to the albedo. r: 0 (where R is infinite) to infinity, in mean free paths. */
typedef struct single_values {
  double r;
  double within;
} single_values;

single_values transport_single_at(const single_rule *rule, double r);

#endif
