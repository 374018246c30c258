/* fit_model: readings as a design models them, without noise. */
#ifndef DIPOLED_TESTS_ACCURACY_FIT_MODEL_H
#define DIPOLED_TESTS_ACCURACY_FIT_MODEL_H

#include <math.h>

#include "core/fit/search.h"

/* Sets values[count] to the readings of a medium with these coefficients, more than 0, with the
 * factor 1; NAN if the model does not take the medium. */
static inline void fit_model_readings(const core_fit *fit, double sigma_a_per_mm,
                                      double sigma_s_prime_per_mm, double *values) {
  const struct fit_place place = {fit_ln(sigma_a_per_mm / sigma_s_prime_per_mm),
                                  fit_ln(sigma_s_prime_per_mm)};
  const core_fault fault = fit_values(&fit->model, place, &fit->places, values, NULL, NULL);
  for (size_t i = 0; i < fit->count; i++) {
    values[i] = fault.field == NULL ? values[i] * fit->weight[i] : (double)NAN;
  }
}

#endif
