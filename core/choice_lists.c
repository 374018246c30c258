#include <ctype.h>
#include <math.h>
#include <string.h>

#include "core/varying.h"

#define END                                                                                        \
  { 0, NULL, NULL }

const core_choice core_models[] = {
#define CORE_MODEL(id, IDENT, name, formula, kernels, variant, parameters, source)                 \
  {id, name, source},
#define CORE_SUM(id, IDENT, name, FIRST, SECOND, source) {id, name, source},
#include "core/models.def"
    END,
};

#define CORE_EVALUATOR(id, IDENT, name, number, about) {id, name, about},
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

#define CORE_DRAW(id, IDENT, name, about) {id, name, about},
const core_choice core_draws[] = {
#include "core/choices.def"
    END,
};

#define CORE_LENGTH(id, IDENT, name, about) {id, name, about},
const core_choice core_lengths[] = {
#include "core/choices.def"
    END,
};

#define CORE_PHASE(id, IDENT, name, about) {id, name, about},
const core_choice core_phases[] = {
#include "core/choices.def"
    END,
};

#define CORE_PARAMETER(id, IDENT, name, unit, least, most, about)                                  \
  {id, name, unit ": " about " (" #least " to " #most ")"},
const core_choice core_parameter_list[] = {
#include "core/choices.def"
    END,
};

#define CORE_COEFFICIENT(bit, IDENT, name, about) {bit, name, about},
const core_choice core_coefficients[] = {
#include "core/choices.def"
    END,
};

#define CORE_UNKNOWN(bit, IDENT, name, about) {bit, name, about},
const core_choice core_unknowns[] = {
#include "core/choices.def"
    END,
};

#define CORE_LIGHT(id, IDENT, name, about) {id, name, about},
const core_choice core_lights[] = {
#include "core/choices.def"
    END,
};

#define CORE_NOTE(bit, IDENT, name, about) {bit, name, about},
const core_choice core_notes[] = {
#include "core/choices.def"
    END,
};

#define CORE_FIT_SCALE(id, IDENT, name, about) {id, name, about},
const core_choice core_fit_scales[] = {
#include "core/choices.def"
    END,
};

#define CORE_FIT_AXIS(id, IDENT, name, about) {id, name, about},
const core_choice core_fit_axes[] = {
#include "core/choices.def"
    END,
};

#define CORE_FIT_STATUS(id, IDENT, name, about) {id, name, about},
const core_choice core_fit_statuses[] = {
#include "core/choices.def"
    END,
};

#define CORE_VALUE(id, IDENT, name, allowed) {id, name, allowed},
const core_choice core_value_statuses[] = {
#include "core/choices.def"
    END,
};

#define ELEMENTWISE true
#define CHANNEL false
#define RADII false
#define COMPARED true
#define DERIVED true
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

size_t core_evaluator_bytes(unsigned evaluator) {
  switch (evaluator) {
#define CORE_EVALUATOR(id, IDENT, name, number, about)                                             \
  case id:                                                                                         \
    return sizeof(number);
#include "core/choices.def"
  default:
    return 0;
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
    if (list->name[0] == name[0] && strcmp(list->name, name) == 0) {
      return list;
    }
  }
  return NULL;
}

bool core_solves(unsigned model) {
  enum { SLOW = 0, COSTLY = 0, DERIVES = 0, MODULATES = 0, SLABS = 0, LAYERS = 0, SOLVES = 1 };
#define BIT(IDENT) 0
  switch (model) {
#define CORE_MODEL(id, IDENT, name, formula, kernels, variant, parameters, source)                 \
  case id:                                                                                         \
    return ((parameters)&SOLVES) != 0;
#include "core/models.def"
  default:
    return false;
  }
#undef BIT
}

static int folded(char c) {
  return c == '-' ? '_' : tolower((unsigned char)c);
}

/* Levenshtein (1966). cost[k] is the distance of what has been read of `a` to the first k
 * characters of `b`. */
unsigned core_name_distance(const char *a, const char *b) {
  enum { MOST = 64 };
  unsigned cost[MOST + 1];
  const size_t a_length = strnlen(a, MOST), b_length = strnlen(b, MOST);
  for (size_t k = 0; k <= b_length; k++) {
    cost[k] = (unsigned)k;
  }
  for (size_t i = 0; i < a_length; i++) {
    unsigned diagonal = cost[0];
    cost[0] = (unsigned)i + 1;
    for (size_t k = 1; k <= b_length; k++) {
      const unsigned replaced = diagonal + (folded(a[i]) != folded(b[k - 1]));
      const unsigned shorter = (cost[k] < cost[k - 1] ? cost[k] : cost[k - 1]) + 1;
      diagonal = cost[k];
      cost[k] = replaced < shorter ? replaced : shorter;
    }
  }
  return cost[b_length];
}

core_parameters core_parameters_none(void) {
  core_parameters parameters = {.layer_count = 1};
  for (size_t i = 0; i < CORE_PARAMETERS_END; i++) {
    parameters.value[i] = (double)NAN;
  }
  return parameters;
}
