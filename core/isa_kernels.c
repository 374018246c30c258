/* Holds the kernels of the models by instruction set. The tables are immutable, and choosing
 * kernels means choosing a pointer. */
#include <assert.h>

#include "core/kernels.h"

/* Positions of the models in the tables below. */
enum model_index {
#define CORE_MODEL(id, IDENT, name, formula, kernels, variant, parameters, source) INDEX_##IDENT,
#include "core/models.def"
  MODELS
};

#define CORE_MODEL(id, IDENT, name, formula, kernels, variant, parameters, source)                 \
  CORE_ISA_LEVELS(CORE_KERNELS_DECLARE, kernels)
#include "core/models.def"

static const struct core_kernels kernels[MODELS][CORE_ISA_COUNT] = {
#define CORE_MODEL(id, IDENT, name, formula, kernels, variant, parameters, source)                 \
  [INDEX_##IDENT] = {CORE_ISA_LEVELS(CORE_KERNELS, kernels)},
#include "core/models.def"
};

const struct core_kernels *core_isa_kernels(const core_isa *isa, enum core_model model) {
  switch (model) {
#define CORE_MODEL(id, IDENT, name, formula, family, variant, parameters, source)                  \
  case CORE_MODEL_##IDENT:                                                                         \
    return &kernels[INDEX_##IDENT][isa->index];
#include "core/models.def"
  default:
    break;
  }
  assert(!"a model of the list, not a sum");
  return NULL;
}
