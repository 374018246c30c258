/* kernels: declares the tables of elementwise functions that evaluate a profile. Internal to core.
 */
#ifndef DIPOLED_CORE_KERNELS_H
#define DIPOLED_CORE_KERNELS_H

#include "core/varying.h"

/* The instruction sets that kernels are compiled for, slowest first, each as X(level, ...). The
 * Makefile holds the compiler flags of each under the same name. With ISAS=portable it defines
 * CORE_PORTABLE_ALONE. */
#if defined(__x86_64__) && !defined(CORE_PORTABLE_ALONE)
#define CORE_ISA_LEVELS(X, ...)                                                                    \
  X(portable, __VA_ARGS__) X(sse2, __VA_ARGS__) X(avx2, __VA_ARGS__) X(avx512, __VA_ARGS__)
#elif defined(__aarch64__) && !defined(CORE_PORTABLE_ALONE)
#define CORE_ISA_LEVELS(X, ...) X(portable, __VA_ARGS__) X(neon, __VA_ARGS__)
#else
#define CORE_ISA_LEVELS(X, ...) X(portable, __VA_ARGS__)
#endif

#define CORE_ISA_INDEX(level, unused) CORE_ISA_INDEX_##level,
enum { CORE_ISA_LEVELS(CORE_ISA_INDEX, ) CORE_ISA_COUNT };

#define CORE_PASTE2_(a, b) a##b
#define CORE_PASTE2(a, b) CORE_PASTE2_(a, b)

/* CORE_ISA_TABLE(type, name) defines name_of[], the objects name_<level> of each instruction set, by
 * core_isa.index. */
#define CORE_ISA_DECLARE(level, type, name) extern const type name##_##level;
#define CORE_ISA_POINTER(level, type, name) &name##_##level,
#define CORE_ISA_TABLE(type, name)                                                                 \
  CORE_ISA_LEVELS(CORE_ISA_DECLARE, type, name)                                                    \
  static const type *const name##_of[] = {CORE_ISA_LEVELS(CORE_ISA_POINTER, type, name)};

/* Positions of the elementwise quantities, in the order of core/choices.def. */
#define CORE_IF_ELEMENTWISE(...) __VA_ARGS__
#define CORE_IF_MULTIPLE(...) __VA_ARGS__
#define CORE_IF_CHANNEL(...)
#define CORE_IF_RADII(...)
#define CORE_IF_COMPARED(...)
#define CORE_IF_DERIVED(...)
#define CORE_ELEMENTWISE(P, bit, IDENT, name, unit, SHAPE, about) CORE_IF_##SHAPE(P##_##IDENT, )
enum core_elementwise {
  CORE_EACH_QUANTITY(CORE_ELEMENTWISE, CORE_ELEMENTWISE) CORE_ELEMENTWISE_COUNT
};

/* The argument of core_varying_check_kernel: radii up to infinity, or numbers u up to 1. */
enum core_varying_argument { CORE_VARYING_RADII, CORE_VARYING_NUMBERS };

enum { CORE_LANES_MOST = 16 }; /* the most numbers that a vector of any instruction set holds */

/* The kernels of a precision.
 *
 * core_kernel writes out[n] from in[n] and the coefficients of a prepared profile. The arrays do not
 * overlap. Kernels that evaluate or sample take whole vectors: n is a multiple of `lanes`.
 *
 * The others are for media that vary (core/varying.h): value i has the medium sigma_a[i], sigma_s[i]
 * in 1/mm. shared: constants of the model, g and eta (core/models/lanes.h); words: tables
 * (core/cells/find.h). Values outside of the model's domain are NaN. core_varying_check_kernel sets
 * status[n] to the statuses (enum core_value_status) of n values, and *range; with numbers u, only the
 * albedos of *range have a meaning. core_varying_invert_kernel does what core_varying_invert() does;
 * `what` is as core_colour. core_varying_gradient_kernel sets ln R and its
 * derivatives by ln sigma_a and ln sigma_s; in double precision only.
 *
 * An entry of core_kernels is NULL where core has one method for all models: core/evaluate.c makes S,
 * the pdf and 2 pi r R from R, core/transfer.c transforms R, and core/sample.c inverts the cdf.
 * Derivatives of ln R have no such method. If all entries of an f32 table are NULL, core evaluates in
 * double precision and rounds. The entries for media that vary are NULL too if a model has none. */
#define CORE_KERNELS_OF(bits, real)                                                                \
  typedef void core_kernel_##bits(const real *coefficients, size_t n, const real *in, real *out);  \
  typedef void core_varying_kernel_##bits(const real *shared, const real *words, size_t n,         \
                                          const real *sigma_a, const real *sigma_s,                \
                                          const real *in, real *out);                              \
  typedef void core_varying_check_kernel_##bits(                                                   \
      const real *shared, size_t n, const real *sigma_a, const real *sigma_s, const real *in,      \
      enum core_varying_argument argument, uint8_t *status, core_varying_range *range);            \
  typedef void core_varying_invert_kernel_##bits(                                                  \
      const real *shared, const real *words, const core_colour *what, size_t n,                    \
      const real *colour, const real *length_mm, real *sigma_a, real *sigma_s, real *albedo,       \
      uint8_t *status);                                                                            \
  typedef void core_varying_gradient_kernel_##bits(                                                \
      const real *shared, const real *words, size_t n, const real *sigma_a, const real *sigma_s,   \
      const real *r, real *ln_R, real *by_ln_sigma_a, real *by_ln_sigma_s);                        \
  typedef struct core_kernels_##bits {                                                             \
    size_t lanes; /* numbers in a vector: a power of two up to CORE_LANES_MOST */                  \
    core_kernel_##bits *evaluate[CORE_ELEMENTWISE_COUNT]; /* in: radii in mm */                    \
    core_kernel_##bits *sample;                           /* in: cdf values; out: radii in mm */   \
    core_varying_kernel_##bits *varying[CORE_ELEMENTWISE_COUNT];                                   \
    core_varying_kernel_##bits *varying_sample;                                                    \
    core_varying_kernel_##bits *varying_albedo; /* in: any valid radii, which are not used */      \
    core_varying_gradient_kernel_##bits *varying_gradient;                                         \
    /* only in core/models/varying.c, which serves all models */                                   \
    core_varying_check_kernel_##bits *varying_check;                                               \
    core_varying_invert_kernel_##bits *varying_invert;                                             \
  } core_kernels_##bits;
CORE_KERNELS_OF(f64, double)
CORE_KERNELS_OF(f32, float)

/* Apply a kernel, one of the kernels `of`, to any n: what does not fill a vector is copied into one. */
void core_run_f64(const core_kernels_f64 *of, core_kernel_f64 *kernel, const double *coefficients,
                  size_t n, const double *in, double *out);
void core_run_f32(const core_kernels_f32 *of, core_kernel_f32 *kernel, const float *coefficients,
                  size_t n, const float *in, float *out);

/* The kernels of one model for one instruction set. */
struct core_kernels {
  const core_kernels_f64 *f64;
  const core_kernels_f32 *f32;
};

/* These declare the kernels of a family, and are them. */
#define CORE_KERNELS_DECLARE(level, family)                                                        \
  extern const core_kernels_f64 core_kernels_##family##_##level##_f64;                             \
  extern const core_kernels_f32 core_kernels_##family##_##level##_f32;
#define CORE_KERNELS(level, family)                                                                \
  {&core_kernels_##family##_##level##_f64, &core_kernels_##family##_##level##_f32},

struct core_isa {
  const char *name;
  bool (*supported)(void); /* returns whether this machine can run the instruction set */
  size_t index;            /* position in CORE_ISA_LEVELS, from 0 */
};

/* Returns the kernels of a model for an instruction set. The model must be known and not a sum. */
const struct core_kernels *core_isa_kernels(const core_isa *isa, enum core_model model);

/* Returns the kernels of tables (core/models/lut.c). They exist in single precision only. */
const struct core_kernels *core_isa_lut_kernels(const core_isa *isa);

/* Returns the kernels of core/models/varying.c, and those of surfaces (core/models/surface.c). */
const struct core_kernels *core_isa_varying_kernels(const core_isa *isa);
const struct core_kernels *core_isa_surface_kernels(const core_isa *isa);

/* The inputs of preparing a model. The medium, the moments and the parameters' ranges have been
 * checked. */
typedef struct core_inputs {
  int variant;
  enum core_moments moments;
  const core_medium *medium;
  const core_parameters *parameters;
  const core_isa *isa;
  /* the largest error of a profile that a table is made of, infinite if the request states none; 0
   * if no table is made */
  double accepted;
  /* whether only the albedo is requested; a formula may then skip the rest */
  bool only_albedo;
  enum core_light light;   /* if only_albedo: the illumination to which the albedo refers */
  const atomic_bool *stop; /* that of core_profile_prepare_until() */
} core_inputs;

/* Errors that the table of anisotropic scattering adds to the numerical error of `transport`,
 * relative. banded: to R in each band of radii, then to the albedo; all: to
 * any other quantity at any radius. */
typedef struct core_added_errors {
  double banded[CORE_ERROR_BANDS + 1];
  double all; /* at least as large as each of `banded` */
} core_added_errors;

/* The results of preparing. Beforehand the caller sets cost to 1, scale_mm to 1 / sigma_t', reach
 * to "everywhere" (most_mm = INFINITY), and the other fields to 0. */
typedef struct core_preparation {
  double coefficients[CORE_COEFFICIENTS_MAX];
  double *table; /* malloc()ed; replaces coefficients if there is not enough room, else NULL */
  size_t table_bytes;
  double albedo;
  double error;            /* numerical error of all values, relative */
  core_added_errors added; /* further error by band of radii, 0 for every model but transport */
  double slope_error;      /* numerical error of dR/dr if it is larger than error, else 0 */
  double slope_epsilons;   /* what rounding adds to error_epsilons for dR/dr */
  /* error of derivatives, if it is not that of R, else 0 */
  double derivative_error;
  double derivative_error_per_mm;
  core_added_errors derivative_added;  /* as `added`, of derivatives, absolute */
  double error_epsilons;               /* further error, in epsilons of the evaluator */
  double error_epsilons_per_mm;        /* further error for each mm of r, in epsilons */
  double cost;                         /* see core_profile */
  double scale_mm;                     /* see core_profile */
  core_reach reach;                    /* see core_profile */
  core_added_errors T_added;           /* as `added`, of T; 0 where T is 0 */
  core_reach T_reach;                  /* see core_profile */
  double balance[CORE_BALANCE_SHARES]; /* see core_profile */
  double balance_error;
  unsigned notes; /* bits of enum core_note */
} core_preparation;

/* Each formula has two functions. core_<formula>_check() returns the fault of inputs outside the
 * model's domain and narrows *radii, which the caller sets to 0 to infinity, to where the model may
 * be evaluated. core_<formula>_prepare() is called for inputs without such a fault and returns
 * faults that show only in preparing. */
typedef core_fault core_check_function(const core_inputs *inputs, core_radii_range *radii);
typedef core_fault core_prepare_function(const core_inputs *inputs, core_preparation *preparation);
#define CORE_DECLARE_FORMULA(id, IDENT, name, formula, ...)                                        \
  core_check_function core_##formula##_check;                                                      \
  core_prepare_function core_##formula##_prepare;
CORE_EACH_MODEL(CORE_DECLARE_FORMULA, CORE_NO_SUM)

/* Returns the relative error of dR/dr of the model `transport` where it comes from the table of
 * solutions. */
double core_transport_slope_error(double g);

/* Returns the reach of the model `transport` for a medium that scatters. */
core_reach core_transport_reach(const core_medium *medium);

/* Returns the medium that the model `transport` evaluates in place of one whose phase function has
 * this gamma = (1 - g_2) / (1 - g): sigma_s' and the rest are the same, and g is gamma - 1, because
 * that is the function of Henyey and Greenstein with this gamma. gamma: NAN if it is not given; the
 * medium is then returned as it is. */
core_medium core_transport_medium(const core_medium *medium, double gamma);

/* Sets *added to what the table of solutions adds for a medium: to zeros if g is 0, or if the table
 * does not cover the medium. */
void core_transport_added_errors(const core_medium *medium, core_added_errors *added);

/* Returns whether the model `transport` has the medium in its table of solutions, or nothing scatters
 * in it. Otherwise preparation solves it, whatever the tolerance is. */
bool core_transport_is_stored(const core_medium *medium);

/* Returns whether preparation looks the medium up: it is stored, and the tolerance (NAN: none is given)
 * is not below what the table states of R at some radius. With g = 0 nothing is more exact than the
 * table. */
bool core_transport_is_looked_up(const core_medium *medium, double tolerance);

/* Returns the fault of a g and eta that the table of solutions does not cover. */
core_fault core_transport_stored_check(double g, double eta);

/* Returns the error of `transport` with isotropic scattering where the table of solutions covers
 * the medium, relative. */
double core_transport_table_error(const core_medium *medium);

/* Returns the largest ratio sigma_a / sigma_s' at which `transport` finds the albedo with this g and
 * eta in the time that is usual for them. */
double core_transport_ratio_most(double g, double eta);

/* Returns the numerical error of the wanted quantities at radii from least to most; there are no
 * radii if least is above most. errors: as core_profile.numerical_errors, or as
 * core_added_errors.banded; all: the error of any quantity at any radius. */
double core_banded_error(const double errors[CORE_ERROR_BANDS + 1], double all,
                         const core_medium *medium, unsigned wanted, core_radii_range radii);

/* Returns the error that is added to the numerical error at radii up to most_mm: 0 within the
 * reach. */
double core_error_beyond(core_reach reach, double most_mm);

#define CORE_OUT_OF_MEMORY                                                                         \
  ((core_fault){CORE_FIELD_MEMORY, "less than the memory that is free: try again", 0})

/* Returns the value of a parameter, or `otherwise` if the parameter is not given. */
static inline double core_parameter_or(const core_inputs *inputs, enum core_parameter parameter,
                                       double otherwise) {
  const double value = inputs->parameters->value[parameter];
  return value == value ? value : otherwise;
}

/* Returns sigma_t' = sigma_a + sigma_s (1 - g). */
static inline double core_sigma_t_prime(const core_medium *medium) {
  return medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g);
}

/* Returns the note of models that replace anisotropic scattering by isotropic scattering of sigma_s
 * (1 - g). */
static inline unsigned core_similarity_note(const core_inputs *inputs) {
  return inputs->medium->g < 0 || inputs->medium->g > 0 ? CORE_NOTE_SIMILARITY : 0;
}

/* Does what core_eval_f64() does. The profile may have any evaluator as
 * long as its coefficients are in double precision: it is of f64, a sum, or has no f32 kernels. */
void core_evaluate(const core_profile *profile, enum core_quantity quantity, size_t n,
                   const double *r, double *out);

/* Evaluates a quantity for which every model has a kernel: R, CDF, SLOPE or LN_R. The profile is
 * one that core_evaluate() accepts, and not a sum. */
static inline void core_run_kernel(const core_profile *profile, enum core_elementwise quantity,
                                   size_t n, const double *r, double *out) {
  core_run_f64(profile->kernels->f64, profile->kernels->f64->evaluate[quantity],
               profile->table != NULL ? profile->table : profile->coefficients.f64, n, r, out);
}

/* Does what core_evaluate() does for the quantity TRANSFER of models without a kernel for it. The
 * profile is not a sum. */
void core_transfer(const core_profile *profile, size_t n, const double *f, double *out);

/* Returns whether a profile has kernels and coefficients in single precision. */
static inline bool core_is_narrow(const core_profile *profile) {
  return profile->parts == NULL && profile->kernels->f32->evaluate[0] != NULL;
}

/* Returns the coefficients that the single precision kernels read. */
static inline const float *core_coefficients_f32(const core_profile *profile) {
  return profile->lut != NULL ? profile->lut : profile->coefficients.f32;
}

#endif
