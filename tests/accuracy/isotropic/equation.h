/* equation: the transport equation at one wavenumber, reduced to a few unknowns and solved. */
#ifndef DIPOLED_TESTS_ISOTROPIC_EQUATION_H
#define DIPOLED_TESTS_ISOTROPIC_EQUATION_H

#include <complex.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "tests/accuracy/isotropic/nodes.h"

enum { EQUATION_RANK_MAX = 160 };

/* The part of the equation at one wavenumber that does not depend on the albedo. */
typedef struct equation {
  double complex k;
  double accuracy; /* relative accuracy of the nodes' rules */
  nodes nodes;
  size_t rank;
  uint16_t pivot[EQUATION_RANK_MAX]; /* positions of the pivots among the nodes */
} equation;

/* Sets *to for a wavenumber k and rules as isotropic_nodes_make() accepts them. The caller frees it
 * with isotropic_equation_free(). Returns false if memory runs out; then there is nothing to free.
 */
bool isotropic_equation_make(equation *to, const nodes_rules *rules, double complex k);
void isotropic_equation_free(equation *of);

/* Memory for solving equations one after another. Each thread needs its own. isotropic_work_new()
 * returns NULL if memory runs out; the caller frees the memory with isotropic_work_free(), which
 * accepts NULL. */
typedef struct isotropic_work isotropic_work;

isotropic_work *isotropic_work_new(void);
void isotropic_work_free(isotropic_work *of);

/* Sets *exitance to the exitance of light scattered at least twice, Fourier transformed over the
 * plane, per power that has entered. albedo: in (0, 1]; kappa: transport_kappa(albedo), with k^2 +
 * kappa^2 not 0. Returns false if memory runs out. */
bool isotropic_equation_solve(const equation *of, isotropic_work *work, double albedo, double kappa,
                              double complex *exitance);

#endif
