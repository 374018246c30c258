/* Makes profiles from tables that were built elsewhere. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/kernels.h"
#include "core/lut/lut.h"

core_radii_range core_table_pieces(const core_profile *profile) {
  return (core_radii_range){(double)profile->lut[CORE_LUT_FIRST_MM],
                            (double)profile->lut[CORE_LUT_LAST_MM]};
}

bool core_table_has(enum core_quantity quantity) {
  return quantity == CORE_QUANTITY_R || quantity == CORE_QUANTITY_CDF ||
         quantity == CORE_QUANTITY_PDF || quantity == CORE_QUANTITY_RING ||
         quantity == CORE_QUANTITY_S;
}

core_fault core_profile_from_table(core_profile *profile, const core_isa *isa, const float *words,
                                   size_t count) {
  const core_fault fault = core_lut_check(words, count);
  if (fault.field != NULL) {
    return fault;
  }
  float *copy = malloc(count * sizeof *copy);
  if (copy == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  memcpy(copy, words, count * sizeof *copy);
  const core_profile facts = *profile;
  *profile = (core_profile){
      .medium = facts.medium,
      .model = facts.model,
      .moments = facts.moments,
      .evaluator = CORE_EVALUATOR_LUT,
      .albedo = facts.albedo,
      .numerical_error = facts.numerical_error,
      .numerical_error_per_mm = facts.numerical_error_per_mm,
      .reach = facts.reach,
      .model_errors = facts.model_errors,
      .notes = facts.notes,
      .radii = facts.radii,
      .cost = 1,
      .kernels = core_isa_lut_kernels(isa),
      .lut = copy,
      .lut_count = count,
      .scale_mm = 1,
      .cos_in = 1,
      .cos_out = 1,
  };
  memcpy(profile->numerical_errors, facts.numerical_errors, sizeof facts.numerical_errors);
  return (core_fault){0};
}
