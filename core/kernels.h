/* kernels: the tables of elementwise functions that a profile evaluates with. Internal to core. */
#ifndef DIPOLED_CORE_KERNELS_H
#define DIPOLED_CORE_KERNELS_H

#include "core/core.h"

/* The instruction sets that kernels are compiled for, worst first; the Makefile holds the compiler
 * flags of each under the same names. X(level, ...) */
#if defined(__x86_64__)
#define CORE_ISA_LEVELS(X, ...)                                                                    \
  X(portable, __VA_ARGS__) X(sse2, __VA_ARGS__) X(avx2, __VA_ARGS__) X(avx512, __VA_ARGS__)
#else
#define CORE_ISA_LEVELS(X, ...) X(portable, __VA_ARGS__)
#endif

/* Positions of the elementwise quantities, in the order of the list. */
#define CORE_IF_ELEMENTWISE(...) __VA_ARGS__
#define CORE_IF_CHANNEL(...)
#define CORE_IF_RADII(...)
#define CORE_QUANTITY(bit, IDENT, name, unit, SHAPE) CORE_IF_##SHAPE(CORE_ELEMENTWISE_##IDENT, )
enum core_elementwise {
#include "core/choices.def"
  CORE_ELEMENTWISE_COUNT
};

/* coefficients as preparation left them; in and out do not overlap, any n. */
typedef void core_kernel_f64(const double *coefficients, size_t n, const double *in, double *out);
typedef void core_kernel_f32(const float *coefficients, size_t n, const float *in, float *out);

typedef struct core_kernels_f64 {
  core_kernel_f64 *evaluate[CORE_ELEMENTWISE_COUNT]; /* in: radii in mm */
  core_kernel_f64 *sample;                           /* in: cdf values; out: radii in mm */
} core_kernels_f64;

typedef struct core_kernels_f32 {
  core_kernel_f32 *evaluate[CORE_ELEMENTWISE_COUNT];
  core_kernel_f32 *sample;
} core_kernels_f32;

/* One model on one instruction set. */
struct core_kernels {
  const core_kernels_f64 *f64;
  const core_kernels_f32 *f32;
};

/* The kernels of a model (by id, in the list) for an instruction set. */
const struct core_kernels *core_isa_kernels(const core_isa *isa, enum core_model model);

/* What a family's preparation fills in: the double precision coefficients, the albedo, and the
 * numerical error in units of epsilon, which core_profile_prepare() multiplies by the evaluator's.
 */
typedef struct core_preparation {
  double coefficients[CORE_COEFFICIENTS_MAX];
  double albedo;
  double error_epsilons;        /* at r = 0 */
  double error_epsilons_per_mm; /* more for each mm */
} core_preparation;

/* Each family has core_<family>_prepare(); the medium has been checked. */
typedef void core_prepare_function(int variant, enum core_moments moments,
                                   const core_medium *medium, core_preparation *preparation);

#endif
