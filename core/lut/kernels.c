/* Defines, for each instruction set, the tables of kernels that belong to no model. They are in a
 * file of their own, so a program that only evaluates tables links no other kernels. */
#include "core/kernels.h"

#define INDEX(level, unused) INDEX_##level,
enum level_index { CORE_ISA_LEVELS(INDEX, ) LEVELS };

#define KERNELS(level, family)                                                                     \
  [INDEX_##                                                                                        \
      level] = {&core_kernels_##family##_##level##_f64, &core_kernels_##family##_##level##_f32},
#define DECLARE(level, family)                                                                     \
  extern const core_kernels_f64 core_kernels_##family##_##level##_f64;                             \
  extern const core_kernels_f32 core_kernels_##family##_##level##_f32;

/* DEFINE(family) defines core_isa_<family>_kernels() of core/kernels.h. */
#define DEFINE(family)                                                                             \
  CORE_ISA_LEVELS(DECLARE, family)                                                                 \
  static const struct core_kernels family##_kernels[LEVELS] = {CORE_ISA_LEVELS(KERNELS, family)};  \
  const struct core_kernels *core_isa_##family##_kernels(const core_isa *isa) {                    \
    return &family##_kernels[isa->index];                                                          \
  }

DEFINE(lut)
DEFINE(surface)
DEFINE(varying)
