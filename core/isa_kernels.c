/* Holds the kernels of the models by instruction set. The tables are immutable, and choosing
 * kernels means choosing a pointer. */
#include <assert.h>

#include "core/kernels.h"

/* Positions of the models in the table below. */
#define INDEX(id, IDENT, ...) INDEX_##IDENT,
enum model_index { CORE_EACH_MODEL(INDEX, CORE_NO_SUM) MODELS };

#define DECLARE(id, IDENT, name, formula, kernels, ...)                                            \
  CORE_ISA_LEVELS(CORE_KERNELS_DECLARE, kernels)
CORE_EACH_MODEL(DECLARE, CORE_NO_SUM)

#define KERNELS(id, IDENT, name, formula, kernels, ...)                                            \
  [INDEX_##IDENT] = {CORE_ISA_LEVELS(CORE_KERNELS, kernels)},
static const struct core_kernels kernels[MODELS][CORE_ISA_COUNT] = {
    CORE_EACH_MODEL(KERNELS, CORE_NO_SUM)};

const struct core_kernels *core_isa_kernels(const core_isa *isa, enum core_model model) {
  switch (model) {
#define CASE(id, IDENT, ...)                                                                       \
  case CORE_MODEL_##IDENT:                                                                         \
    return &kernels[INDEX_##IDENT][isa->index];
    CORE_EACH_MODEL(CASE, CORE_NO_SUM)
  default:
    break;
  }
  assert(!"a model of the list, not a sum");
  return NULL;
}
