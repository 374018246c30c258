/* Which kernels a machine runs. The tables are immutable; choosing one is choosing a pointer. */
#include <assert.h>
#include <string.h>

#include "core/kernels.h"

/* Positions of the models in the tables below. */
enum model_index {
#define CORE_MODEL(id, IDENT, name, formula, kernels, variant, parameters, source) INDEX_##IDENT,
#include "core/models.def"
  MODELS
};

#define INDEX(level, unused) INDEX_##level,
enum level_index { CORE_ISA_LEVELS(INDEX, ) LEVELS };

#define DECLARE(level, family)                                                                     \
  extern const core_kernels_f64 core_kernels_##family##_##level##_f64;                             \
  extern const core_kernels_f32 core_kernels_##family##_##level##_f32;
#define CORE_MODEL(id, IDENT, name, formula, kernels, variant, parameters, source)                 \
  CORE_ISA_LEVELS(DECLARE, kernels)
#include "core/models.def"

CORE_ISA_LEVELS(DECLARE, lut)

#define KERNELS(level, family)                                                                     \
  [INDEX_##                                                                                        \
      level] = {&core_kernels_##family##_##level##_f64, &core_kernels_##family##_##level##_f32},
static const struct core_kernels kernels[MODELS][LEVELS] = {
#define CORE_MODEL(id, IDENT, name, formula, kernels, variant, parameters, source)                 \
  [INDEX_##IDENT] = {CORE_ISA_LEVELS(KERNELS, kernels)},
#include "core/models.def"
};

static const struct core_kernels lut_kernels[LEVELS] = {CORE_ISA_LEVELS(KERNELS, lut)};

struct core_isa {
  const char *name;
  bool (*supported)(void);
};

static bool portable_supported(void) {
  return true;
}

#if defined(__x86_64__)
/* The compiler's run-time support asks CPUID and, for the wide registers, XGETBV. */
static bool sse2_supported(void) {
  return true;
}

static bool avx2_supported(void) {
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
}

static bool avx512_supported(void) {
  return avx2_supported() && __builtin_cpu_supports("avx512f") &&
         __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
}
#endif

#define LEVEL(level, unused) {#level, level##_supported},
static const core_isa levels[LEVELS] = {CORE_ISA_LEVELS(LEVEL, )};

const core_isa *core_isa_select(const char *name) {
  for (size_t i = LEVELS; i-- > 0;) {
    if ((name == NULL || strcmp(levels[i].name, name) == 0) && levels[i].supported()) {
      return &levels[i];
    }
  }
  return NULL;
}

const char *core_isa_name(const core_isa *isa) {
  return isa->name;
}

const char *core_isa_listed(size_t index) {
  return index < LEVELS ? levels[index].name : NULL;
}

const struct core_kernels *core_isa_kernels(const core_isa *isa, enum core_model model) {
  switch (model) {
#define CORE_MODEL(id, IDENT, name, formula, family, variant, parameters, source)                  \
  case CORE_MODEL_##IDENT:                                                                         \
    return &kernels[INDEX_##IDENT][isa - levels];
#include "core/models.def"
  default:
    break;
  }
  assert(!"a model of the list, not a sum");
  return NULL;
}

const struct core_kernels *core_isa_lut_kernels(const core_isa *isa) {
  return &lut_kernels[isa - levels];
}
