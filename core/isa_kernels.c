/* Holds the kernels of the models by instruction set. The tables are immutable, and choosing
 * kernels means choosing a pointer. */
#include <assert.h>
#include <string.h>

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

/* So many numbers are copied for one call, rather than two. */
enum { COPIED = 4 * CORE_LANES_MOST };

#define DEFINE_RUN(bits, real)                                                                     \
  void core_run_##bits(const core_kernels_##bits *of, core_kernel_##bits *kernel,                  \
                       const real *coefficients, size_t n, const real *in, real *out) {            \
    const size_t lanes = of->lanes, left = n & (lanes - 1);                                        \
    const size_t direct = left > 0 && n <= COPIED ? 0 : n - left;                                  \
    if (direct > 0) {                                                                              \
      kernel(coefficients, direct, in, out);                                                       \
    }                                                                                              \
    if (direct < n) {                                                                              \
      real copied[COPIED + CORE_LANES_MOST], found[COPIED + CORE_LANES_MOST];                      \
      const size_t count = n - direct, whole = (count + lanes - 1) & ~(lanes - 1);                 \
      memcpy(copied, in + direct, count * sizeof *in);                                             \
      for (size_t i = count; i < whole; i++) {                                                     \
        copied[i] = in[n - 1];                                                                     \
      }                                                                                            \
      kernel(coefficients, whole, copied, found);                                                  \
      memcpy(out + direct, found, count * sizeof *out);                                            \
    }                                                                                              \
  }

DEFINE_RUN(f64, double)
DEFINE_RUN(f32, float)
