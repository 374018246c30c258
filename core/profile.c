#include <assert.h>
#include <float.h>
#include <math.h>

#include "core/kernels.h"

#define CORE_MODEL(id, IDENT, name, family, variant, source)                                       \
  extern core_prepare_function core_##family##_prepare;
#include "core/models.def"
#undef CORE_MODEL

static void prepare_model(enum core_model model, enum core_moments moments,
                          const core_medium *medium, core_preparation *preparation) {
  switch (model) {
#define CORE_MODEL(id, IDENT, name, family, variant, source)                                       \
  case id:                                                                                         \
    core_##family##_prepare(variant, moments, medium, preparation);                                \
    return;
#include "core/models.def"
#undef CORE_MODEL
  }
  assert(!"a model of the list");
}

core_fault core_profile_check(unsigned model, unsigned moments, unsigned evaluator,
                              const core_medium *medium) {
  if (core_choice_by_id(core_models, model) == NULL) {
    return (core_fault){"model", "a model of the list", 0};
  }
  if (core_choice_by_id(core_moments_list, moments) == NULL) {
    return (core_fault){"moments", "moments of the list", 0};
  }
  if (core_choice_by_id(core_evaluators, evaluator) == NULL) {
    return (core_fault){"evaluator", "an evaluator of the list", 0};
  }
  const core_fault fault = core_medium_check(medium);
  return fault.field != NULL ? fault : core_fresnel_check(moments, medium->eta);
}

core_fault core_profile_prepare(core_profile *profile, const core_isa *isa, unsigned model,
                                unsigned moments, unsigned evaluator, const core_medium *medium) {
  const core_fault fault = core_profile_check(model, moments, evaluator, medium);
  if (fault.field != NULL) {
    return fault;
  }
  core_preparation preparation = {0};
  prepare_model(model, moments, medium, &preparation);
  const bool single = evaluator == CORE_EVALUATOR_F32;
  const double epsilon = single ? (double)FLT_EPSILON : DBL_EPSILON;
  *profile = (core_profile){
      .medium = *medium,
      .model = model,
      .moments = moments,
      .evaluator = evaluator,
      .albedo = preparation.albedo,
      .numerical_error = preparation.error_epsilons * epsilon,
      .numerical_error_per_mm = preparation.error_epsilons_per_mm * epsilon,
      .model_error = (double)NAN,
      .kernels = core_isa_kernels(isa, model),
  };
  for (int i = 0; i < CORE_COEFFICIENTS_MAX; i++) {
    if (single) {
      profile->coefficients.f32[i] = (float)preparation.coefficients[i];
    } else {
      profile->coefficients.f64[i] = preparation.coefficients[i];
    }
  }
  return (core_fault){0};
}

static enum core_elementwise position(enum core_quantity quantity) {
  switch (quantity) {
#define CORE_QUANTITY(bit, IDENT, name, unit, SHAPE)                                               \
  CORE_IF_##SHAPE(case CORE_QUANTITY_##IDENT : return CORE_ELEMENTWISE_##IDENT;)
#include "core/choices.def"
  default:
    assert(!"an elementwise quantity");
    return CORE_ELEMENTWISE_COUNT;
  }
}

void core_eval_f64(const core_profile *profile, enum core_quantity quantity, size_t n,
                   const double *r, double *out) {
  assert(profile->evaluator == CORE_EVALUATOR_F64);
  profile->kernels->f64->evaluate[position(quantity)](profile->coefficients.f64, n, r, out);
}

void core_eval_f32(const core_profile *profile, enum core_quantity quantity, size_t n,
                   const float *r, float *out) {
  assert(profile->evaluator == CORE_EVALUATOR_F32);
  profile->kernels->f32->evaluate[position(quantity)](profile->coefficients.f32, n, r, out);
}

void core_sample_f64(const core_profile *profile, size_t n, const double *u, double *r) {
  assert(profile->evaluator == CORE_EVALUATOR_F64);
  profile->kernels->f64->sample(profile->coefficients.f64, n, u, r);
}

void core_sample_f32(const core_profile *profile, size_t n, const float *u, float *r) {
  assert(profile->evaluator == CORE_EVALUATOR_F32);
  profile->kernels->f32->sample(profile->coefficients.f32, n, u, r);
}
