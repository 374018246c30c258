/* Prepares what media that vary have in common, and makes its words. It is apart from evaluating,
 * so that a client that has the words does without the preparation of profiles. */
#include <math.h>

#include "core/varying.h"
#include "core/varying/surface.h"

core_fault core_varying_prepare(core_varying *varying, const core_isa *isa, unsigned model,
                                unsigned moments, unsigned evaluator, double g, double eta,
                                const core_parameters *parameters) {
  const core_parameters none = core_parameters_none();
  const core_parameters *given = parameters != NULL ? parameters : &none;
  /* A medium to check the model, g, eta and parameters with. */
  const core_medium medium = {1, g > -1 && g < 1 ? 1 / (1 - g) : 1, g, eta};
  core_fault fault = core_profile_check(model, moments, evaluator, &medium, given, NULL);
  if (fault.field == NULL) {
    fault = core_surface_begin(varying, isa, model, moments, evaluator, g, eta, given);
  }
  if (fault.field != NULL) {
    return fault;
  }
  const double tolerance = given->value[CORE_PARAMETER_TOLERANCE];
  const core_surface_inputs inputs = {
      .g = varying->table_g,
      .eta = eta,
      .tolerance = isnan(tolerance) ? CORE_VARYING_TOLERANCE : tolerance,
      .is_transport = core_solves(model),
      .shared = varying->shared.f64,
  };
  fault = core_surface_build(&inputs, &varying->words, &varying->words_count);
  return fault.field == NULL ? core_surface_share(varying) : fault;
}
