/* Checks and prepares profiles. */
#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/kernels.h"
#include "core/lut/lut.h"
#include "core/paths.h"
#include "core/ruler.h"

/* ---- the list, as a table -------------------------------------------------------------------- */

struct model {
  unsigned id;
  core_check_function *check; /* NULL for a sum of two models */
  core_prepare_function *prepare;
  int variant;
  unsigned parameters; /* a mask of the parameters that the model takes, and of the flags below */
  unsigned parts[2];   /* ids of the two models of a sum */
};

/* preparing takes more than a millisecond; no parameter has the ids 0 and 27 to 31 */
#define SLOW 1u
#define COSTLY (1u << 31)  /* preparing takes more than some ten microseconds */
#define SOLVES (1u << 30)  /* preparing may solve transport */
#define DERIVES (1u << 29) /* the model has derivatives of ln R */
#define SLABS (1u << 28)   /* the model takes a layer of finite thickness */
#define LAYERS (1u << 27)  /* the model takes several layers */
#define BIT(IDENT) (1u << CORE_PARAMETER_##IDENT)
#define MODULATES (BIT(INDEX) | BIT(MHZ)) /* it is an analytic function of sigma_a (core/paths.h) */
#define TAKEN_BY_ALL (BIT(TOLERANCE) | BIT(COS_IN) | BIT(COS_OUT))

#define MODEL(id, IDENT, name, formula, kernels, variant, parameters, source)                      \
  {id, core_##formula##_check, core_##formula##_prepare, variant, parameters, {0}},
#define SUM(id, IDENT, name, FIRST, SECOND, source)                                                \
  {id, NULL, NULL, 0, 0, {CORE_MODEL_##FIRST, CORE_MODEL_##SECOND}},
static const struct model models[] = {CORE_EACH_MODEL(MODEL, SUM)};

#define PI 3.14159265358979323846

enum { MODELS = sizeof models / sizeof models[0] };

static const struct model *find_model(unsigned id) {
  for (size_t i = 0; i < MODELS; i++) {
    if (models[i].id == id) {
      return &models[i];
    }
  }
  return NULL;
}

static unsigned parameters_of(const struct model *model) {
  if (model->check != NULL) {
    return model->parameters | TAKEN_BY_ALL | ((model->parameters & DERIVES) != 0 ? BIT(INDEX) : 0);
  }
  const unsigned first = parameters_of(find_model(model->parts[0]));
  const unsigned second = parameters_of(find_model(model->parts[1]));
  return (first | second) & ~(MODULATES & ~(first & second));
}

bool core_has_derivatives(unsigned model) {
  const struct model *found = find_model(model);
  return found != NULL && (found->check != NULL ? (found->parameters & DERIVES) != 0
                                                : core_has_derivatives(found->parts[0]) &&
                                                      core_has_derivatives(found->parts[1]));
}

/* Returns the model, or the one that it is fitted to. */
static const struct model *find_fitted(unsigned model, const core_parameters *parameters) {
  const struct model *found = find_model(model);
  const double fitted = parameters->value[CORE_PARAMETER_FIT_MODEL];
  return found != NULL && (parameters_of(found) & BIT(FIT_MODEL)) != 0 && !isnan(fitted)
             ? find_model((unsigned)fitted)
             : found;
}

unsigned core_ruler_of(unsigned model, const core_parameters *parameters) {
  const struct model *found = find_fitted(model, parameters);
  return found != NULL && (parameters_of(found) & SLABS) != 0 &&
                 (found->variant & CORE_SLAB_TRANSMITTED) != 0
             ? CORE_MODEL_TRANSPORT_TRANSMITTED
             : CORE_MODEL_TRANSPORT;
}

bool core_has_to_solve(unsigned model, const core_medium *medium,
                       const core_parameters *parameters) {
  const double *value = parameters->value;
  const struct model *found = find_fitted(model, parameters);
  const core_medium taken = core_transport_medium(medium, value[CORE_PARAMETER_GAMMA]);
  return found != NULL && (parameters_of(found) & SOLVES) != 0 &&
         (medium->thickness_mm > 0 ||
          !core_transport_is_looked_up(&taken, value[CORE_PARAMETER_TOLERANCE]));
}

bool core_prepares_slowly(unsigned model, unsigned evaluator, const core_medium *medium,
                          const core_parameters *parameters) {
  const struct model *found = find_model(model);
  return found != NULL && (evaluator == CORE_EVALUATOR_LUT || (parameters_of(found) & SLOW) != 0 ||
                           (medium == NULL ? (parameters_of(found) & SOLVES) != 0
                                           : core_has_to_solve(model, medium, parameters) ||
                                                 ((parameters_of(found) & SOLVES) != 0 &&
                                                  !isnan(parameters->value[CORE_PARAMETER_MHZ]))));
}

bool core_finds_albedo_slowly(unsigned model) {
  const struct model *found = find_model(model);
  return found != NULL && (parameters_of(found) & SLOW) != 0;
}

bool core_worth_keeping(unsigned model, unsigned evaluator, const core_parameters *parameters) {
  const struct model *found = find_model(model);
  return found != NULL &&
         (evaluator == CORE_EVALUATOR_LUT || (parameters_of(found) & (SLOW | COSTLY)) != 0 ||
          (parameters != NULL && !isnan(parameters->value[CORE_PARAMETER_MHZ])));
}

/* ---- checking -------------------------------------------------------------------------------- */

static const struct {
  unsigned id;
  const char *name;
  double least;
  double most;
  const char *range;
} parameter_ranges[] = {
#define RANGE(P, id, IDENT, name, about, unit, least, most)                                        \
  {id, name, least, most, #least " to " #most},
    CORE_EACH_PARAMETER(RANGE, )};

core_fault core_parameter_check(enum core_parameter parameter, double value) {
  for (size_t i = 0; i < sizeof parameter_ranges / sizeof parameter_ranges[0]; i++) {
    if (parameter_ranges[i].id == (unsigned)parameter &&
        !(value >= parameter_ranges[i].least && value <= parameter_ranges[i].most)) {
      return (core_fault){parameter_ranges[i].name, parameter_ranges[i].range, 0};
    }
  }
  return (core_fault){0};
}

static core_fault check_parameters(const struct model *model, const core_parameters *parameters) {
  const unsigned taken = parameters_of(model);
  for (size_t i = 0; i < sizeof parameter_ranges / sizeof parameter_ranges[0]; i++) {
    const double value = parameters->value[parameter_ranges[i].id];
    if (isnan(value)) {
      continue;
    }
    if ((taken & 1u << parameter_ranges[i].id) == 0) {
      return (core_fault){parameter_ranges[i].name, "nothing: this model does not take it", 0};
    }
    const core_fault fault = core_parameter_check(parameter_ranges[i].id, value);
    if (fault.field != NULL) {
      return fault;
    }
  }
  return (core_fault){0};
}

/* Checks that the model takes media of this number of layers, and a last layer of finite
 * thickness. */
static core_fault check_shape(const struct model *model, const core_inputs *inputs) {
  const unsigned taken = parameters_of(model), count = inputs->parameters->layer_count;
  const bool ends = inputs->medium[count - 1].thickness_mm > 0;
  if (count > 1 && (taken & LAYERS) == 0) {
    return (core_fault){"layer_count",
                        (taken & SLABS) != 0 ? "1 layer: transport takes several"
                                             : "1 layer, a half space: transport takes layers",
                        0};
  }
  if (ends && (taken & SLABS) == 0) {
    return (core_fault){"thickness",
                        "0, a half space, with this model: transport and multipoles take slabs", 0};
  }
  return !ends && !isnan(inputs->parameters->value[CORE_PARAMETER_ETA_BELOW])
             ? (core_fault){"eta_below", "nothing: the last layer is a half space", 0}
             : (core_fault){0};
}

/* Checks the inputs against the model's domain; for a sum, against the domains of both parts. */
static core_fault check_domain(const struct model *model, core_inputs inputs,
                               core_radii_range *radii) {
  inputs.variant = model->variant;
  if (model->check != NULL) {
    return model->check(&inputs, radii);
  }
  core_fault fault = check_domain(find_model(model->parts[0]), inputs, radii);
  if (fault.field == NULL) {
    fault = check_domain(find_model(model->parts[1]), inputs, radii);
  }
  return fault;
}

static core_fault check(const struct model *model, unsigned moments, unsigned evaluator,
                        const core_inputs *inputs, core_radii_range *radii) {
  if (model == NULL) {
    return (core_fault){"model", "a model of the list", 0};
  }
  if (core_choice_by_id(core_moments_list, moments) == NULL) {
    return (core_fault){"moments", "moments of the list", 0};
  }
  if (core_choice_by_id(core_evaluators, evaluator) == NULL) {
    return (core_fault){"evaluator", "an evaluator of the list", 0};
  }
  core_fault fault = core_layers_check(inputs->medium, inputs->parameters->layer_count);
  if (fault.field == NULL) {
    fault = core_fresnel_check(moments, inputs->medium->eta);
  }
  if (fault.field == NULL) {
    fault = check_parameters(model, inputs->parameters);
  }
  if (fault.field == NULL) {
    fault = check_shape(model, inputs);
  }
  if (fault.field == NULL && evaluator == CORE_EVALUATOR_LUT &&
      inputs->parameters->value[CORE_PARAMETER_TOLERANCE] < CORE_LUT_TOLERANCE_MIN) {
    fault = (core_fault){"tolerance", CORE_TEXT(CORE_LUT_TOLERANCE_MIN) " to 1 with lut", 0};
  }
  if (fault.field == NULL && !isnan(inputs->parameters->value[CORE_PARAMETER_DERIVATIVES]) &&
      !core_has_derivatives(model->id)) {
    fault = (core_fault){"wanted", "no derivatives: this model does not have them", 0};
  }
  *radii = (core_radii_range){0, (double)INFINITY};
  return fault.field == NULL ? check_domain(model, *inputs, radii) : fault;
}

core_fault core_profile_check(unsigned model, unsigned moments, unsigned evaluator,
                              const core_medium *medium, const core_parameters *parameters,
                              core_radii_range *radii) {
  const core_parameters none = core_parameters_none();
  const core_inputs inputs = {
      .moments = moments, .medium = medium, .parameters = parameters != NULL ? parameters : &none};
  core_radii_range range;
  const core_fault fault = check(find_model(model), moments, evaluator, &inputs, &range);
  if (fault.field == NULL && radii != NULL) {
    *radii = range;
  }
  return fault;
}

/* ---- preparing ------------------------------------------------------------------------------- */

/* Sets the note of an albedo that exceeds 1 by more than its error. Every evaluator computes the
 * albedo in double precision, so all evaluators set the same note. */
static void note_albedo(core_profile *profile, double error) {
  profile->notes |= profile->albedo > 1 + error ? CORE_NOTE_ALBEDO_ABOVE_1 : 0u;
}

/* Sets the numerical errors: `error` plus what the table of anisotropic scattering adds. */
static void set_numerical_errors(core_profile *profile, double error,
                                 const core_added_errors *added) {
  profile->numerical_error = error + added->all;
  for (size_t i = 0; i <= CORE_ERROR_BANDS; i++) {
    profile->numerical_errors[i] = error + added->banded[i];
  }
}

/* ---- derivatives ----------------------------------------------------------------------------- */

/* The error of derivatives relative to that of R, for models that do not state it. */
#define OWN_DERIVATIVE 4.0

/* Adds the error of rounding derivatives, computed in double precision, to single. rate: the
 * largest change of ln R per mm. */
static void round_derivatives(core_profile *profile, double rate) {
  profile->derivative_error += 8 * (double)FLT_EPSILON;
  profile->derivative_error_per_mm += (double)FLT_EPSILON * rate;
}

static bool rounds_derivatives(const core_profile *profile) {
  return profile->evaluator != CORE_EVALUATOR_F64 && !core_is_narrow(profile);
}

static void set_derivative_error(core_profile *profile, const core_preparation *preparation) {
  const bool own = preparation->derivative_error > 0;
  profile->derivative_error =
      own ? preparation->derivative_error : OWN_DERIVATIVE * profile->numerical_error;
  profile->derivative_error_per_mm =
      own ? preparation->derivative_error_per_mm : OWN_DERIVATIVE * profile->numerical_error_per_mm;
  memcpy(profile->derivative_errors, preparation->derivative_added.banded,
         sizeof profile->derivative_errors);
  if (rounds_derivatives(profile)) {
    round_derivatives(profile, fmax(preparation->error_epsilons_per_mm,
                                    2 * core_sigma_t_prime(&profile->medium)));
  }
}

static core_fault prepare(core_profile *profile, const struct model *model, core_inputs inputs,
                          core_radii_range radii);

static core_fault prepare_model(core_profile *profile, const struct model *model,
                                const core_inputs *inputs) {
  core_preparation preparation = {.cost = 1,
                                  .scale_mm = 1 / core_sigma_t_prime(inputs->medium),
                                  .reach = {.most_mm = (double)INFINITY}};
  const core_fault fault = model->prepare(inputs, &preparation);
  if (fault.field != NULL) {
    return fault;
  }
  profile->kernels = core_isa_kernels(inputs->isa, model->id);
  const bool single = profile->evaluator == CORE_EVALUATOR_F32;
  const bool wide = profile->kernels->f32->evaluate[0] == NULL;
  const double epsilon = single && !wide ? (double)FLT_EPSILON : DBL_EPSILON;
  profile->albedo = preparation.albedo;
  const double error = preparation.error + preparation.error_epsilons * epsilon +
                       (single && wide ? (double)FLT_EPSILON : 0);
  set_numerical_errors(profile, error, &preparation.added);
  if (preparation.slope_epsilons > 0) {
    profile->slope_error = profile->numerical_error + preparation.slope_epsilons * epsilon;
  } else {
    profile->slope_error = preparation.slope_error > 0 ? preparation.slope_error + epsilon : 0;
  }
  profile->numerical_error_per_mm = preparation.error_epsilons_per_mm * epsilon;
  profile->reach = preparation.reach;
  for (size_t i = 0; preparation.T_added.all > 0 && i <= CORE_ERROR_BANDS; i++) {
    profile->T_errors[i] = error + preparation.T_added.banded[i];
  }
  profile->T_reach = preparation.T_reach;
  memcpy(profile->balance, preparation.balance, sizeof profile->balance);
  profile->balance_error = preparation.balance_error;
  profile->notes = preparation.notes;
  note_albedo(profile,
              preparation.error + preparation.error_epsilons * DBL_EPSILON + preparation.added.all);
  profile->cost = preparation.cost;
  profile->scale_mm = preparation.scale_mm;
  profile->table = preparation.table;
  profile->table_bytes = preparation.table_bytes;
  for (int i = 0; i < CORE_COEFFICIENTS_MAX; i++) {
    if (single && !wide) {
      profile->coefficients.f32[i] = (float)preparation.coefficients[i];
    } else {
      profile->coefficients.f64[i] = preparation.coefficients[i];
    }
  }
  set_derivative_error(profile, &preparation);
  return fault;
}

/* The derivative of a sum is the mean of its parts' derivatives, weighted with R. So errors of R
 * contribute in proportion to the difference of the parts' derivatives. */
static void set_sum_derivative_error(core_profile *profile) {
  const core_profile *parts = profile->parts;
  const core_medium *medium = &profile->medium;
  const double rate = 4 * fmax(medium->eta, 1) * (medium->sigma_a_per_mm + medium->sigma_s_per_mm);
  const double numerical = fmax(parts[0].numerical_error, parts[1].numerical_error);
  profile->derivative_error =
      fmax(parts[0].derivative_error, parts[1].derivative_error) + 16 * numerical;
  profile->derivative_error_per_mm =
      fmax(parts[0].derivative_error_per_mm, parts[1].derivative_error_per_mm) +
      4 * numerical * rate;
  if (rounds_derivatives(profile)) {
    round_derivatives(profile, rate);
  }
}

/* Prepares both parts in double precision. Their sum is rounded once. */
static core_fault prepare_sum(core_profile *profile, const struct model *model,
                              const core_inputs *inputs, core_radii_range radii) {
  core_profile *parts = malloc(2 * sizeof *parts);
  if (parts == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  for (int i = 0; i < 2; i++) {
    parts[i] = (core_profile){.evaluator = CORE_EVALUATOR_F64};
    const core_fault fault = prepare(&parts[i], find_model(model->parts[i]), *inputs, radii);
    if (fault.field != NULL) {
      if (i == 1) {
        core_profile_free(&parts[0]);
      }
      free(parts);
      return fault;
    }
  }
  profile->parts = parts;
  profile->albedo = parts[0].albedo + parts[1].albedo;
  const bool scatters = profile->albedo > 0;
  profile->part_shares[0] = scatters ? parts[0].albedo / profile->albedo : 0;
  profile->part_shares[1] = scatters ? parts[1].albedo / profile->albedo : 0;
  const bool single = profile->evaluator == CORE_EVALUATOR_F32;
  const core_added_errors none = {{0}, 0};
  const double rounding = 2 * DBL_EPSILON + (single ? (double)FLT_EPSILON : 0);
  set_numerical_errors(profile, fmax(parts[0].numerical_error, parts[1].numerical_error) + rounding,
                       &none);
  const double slope = fmax(parts[0].slope_error, parts[1].slope_error);
  profile->slope_error = slope > 0 ? slope + rounding : 0;
  profile->numerical_error_per_mm =
      fmax(parts[0].numerical_error_per_mm, parts[1].numerical_error_per_mm);
  profile->reach =
      parts[0].reach.most_mm < parts[1].reach.most_mm ? parts[0].reach : parts[1].reach;
  profile->notes = (parts[0].notes | parts[1].notes) & ~(unsigned)CORE_NOTE_ALBEDO_ABOVE_1;
  note_albedo(profile, fmax(parts[0].numerical_error, parts[1].numerical_error) + 2 * DBL_EPSILON);
  profile->cost = parts[0].cost + parts[1].cost;
  profile->scale_mm = fmin(parts[0].scale_mm, parts[1].scale_mm);
  set_sum_derivative_error(profile);
  return (core_fault){0};
}

/* The tolerance for the profile from which a table is made, as a share of the table's tolerance. */
#define SOURCE_SHARE 0.0625

/* The same share for a profile whose error does not follow a tolerance. */
#define ACCEPTED_SHARE 0.5

/* A table states the largest error found between the nodes of the fits, times this. */
#define FOUND_MARGIN 1.1

/* Returns whether the model is fitted to another model. The tolerance of such a fit does not follow
 * from the table's. */
static bool fits(const struct model *model) {
  return (model->parameters & BIT(GAUSSIANS)) != 0;
}

/* Returns whether the error of a profile does not shrink with the tolerance, because it comes from
 * the table of solutions or from the solver. */
static bool keeps_error(const core_profile *source, double tolerance) {
  return source->numerical_errors[CORE_ERROR_BANDS] < source->numerical_error ||
         source->numerical_error > ACCEPTED_SHARE * tolerance;
}

static core_fault build_table(core_profile *profile, const struct model *model, double tolerance) {
  /* lut.error includes all rounding except that of the factors of 2 pi r R and the pdf. */
  const double rounding = 2 * (double)FLT_EPSILON;
  const core_profile *source = profile->source;
  const double spent = rounding + (fits(model)                      ? 0
                                   : keeps_error(source, tolerance) ? SOURCE_SHARE * tolerance
                                                                    : source->numerical_error);
  core_lut lut;
  const core_fault fault = core_lut_build(&lut, source, (tolerance - spent) / FOUND_MARGIN);
  if (fault.field == NULL) {
    profile->lut = lut.words;
    profile->lut_count = lut.count;
    const double own = FOUND_MARGIN * lut.error + rounding;
    profile->numerical_error = own + source->numerical_error;
    for (size_t i = 0; i <= CORE_ERROR_BANDS; i++) {
      profile->numerical_errors[i] = own + source->numerical_errors[i];
    }
    profile->slope_error = source->slope_error > 0 ? source->slope_error + rounding : 0;
  }
  return fault;
}

static bool is_tolerance(core_fault fault) {
  return fault.field != NULL && strcmp(fault.field, "tolerance") == 0;
}

/* Makes a table of the model in double precision. The profile keeps that model as its source, for
 * quantities that the table does not hold. */
static core_fault prepare_table(core_profile *profile, const struct model *model,
                                core_inputs inputs, core_radii_range radii) {
  core_parameters parameters = *inputs.parameters;
  const double asked = core_parameter_or(&inputs, CORE_PARAMETER_TOLERANCE, CORE_LUT_TOLERANCE);
  const double tolerance = fmin(asked, CORE_LUT_TOLERANCE_MAX);
  inputs.accepted = isnan(parameters.value[CORE_PARAMETER_TOLERANCE]) ? (double)INFINITY
                                                                      : ACCEPTED_SHARE * tolerance;
  parameters.value[CORE_PARAMETER_TOLERANCE] =
      fits(model) ? (double)NAN : fmin(SOURCE_SHARE * tolerance, CORE_LUT_TOLERANCE);
  inputs.parameters = &parameters;
  core_profile *source = malloc(sizeof *source);
  if (source == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  *source = (core_profile){.evaluator = CORE_EVALUATOR_F64};
  core_fault fault = prepare(source, model, inputs, radii);
  if (fault.field != NULL) {
    free(source);
    return fault;
  }
  *profile = *source;
  profile->evaluator = CORE_EVALUATOR_LUT;
  profile->kernels = core_isa_lut_kernels(inputs.isa);
  profile->source = source;
  profile->parts = NULL;
  profile->table = NULL;
  profile->table_bytes = 0;
  profile->cost = 1;
  for (size_t i = 0; i <= CORE_ERROR_BANDS; i++) {
    profile->T_errors[i] += source->T_errors[i] > 0 ? (double)FLT_EPSILON : 0;
  }
  fault = build_table(profile, model, tolerance);
  /* If a part of the error is independent of the tolerance, a table that misses the tolerance is
   * still useful and states its error. */
  for (double looser = 4 * tolerance;
       is_tolerance(fault) && keeps_error(source, tolerance) && looser <= 0.01; looser *= 4) {
    fault = build_table(profile, model, looser);
  }
  if (fault.field != NULL) {
    core_profile_free(profile);
    return fault;
  }
  const core_medium *medium = inputs.medium;
  round_derivatives(profile,
                    2 * fmax(medium->eta, 1) * (medium->sigma_a_per_mm + medium->sigma_s_per_mm));
  return fault;
}

static double given_or_1(double value) {
  return isnan(value) ? 1 : value;
}

void core_profile_set_angles(core_profile *profile, const core_parameters *parameters) {
  profile->cos_in = given_or_1(parameters->value[CORE_PARAMETER_COS_IN]);
  profile->cos_out = given_or_1(parameters->value[CORE_PARAMETER_COS_OUT]);
}

static core_fault prepare(core_profile *profile, const struct model *model, core_inputs inputs,
                          core_radii_range radii) {
  const enum core_evaluator evaluator = profile->evaluator;
  *profile = (core_profile){
      .medium = *inputs.medium,
      .model = model->id,
      .moments = inputs.moments,
      .evaluator = evaluator,
      .radii = radii,
  };
  core_profile_set_angles(profile, inputs.parameters);
  const size_t layer = (size_t)core_parameter_or(&inputs, CORE_PARAMETER_DERIVATIVE_LAYER, 1) - 1;
  profile->path_sigma_a_per_mm = inputs.medium[layer].sigma_a_per_mm;
  profile->path_index = core_parameter_or(&inputs, CORE_PARAMETER_INDEX, inputs.medium[layer].eta);
  inputs.variant = model->variant;
  const core_fault fault = evaluator == CORE_EVALUATOR_LUT
                               ? prepare_table(profile, model, inputs, radii)
                           : model->check != NULL ? prepare_model(profile, model, &inputs)
                                                  : prepare_sum(profile, model, &inputs, radii);
  if (fault.field == NULL) {
    profile->notes |= isnan(inputs.parameters->value[CORE_PARAMETER_GAMMA]) ? 0u : CORE_NOTE_GAMMA;
  }
  return fault;
}

/* ---- modulated light ------------------------------------------------------------------------- */

/* Prepares the model for the medium of a node. least: sigma_a of the layer that absorbs least. share:
 * its layers' indices over the largest one. */
static core_fault prepare_node(core_profile *node, const struct model *model, core_inputs inputs,
                               double more_per_mm, const double *share) {
  core_medium medium[CORE_LAYERS_MAX];
  for (uint32_t i = 0; i < inputs.parameters->layer_count; i++) {
    medium[i] = inputs.medium[i];
    medium[i].sigma_a_per_mm = fmax(0, medium[i].sigma_a_per_mm + more_per_mm * share[i]);
  }
  inputs.medium = medium;
  core_radii_range radii;
  core_fault fault = check(model, inputs.moments, CORE_EVALUATOR_F64, &inputs, &radii);
  *node = (core_profile){.evaluator = CORE_EVALUATOR_F64};
  fault = fault.field != NULL ? fault : prepare(node, model, inputs, radii);
  const bool of_node = fault.field != NULL && strcmp(fault.field, CORE_FIELD_MEMORY) != 0 &&
                       strcmp(fault.field, CORE_FIELD_STOPPED) != 0;
  return of_node ? (core_fault){"mhz", "less: the model does not cover as much absorption", 0}
                 : fault;
}

/* The largest error of R with which many nodes are taken. */
#define NODES_MANY_ERROR 1e-4

static core_fault prepare_modulation(core_profile *profile, const struct model *model,
                                     core_inputs inputs) {
  const double mhz = inputs.parameters->value[CORE_PARAMETER_MHZ];
  const uint32_t layers = inputs.parameters->layer_count;
  double share[CORE_LAYERS_MAX], index = 0, least = (double)INFINITY;
  for (uint32_t i = 0; i < layers; i++) {
    share[i] = core_parameter_or(&inputs, CORE_PARAMETER_INDEX, inputs.medium[i].eta);
    index = fmax(index, share[i]);
  }
  for (uint32_t i = 0; i < layers; i++) {
    share[i] /= index;
    least = fmin(least, inputs.medium[i].sigma_a_per_mm / share[i]);
  }
  core_parameters parameters = *inputs.parameters;
  parameters.value[CORE_PARAMETER_MHZ] = parameters.value[CORE_PARAMETER_DERIVATIVES] = (double)NAN;
  if (profile->evaluator == CORE_EVALUATOR_LUT) {
    parameters.value[CORE_PARAMETER_TOLERANCE] = (double)NAN; /* it is the table's */
  }
  inputs.parameters = &parameters;
  core_modulation *made = profile->modulation = calloc(1, sizeof *made);
  if (made == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  if (!(mhz > 0)) {
    return (core_fault){0};
  }
  made->here = sqrt(least);
  made->there = core_modulated_u(least, 2e-6 * PI * mhz * index / CORE_LIGHT_SPEED_MM_PER_PS);
  made->nodes = core_nodes_around(profile->numerical_error > NODES_MANY_ERROR, 0, made->there);
  core_fault fault = {0};
  for (unsigned i = 0; i < made->nodes.count && fault.field == NULL; i++) {
    const double u = made->nodes.u[i];
    fault = prepare_node(&made->node[i], model, inputs, u * u - least, share);
  }
  return fault;
}

/* ---- path lengths ---------------------------------------------------------------------------- */

/* Whether a model's derivative by ln sigma_a is in proportion to sigma_a where that is low, and its
 * rounding error is, too. */
static bool has_faint_paths(const struct model *model) {
  return core_has_derivatives(model->id) &&
         (parameters_of(model) & (MODULATES | SOLVES)) == MODULATES;
}

/* sigma_a over sigma_t' from which on a profile's own derivative gives PATH, and the least one that
 * stands for 0: up to 1e100 mean free paths R is the same there as at 0. */
#define FAINT 1e-3
#define FAINTEST 0x1p-800

static core_fault prepare_paths(core_profile *profile, const struct model *model,
                                core_inputs inputs) {
  const double sigma_t_prime = core_sigma_t_prime(inputs.medium);
  core_medium medium = *inputs.medium;
  medium.sigma_a_per_mm = fmax(medium.sigma_a_per_mm, FAINTEST * sigma_t_prime);
  if (!(medium.sigma_a_per_mm < FAINT * sigma_t_prime)) {
    return (core_fault){0};
  }
  inputs.medium = &medium;
  profile->paths = malloc(sizeof *profile->paths);
  if (profile->paths == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  profile->paths->evaluator = CORE_EVALUATOR_F64;
  return prepare(profile->paths, model, inputs, profile->radii);
}

core_fault core_paths_check(unsigned model, unsigned wanted, const core_medium *medium,
                            const core_parameters *parameters) {
  const double layer = parameters->value[CORE_PARAMETER_DERIVATIVE_LAYER];
  const size_t at = isnan(layer) ? 0 : (size_t)layer - 1;
  if ((wanted & CORE_PATHS) != 0 && !(medium[at].sigma_a_per_mm > 0) &&
      !has_faint_paths(find_model(model))) {
    return (core_fault){
        "sigma_a", "above 0 with path, dpf and time of this model: dipoles and single have a limit",
        at};
  }
  return (wanted & CORE_MODULATED) != 0 && isnan(parameters->value[CORE_PARAMETER_MHZ])
             ? (core_fault){"mhz", "a frequency: phase and modulation need it", 0}
             : (core_fault){0};
}

static core_fault check_and_prepare(core_profile *profile, unsigned model, unsigned evaluator,
                                    const core_inputs *inputs) {
  const struct model *found = find_model(model);
  core_radii_range radii;
  const core_fault fault = check(found, inputs->moments, evaluator, inputs, &radii);
  if (fault.field != NULL) {
    return fault;
  }
  profile->evaluator = evaluator;
  core_fault made = prepare(profile, found, *inputs, radii);
  if (made.field != NULL) {
    return made;
  }
  if (!isnan(inputs->parameters->value[CORE_PARAMETER_MHZ])) {
    made = prepare_modulation(profile, found, *inputs);
  }
  if (made.field == NULL && !isnan(inputs->parameters->value[CORE_PARAMETER_DERIVATIVES]) &&
      has_faint_paths(found)) {
    made = prepare_paths(profile, found, *inputs);
  }
  if (made.field != NULL) {
    core_profile_free(profile);
  }
  return made;
}

core_fault core_profile_prepare(core_profile *profile, const core_isa *isa, unsigned model,
                                unsigned moments, unsigned evaluator, const core_medium *medium,
                                const core_parameters *parameters) {
  return core_profile_prepare_until(profile, isa, model, moments, evaluator, medium, parameters,
                                    NULL);
}

core_fault core_profile_prepare_until(core_profile *profile, const core_isa *isa, unsigned model,
                                      unsigned moments, unsigned evaluator,
                                      const core_medium *medium, const core_parameters *parameters,
                                      const atomic_bool *stop) {
  const core_parameters none = core_parameters_none();
  const core_inputs inputs = {
      .moments = moments,
      .medium = medium,
      .parameters = parameters != NULL ? parameters : &none,
      .isa = isa,
      .stop = stop,
  };
  return check_and_prepare(profile, model, evaluator, &inputs);
}

core_fault core_albedo(const core_isa *isa, unsigned model, unsigned moments, enum core_light light,
                       const core_medium *medium, double *albedo, double *error) {
  assert(light == CORE_LIGHT_BEAM || core_solves(model));
  const core_parameters none = core_parameters_none();
  const core_inputs inputs = {.moments = moments,
                              .medium = medium,
                              .parameters = &none,
                              .isa = isa,
                              .only_albedo = true,
                              .light = light};
  core_profile profile;
  const core_fault fault = check_and_prepare(&profile, model, CORE_EVALUATOR_F64, &inputs);
  *albedo = *error = (double)NAN;
  if (fault.field == NULL) {
    *albedo = profile.albedo;
    *error = profile.numerical_errors[CORE_ERROR_BANDS];
    core_profile_free(&profile);
  }
  return fault;
}
