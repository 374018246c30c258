#include <ctype.h>
#include <math.h>
#include <string.h>

#include "core/varying.h"

#define END                                                                                        \
  { 0, NULL, NULL }

#define MODEL(id, IDENT, name, formula, kernels, variant, parameters, source) {id, name, source},
#define SUM(id, IDENT, name, FIRST, SECOND, source) {id, name, source},
const core_choice core_models[] = {CORE_EACH_MODEL(MODEL, SUM) END};

#define ENTRY(P, id, IDENT, name, about, ...) {id, name, about},
#define PARAMETER(P, id, IDENT, name, about, unit, least, most)                                    \
  {id, name, unit ": " about " (" #least " to " #most ")"},
const core_choice core_evaluators[] = {CORE_EACH_EVALUATOR(ENTRY, ) END};
const core_choice core_moments_list[] = {CORE_EACH_MOMENTS(ENTRY, ) END};
const core_choice core_quantities[] = {CORE_EACH_QUANTITY(ENTRY, ) END};
const core_choice core_spacings[] = {CORE_EACH_SPACING(ENTRY, ) END};
const core_choice core_draws[] = {CORE_EACH_DRAW(ENTRY, ) END};
const core_choice core_lengths[] = {CORE_EACH_LENGTH(ENTRY, ) END};
const core_choice core_phases[] = {CORE_EACH_PHASE(ENTRY, ) END};
const core_choice core_parameter_list[] = {CORE_EACH_PARAMETER(PARAMETER, ) END};
const core_choice core_coefficients[] = {CORE_EACH_COEFFICIENT(ENTRY, ) END};
const core_choice core_unknowns[] = {CORE_EACH_UNKNOWN(ENTRY, ) END};
const core_choice core_lights[] = {CORE_EACH_LIGHT(ENTRY, ) END};
const core_choice core_notes[] = {CORE_EACH_NOTE(ENTRY, ) END};
const core_choice core_fit_scales[] = {CORE_EACH_FIT_SCALE(ENTRY, ) END};
const core_choice core_fit_axes[] = {CORE_EACH_FIT_AXIS(ENTRY, ) END};
const core_choice core_fit_statuses[] = {CORE_EACH_FIT_STATUS(ENTRY, ) END};
const core_choice core_value_statuses[] = {CORE_EACH_VALUE(ENTRY, ) END};

size_t core_evaluator_bytes(unsigned evaluator) {
  switch (evaluator) {
#define BYTES_OF(P, id, IDENT, name, about, number)                                                \
  case id:                                                                                         \
    return sizeof(number);
    CORE_EACH_EVALUATOR(BYTES_OF, )
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
#define IS_SOLVED(id, IDENT, name, formula, kernels, variant, parameters, source)                  \
  case id:                                                                                         \
    return ((parameters)&SOLVES) != 0;
    CORE_EACH_MODEL(IS_SOLVED, CORE_NO_SUM)
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
