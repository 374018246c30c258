/* energy: how kernels read the tables of core/energy.h. */
#ifndef DIPOLED_CORE_MODELS_ENERGY_H
#define DIPOLED_CORE_MODELS_ENERGY_H

#include "core/energy.h"
#include "core/kernel.h"

/* Returns the Legendre series whose CORE_ENERGY_TERMS coefficients begin at table[at], at s, from -1 to
 * 1, by Clenshaw's recurrence. */
static inline double energy_series(const double *table, int64_t at, double s) {
  double next = 0;
  double after = 0;
#pragma GCC unroll 16
  for (int k = CORE_ENERGY_TERMS - 1; k >= 1; k--) {
    const double sum =
        table[at + k] + (2 * k + 1) * s / (k + 1) * next - (k + 1.0) / (k + 2) * after;
    after = next;
    next = sum;
  }
  return table[at] + s * next - 0.5 * after;
}

/* Returns the cdf at r mm, from 0 to infinity, from a table that core_energy_build() made. It
 * returns 1 only from the end of the table on, and less than 1 before: so rounding cannot make the
 * cdf fall. */
static inline double energy_cdf(const double *table, double r) {
  const double first = table[CORE_ENERGY_FIRST_MM];
  const double panels = table[CORE_ENERGY_PANELS], rise = table[CORE_ENERGY_RISE];
  const double ratio = real_max(r / first, 1);
  const double y = real_log(real_min(ratio, 1e300), 0) * table[CORE_ENERGY_PER_PANEL];
  const double panel = real_floor(real_min(y, panels - 1));
  const int64_t at = CORE_ENERGY_SERIES + real_index(panel) * CORE_ENERGY_TERMS;
  const double inside = energy_series(table, at, real_min(2 * (y - panel) - 1, 1));
  const double shrunk = real_min(real_log(real_max(r / first, 1e-300), 0), 0);
  const double fallen = real_exp(shrunk * table[CORE_ENERGY_POWER]).exp;
  const double below = r < first ? fallen * (1 - rise * shrunk) : 1;
  const double bounded = real_min(real_max(inside * below, 0), REAL_BELOW_1);
  const double any = y < panels ? bounded : 1;
  return r > 0 ? any : 0;
}

#endif
