/* equation: the transport equation at one wavenumber, reduced to a few unknowns and solved. */
#ifndef DIPOLED_CORE_TRANSPORT_EQUATION_H
#define DIPOLED_CORE_TRANSPORT_EQUATION_H

#include <complex.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/transport/nodes.h"

enum { EQUATION_RANK_MAX = 160 };

/* What does not depend on the albedo. */
typedef struct equation {
  double complex k;
  double accuracy; /* of the rules */
  nodes nodes;
  size_t rank;
  uint16_t pivot[EQUATION_RANK_MAX]; /* nodes */
} equation;

/* For k and rules as transport_nodes_make() takes them; freed by transport_equation_free(). False:
 * no memory, and nothing to free. */
bool transport_equation_make(equation *to, const nodes_rules *rules, double complex k);
void transport_equation_free(equation *of);

/* Memory for solving; one for each thread. NULL: no memory. */
typedef struct transport_work transport_work;

transport_work *transport_work_new(void);
void transport_work_free(transport_work *of);

/* The exitance of light scattered at least twice, Fourier transformed over the plane, per power
 * that has entered. albedo in (0, 1], kappa its transport_kappa(); k^2 + kappa^2 not 0. False: no
 * memory. */
bool transport_equation_solve(const equation *of, transport_work *work, double albedo, double kappa,
                              double complex *exitance);

#endif
