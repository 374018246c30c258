#include "tests/accuracy/table_case.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* ---- media -------------------------------------------------------------------------------- */

static const double etas[] = {1, 1.3, 1.5, 2};
static const double ratios[] = {1e-4, 1e-2, 1, 10};
enum { ETAS = sizeof etas / sizeof etas[0], GRID = ETAS * sizeof ratios / sizeof ratios[0] };

size_t table_ordinary_count(void) {
  return GRID + 3 * core_measured_media_count;
}

struct table_place table_ordinary(size_t index) {
  const size_t count = table_ordinary_count();
  const size_t i = index * 23 % count; /* coprime to it */
  if (i < GRID) {
    const double ratio = ratios[i / ETAS];
    const core_medium medium = {ratio / (1 + ratio), 1 / (1 + ratio), 0, etas[i % ETAS]};
    return (struct table_place){medium, 3};
  }
  const size_t channel = i - GRID;
  return (struct table_place){core_measured_media[channel / 3].channel[channel % 3], 3};
}

const struct table_place table_extremes[] = {
    {{0, 1, 0, 1.3}, 3}, /* no absorption, */
    {{0, 2.5, 0, 0.7}, 3},
    {{0, 1, 0, 4}, 3},
    {{1e-20, 1, 0, 1.3}, 3}, /* next to none, */
    {{1e-7, 1, 0, 1.4}, 3},  /* little, */
    {{1e3, 1, 0, 1.3}, 3},   /* much, */
    {{1e8, 1, 0, 1.3}, 3},   /* as good as no scattering */
    {{0.1, 0.9, 0, 0.25}, 3},
    {{0.01, 1, 0, 0.7}, 3},
    {{0.03, 1, 0, 4}, 3},
    {{0.1, 10, 0.9, 1.4}, 3},
    {{0.1, 10, -0.8, 1.4}, 3},
    {{0.01, 100, 0.99, 1.4}, 3},
    {{1e-14, 1e-12, 0, 1.3}, 3},
    {{1e10, 1e12, 0, 1.3}, 3},
    {{0.03, 1, 0, 1.4}, 1.2}, /* thin and thick slabs */
    {{0.03, 1, 0, 1.4}, 1e5},
    {{0, 1, 0, 1.4}, 1e5},
    {{1e9, 1e14, 0, 0.4}, 3}, /* corners */
    {{0, 1e15, 0, 1000}, 3},
    {{1e-12, 1e-14, 0.99, 900}, 3},
    {{1e-300, 1, 0.999999999, 3}, 3},
    {{1e12, 1e4, 0, 0.25}, 3},
    {{1, 1e-15, 0, 1.3}, 3}, /* almost no light */
    {{0.1, 1e-30, 0, 1.3}, 3},
    {{1e-15, 2.3e-308, 0, 1.3}, 3}, /* R is too small for a double */
    {{1e-5, 1e-320, 0.9, 0.46}, 3},
};
const size_t table_extremes_count = sizeof table_extremes / sizeof table_extremes[0];

double table_mfp_mm(const core_medium *medium) {
  return 1 / (medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g));
}

/* ---- preparing ---------------------------------------------------------------------------- */

bool table_is_approximate(unsigned model) {
  return model == CORE_MODEL_TRANSPORT || model == CORE_MODEL_QUANTIZED ||
         model == CORE_MODEL_QUANTIZED_SINGLE;
}

core_parameters table_parameters(unsigned model, const struct table_place *place,
                                 double tolerance) {
  core_parameters parameters = core_parameters_none();
  const core_fault needs = core_profile_check(model, CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64,
                                              &place->medium, &parameters, NULL);
  if (needs.field != NULL && strcmp(needs.field, "thickness") == 0) {
    parameters.value[CORE_PARAMETER_THICKNESS] =
        place->thickness_mfp * table_mfp_mm(&place->medium);
  }
  parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
  return parameters;
}

static core_fault prepare(core_profile *profile, unsigned model, unsigned evaluator,
                          const struct table_place *place, double tolerance) {
  const core_parameters parameters = table_parameters(model, place, tolerance);
  return core_profile_prepare(profile, core_isa_select(NULL), model, CORE_MOMENTS_EXACT, evaluator,
                              &place->medium, &parameters);
}

core_fault table_truth(core_profile *truth, unsigned model, const struct table_place *place) {
  return prepare(truth, model, CORE_EVALUATOR_F64, place,
                 table_is_approximate(model) ? 1e-8 : (double)NAN);
}

core_fault table_prepare(core_profile *table, unsigned model, const struct table_place *place,
                         double tolerance) {
  return prepare(table, model, CORE_EVALUATOR_LUT, place, tolerance);
}

/* ---- errors ------------------------------------------------------------------------------- */

double table_error(float value, double truth) {
  const double off = fabs((double)value - truth);
  if (off <= 16 * 0x1p-149) {
    return 0;
  }
  /* What is too large for single precision is infinite in it, or next to that. */
  const double error =
      fmin(truth, (double)FLT_MAX) == (double)FLT_MAX && isinf(value) ? 0 : off / truth;
  return isnan(error) ? (double)INFINITY : error;
}
