/* Prepares models for media that vary, and evaluates them. If a model has no kernel in single
 * precision, the kernel in double precision is used and its results are rounded. */
#include "core/varying.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/kernels.h"
#include "core/transport/table.h"
#include "core/varying/surface.h"

#define CORE_REAL 64
#include "core/models/lanes.h"

enum { CHUNK = 256 };

/* ---- preparing ------------------------------------------------------------------------------- */

/* The families of models whose media can vary. */
enum family { NONE, DIPOLE, BURLEY, TRANSPORT };

static enum family family_of(unsigned model, int *variant) {
  switch (model) {
#define FAMILY(id, IDENT, name, formula, kernels, variant_of_model, parameters, source)            \
  case id:                                                                                         \
    *variant = (variant_of_model);                                                                 \
    return strcmp(#formula, "dipole") == 0      ? DIPOLE                                           \
           : strcmp(#formula, "burley") == 0    ? BURLEY                                           \
           : strcmp(#formula, "transport") == 0 ? TRANSPORT                                        \
                                                : NONE;
    CORE_EACH_MODEL(FAMILY, CORE_NO_SUM)
  default:
    return NONE;
  }
}

/* Returns a valid medium with this g and eta, for checks of the other arguments. */
static core_medium example(double g, double eta) {
  return (core_medium){1, g > -1 && g < 1 ? 1 / (1 - g) : 1, g, eta};
}

/* Sets the constants of varying->shared that follow from the model, g and eta. */
static void share(core_varying *varying, enum family family, int variant,
                  const core_parameters *parameters) {
  double *shared = varying->shared.f64;
  const double given = parameters->value[CORE_PARAMETER_SURFACE_ALBEDO];
  shared[LANES_SCATTER] = 1 - varying->g;
  shared[LANES_SIGMA_T_LEAST] = CORE_VARYING_SIGMA_T_PRIME_MIN_PER_MM;
  shared[LANES_SIGMA_T_MOST] = CORE_VARYING_SIGMA_T_PRIME_MAX_PER_MM;
  shared[LANES_SCATTERED_LEAST] = CORE_VARYING_SCATTERED_MIN;
  shared[LANES_ABSORBS] = varying->model == CORE_MODEL_BURLEY_DMFP;
  shared[LANES_SURFACE_ALBEDO] = isnan(given) ? -1 : given;
  shared[LANES_FIT] = variant;
  if (family != TRANSPORT) {
    lanes_share_dipole(shared, family == DIPOLE ? variant : CORE_DIPOLE_BETTER,
                       core_fresnel_moments(varying->moments, varying->eta));
  }
}

/* Sets the members that follow from the words. */
core_fault core_surface_share(core_varying *varying) {
  const float *words = varying->words;
  if (varying->evaluator == CORE_EVALUATOR_F64) {
    varying->wide_words = core_surface_widen(words, varying->words_count);
    if (varying->wide_words == NULL) {
      core_varying_free(varying);
      return CORE_OUT_OF_MEMORY;
    }
  }
  double *shared = varying->shared.f64;
  if (words[CORE_SURFACE_SCATTERED_LEAST] > 0) {
    shared[LANES_SCATTERED_LEAST] = (double)words[CORE_SURFACE_SCATTERED_LEAST];
  }
  for (int i = 0; i < 3; i++) {
    shared[LANES_FAR + i] = (double)words[CORE_SURFACE_FAR + i];
  }
  for (int light = 0; light < CORE_LIGHTS; light++) {
    varying->colour_least[light] = (double)words[CORE_SURFACE_COLOUR_LEAST + light];
    varying->colour_most[light] = (double)words[CORE_SURFACE_COLOUR_MOST + light];
    shared[LANES_COLOUR_LEAST + light] = varying->colour_least[light];
    shared[LANES_COLOUR_MOST + light] = varying->colour_most[light];
    shared[LANES_SPECULAR + light] = varying->specular[light] = core_specular(light, varying->eta);
  }
  varying->surface_error = (double)words[CORE_SURFACE_ERROR];
  varying->albedo_least = shared[LANES_SCATTERED_LEAST];
  varying->albedo_most = 1;
  for (int i = 0; i < CORE_VARYING_SHARED_MAX; i++) {
    varying->shared.f32[i] = (float)shared[i];
  }
  return (core_fault){0};
}

/* Checks what evaluating relies on. Making the words needs more (core/varying/prepare.c). */
static core_fault check(unsigned moments, unsigned evaluator, double g, double eta,
                        const core_parameters *parameters, enum family family) {
  const core_medium medium = example(g, eta);
  core_fault fault = core_medium_check(&medium);
  if (fault.field == NULL && core_choice_by_id(core_moments_list, moments) == NULL) {
    fault = (core_fault){"moments", "one of the list", 0};
  }
  if (fault.field == NULL) {
    fault = core_fresnel_check(moments, eta);
  }
  if (fault.field != NULL) {
    return fault;
  }
  if (family == NONE) {
    return (core_fault){"model", "a dipole, Burley's profile or transport if media vary", 0};
  }
  if (evaluator != CORE_EVALUATOR_F64 && evaluator != CORE_EVALUATOR_F32) {
    return (core_fault){"evaluator", "f64 or f32 if media vary", 0};
  }
  if (parameters->value[CORE_PARAMETER_TOLERANCE] < CORE_VARYING_TOLERANCE_MIN) {
    return (core_fault){"tolerance", "1e-5 to 1 if media vary", 0};
  }
  const core_medium taken = core_transport_medium(&medium, parameters->value[CORE_PARAMETER_GAMMA]);
  return family == TRANSPORT ? core_transport_stored_check(taken.g, eta) : (core_fault){0};
}

/* Sets the g of the surface, and the notes, which are those of core_profile_prepare(). */
static void set_scattering(core_varying *varying, enum family family) {
  const core_medium medium = example(varying->g, varying->eta);
  const core_medium taken = core_transport_medium(&medium, varying->gamma);
  const bool similar = family != TRANSPORT && (varying->g < 0 || varying->g > 0);
  varying->table_g = family == TRANSPORT ? taken.g : 0;
  varying->notes = (similar ? (unsigned)CORE_NOTE_SIMILARITY : 0) |
                   (isnan(varying->gamma) ? 0 : (unsigned)CORE_NOTE_GAMMA);
}

core_fault core_surface_begin(core_varying *varying, const core_isa *isa, unsigned model,
                              unsigned moments, unsigned evaluator, double g, double eta,
                              const core_parameters *parameters) {
  int variant = 0;
  const enum family family = family_of(model, &variant);
  const core_fault fault = check(moments, evaluator, g, eta, parameters, family);
  if (fault.field != NULL) {
    return fault;
  }
  *varying = (core_varying){
      .model = model,
      .moments = moments,
      .evaluator = evaluator,
      .g = g,
      .eta = eta,
      .kernels = family == TRANSPORT ? core_isa_surface_kernels(isa) : core_isa_kernels(isa, model),
      .check_kernels = core_isa_varying_kernels(isa),
      .gamma = parameters->value[CORE_PARAMETER_GAMMA],
  };
  set_scattering(varying, family);
  share(varying, family, variant, parameters);
  return (core_fault){0};
}

core_fault core_varying_open(core_varying *varying, const core_isa *isa, unsigned model,
                             unsigned moments, unsigned evaluator, double g, double eta,
                             const core_parameters *parameters, const float *words, size_t count) {
  const core_parameters none = core_parameters_none();
  core_fault fault = core_surface_begin(varying, isa, model, moments, evaluator, g, eta,
                                        parameters != NULL ? parameters : &none);
  if (fault.field == NULL) {
    fault = core_surface_check(words, count, core_solves(model));
  }
  if (fault.field != NULL) {
    return fault;
  }
  varying->words = malloc(count * sizeof *words);
  varying->words_count = count;
  if (varying->words == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  memcpy(varying->words, words, count * sizeof *words);
  return core_surface_share(varying);
}

void core_varying_free(core_varying *varying) {
  free(varying->words);
  free(varying->wide_words);
  varying->words = NULL;
  varying->wide_words = NULL;
}

size_t core_varying_bytes(const core_varying *varying) {
  const size_t wide = varying->wide_words != NULL ? sizeof *varying->wide_words : 0;
  return varying->words_count * (sizeof *varying->words + wide);
}

/* ---- checking -------------------------------------------------------------------------------- */

void core_varying_range_add(core_varying_range *range, const core_varying_range *other) {
  range->computed += other->computed;
  range->albedo_least = fmin(range->albedo_least, other->albedo_least);
  range->albedo_most = fmax(range->albedo_most, other->albedo_most);
  range->mfp_least = fmin(range->mfp_least, other->mfp_least);
  range->mfp_most = fmax(range->mfp_most, other->mfp_most);
}

void core_varying_check(const core_varying *varying, bool drawn, size_t n, const void *sigma_a,
                        const void *sigma_s, const void *r, uint8_t *status,
                        core_varying_range *range) {
  const struct core_kernels *kernels = varying->check_kernels;
  const enum core_varying_argument what = drawn ? CORE_VARYING_NUMBERS : CORE_VARYING_RADII;
  if (varying->evaluator == CORE_EVALUATOR_F64) {
    kernels->f64->varying_check(varying->shared.f64, n, sigma_a, sigma_s, r, what, status, range);
  } else {
    kernels->f32->varying_check(varying->shared.f32, n, sigma_a, sigma_s, r, what, status, range);
  }
  if (drawn) {
    range->mfp_least = 0;
    range->mfp_most = (double)INFINITY;
  }
}

/* ---- errors ---------------------------------------------------------------------------------- */

/* The largest number of decay lengths 1 / mu at which a value has not underflowed, in each
 * precision. */
#define DECAYS_MOST_F32 140.0
#define DECAYS_MOST_F64 800.0

/* Rounding error of dipoles in epsilons per unit of the condition number (core/models/dipole.c). */
#define ROUNDING 16.0

/* An upper bound of 1 / d of Burley's fits, in units of sigma_t'. */
#define BURLEY_MOST 44.0

/* Returns the relative error by rounding of values in a range. */
static double rounding(const core_varying *varying, enum family family,
                       const core_varying_range *range) {
  const bool f32 = varying->evaluator == CORE_EVALUATOR_F32;
  const double epsilon = f32 && family != BURLEY ? (double)FLT_EPSILON : DBL_EPSILON;
  const double most = f32 && family != BURLEY ? DECAYS_MOST_F32 : DECAYS_MOST_F64;
  const double per_mfp = family == BURLEY ? BURLEY_MOST : sqrt(3 * (1 - range->albedo_least));
  const double decays = per_mfp > 0 ? fmin(per_mfp * range->mfp_most, most) : 0;
  const double mirror = real_log(1 + varying->shared.f64[LANES_Z2_PER_D], 0);
  return ROUNDING * epsilon * (1 + per_mfp + decays) + 3 * epsilon * fmax(mirror - 4, 0) +
         (f32 && family == BURLEY ? (double)FLT_EPSILON : 0);
}

/* Returns a medium with this g and albedo and sigma_t' = 1 per mm. */
static core_medium medium_of(const core_varying *varying, double g, double albedo) {
  return (core_medium){1 - albedo, albedo / (1 - g), g, varying->eta};
}

/* Returns the error of the table of solutions, of the wanted quantities in a range. Within a band of
 * the albedo the reach grows with the albedo, and with it the bands of radii whose errors count: the
 * largest albedo has the largest error. */
static double table_error(const core_varying *varying, unsigned wanted,
                          const core_varying_range *range) {
  const double g = varying->table_g;
  const size_t last = transport_table_albedo_band(range->albedo_most);
  double error = 0;
  for (size_t band = transport_table_albedo_band(range->albedo_least); band <= last && g != 0;
       band++) {
    const double end = band < last ? transport_table_albedo_end(band) * (1 - 0x1p-40) : 1;
    const core_medium medium = medium_of(varying, g, fmin(end, range->albedo_most));
    core_added_errors added;
    core_transport_added_errors(&medium, &added);
    error = fmax(error, core_banded_error(added.banded, added.all, &medium, wanted,
                                          (core_radii_range){range->mfp_least, range->mfp_most}));
  }
  /* Densities and the cdf have two errors: that of R and that of the energy by which they are
   * divided. */
  const core_medium grey = {1, 1, 0, varying->eta};
  return 2 * core_transport_table_error(&grey) + error;
}

double core_varying_error(const core_varying *varying, unsigned wanted,
                          const core_varying_range *range) {
  int variant;
  const enum family family = family_of(varying->model, &variant);
  if (range->albedo_least > range->albedo_most) {
    return 0;
  }
  const double error = rounding(varying, family, range) + varying->surface_error;
  return error + (family == TRANSPORT ? table_error(varying, wanted, range) : 0);
}

/* ---- evaluating ------------------------------------------------------------------------------ */

/* Near the source r R is constant. Where R is infinite, it is evaluated at this radius instead. */
#define NEAREST_MM 1e-20

/* DEFINE_EVALUATE() defines evaluate_f64() and evaluate_f32(): R, CDF, PDF, RING, ALBEDO, and
 * RADIUS at a cdf. 2 pi r R is computed from R, and the density from it and the albedo. run_f64() and
 * run_f32() apply a kernel to any n: what is left after whole vectors is copied into a vector. */
#define DEFINE_EVALUATE(type, bits, table)                                                         \
  static void copy_left_##bits(size_t lanes, size_t n, const type *sigma_a, const type *sigma_s,   \
                               const type *in, type left[3][CORE_LANES_MOST]) {                    \
    for (size_t i = 0; i < lanes; i++) {                                                           \
      const size_t k = i < n ? i : n - 1;                                                          \
      left[0][i] = sigma_a[k];                                                                     \
      left[1][i] = sigma_s[k];                                                                     \
      left[2][i] = in[k];                                                                          \
    }                                                                                              \
  }                                                                                                \
                                                                                                   \
  static void run_##bits(const core_varying *varying, core_varying_kernel_##bits *kernel,          \
                         size_t n, const type *sigma_a, const type *sigma_s, const type *in,       \
                         type *out) {                                                              \
    const size_t lanes = varying->kernels->bits->lanes, whole = n & ~(lanes - 1);                  \
    kernel(varying->shared.bits, varying->table, whole, sigma_a, sigma_s, in, out);                \
    if (whole < n) {                                                                               \
      type left[3][CORE_LANES_MOST], found[CORE_LANES_MOST];                                       \
      copy_left_##bits(lanes, n - whole, sigma_a + whole, sigma_s + whole, in + whole, left);      \
      kernel(varying->shared.bits, varying->table, lanes, left[0], left[1], left[2], found);       \
      memcpy(out + whole, found, (n - whole) * sizeof *out);                                       \
    }                                                                                              \
  }                                                                                                \
                                                                                                   \
  static void multiply_##bits(const core_varying *varying, bool density, size_t n,                 \
                              const type *sigma_a, const type *sigma_s, const type *r,             \
                              type *out) {                                                         \
    const core_kernels_##bits *kernels = varying->kernels->bits;                                   \
    type albedo[CHUNK];                                                                            \
    if (density) {                                                                                 \
      run_##bits(varying, kernels->varying_albedo, n, sigma_a, sigma_s, r, albedo);                \
    }                                                                                              \
    for (size_t i = 0; i < n; i++) {                                                               \
      type near = r[i];                                                                            \
      if (isinf(out[i])) {                                                                         \
        near = (type)NEAREST_MM;                                                                   \
        run_##bits(varying, kernels->varying[CORE_ELEMENTWISE_R], 1, &sigma_a[i], &sigma_s[i],     \
                   &near, &out[i]);                                                                \
      }                                                                                            \
      const double R = (double)out[i] / (density ? (double)albedo[i] : 1);                         \
      out[i] = out[i] > 0 ? (type)(6.28318530717958647693 * (double)near * R) : out[i];            \
    }                                                                                              \
  }                                                                                                \
                                                                                                   \
  static void evaluate_##bits(const core_varying *varying, enum core_quantity quantity, size_t n,  \
                              const type *sigma_a, const type *sigma_s, const type *in,            \
                              type *out) {                                                         \
    const core_kernels_##bits *kernels = varying->kernels->bits;                                   \
    const bool density = quantity == CORE_QUANTITY_PDF;                                            \
    const bool ring = density || quantity == CORE_QUANTITY_RING;                                   \
    core_varying_kernel_##bits *kernel =                                                           \
        quantity == CORE_QUANTITY_RADIUS ? kernels->varying_sample                                 \
        : quantity == CORE_QUANTITY_ALBEDO                                                         \
            ? kernels->varying_albedo                                                              \
            : kernels->varying[quantity == CORE_QUANTITY_CDF ? CORE_ELEMENTWISE_CDF                \
                                                             : CORE_ELEMENTWISE_R];                \
    for (size_t done = 0; done < n; done += CHUNK) {                                               \
      const size_t count = n - done < CHUNK ? n - done : CHUNK;                                    \
      const type *a = sigma_a + done, *s = sigma_s + done;                                         \
      const type *x = quantity == CORE_QUANTITY_ALBEDO                                             \
                          ? a                                                                      \
                          : in + done; /* ALBEDO reads no radius: any numbers from 0 on serve */   \
      run_##bits(varying, kernel, count, a, s, x, out + done);                                     \
      if (ring) {                                                                                  \
        multiply_##bits(varying, density, count, a, s, x, out + done);                             \
      }                                                                                            \
    }                                                                                              \
  }

DEFINE_EVALUATE(double, f64, wide_words)
DEFINE_EVALUATE(float, f32, words)

void core_varying_gradient_f64(const core_varying *varying, size_t n, const double *sigma_a,
                               const double *sigma_s, const double *r, const core_gradient *out) {
  assert(varying->evaluator == CORE_EVALUATOR_F64);
  core_varying_gradient_kernel_f64 *kernel = varying->kernels->f64->varying_gradient;
  const size_t lanes = varying->kernels->f64->lanes, whole = n & ~(lanes - 1);
  kernel(varying->shared.f64, varying->wide_words, whole, sigma_a, sigma_s, r, out->ln_R,
         out->by_ln_sigma_a, out->by_ln_sigma_s);
  if (whole < n) {
    double left[3][CORE_LANES_MOST], found[3][CORE_LANES_MOST];
    const size_t bytes = (n - whole) * sizeof **found;
    copy_left_f64(lanes, n - whole, sigma_a + whole, sigma_s + whole, r + whole, left);
    kernel(varying->shared.f64, varying->wide_words, lanes, left[0], left[1], left[2], found[0],
           found[1], found[2]);
    memcpy(out->ln_R + whole, found[0], bytes);
    memcpy(out->by_ln_sigma_a + whole, found[1], bytes);
    memcpy(out->by_ln_sigma_s + whole, found[2], bytes);
  }
}

/* Evaluates in double precision and rounds. A cdf below 1 stays below 1. */
static void widely(const core_varying *varying, enum core_quantity quantity, size_t n,
                   const float *sigma_a, const float *sigma_s, const float *in, float *out) {
  double wide[4][CHUNK];
  for (size_t done = 0; done < n; done += CHUNK) {
    const size_t count = n - done < CHUNK ? n - done : CHUNK;
    for (size_t i = 0; i < count; i++) {
      wide[0][i] = (double)sigma_a[done + i];
      wide[1][i] = (double)sigma_s[done + i];
      wide[2][i] = quantity != CORE_QUANTITY_ALBEDO ? (double)in[done + i] : 0;
    }
    evaluate_f64(varying, quantity, count, wide[0], wide[1], wide[2], wide[3]);
    for (size_t i = 0; i < count; i++) {
      const bool less = quantity == CORE_QUANTITY_CDF && wide[3][i] < 1;
      const float rounded = (float)wide[3][i];
      out[done + i] = less && rounded >= 1 ? 1 - FLT_EPSILON / 2 : rounded;
    }
  }
}

void core_varying_eval(const core_varying *varying, enum core_quantity quantity, size_t n,
                       const void *sigma_a, const void *sigma_s, const void *r, void *out) {
  if (varying->evaluator == CORE_EVALUATOR_F64) {
    evaluate_f64(varying, quantity, n, sigma_a, sigma_s, r, out);
  } else {
    (varying->kernels->f32->varying_sample != NULL ? evaluate_f32 : widely)(
        varying, quantity, n, sigma_a, sigma_s, r, out);
  }
}

/* ---- from colours to media ------------------------------------------------------------------- */

core_fault core_light_check(unsigned model, enum core_light light) {
  const bool known = (unsigned)light < (core_solves(model) ? CORE_LIGHTS : CORE_LIGHT_BEAM + 1);
  return known ? (core_fault){0}
               : (core_fault){"light",
                              "light that the model knows: a beam, or diffuse with transport", 0};
}

double core_specular(enum core_light light, double eta) {
  const double normal = (eta - 1) / (eta + 1);
  return light == CORE_LIGHT_BEAM
             ? normal * normal
             : 1 - core_fresnel_moments(CORE_MOMENTS_EXACT, 1 / eta).one_minus_2c1;
}

core_fault core_colour_check(const core_varying *varying, const core_colour *what) {
  const core_fault fault = core_light_check(varying->model, what->light);
  if (fault.field != NULL) {
    return fault;
  }
  if (core_choice_by_id(core_lengths, what->length) == NULL) {
    return (core_fault){"length", "a length of the list", 0};
  }
  if (!(varying->eta >= CORE_COLOUR_ETA_MIN && varying->eta <= CORE_COLOUR_ETA_MAX)) {
    return (core_fault){"eta", "0.01 to 4 with colours", 0};
  }
  return (core_fault){0};
}

void core_varying_invert(const core_varying *varying, const core_colour *what, size_t n,
                         const void *colour, const void *length_mm, void *sigma_a, void *sigma_s,
                         void *albedo, uint8_t *status) {
  assert(core_colour_check(varying, what).field == NULL);
  const struct core_kernels *kernels = varying->check_kernels;
  if (varying->evaluator == CORE_EVALUATOR_F64) {
    kernels->f64->varying_invert(varying->shared.f64, varying->wide_words, what, n, colour,
                                 length_mm, sigma_a, sigma_s, albedo, status);
  } else {
    kernels->f32->varying_invert(varying->shared.f32, varying->words, what, n, colour, length_mm,
                                 sigma_a, sigma_s, albedo, status);
  }
}
