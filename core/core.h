/* core: subsurface-scattering profiles R(r), their albedo and their cdf.
 *
 * Prepare once, evaluate elementwise: core_profile_prepare() turns a medium, a model and an
 * evaluator into a profile (coefficients); core_eval_f64() and core_eval_f32() apply it to radii.
 * The same profile and radius give the same bits on every instruction set, at every array length,
 * alignment and slicing, on every machine.
 *
 * Units: lengths in mm, coefficients in 1/mm, R in 1/mm^2 per unit of power that entered the medium
 * (not per launched power: specular reflection is not part of it).
 *
 * Nothing here logs, opens files or keeps state; every function may be called from any thread at
 * any time. Only core_profile_prepare() allocates, and only for models that need a table.
 */
#ifndef DIPOLED_CORE_H
#define DIPOLED_CORE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* ---- lists ------------------------------------------------------------------------------------
 */

enum core_dipole_switch {
  CORE_DIPOLE_GROSJEAN = 1, /* Grosjean's diffusion coefficient and prefactor alpha'^2 */
  CORE_DIPOLE_BOUNDARY = 2, /* A = (1 + 3 C2) / (1 - 2 C1) */
  CORE_DIPOLE_EXITANCE = 4, /* fluence and flux leave: (1 - 2 C1) / 4 and (1 - 3 C2) / 2 */
};

/* Of Burley's profile: which fit gives its width. */
enum core_burley_fit { CORE_BURLEY_SEARCHLIGHT, CORE_BURLEY_DIFFUSE, CORE_BURLEY_DMFP };

/* Of diffusing clouds, besides the dipole's switches: a slab's transmitted profile in place of the
 * reflected one; a half space with the beam's source in place of a slab. */
enum { CORE_SLAB_TRANSMITTED = 8, CORE_CLOUD_BEAM = 16 };

enum core_model {
#define CORE_MODEL(id, IDENT, name, formula, kernels, variant, parameters, source)                 \
  CORE_MODEL_##IDENT = (id),
#define CORE_SUM(id, IDENT, name, FIRST, SECOND, source) CORE_MODEL_##IDENT = (id),
#include "core/models.def"
};

#define CORE_EVALUATOR(id, IDENT, name, number, about) CORE_EVALUATOR_##IDENT = (id),
enum core_evaluator {
#include "core/choices.def"
};

#define CORE_MOMENTS(id, IDENT, name, eta_min, eta_max, about) CORE_MOMENTS_##IDENT = (id),
enum core_moments {
#include "core/choices.def"
};

#define CORE_QUANTITY(bit, IDENT, name, unit, SHAPE) CORE_QUANTITY_##IDENT = (bit),
enum core_quantity {
#include "core/choices.def"
};

#define CORE_SPACING(id, IDENT, name, about) CORE_SPACING_##IDENT = (id),
enum core_spacing {
#include "core/choices.def"
};

#define CORE_DRAW(id, IDENT, name, about) CORE_DRAW_##IDENT = (id),
enum core_draw_rule {
#include "core/choices.def"
};

#define CORE_LENGTH(id, IDENT, name, about) CORE_LENGTH_##IDENT = (id),
enum core_length {
#include "core/choices.def"
};

#define CORE_PARAMETER(id, IDENT, name, unit, least, most, about) CORE_PARAMETER_##IDENT = (id),
enum core_parameter {
#include "core/choices.def"
  CORE_PARAMETERS_END
};

#define CORE_NOTE(bit, IDENT, name, about) CORE_NOTE_##IDENT = (bit),
enum core_note {
#include "core/choices.def"
};

/* One entry of a list, for listings and for turning names into ids. `about` is the source of a
 * model, the unit of a quantity, the meaning of anything else. */
typedef struct core_choice {
  unsigned id;
  const char *name;
  const char *about;
} core_choice;

/* Each list ends with an entry whose name is NULL; static, immutable. */
extern const core_choice core_models[];
extern const core_choice core_evaluators[];
extern const core_choice core_moments_list[];
extern const core_choice core_quantities[];
extern const core_choice core_spacings[];
extern const core_choice core_draws[];
extern const core_choice core_lengths[];
extern const core_choice core_parameter_list[];
extern const core_choice core_notes[];

/* The entry of a list with this id or this exact name; NULL when there is none. */
const core_choice *core_choice_by_id(const core_choice *list, unsigned id);
const core_choice *core_choice_by_name(const core_choice *list, const char *name);

/* True for quantities with one value for each radius and channel. bit: of the list. */
bool core_quantity_elementwise(unsigned bit);

/* Bytes of a radius or value of an evaluator: 8 or 4; 0 for one that is not in the list. */
size_t core_evaluator_bytes(unsigned evaluator);

/* ---- faults -----------------------------------------------------------------------------------
 */

/* What is wrong with an input: which field, and what is allowed. field == NULL: nothing is wrong.
 * The strings are static. index: the position of the value in its array, 0 for a single one. */
typedef struct core_fault {
  const char *field;
  const char *allowed;
  size_t index;
} core_fault;

/* The field of the fault that there is no memory left for a profile, which may pass. */
#define CORE_FIELD_MEMORY "memory"

/* ---- media ------------------------------------------------------------------------------------
 */

/* A homogeneous, semi-infinite medium. */
typedef struct core_medium {
  double sigma_a_per_mm; /* absorption coefficient: 0 to CORE_SIGMA_MAX_PER_MM */
  double sigma_s_per_mm; /* scattering coefficient: 0 to CORE_SIGMA_MAX_PER_MM */
  double g;              /* mean cosine of the phase function: in (-1, 1) */
  double eta;            /* index inside over index outside: CORE_ETA_MIN to CORE_ETA_MAX */
} core_medium;

#define CORE_SIGMA_MAX_PER_MM 1e15
#define CORE_SIGMA_T_PRIME_MIN_PER_MM 1e-15 /* sigma_a + sigma_s (1 - g) must reach it */
#define CORE_ETA_MIN 1e-3
#define CORE_ETA_MAX 1e3

/* The first fault of the medium, in the order of its fields. */
core_fault core_medium_check(const core_medium *medium);

/* The media measured by Jensen et al. 2001 (Figure 5); three channels: red, green, blue.
 * Only sigma_s' was measured: sigma_s holds it, with g = 0. eta = 1.3. */
typedef struct core_measured_medium {
  const char *name;
  core_medium channel[3];
} core_measured_medium;

extern const core_measured_medium core_measured_media[];
extern const size_t core_measured_media_count;

const core_measured_medium *core_measured_medium_by_name(const char *name); /* NULL: none */

/* ---- parameters -------------------------------------------------------------------------------
 */

/* Optional numbers that a request may carry; value[CORE_PARAMETER_...], NaN where it is not given.
 */
typedef struct core_parameters {
  double value[CORE_PARAMETERS_END];
} core_parameters;

/* None given. */
core_parameters core_parameters_none(void);

/* The fault of a value that is out of its range, whatever the model. */
core_fault core_parameter_check(enum core_parameter parameter, double value);

/* ---- Fresnel moments --------------------------------------------------------------------------
 */

/* With C_k the integral over mu in [0, 1] of F(mu) mu^k, F the unpolarized Fresnel reflectance of
 * light that strikes the boundary from inside (d'Eon 2012, section 2). The complements are kept,
 * because 1 - 2 C1 loses its digits when eta is large. */
typedef struct core_fresnel {
  double one_minus_2c1;
  double one_minus_3c2;
} core_fresnel;

/* The fault of an eta outside the range of these moments (a kind of the list, asserted). */
core_fault core_fresnel_check(enum core_moments moments, double eta);

/* eta in that range; asserted. The exact moments are within 4 epsilon of the integrals, the fits
 * within 1 epsilon of their polynomials' exact values. */
core_fresnel core_fresnel_moments(enum core_moments moments, double eta);

/* The unpolarized Fresnel transmittance of light between outside and inside, for the cosine of its
 * angle outside, from 0 to 1; 0 where light from outside is totally reflected. */
double core_fresnel_transmittance(double eta, double cos_outside);

/* ---- instruction sets -------------------------------------------------------------------------
 */

typedef struct core_isa core_isa;

/* The kernels for an instruction set: "portable", "sse2", "avx2", "avx512" (x86-64), or NULL for
 * the best that this machine has. NULL is returned for a name that is unknown or that this machine
 * cannot run. */
const core_isa *core_isa_select(const char *name);

const char *core_isa_name(const core_isa *isa);

/* All levels that this build holds, worst first; NULL past the end. The machine may lack some. */
const char *core_isa_listed(size_t index);

/* ---- profiles ---------------------------------------------------------------------------------
 */

enum { CORE_COEFFICIENTS_MAX = 32 };

/* Radii in mm from least to most, both included. */
typedef struct core_radii_range {
  double least_mm;
  double most_mm;
} core_radii_range;

/* How far a model is from radiative transport for one medium; core/model_error.h finds it. */
enum { CORE_MODEL_ERROR_BANDS = 10 };
typedef struct core_model_errors {
  bool exact; /* the model is transport itself: no error anywhere */
  /* Relative errors of R in each band of radii, then that of the albedo. NAN: not measured. */
  double error[CORE_MODEL_ERROR_BANDS + 1];
} core_model_errors;

/* Up to which radius a numerical error holds, and how it grows from there on: at radius r beyond
 * most_mm, e^(growth ln^2(r / most_mm)) - 1 is added to it, or INFINITY in place of more than 1000. */
typedef struct core_reach {
  double most_mm; /* INFINITY: everywhere */
  double growth;
} core_reach;

/* model + medium + evaluator, prepared. It may be copied; the copies share what one of them frees.
 * Read the public part; the rest belongs to the kernels. */
typedef struct core_profile {
  core_medium medium;
  enum core_model model;
  enum core_moments moments;
  enum core_evaluator evaluator;
  double albedo; /* integral of 2 pi r R(r) from 0 to infinity; 0 when nothing scatters */
  /* Numerical error: a value at radius r is off from the model's exact formula by at most
   * numerical_error + numerical_error_per_mm * r, relative, or by 16 of the smallest subnormal
   * numbers, whichever is more. A value that is larger than the largest finite number of its
   * precision is infinity. S is R times a number: what R loses by underflow or overflow, S loses
   * times that number. The bound holds for R, S, cdf and (at r = 0, and in double precision for both
   * evaluators) the albedo. It holds for dR/dr, pdf and 2 pi r R with sigma_t' from 1e-6 to 1e6 per
   * mm, sigma_a up to 1e6 sigma_s', eta from 0.2 to 5 and r 0 or from 1e-12 to 1e6 mean free paths
   * 1 / sigma_t', beyond which they may underflow too early. For ln R see core_eval_f64(). Where the
   * albedo has underflowed to 0, cdf and pdf are 0. It holds for radii within the reach;
   * core_profile_errors() has the error for any radii. */
  double numerical_error;
  double numerical_error_per_mm;
  core_reach reach;
  core_model_errors model_errors;
  unsigned notes;         /* bits of enum core_note */
  core_radii_range radii; /* where the profile may be evaluated */
  double cost;            /* of a radius: about as many evaluations of a dipole */

  const struct core_kernels *kernels; /* NULL: a sum of parts */
  struct core_profile *parts;         /* [2], of a sum; owned */
  double *table;                      /* instead of the coefficients below; owned */
  size_t table_bytes;
  float *lut;                  /* of evaluator lut: core/lut/lut.h; owned */
  size_t lut_count;            /* its words */
  struct core_profile *source; /* that it was made from; NULL: it was downloaded; owned */
  double scale_mm;             /* the order of the radii that matter */
  double cos_in;               /* angles of S */
  double cos_out;
  double part_shares[2]; /* of the albedo */
  union {
    double f64[CORE_COEFFICIENTS_MAX];
    float f32[CORE_COEFFICIENTS_MAX];
  } coefficients;
} core_profile;

/* The fault that core_profile_prepare() would return for the same arguments, cheaply; without one,
 * *radii is where such a profile may be evaluated. What only shows in preparing is not found: that
 * memory has run out, or that a fit does not reach the tolerance. parameters, radii: may be NULL. */
core_fault core_profile_check(unsigned model, unsigned moments, unsigned evaluator,
                              const core_medium *medium, const core_parameters *parameters,
                              core_radii_range *radii);

/* Whether preparing may take longer than a millisecond, so that who serves others does it on a thread
 * apart. */
bool core_prepares_slowly(unsigned model, unsigned evaluator);

/* Whether preparing takes longer than some ten microseconds, so that who is asked for the same medium
 * again keeps the profile. True for all that prepare slowly. */
bool core_worth_keeping(unsigned model, unsigned evaluator);

/* Prepares *profile for the kernels of isa. model, moments and evaluator are any integers (a peer
 * may have sent them); parameters may be NULL (none is given). On a fault *profile is unspecified,
 * else it is to be freed with core_profile_free(). */
core_fault core_profile_prepare(core_profile *profile, const core_isa *isa, unsigned model,
                                unsigned moments, unsigned evaluator, const core_medium *medium,
                                const core_parameters *parameters);

/* What a reply states of a profile's values. */
typedef struct core_stated_errors {
  double numerical;        /* as numerical_error, */
  double numerical_per_mm; /* and numerical_error_per_mm, for all of the radii */
  double model;            /* how far they may be from radiative transport; NAN: not known */
} core_stated_errors;

/* The errors of the quantities that are wanted (bits) at radii from least to most; with least above
 * most there are no radii. The model's error is relative, of
 * ln R absolute; the cdf and dR/dr were not measured, and it does not speak of them. */
core_stated_errors core_profile_errors(const core_profile *profile, unsigned wanted,
                                       core_radii_range radii);

/* Sets the angles of S to those of the parameters (normal when not given), as preparing with them
 * would; nothing else depends on them, so that one preparation serves all angles. */
void core_profile_set_angles(core_profile *profile, const core_parameters *parameters);

/* Frees what the profile owns; its copies are then dead, too. */
void core_profile_free(core_profile *profile);

/* What a profile owns, in bytes; itself not counted. */
size_t core_profile_bytes(const core_profile *profile);

/* Evaluates one elementwise quantity of a profile prepared with evaluator f64 (both asserted) at n
 * radii: r[n] in mm, from 0 to infinity inclusive; out[n] in the quantity's unit:
 *   R      1/mm^2; underflows gradually
 *   CDF    the energy within r over the albedo, from 0 to 1
 *   SLOPE  dR/dr, 1/mm^3, never positive
 *   LN_R   the natural logarithm of R, which goes on where R has underflowed: finite up to 1e100
 *          (f32: 1e12) mean free paths 1 / sigma_t', -infinity from there on and where R is 0.
 *          Its error is absolute: numerical_error + numerical_error_per_mm r + 8 epsilon |ln R|
 *   PDF    the density of radii, 2 pi r R over the albedo, 1/mm
 *   RING   2 pi r R, the power that leaves per mm of radius; finite at r = 0 where R is not, 1/mm
 *   S      the BSSRDF for the two angles of the parameters (normal when not given), 1/(mm^2 sr):
 *          F_t(cos_in) R(r) F_t(cos_out) / (pi (1 - 2 C1(1 / eta))), with the exact C1
 *          (d'Eon 2012, Eq. 1; Jensen et al. 2001, Eq. 5)
 * The arrays are aligned for their type, no more; they do not overlap. Values for radii that
 * core_radii_check_f64() faults are unspecified. */
void core_eval_f64(const core_profile *profile, enum core_quantity quantity, size_t n,
                   const double *r, double *out);

/* The same for evaluators f32 and lut. */
void core_eval_f32(const core_profile *profile, enum core_quantity quantity, size_t n,
                   const float *r, float *out);

/* Radii with given cdf: r[n] in mm such that cdf(r) = u, for u[n] from 0 to 1 inclusive (0: 0;
 * 1: infinity), for drawing radii in proportion to r R(r) from uniform numbers.
 * |cdf(r) - u| is at most CORE_SAMPLE_ERROR_F64 (F32) and the numerical error of the cdf, for u up
 * to 1 - 1e-7. A profile that scatters nothing has no distribution: r is 0. */
void core_sample_f64(const core_profile *profile, size_t n, const double *u, double *r);
void core_sample_f32(const core_profile *profile, size_t n, const float *u, float *r);

/* For evaluator lut: the radius is within the numerical error of the one that has the cdf u. */

#define CORE_SAMPLE_ERROR_F64 1e-14
#define CORE_SAMPLE_ERROR_F32 4e-7

/* ---- tables -----------------------------------------------------------------------------------
 */

/* The radii between which a profile of evaluator lut has pieces, in mm; outside, asymptotes go on. */
core_radii_range core_table_pieces(const core_profile *profile);

/* A profile from a table that was made elsewhere: lut_count words, which are copied, and the public
 * part of *profile, which the caller has filled in; the rest is set here. It evaluates what
 * core_table_has() and samples; with the same bits as the profile that the words are from. Faults:
 * `table`, when the words are not a table; `memory`. */
core_fault core_profile_from_table(core_profile *profile, const core_isa *isa, const float *words,
                                   size_t count);

/* Whether a table alone, without the profile that it was made from, holds a quantity. */
bool core_table_has(enum core_quantity quantity);

/* ---- from albedo to coefficients ---------------------------------------------------------------
 */

/* The medium (g = 0: sigma_s is sigma_s') whose albedo under a model is the one that is wanted. */
typedef struct core_inversion {
  core_fault fault; /* field `albedo`: it cannot be reached; the two numbers below say what can */
  core_medium medium;
  double albedo_least; /* reachable, for this model, moments and eta */
  double albedo_most;
} core_inversion;

#define CORE_MEAN_FREE_PATH_MIN_MM 1e-14 /* within what a medium may have, with room to round */
#define CORE_MEAN_FREE_PATH_MAX_MM 1e14

/* mean_free_path_mm: 1 / sigma_t', in that range. The medium's albedo is within 1e-12 of the wanted
 * one, relative, where the model's albedo has so many digits. core/inverter.h has more. */
core_inversion core_invert_albedo(unsigned model, unsigned moments, double albedo,
                                  double mean_free_path_mm, double eta);

/* ---- radii ------------------------------------------------------------------------------------
 */

/* The first radius that is negative or NaN. -0.0 is 0. */
core_fault core_radii_check_f64(size_t n, const double *r);
core_fault core_radii_check_f32(size_t n, const float *r);

/* From the least to the largest finite one of n radii that are not NaN: at an infinite radius, where
 * R is 0, no model is off. Without a finite radius the range is from INFINITY to 0. */
core_radii_range core_radii_range_f64(size_t n, const double *r);
core_radii_range core_radii_range_f32(size_t n, const float *r);

/* The first radius outside a profile's range, of radii that are not NaN. */
core_fault core_radii_range_check_f64(const core_radii_range *range, size_t n, const double *r);
core_fault core_radii_range_check_f32(const core_radii_range *range, size_t n, const float *r);

/* Radii by rule: count of them from start to stop, both included (count = 1: start alone).
 * linear:       start + i (stop - start) / (count - 1)
 * logarithmic:  start (stop / start)^(i / (count - 1)), each within 1e-12 of it, relative
 * In single precision: the double precision radius, rounded. */
typedef struct core_grid {
  enum core_spacing spacing; /* LINEAR or LOGARITHMIC */
  uint64_t count;            /* at least 1, at most CORE_GRID_COUNT_MAX */
  double start_mm;           /* finite, at least 0; logarithmic: at least CORE_GRID_LOG_MIN_MM */
  double stop_mm;            /* finite, at least start */
} core_grid;

#define CORE_GRID_COUNT_MAX ((uint64_t)1 << 53)
#define CORE_GRID_LOG_MIN_MM 1e-300

/* The faults name the fields of the wire: radius_count, radius_start, radius_stop. */
core_fault core_grid_check(const core_grid *grid);

/* Writes the radii first, first + 1, ..., first + n - 1 of the grid to r[n]. */
void core_grid_radii_f64(const core_grid *grid, uint64_t first, size_t n, double *r);
void core_grid_radii_f32(const core_grid *grid, uint64_t first, size_t n, float *r);

#endif
