/* Defines, for each instruction set, the tables of kernels that belong to no model. They are in a
 * file of their own, so a program that only evaluates tables links no other kernels. */
#include "core/kernels.h"

/* DEFINE(family) defines core_isa_<family>_kernels() of core/kernels.h. */
#define DEFINE(family)                                                                             \
  CORE_ISA_LEVELS(CORE_KERNELS_DECLARE, family)                                                    \
  const struct core_kernels *core_isa_##family##_kernels(const core_isa *isa) {                    \
    static const struct core_kernels kernels[] = {CORE_ISA_LEVELS(CORE_KERNELS, family)};          \
    return &kernels[isa->index];                                                                   \
  }

DEFINE(lut)
DEFINE(surface)
DEFINE(varying)
