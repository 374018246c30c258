#include "core/tools/tradeoff/subjects.h"
#include "core/tools/tools.h"

#include <math.h>

enum { CHUNK = 256, RADII = 8 };

/* sigma_a over sigma_s where the limit of no absorption is meant */
#define ABSORPTION_LEAST 1e-20

/* ---- one subject ----------------------------------------------------------------------------- */

static core_fault prepare(core_profile *profile, unsigned model, unsigned evaluator,
                          const core_medium *medium, double tolerance) {
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
  return core_profile_prepare(profile, core_isa_select(NULL), model, CORE_MOMENTS_EXACT, evaluator,
                              medium, &parameters);
}

core_fault subjects_prepare(core_profile *profile, const subjects *all, const subject *of,
                            const core_medium *medium, double tolerance) {
  const unsigned model = all->models[of->model].model->id;
  core_medium limit = *medium;
  const core_fault fault = prepare(profile, model, of->evaluator->id, medium, tolerance);
  if (fault.field == NULL || medium->sigma_a_per_mm > 0) {
    return fault;
  }
  limit.sigma_a_per_mm = ABSORPTION_LEAST * medium->sigma_s_per_mm;
  return prepare(profile, model, of->evaluator->id, &limit, tolerance);
}

void subjects_evaluate(const core_profile *profile, size_t n, const double *r, double *R) {
  if (profile->evaluator == CORE_EVALUATOR_F64) {
    core_eval_f64(profile, CORE_QUANTITY_R, n, r, R);
    return;
  }
  for (size_t done = 0; done < n; done += CHUNK) {
    float in[CHUNK], out[CHUNK];
    const size_t count = n - done < CHUNK ? n - done : CHUNK;
    for (size_t i = 0; i < count; i++) {
      in[i] = (float)r[done + i];
    }
    core_eval_f32(profile, CORE_QUANTITY_R, count, in, out);
    for (size_t i = 0; i < count; i++) {
      R[done + i] = (double)out[i];
    }
  }
}

/* ---- which there are ------------------------------------------------------------------------- */

/* Returns why the comparison leaves a model out, or NULL if it does not. It leaves out a fit to
 * another model, a model that needs a parameter, and one that ignores the medium. */
static const char *why_left_out(unsigned model) {
  const core_medium medium = {0.05, 1, 0, 1.4};
  core_profile profile;
  if (model == CORE_MODEL_GAUSSIANS) {
    return "a fit, as far off as the model that it is fitted to";
  }
  const core_fault fault = prepare(&profile, model, CORE_EVALUATOR_F64, &medium, (double)NAN);
  if (fault.field != NULL) {
    return fault.field; /* the parameter that the model needs */
  }
  const bool fixed = (profile.notes & CORE_NOTE_MEDIUM_UNUSED) != 0;
  core_profile_free(&profile);
  return fixed ? "the same profile for every medium" : NULL;
}

/* Whether R is the same for media with the same sigma_s (1 - g) and different g. */
static bool is_similar(unsigned model) {
  static const double r[RADII] = {0.01, 0.03, 0.1, 0.3, 1, 3, 10, 20};
  static const double gs[] = {-0.4, 0.5, 0.9};
  const core_medium isotropic = {0.1, 1, 0, 1.4};
  core_profile profile;
  double R[RADII], truth[RADII];
  bool similar =
      prepare(&profile, model, CORE_EVALUATOR_F64, &isotropic, (double)NAN).field == NULL;
  if (!similar) {
    return false;
  }
  core_eval_f64(&profile, CORE_QUANTITY_R, RADII, r, truth);
  core_profile_free(&profile);
  for (size_t k = 0; k < sizeof gs / sizeof gs[0] && similar; k++) {
    const core_medium medium = {0.1, 1 / (1 - gs[k]), gs[k], 1.4};
    similar = prepare(&profile, model, CORE_EVALUATOR_F64, &medium, (double)NAN).field == NULL;
    if (similar) {
      core_eval_f64(&profile, CORE_QUANTITY_R, RADII, r, R);
      core_profile_free(&profile);
    }
    for (size_t i = 0; i < RADII && similar; i++) {
      similar = fabs(R[i] / truth[i] - 1) < 1e-9;
    }
  }
  return similar;
}

static void add(subjects *all, const core_choice *model) {
  const size_t index = all->model_count++;
  all->models[index] = (subject_model){model, is_similar(model->id)};
  for (const core_choice *evaluator = core_evaluators; evaluator->name != NULL; evaluator++) {
    if (all->count == SUBJECTS_MAX) {
      tools_fail("there are more evaluators than SUBJECTS_MAX allows");
    }
    all->all[all->count++] = (subject){index, evaluator};
  }
}

void subjects_find(subjects *all) {
  all->model_count = all->count = all->left_out_count = 0;
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    if (all->model_count + all->left_out_count == SUBJECTS_MODELS_MAX) {
      tools_fail("there are more models than SUBJECTS_MODELS_MAX allows");
    }
    const char *why = why_left_out(model->id);
    if (why == NULL) {
      add(all, model);
    } else {
      all->left_out[all->left_out_count].model = model;
      all->left_out[all->left_out_count++].why = why;
    }
  }
}
