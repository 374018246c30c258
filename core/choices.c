#include <string.h>

#include "core/core.h"

#define END                                                                                        \
  { 0, NULL, NULL }

const core_choice core_models[] = {
#define CORE_MODEL(id, IDENT, name, family, variant, source) {id, name, source},
#include "core/models.def"
#undef CORE_MODEL
    END,
};

#define CORE_EVALUATOR(id, IDENT, name, about) {id, name, about},
const core_choice core_evaluators[] = {
#include "core/choices.def"
    END,
};

#define CORE_MOMENTS(id, IDENT, name, eta_min, eta_max, about) {id, name, about},
const core_choice core_moments_list[] = {
#include "core/choices.def"
    END,
};

#define CORE_QUANTITY(bit, IDENT, name, unit, SHAPE) {bit, name, unit},
const core_choice core_quantities[] = {
#include "core/choices.def"
    END,
};

#define CORE_SPACING(id, IDENT, name, about) {id, name, about},
const core_choice core_spacings[] = {
#include "core/choices.def"
    END,
};

#define ELEMENTWISE true
#define CHANNEL false
#define RADII false
bool core_quantity_elementwise(unsigned bit) {
  switch (bit) {
#define CORE_QUANTITY(bit, IDENT, name, unit, SHAPE)                                               \
  case bit:                                                                                        \
    return SHAPE;
#include "core/choices.def"
  default:
    return false;
  }
}

const core_choice *core_choice_by_id(const core_choice *list, unsigned id) {
  for (; list->name != NULL; list++) {
    if (list->id == id) {
      return list;
    }
  }
  return NULL;
}

const core_choice *core_choice_by_name(const core_choice *list, const char *name) {
  for (; list->name != NULL; list++) {
    if (strcmp(list->name, name) == 0) {
      return list;
    }
  }
  return NULL;
}
