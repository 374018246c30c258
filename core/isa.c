/* Lists the instruction sets and finds which of them this machine runs. */
#include <string.h>

#include "core/kernels.h"

static bool portable_supported(void) {
  return true;
}

#if defined(__x86_64__) && !defined(CORE_PORTABLE_ALONE)
/* __builtin_cpu_supports() uses CPUID and, for the wide registers, XGETBV. */
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
#elif defined(__aarch64__) && !defined(CORE_PORTABLE_ALONE)
static bool neon_supported(void) {
  return true; /* each processor of this architecture has it */
}
#endif

#define LEVEL(level, unused) {#level, level##_supported, CORE_ISA_INDEX_##level},
static const core_isa levels[CORE_ISA_COUNT] = {CORE_ISA_LEVELS(LEVEL, )};

const core_isa *core_isa_select(const char *name) {
  for (size_t i = CORE_ISA_COUNT; i-- > 0;) {
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
  return index < CORE_ISA_COUNT ? levels[index].name : NULL;
}
