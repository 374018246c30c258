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

/* An entry is NULL where profile.c has a way for all models: S from R, sampling by inverting the
 * cdf. A table for f32 that is all NULL: single precision is double precision, rounded. */
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

struct core_isa {
  const char *name;
  bool (*supported)(void); /* whether this machine can run it */
  size_t index;            /* in the order of CORE_ISA_LEVELS, from 0 */
};

/* The kernels of a model (by id, in the list, not a sum) for an instruction set. */
const struct core_kernels *core_isa_kernels(const core_isa *isa, enum core_model model);

/* The kernels of tables (core/models/lut.c), which have no f64. */
const struct core_kernels *core_isa_lut_kernels(const core_isa *isa);

/* What a model is prepared from; the medium, the moments and the parameters' ranges have been
 * checked. */
typedef struct core_inputs {
  int variant;
  enum core_moments moments;
  const core_medium *medium;
  const core_parameters *parameters;
  const core_isa *isa;
  double tabulated; /* how far a table of solutions may be off that is taken instead; 0: none is */
} core_inputs;

/* What a formula's preparation fills in; it finds zeros, and 1 for cost. */
typedef struct core_preparation {
  double coefficients[CORE_COEFFICIENTS_MAX];
  double *table; /* malloc(), instead of the coefficients when they need more room; NULL: not */
  size_t table_bytes;
  double albedo;
  double error;                 /* numerical, relative, of all values */
  double error_epsilons;        /* and in units of the evaluator's epsilon: at r = 0 */
  double error_epsilons_per_mm; /* and more for each mm */
  double cost;                  /* see core_profile */
  double scale_mm;              /* see core_profile; 0: 1 / sigma_t' */
  core_reach reach;             /* found as: everywhere */
  unsigned notes;               /* besides those that hold for all models */
} core_preparation;

/* Each formula has core_<formula>_check(): the fault of inputs outside the model's domain, and the
 * radii it may be evaluated at (0 to infinity unless it says otherwise); and
 * core_<formula>_prepare() for inputs without a fault: it finds what only shows then. */
typedef core_fault core_check_function(const core_inputs *inputs, core_radii_range *radii);
typedef core_fault core_prepare_function(const core_inputs *inputs, core_preparation *preparation);

/* The reach of `transport` for a medium that scatters. */
core_reach core_transport_reach(const core_medium *medium);

/* What a reach adds to the numerical error at radii up to most_mm; 0 within it. */
double core_error_beyond(core_reach reach, double most_mm);

#define CORE_OUT_OF_MEMORY ((core_fault){CORE_FIELD_MEMORY, "less than what is left: try again", 0})

/* The value of a parameter, or another one where it is not given. */
static inline double core_parameter_or(const core_inputs *inputs, enum core_parameter parameter,
                                       double otherwise) {
  const double value = inputs->parameters->value[parameter];
  return value == value ? value : otherwise;
}

/* sigma_a + sigma_s (1 - g) */
static inline double core_sigma_t_prime(const core_medium *medium) {
  return medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g);
}

/* For models that see isotropic scattering of sigma_s (1 - g). */
static inline unsigned core_similarity_note(const core_inputs *inputs) {
  return inputs->medium->g < 0 || inputs->medium->g > 0 ? CORE_NOTE_SIMILARITY : 0;
}

/* core_eval_f64() for any quantity but S, and for profiles of either evaluator that hold their
 * coefficients in double precision: sums and those whose kernels have no f32. */
void core_evaluate(const core_profile *profile, enum core_quantity quantity, size_t n,
                   const double *r, double *out);

/* Whether a profile has kernels and coefficients of its own in single precision, and what these
 * kernels read. */
static inline bool core_is_narrow(const core_profile *profile) {
  return profile->parts == NULL && profile->kernels->f32->evaluate[0] != NULL;
}

static inline const float *core_coefficients_f32(const core_profile *profile) {
  return profile->lut != NULL ? profile->lut : profile->coefficients.f32;
}

#endif
