/* energy: tabulates the energy within r for models that have a formula for R only.
 *
 * The table covers y = ln r in panels and integrates each with a Gauss rule. Within a panel the
 * energy is the integral of the Legendre series through the rule's points. The error of the series
 * was measured to be below 1e-11 of the albedo for the models that use it
 * (tests/accuracy/test_models.c).
 */
#ifndef DIPOLED_CORE_ENERGY_H
#define DIPOLED_CORE_ENERGY_H

#include <stddef.h>

#include "core/kernels.h"

enum core_energy_field {
  CORE_ENERGY_PANELS,    /* number of panels */
  CORE_ENERGY_FIRST_MM,  /* the radius where the first panel begins */
  CORE_ENERGY_PER_PANEL, /* panels per unit of ln r */
  /* Below the first radius the energy is proportional to r^POWER (1 + RISE ln(first / r)). RISE is
   * 0 unless R rises towards the source like a logarithm. */
  CORE_ENERGY_POWER,
  CORE_ENERGY_RISE,
  CORE_ENERGY_SERIES, /* from here on: CORE_ENERGY_TERMS Legendre coefficients for each panel */
  CORE_ENERGY_TERMS = 17
};

/* Returns how many numbers a table for radii from first_mm to last_mm has. */
size_t core_energy_length(double first_mm, double last_mm);

/* Fills in a table of core_energy_length() numbers from the kernel of R in `kernels`. Returns
 * the whole energy and divides the table by it unless it is 0. */
double core_energy_build(const core_kernels_f64 *kernels, const double *c, double first_mm,
                         double last_mm, double *table);

#endif
