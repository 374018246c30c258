/* energy: the energy within r of models that have a formula for R alone, as a table.
 *
 * Over y = ln r the energy is gathered panel by panel with a Gauss rule; within a panel it is the
 * integral of the Legendre series through the rule's points. The error is that of the series:
 * measured below 1e-11 of the albedo for the models that use it (tests/accuracy/test_models.c).
 */
#ifndef DIPOLED_CORE_ENERGY_H
#define DIPOLED_CORE_ENERGY_H

#include <stddef.h>

#include "core/kernels.h"

enum core_energy_field {
  CORE_ENERGY_PANELS,    /* how many */
  CORE_ENERGY_FIRST_MM,  /* the radius where they begin */
  CORE_ENERGY_PER_PANEL, /* ln r in units of a panel's width: 1 / width */
  CORE_ENERGY_POWER,     /* below the first radius the energy is that power of r, */
  CORE_ENERGY_RISE,   /* times 1 + RISE ln(first / r), where R rises towards the source like that */
  CORE_ENERGY_SERIES, /* CORE_ENERGY_TERMS Legendre coefficients for each panel follow */
  CORE_ENERGY_TERMS = 17
};

/* Numbers in a table that reaches from first_mm to last_mm. */
size_t core_energy_length(double first_mm, double last_mm);

/* Fills in such a table from ring(c, ...) = 2 pi r R in 1/mm; returns the whole energy, by which
 * the table has been divided (unless it is 0). */
double core_energy_build(core_kernel_f64 *ring, const double *c, double first_mm, double last_mm,
                         double *table);

#endif
