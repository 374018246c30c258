/* subjects: which models are measured, and which are left out and why. */
#ifndef TRADEOFF_SUBJECTS_H
#define TRADEOFF_SUBJECTS_H

#include <stdbool.h>
#include <stddef.h>

#include "core/core.h"

enum { SUBJECTS_MODELS_MAX = 64, SUBJECTS_MAX = 4 * SUBJECTS_MODELS_MAX };

typedef struct subject_model {
  const core_choice *model;
  bool similarity; /* depends on g and sigma_s through sigma_s (1 - g) alone, as it was seen to */
} subject_model;

/* A model with an evaluator. */
typedef struct subject {
  size_t model; /* position in the models */
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

/* Goes through the lists of models and evaluators. */
void subjects_find(subjects *all);

/* A profile of a subject for a medium, exact moments; tolerance: NaN for the default. */
core_fault subjects_prepare(core_profile *profile, const subjects *all, const subject *of,
                            const core_medium *medium, double tolerance);

/* R at n radii, in double precision, by the subject's evaluator. */
void subjects_evaluate(const core_profile *profile, size_t n, const double *r, double *R);

#endif
