/* varying: evaluates profiles where every value has its own medium, as the shading points of a
 * texture do.
 *
 * Each value has its own sigma_a, sigma_s and radius (or u); model, moments, g and eta are those of
 * the request. core_varying_prepare() makes what depends on these alone. The rest of the
 * preparation is part of the kernels. It serves the dipole family, Burley's three and `transport`.
 *
 * For `transport` the preparation makes a surface (core/varying/surface.h): a table over albedo and
 * radius for one g and eta, from the table of solutions. Its error is measured after it is made,
 * and stated.
 *
 * A value that cannot be computed is NaN, and its status says why.
 * The same value gets the same bits on every instruction set and in every slice of an array.
 *
 * Arrays need only their type's alignment; outputs must not overlap inputs or each other. Nothing
 * but core_varying_prepare() and core_varying_open() allocates.
 */
#ifndef DIPOLED_CORE_VARYING_H
#define DIPOLED_CORE_VARYING_H

#include "core/core.h"

/* ---- statuses -------------------------------------------------------------------------------- */

/* What became of one value, in one byte. */
enum core_value_status { CORE_EACH_VALUE(CORE_ENUM, CORE_VALUE) };

/* of the kind of choice; `about` says what is allowed */
extern const core_choice core_value_statuses[];

/* ---- preparing ------------------------------------------------------------------------------- */

#define CORE_VARYING_TOLERANCE 1e-3 /* default of the parameter `tolerance` of a surface */
#define CORE_VARYING_TOLERANCE_MIN 1e-5
/* sigma_t' = sigma_a + sigma_s (1 - g) of media that vary */
#define CORE_VARYING_SIGMA_T_PRIME_MIN_PER_MM 1e-6
#define CORE_VARYING_SIGMA_T_PRIME_MAX_PER_MM 1e6
/* least sigma_s (1 - g) / sigma_t' of a dipole or Burley's profile where sigma_s is not 0 */
#define CORE_VARYING_SCATTERED_MIN 1e-12

enum { CORE_VARYING_SHARED_MAX = 32 };

/* A model with g, eta and an evaluator, prepared. Callers read the fields down to `words_count`;
 * the others belong to core. Copies share the owned memory, which is freed once. */
typedef struct core_varying {
  enum core_model model;
  enum core_moments moments;
  enum core_evaluator evaluator; /* f64 or f32 */
  double g;
  double eta;
  unsigned notes; /* a mask of enum core_note */
  /* The media that the preparation serves have a ratio sigma_s' / sigma_t' from least to most.
   * sigma_s may also be 0, unless the model is `transport`. */
  double albedo_least;
  double albedo_most;
  /* The colours that a medium has, from least to most, per power that entered. The most is below
   * the least for light that the model does not know. */
  double colour_least[CORE_LIGHTS];
  double colour_most[CORE_LIGHTS];
  /* Fresnel reflectance of the surface: the share of the incident light that does not enter. */
  double specular[CORE_LIGHTS];
  /* largest relative error found when the surface was made; 0 for models without a surface */
  double surface_error;
  float *words; /* words of the surface and of the colours (core/varying/surface.h); owned */
  size_t words_count;

  /* parameter of the scattering that the surface is made for: g, gamma - 1, or 0 for similarity */
  double table_g;
  double gamma;                       /* parameters of core_varying_prepare(); NAN if not given */
  const struct core_kernels *kernels; /* kernels of the model */
  /* kernels that every model uses, for checks and colours */
  const struct core_kernels *check_kernels;
  /* the same words in double precision; NULL if the evaluator does not need them; owned */
  double *wide_words;
  struct {
    double f64[CORE_VARYING_SHARED_MAX];
    float f32[CORE_VARYING_SHARED_MAX];
  } shared;
} core_varying;

/* Prepares *varying for the kernels of isa. model, moments and evaluator may be any integers.
 * parameters (NULL: none): `tolerance`, from CORE_VARYING_TOLERANCE_MIN on, of the surface's error
 * against the evaluator f64 of the same model; `surface_albedo`; `gamma`. Faults: those of
 * core_profile_check() for a medium with this g and eta; `model` or `evaluator` if media cannot
 * vary with it; `eta` if the table of solutions does not cover it; `tolerance` if no surface keeps
 * it; and `memory`. On a fault *varying is unspecified. Otherwise the caller frees it. For
 * `transport` this takes some 20 ms and 1 MB with the default tolerance, 60 ms and 4 MB with 1e-4,
 * and 0.4 s and 22 MB with 1e-5 (1.5 s and 54 MB for g near -0.5 and eta from 1.7 on); f64 takes
 * three times the memory. For other models it takes some ten microseconds. */
core_fault core_varying_prepare(core_varying *varying, const core_isa *isa, unsigned model,
                                unsigned moments, unsigned evaluator, double g, double eta,
                                const core_parameters *parameters);

/* Does the same, but takes the `count` words of another preparation with the same arguments in
 * place of making them. It copies the words. Evaluating then gives the same bits. Fault besides:
 * `table` if the words are not such words. Whatever numbers they hold, evaluating reads nothing
 * else. */
core_fault core_varying_open(core_varying *varying, const core_isa *isa, unsigned model,
                             unsigned moments, unsigned evaluator, double g, double eta,
                             const core_parameters *parameters, const float *words, size_t count);

/* Frees what the preparation owns. */
void core_varying_free(core_varying *varying);

/* Size in bytes of the memory that a preparation owns, without the structure itself. */
size_t core_varying_bytes(const core_varying *varying);

/* The arrays below are of double or, with the evaluator f32, of float. */

/* ---- checking and errors --------------------------------------------------------------------- */

/* What the computed values of an array have in common. */
typedef struct core_varying_range {
  /* number of values with status OK or FAR; the members below cover only values with OK */
  size_t computed;
  double albedo_least; /* range of sigma_s' / sigma_t'; least > most if no value has OK */
  double albedo_most;
  double mfp_least; /* range of r sigma_t', of finite radii */
  double mfp_most;
} core_varying_range;

/* Sets status[n] to those of n values with sigma_a[n], sigma_s[n] in 1/mm and r[n] in mm, and
 * *range. drawn: r holds numbers u; in the range only the albedos are then set, and the radii are 0
 * to infinity. */
void core_varying_check(const core_varying *varying, bool drawn, size_t n, const void *sigma_a,
                        const void *sigma_s, const void *r, uint8_t *status,
                        core_varying_range *range);

/* Extends *range to include *other. */
void core_varying_range_add(core_varying_range *range, const core_varying_range *other);

/* Returns the numerical error of the wanted quantities (bits) of values in a range whose status is
 * OK: relative, against the exact formula of the model. It contains rounding, up to where a value
 * underflows; for `transport` also the measured error of the surface and that of the table of
 * solutions. */
double core_varying_error(const core_varying *varying, unsigned wanted,
                          const core_varying_range *range);

/* ---- evaluating ------------------------------------------------------------------------------ */

/* Evaluates R, CDF, PDF, RING (core.h) or ALBEDO, which does not need r, for n values: out[i] of the
 * medium sigma_a[i], sigma_s[i] at r[i] mm. Or RADIUS: out[i] is the radius in mm at which the cdf of
 * the medium is r[i], 0 to 1. A value whose status is neither OK nor FAR is NaN. */
void core_varying_eval(const core_varying *varying, enum core_quantity quantity, size_t n,
                       const void *sigma_a, const void *sigma_s, const void *r, void *out);

/* The values of core_varying_gradient_f64(), each an array of n numbers. */
typedef struct core_gradient {
  double *ln_R;
  double *by_ln_sigma_a; /* d ln R / d ln sigma_a at constant r and sigma_s */
  /* d ln R / d ln sigma_s at constant r and sigma_a; the derivative by ln sigma_s' is the same */
  double *by_ln_sigma_s;
} core_gradient;

/* Sets ln R and its derivatives, for all models that core_varying_prepare() accepts, with evaluator
 * f64 (asserted). Derivatives of a surface are exact for the surface. A value whose status is
 * neither OK nor FAR is NaN. */
void core_varying_gradient_f64(const core_varying *varying, size_t n, const double *sigma_a,
                               const double *sigma_s, const double *r, const core_gradient *out);

/* ---- from colours to media ------------------------------------------------------------------- */

/* The albedo of a medium from core_varying_invert() is off from the colour, per power
 * that entered, by less than this, absolute, for these eta. (For eta of 10 it is 1e-3, for 1000 it
 * is 0.9.) */
#define CORE_COLOUR_ERROR 1e-5
#define CORE_COLOUR_ETA_MIN 0.01
#define CORE_COLOUR_ETA_MAX 4

/* What a colour means. */
typedef struct core_colour {
  enum core_light light;
  /* whether the colour includes the light that the surface reflects without entering (Fresnel) */
  bool specular;
  enum core_length length;
} core_colour;

/* Returns a fault, `light`, if a model does not know the light: all know a beam, and transport also
 * diffuse light. */
core_fault core_light_check(unsigned model, enum core_light light);

/* Returns the share of the light striking the surface that the surface itself reflects (Fresnel). */
double core_specular(enum core_light light, double eta);

/* Returns a fault if the model does not know this light (`light`) or length (`length`), or does not
 * keep CORE_COLOUR_ERROR (`eta`). */
core_fault core_colour_check(const core_varying *varying, const core_colour *what);

/* Sets sigma_a[n] and sigma_s[n], in 1/mm, to the media of the colours (diffuse albedos) colour[n]
 * and lengths length_mm[n]. albedo[n] is set to sigma_s / (sigma_a + sigma_s), which a random walk
 * needs. A colour that no medium has, or a length that leads out of the domain,
 * gets its status, and its results are NaN. */
void core_varying_invert(const core_varying *varying, const core_colour *what, size_t n,
                         const void *colour, const void *length_mm, void *sigma_a, void *sigma_s,
                         void *albedo, uint8_t *status);

#endif
