/* Holds the kernels of tables by instruction set. They are in a file of their own, so that a
 * program that only evaluates tables links no other kernels. */
#include "core/kernels.h"

#define INDEX(level, unused) INDEX_##level,
enum level_index { CORE_ISA_LEVELS(INDEX, ) LEVELS };

#define DECLARE(level, unused)                                                                     \
  extern const core_kernels_f64 core_kernels_lut_##level##_f64;                                    \
  extern const core_kernels_f32 core_kernels_lut_##level##_f32;
CORE_ISA_LEVELS(DECLARE, )

#define KERNELS(level, unused)                                                                     \
  [INDEX_##level] = {&core_kernels_lut_##level##_f64, &core_kernels_lut_##level##_f32},
static const struct core_kernels kernels[LEVELS] = {CORE_ISA_LEVELS(KERNELS, )};

const struct core_kernels *core_isa_lut_kernels(const core_isa *isa) {
  return &kernels[isa->index];
}
