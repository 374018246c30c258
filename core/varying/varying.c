/* Prepares and evaluates where every value has a medium of its own. Kernels of a precision that a
 * model lacks are replaced by those of double precision, whose results are rounded. */
#include "core/varying.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/kernels.h"
#include "core/model_error.h"
#include "core/varying/surface.h"

#define CORE_REAL 64
#include "core/models/lanes.h"

enum { CHUNK = 256 };

/* ---- statuses -------------------------------------------------------------------------------- */

core_fault core_value_fault(unsigned status, size_t index) {
  switch (status) {
#define CORE_VALUE(id, IDENT, name, field, allowed)                                                \
  case CORE_VALUE_##IDENT:                                                                         \
    return field != NULL ? (core_fault){field, allowed, index} : (core_fault){0};
#include "core/choices.def"
  default:
    assert(!"a status");
    return (core_fault){0};
  }
}

/* ---- preparing ------------------------------------------------------------------------------- */

/* The families of models whose media can vary. */
enum family { NONE, DIPOLE, BURLEY, TRANSPORT };

static enum family family_of(unsigned model, int *variant) {
  switch (model) {
#define CORE_MODEL(id, IDENT, name, formula, kernels, variant_of_model, parameters, source)        \
  case id:                                                                                         \
    *variant = (variant_of_model);                                                                 \
    return strcmp(#formula, "dipole") == 0      ? DIPOLE                                           \
           : strcmp(#formula, "burley") == 0    ? BURLEY                                           \
           : strcmp(#formula, "transport") == 0 ? TRANSPORT                                        \
                                                : NONE;
#include "core/models.def"
  default:
    return NONE;
  }
}

/* Returns a medium that stands for all: its faults are those of the model, g, eta and
 * parameters. */
static core_medium example(double g, double eta) {
  return (core_medium){1, 1 / (1 - g), g, eta};
}

static void share_dipole(double *shared, int variant, core_fresnel fresnel) {
  const bool exitance = (variant & CORE_DIPOLE_EXITANCE) != 0;
  const double lost =
      (variant & CORE_DIPOLE_BOUNDARY) ? fresnel.one_minus_3c2 : fresnel.one_minus_2c1;
  shared[LANES_GROSJEAN] = (variant & CORE_DIPOLE_GROSJEAN) != 0;
  shared[LANES_Z2_PER_D] = 4 * (2 - lost) / fresnel.one_minus_2c1;
  shared[LANES_C_PHI] = exitance ? 0.25 * fresnel.one_minus_2c1 : 0;
  shared[LANES_C_FLUX] = exitance ? 0.5 * fresnel.one_minus_3c2 : 1;
}

/* Sets the numbers that follow from the model, g and eta alone. */
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
    const int switches = family == DIPOLE
                             ? variant
                             : CORE_DIPOLE_GROSJEAN | CORE_DIPOLE_BOUNDARY | CORE_DIPOLE_EXITANCE;
    share_dipole(shared, switches, core_fresnel_moments(varying->moments, varying->eta));
  }
}

/* Sets what follows from the words. */
static core_fault share_words(core_varying *varying) {
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
  const double normal = (varying->eta - 1) / (varying->eta + 1);
  varying->specular[CORE_LIGHT_BEAM] = normal * normal;
  varying->specular[CORE_LIGHT_DIFFUSE] =
      1 - core_fresnel_moments(CORE_MOMENTS_EXACT, 1 / varying->eta).one_minus_2c1;
  for (int light = 0; light < CORE_LIGHTS; light++) {
    varying->colour_least[light] = (double)words[CORE_SURFACE_COLOUR_LEAST + light];
    varying->colour_most[light] = (double)words[CORE_SURFACE_COLOUR_MOST + light];
    shared[LANES_COLOUR_LEAST + light] = varying->colour_least[light];
    shared[LANES_COLOUR_MOST + light] = varying->colour_most[light];
    shared[LANES_SPECULAR + light] = varying->specular[light];
  }
  varying->albedo_least = shared[LANES_SCATTERED_LEAST];
  varying->albedo_most = 1;
  for (int i = 0; i < CORE_VARYING_SHARED_MAX; i++) {
    varying->shared.f32[i] = (float)shared[i];
  }
  return (core_fault){0};
}

static core_fault check(unsigned model, unsigned moments, unsigned evaluator, double g, double eta,
                        const core_parameters *parameters, enum family family) {
  const core_medium medium = example(g, eta);
  const core_fault fault = core_profile_check(model, moments, evaluator, &medium, parameters, NULL);
  if (fault.field != NULL) {
    return fault;
  }
  if (family == NONE) {
    return (core_fault){"model", "a dipole, Burley's profile or transport if media vary", 0};
  }
  if (evaluator == CORE_EVALUATOR_LUT) {
    return (core_fault){"evaluator", "f64 or f32 if media vary", 0};
  }
  if (parameters->value[CORE_PARAMETER_TOLERANCE] < CORE_VARYING_TOLERANCE_MIN) {
    return (core_fault){"tolerance", "1e-5 to 1 if media vary", 0};
  }
  return (core_fault){0};
}

/* Prepares all but the words. */
static core_fault begin(core_varying *varying, const core_isa *isa, unsigned model,
                        unsigned moments, unsigned evaluator, double g, double eta,
                        const core_parameters *parameters, enum family *family) {
  int variant = 0;
  *family = family_of(model, &variant);
  const core_fault fault = check(model, moments, evaluator, g, eta, parameters, *family);
  if (fault.field != NULL) {
    return fault;
  }
  *varying = (core_varying){
      .model = model,
      .moments = moments,
      .evaluator = evaluator,
      .g = g,
      .eta = eta,
      .kernels =
          *family == TRANSPORT ? core_isa_surface_kernels(isa) : core_isa_kernels(isa, model),
      .check_kernels = core_isa_varying_kernels(isa),
  };
  share(varying, *family, variant, parameters);
  return (core_fault){0};
}

core_fault core_varying_prepare(core_varying *varying, const core_isa *isa, unsigned model,
                                unsigned moments, unsigned evaluator, double g, double eta,
                                const core_parameters *parameters) {
  const core_parameters none = core_parameters_none();
  const core_parameters *given = parameters != NULL ? parameters : &none;
  enum family family;
  core_fault fault = begin(varying, isa, model, moments, evaluator, g, eta, given, &family);
  if (fault.field != NULL) {
    return fault;
  }
  const double tolerance = given->value[CORE_PARAMETER_TOLERANCE];
  const core_medium medium = example(g, eta);
  const core_medium taken = core_transport_medium(&medium, given->value[CORE_PARAMETER_GAMMA]);
  const core_surface_inputs inputs = {
      .isa = isa,
      .moments = moments,
      .g = taken.g,
      .eta = eta,
      .tolerance = isnan(tolerance) ? CORE_VARYING_TOLERANCE : tolerance,
      .is_transport = family == TRANSPORT,
      .shared = varying->shared.f64,
  };
  fault = core_surface_build(&inputs, &varying->words, &varying->words_count);
  return fault.field == NULL ? share_words(varying) : fault;
}

core_fault core_varying_open(core_varying *varying, const core_isa *isa, unsigned model,
                             unsigned moments, unsigned evaluator, double g, double eta,
                             const core_parameters *parameters, const float *words, size_t count) {
  const core_parameters none = core_parameters_none();
  enum family family;
  core_fault fault = begin(varying, isa, model, moments, evaluator, g, eta,
                           parameters != NULL ? parameters : &none, &family);
  if (fault.field == NULL) {
    fault = core_surface_check(words, count, family == TRANSPORT);
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
  return share_words(varying);
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

static core_varying_range nothing(void) {
  return (core_varying_range){0, (double)INFINITY, 0, (double)INFINITY, 0};
}

void core_varying_range_add(core_varying_range *range, const core_varying_range *other) {
  range->answered += other->answered;
  range->albedo_least = fmin(range->albedo_least, other->albedo_least);
  range->albedo_most = fmax(range->albedo_most, other->albedo_most);
  range->mfp_least = fmin(range->mfp_least, other->mfp_least);
  range->mfp_most = fmax(range->mfp_most, other->mfp_most);
}

#define DEFINE_CHECK(type, bits)                                                                   \
  static void check_##bits(const core_varying *varying, enum core_varying_argument argument,       \
                           size_t n, const type *sigma_a, const type *sigma_s, const type *in,     \
                           uint8_t *status, core_varying_range *range) {                           \
    type albedo[CHUNK], mfp[CHUNK];                                                                \
    *range = nothing();                                                                            \
    for (size_t done = 0; done < n; done += CHUNK) {                                               \
      const size_t count = n - done < CHUNK ? n - done : CHUNK;                                    \
      varying->check_kernels->bits->varying_check(varying->shared.bits, count, sigma_a + done,     \
                                                  sigma_s + done, in + done, argument,             \
                                                  status + done, albedo, mfp);                     \
      for (size_t i = 0; i < count; i++) {                                                         \
        const uint8_t found = status[done + i];                                                    \
        range->answered += found <= CORE_VALUE_FAR;                                                \
        if (found == CORE_VALUE_OK) {                                                              \
          range->albedo_least = fmin(range->albedo_least, (double)albedo[i]);                      \
          range->albedo_most = fmax(range->albedo_most, (double)albedo[i]);                        \
          if (mfp[i] < (type)INFINITY) {                                                           \
            range->mfp_least = fmin(range->mfp_least, (double)mfp[i]);                             \
            range->mfp_most = fmax(range->mfp_most, (double)mfp[i]);                               \
          }                                                                                        \
        }                                                                                          \
      }                                                                                            \
    }                                                                                              \
    if (argument == CORE_VARYING_NUMBERS) {                                                        \
      range->mfp_least = 0;                                                                        \
      range->mfp_most = (double)INFINITY;                                                          \
    }                                                                                              \
  }                                                                                                \
  void core_varying_check_##bits(const core_varying *varying, size_t n, const type *sigma_a,       \
                                 const type *sigma_s, const type *r, uint8_t *status,              \
                                 core_varying_range *range) {                                      \
    check_##bits(varying, CORE_VARYING_RADII, n, sigma_a, sigma_s, r, status, range);              \
  }                                                                                                \
  void core_varying_check_u_##bits(const core_varying *varying, size_t n, const type *sigma_a,     \
                                   const type *sigma_s, const type *u, uint8_t *status,            \
                                   core_varying_range *range) {                                    \
    check_##bits(varying, CORE_VARYING_NUMBERS, n, sigma_a, sigma_s, u, status, range);            \
  }

DEFINE_CHECK(double, f64)
DEFINE_CHECK(float, f32)

/* ---- evaluating ------------------------------------------------------------------------------ */

static enum core_elementwise position(enum core_quantity quantity) {
  switch (quantity) {
  case CORE_QUANTITY_R:
    return CORE_ELEMENTWISE_R;
  case CORE_QUANTITY_CDF:
    return CORE_ELEMENTWISE_CDF;
  case CORE_QUANTITY_PDF:
    return CORE_ELEMENTWISE_PDF;
  case CORE_QUANTITY_RING:
    return CORE_ELEMENTWISE_RING;
  default:
    assert(!"R, CDF, PDF or RING");
    return CORE_ELEMENTWISE_COUNT;
  }
}

void core_varying_eval_f64(const core_varying *varying, enum core_quantity quantity, size_t n,
                           const double *sigma_a, const double *sigma_s, const double *r,
                           double *out) {
  assert(varying->evaluator == CORE_EVALUATOR_F64);
  varying->kernels->f64->varying[position(quantity)](varying->shared.f64, varying->wide_words, n,
                                                     sigma_a, sigma_s, r, out);
}

void core_varying_sample_f64(const core_varying *varying, size_t n, const double *sigma_a,
                             const double *sigma_s, const double *u, double *r) {
  assert(varying->evaluator == CORE_EVALUATOR_F64);
  varying->kernels->f64->varying_sample(varying->shared.f64, varying->wide_words, n, sigma_a,
                                        sigma_s, u, r);
}

/* Evaluates in double precision and rounds. `below_1`: whether a value below 1 must stay so. */
static void widely(const core_varying *varying, core_varying_kernel_f64 *kernel, bool below_1,
                   size_t n, const float *sigma_a, const float *sigma_s, const float *in,
                   float *out) {
  double wide[4][CHUNK];
  for (size_t done = 0; done < n; done += CHUNK) {
    const size_t count = n - done < CHUNK ? n - done : CHUNK;
    for (size_t i = 0; i < count; i++) {
      wide[0][i] = (double)sigma_a[done + i];
      wide[1][i] = (double)sigma_s[done + i];
      wide[2][i] = (double)in[done + i];
    }
    kernel(varying->shared.f64, varying->wide_words, count, wide[0], wide[1], wide[2], wide[3]);
    for (size_t i = 0; i < count; i++) {
      const float rounded = (float)wide[3][i];
      out[done + i] = below_1 && wide[3][i] < 1 && rounded >= 1 ? 1 - FLT_EPSILON / 2 : rounded;
    }
  }
}

void core_varying_eval_f32(const core_varying *varying, enum core_quantity quantity, size_t n,
                           const float *sigma_a, const float *sigma_s, const float *r, float *out) {
  assert(varying->evaluator == CORE_EVALUATOR_F32);
  const enum core_elementwise at = position(quantity);
  core_varying_kernel_f32 *kernel = varying->kernels->f32->varying[at];
  if (kernel != NULL) {
    kernel(varying->shared.f32, varying->words, n, sigma_a, sigma_s, r, out);
  } else {
    widely(varying, varying->kernels->f64->varying[at], quantity == CORE_QUANTITY_CDF, n, sigma_a,
           sigma_s, r, out);
  }
}

void core_varying_sample_f32(const core_varying *varying, size_t n, const float *sigma_a,
                             const float *sigma_s, const float *u, float *r) {
  assert(varying->evaluator == CORE_EVALUATOR_F32);
  if (varying->kernels->f32->varying_sample != NULL) {
    varying->kernels->f32->varying_sample(varying->shared.f32, varying->words, n, sigma_a, sigma_s,
                                          u, r);
  } else {
    widely(varying, varying->kernels->f64->varying_sample, false, n, sigma_a, sigma_s, u, r);
  }
}

/* ---- from colours to media ------------------------------------------------------------------- */

core_fault core_colour_check(const core_varying *varying, const core_colour *what) {
  if ((unsigned)what->light >= CORE_LIGHTS ||
      !(varying->colour_least[what->light] < varying->colour_most[what->light])) {
    return (core_fault){"light", "light that the model knows: a beam, or diffuse with transport",
                        0};
  }
  if (core_choice_by_id(core_lengths, what->length) == NULL) {
    return (core_fault){"length", "a length of the list", 0};
  }
  return (core_fault){0};
}

#define DEFINE_INVERT(type, bits, table)                                                           \
  void core_varying_invert_##bits(const core_varying *varying, const core_colour *what, size_t n,  \
                                  const type *colour, const type *length_mm, type *sigma_a,        \
                                  type *sigma_s, type *albedo, uint8_t *status) {                  \
    assert(core_colour_check(varying, what).field == NULL);                                        \
    type unwanted[CHUNK];                                                                          \
    for (size_t done = 0; done < n; done += CHUNK) {                                               \
      const size_t count = n - done < CHUNK ? n - done : CHUNK;                                    \
      varying->check_kernels->bits->varying_invert(                                                \
          varying->shared.bits, varying->table, what, count, colour + done, length_mm + done,      \
          sigma_a + done, sigma_s + done, albedo != NULL ? albedo + done : unwanted,               \
          status + done);                                                                          \
    }                                                                                              \
  }

DEFINE_INVERT(double, f64, wide_words)
DEFINE_INVERT(float, f32, words)
