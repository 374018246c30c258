/* subjects: lists the models that are measured, and those that are left out with the reason. */
#ifndef TRADEOFF_SUBJECTS_H
#define TRADEOFF_SUBJECTS_H

#include <stdbool.h>
#include <stddef.h>

#include "core/core.h"

enum { SUBJECTS_MODELS_MAX = 64, SUBJECTS_MAX = 4 * SUBJECTS_MODELS_MAX };

typedef struct subject_model {
  const core_choice *model;
  bool similarity; /* R was found to depend on g and sigma_s only as sigma_s (1 - g) */
} subject_model;

/* A model with an evaluator. */
typedef struct subject {
  size_t model; /* position in subjects.models */
  const core_choice *evaluator;
} subject;

typedef struct subjects {
  subject_model models[SUBJECTS_MODELS_MAX];
  size_t model_count;
  subject all[SUBJECTS_MAX]; /* by model, then evaluator, in the order of the lists */
  size_t count;
  struct {
    const core_choice *model;
    const char *why;
  } left_out[SUBJECTS_MODELS_MAX];
  size_t left_out_count;
} subjects;

/* Makes the lists from those of core's models and evaluators. */
void subjects_find(subjects *all);

/* Prepares a subject's profile for a medium with exact moments; NaN asks for the default tolerance.
 * A model that refuses a medium without absorption, as burley-dmfp does, is prepared with so little
 * of it that R is what it tends to. */
core_fault subjects_prepare(core_profile *profile, const subjects *all, const subject *of,
                            const core_medium *medium, double tolerance);

/* Evaluates R at n radii with the subject's evaluator; the values are converted to double. */
void subjects_evaluate(const core_profile *profile, size_t n, const double *r, double *R);

#endif
