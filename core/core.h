/* core: evaluates subsurface-scattering profiles R(r), their albedo and their cdf.
 *
 * A caller prepares once and evaluates often: core_profile_prepare() turns a medium, a model and an
 * evaluator into a profile (coefficients); core_eval_f64() and core_eval_f32() apply it to radii.
 * The same profile and radius give the same bits on every instruction set, at every array length,
 * alignment and slicing, on every machine.
 *
 * Lengths are in mm, coefficients in 1/mm, and R is in 1/mm^2 per unit of power that entered the
 * medium. Power that the surface reflects specularly does not count as entered.
 *
 * Nothing here logs, opens files or keeps state; every function may be called from any thread at
 * any time. Only core_profile_prepare() allocates, and only for models that need a table.
 */
#ifndef DIPOLED_CORE_H
#define DIPOLED_CORE_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/choices.def"
#include "core/models.def"

/* ---- lists ----------------------------------------------------------------------------------- */

enum core_dipole_switch {
  CORE_DIPOLE_GROSJEAN = 1, /* Grosjean's diffusion coefficient and prefactor alpha'^2 */
  CORE_DIPOLE_BOUNDARY = 2, /* A = (1 + 3 C2) / (1 - 2 C1) */
  CORE_DIPOLE_EXITANCE = 4, /* exitance: (1 - 2 C1) / 4 fluence + (1 - 3 C2) / 2 flux */
  CORE_DIPOLE_BETTER = 7,   /* all three */
};

/* The fit that gives the width of Burley's profile. */
enum core_burley_fit { CORE_BURLEY_SEARCHLIGHT, CORE_BURLEY_DIFFUSE, CORE_BURLEY_DMFP };

/* Switches of core/models/cloud.c besides those of the dipole. With CORE_SLAB_TRANSMITTED the
 * profile is what a slab transmits, also in core/models/transport.c. CORE_CLOUD_BEAM requests a
 * half space with the beam's source in place of a slab. */
enum { CORE_SLAB_TRANSMITTED = 8, CORE_CLOUD_BEAM = 16 };

#define CORE_MODEL_ID(id, IDENT, ...) CORE_MODEL_##IDENT = (id),
enum core_model { CORE_EACH_MODEL(CORE_MODEL_ID, CORE_MODEL_ID) };

/* Tolerances of tables, which core/choices.def quotes. A request may give the least up to 1. */
#define CORE_LUT_TOLERANCE_MIN 1e-6
#define CORE_LUT_TOLERANCE_MAX 0.1 /* larger values are clamped to this limit */
#define CORE_LUT_TOLERANCE 1e-4    /* used if a request gives none */
/* The least tolerance of `transport`, which is then solved on the solver's finest grid. */
#define CORE_TOLERANCE_FINEST 1e-8
#define CORE_TEXT_(number) #number
#define CORE_TEXT(number) CORE_TEXT_(number)

#define CORE_ENUM(P, id, IDENT, ...) P##_##IDENT = (id),
enum core_evaluator { CORE_EACH_EVALUATOR(CORE_ENUM, CORE_EVALUATOR) };
enum core_moments { CORE_EACH_MOMENTS(CORE_ENUM, CORE_MOMENTS) };
enum core_quantity { CORE_EACH_QUANTITY(CORE_ENUM, CORE_QUANTITY) };
enum core_spacing { CORE_EACH_SPACING(CORE_ENUM, CORE_SPACING) };
enum core_draw_rule { CORE_EACH_DRAW(CORE_ENUM, CORE_DRAW) };
enum core_length { CORE_EACH_LENGTH(CORE_ENUM, CORE_LENGTH) };
enum core_phase { CORE_EACH_PHASE(CORE_ENUM, CORE_PHASE) };
enum core_parameter { CORE_EACH_PARAMETER(CORE_ENUM, CORE_PARAMETER) CORE_PARAMETERS_END };
enum core_coefficient { CORE_EACH_COEFFICIENT(CORE_ENUM, CORE_COEFFICIENT) };
enum core_unknown { CORE_EACH_UNKNOWN(CORE_ENUM, CORE_UNKNOWN) };
enum core_note { CORE_EACH_NOTE(CORE_ENUM, CORE_NOTE) };
enum core_fit_scale { CORE_EACH_FIT_SCALE(CORE_ENUM, CORE_FIT_SCALE) };
enum core_fit_axis { CORE_EACH_FIT_AXIS(CORE_ENUM, CORE_FIT_AXIS) };
enum core_fit_status { CORE_EACH_FIT_STATUS(CORE_ENUM, CORE_FIT_STATUS) };

/* One entry of a list, for listings and for turning names into ids. `about` is the source of a
 * model, the unit of a quantity, or the meaning of any other entry. */
typedef struct core_choice {
  unsigned id;
  const char *name;
  const char *about;
} core_choice;

/* Each list is immutable and ends with an entry whose name is NULL. */
extern const core_choice core_models[];
extern const core_choice core_evaluators[];
extern const core_choice core_moments_list[];
extern const core_choice core_quantities[];
extern const core_choice core_spacings[];
extern const core_choice core_draws[];
extern const core_choice core_lengths[];
extern const core_choice core_phases[];
extern const core_choice core_parameter_list[];
extern const core_choice core_notes[];
extern const core_choice core_coefficients[];
extern const core_choice core_unknowns[];
extern const core_choice core_properties[]; /* of core/tissue/tissue.h, and the two that follow */
extern const core_choice core_haemoglobins[];
extern const core_choice core_tissues[];
extern const core_choice core_lights[];
extern const core_choice core_fit_scales[];
extern const core_choice core_fit_axes[];
extern const core_choice core_fit_statuses[];

/* Returns the entry of a list with this id or this exact name, or NULL if there is none. */
const core_choice *core_choice_by_id(const core_choice *list, unsigned id);
const core_choice *core_choice_by_name(const core_choice *list, const char *name);

/* Returns how far two names are apart: the number of characters to insert, remove or replace, where
 * capitals do not differ from small letters, nor '-' from '_'. Only 64 characters count. */
unsigned core_name_distance(const char *a, const char *b);

/* Whether a model is radiative transport itself: it comes from the table of solutions, or is solved,
 * and has no model error. */
bool core_solves(unsigned model);

/* The quantities of a shape, of those that core/choices.def says. */
enum core_shape {
  CORE_SHAPE_ELEMENTWISE = 1,
  CORE_SHAPE_MULTIPLE = 2,
  CORE_SHAPE_DERIVED = 4,
  CORE_SHAPE_COMPARED = 8,
  CORE_SHAPE_CHANNEL = 16,
  CORE_SHAPE_RADII = 32
};
#define CORE_OF_SHAPE(shapes, bit, IDENT, name, unit, SHAPE, about)                                \
  +((CORE_SHAPE_##SHAPE & (shapes)) != 0 ? (bit) : 0)
enum {
  CORE_MULTIPLES = CORE_EACH_QUANTITY(CORE_OF_SHAPE, CORE_SHAPE_MULTIPLE),
  /* with a value for each radius and channel */
  CORE_ARRAYS = CORE_EACH_QUANTITY(CORE_OF_SHAPE, ~(CORE_SHAPE_CHANNEL | CORE_SHAPE_RADII)),
  /* that need no radii */
  CORE_OF_CHANNEL = CORE_EACH_QUANTITY(CORE_OF_SHAPE, CORE_SHAPE_CHANNEL)
};

/* Size in bytes of a radius or value of an evaluator: 8 or 4, or 0 if the id is unknown. */
size_t core_evaluator_bytes(unsigned evaluator);

/* ---- faults ---------------------------------------------------------------------------------- */

/* What is wrong with an input: the field, the values that are allowed (both static strings), and
 * the position of the wrong value in its array, or 0 for a single value. If nothing is wrong, field
 * is NULL. */
typedef struct core_fault {
  const char *field;
  const char *allowed;
  size_t index;
} core_fault;

/* The field of a fault when no memory is left for a profile; trying again later may succeed. */
#define CORE_FIELD_MEMORY "memory"
/* The field of a fault that says that a caller has stopped a preparation. */
#define CORE_FIELD_STOPPED "stopped"

/* ---- media ----------------------------------------------------------------------------------- */

/* A layer of a medium. A medium is an array of them from the top down, as many as the layer_count of
 * the parameters says that go with it. The last one is a half space, or light leaves below it, too. */
typedef struct core_medium {
  double sigma_a_per_mm; /* absorption coefficient: 0 to CORE_SIGMA_MAX_PER_MM */
  double sigma_s_per_mm; /* scattering coefficient: 0 to CORE_SIGMA_MAX_PER_MM */
  double g;              /* mean cosine of the phase function: in (-1, 1) */
  double eta;            /* index inside over index outside: CORE_ETA_MIN to CORE_ETA_MAX */
  double thickness_mm;   /* 0: a half space; else CORE_THICKNESS_MIN_MM to _MAX_MM */
} core_medium;

enum { CORE_LAYERS_MAX = 8 };

/* BALANCE: the shares of the power that entered that leave above and below the layers after they were
 * scattered, then without being scattered, then those that each layer absorbs, from the top down; they
 * sum up to 1. The model is core_solves(). The errors are absolute. */
enum { CORE_BALANCE_SHARES = 4 + CORE_LAYERS_MAX };

#define CORE_THICKNESS_MIN_MM 1e-15
#define CORE_THICKNESS_MAX_MM 1e30

#define CORE_SIGMA_MAX_PER_MM 1e15
#define CORE_SIGMA_T_PRIME_MIN_PER_MM 1e-15 /* least sigma_a + sigma_s (1 - g) */
/* A medium either scatters nothing or has at least this ratio of sigma_s (1 - g) to sigma_t'.
 * Below, its albedo would underflow. */
#define CORE_SCATTERED_MIN 1e-32
#define CORE_ETA_MIN 1e-3
#define CORE_ETA_MAX 1e3

/* Returns the first fault of a layer, in the order of the structure's fields. */
core_fault core_medium_check(const core_medium *medium);

/* Returns the first fault of the layers of a medium, 1 to CORE_LAYERS_MAX, with the index of the layer:
 * only the last one may be a half space. */
core_fault core_layers_check(const core_medium *medium, size_t layer_count);

enum { CORE_NAME_BYTES = 17 };

/* A medium with a name, for red, green and blue: one measured by Jensen et al. 2001 (Figure 5), who
 * give sigma_s' only, so that sigma_s holds it, g is 0, and eta is 1.3; or layers of skin (medium.c). */
typedef struct core_measured_medium {
  char name[CORE_NAME_BYTES];
  size_t layer_count;
  core_medium channel[3 * CORE_LAYERS_MAX]; /* [3][layer_count] */
} core_measured_medium;

extern const core_measured_medium core_measured_media[];
extern const size_t core_measured_media_count;

/* Returns the measured medium with this name, or NULL if there is none. */
const core_measured_medium *core_measured_medium_by_name(const char *name);

/* ---- parameters ------------------------------------------------------------------------------ */

/* Not of the wire: if it is given, core_profile_prepare() also prepares what the derivatives of ln
 * R need, and refuses models that do not have them. */
enum { CORE_PARAMETER_DERIVATIVES = 0 };

/* Optional numbers of a request: value[CORE_PARAMETER_...], or NaN if it is not given; and of how many
 * layers its media are. */
typedef struct core_parameters {
  double value[CORE_PARAMETERS_END];
  uint32_t layer_count; /* 1 to CORE_LAYERS_MAX */
} core_parameters;

/* Returns parameters of which none is given, for media of one layer. */
core_parameters core_parameters_none(void);

/* Returns a fault if the value is outside the parameter's range, which holds for all models. */
core_fault core_parameter_check(enum core_parameter parameter, double value);

/* ---- Fresnel moments ------------------------------------------------------------------------- */

/* C_k is the integral over mu in [0, 1] of F(mu) mu^k, where F is the unpolarized Fresnel
 * reflectance of light that strikes the boundary from inside (d'Eon 2012, section 2). The structure
 * holds 1 - 2 C1 rather than C1, as the difference would lose its digits when eta is large. */
typedef struct core_fresnel {
  double one_minus_2c1;
  double one_minus_3c2;
} core_fresnel;

/* Returns a fault if eta is outside the range of these moments. Asserts that the moments are known.
 */
core_fault core_fresnel_check(enum core_moments moments, double eta);

/* Computes the moments. Asserts that eta is in the range of core_fresnel_check(). The exact moments
 * are within 4 epsilon of the integrals, the fits within 1 epsilon of their polynomials' exact
 * values. */
core_fresnel core_fresnel_moments(enum core_moments moments, double eta);

/* The unpolarized Fresnel transmittance of the boundary, from 0 to 1, for light whose angle outside
 * has this cosine. It is 0 where light from outside is totally reflected. */
double core_fresnel_transmittance(double eta, double cos_outside);

/* ---- instruction sets ------------------------------------------------------------------------ */

typedef struct core_isa core_isa;

/* Returns the kernels for an instruction set: "portable"; "sse2", "avx2" or "avx512" on x86-64;
 * "neon" on aarch64. NULL as the name requests the best set that this machine has. Returns NULL if
 * the name is unknown or this machine cannot run the set. */
const core_isa *core_isa_select(const char *name);

const char *core_isa_name(const core_isa *isa);

/* Names of the instruction sets that this build holds, slowest first; NULL past the end. This
 * machine may be unable to run some of them. */
const char *core_isa_listed(size_t index);

/* ---- profiles -------------------------------------------------------------------------------- */

enum { CORE_COEFFICIENTS_MAX = 45 };

/* Radii in mm from least to most, both included. */
typedef struct core_radii_range {
  double least_mm;
  double most_mm;
} core_radii_range;

/* The numbers of bands of radii (core_error_edges_mfp): numerical errors are stated for all bands, model
 * errors for the first ones, up to 20 mean free paths. */
enum { CORE_ERROR_BANDS = 12, CORE_MODEL_ERROR_BANDS = 10 };

/* The largest radius at which a profile's numerical error holds, and the error's growth beyond it:
 * at a radius r > most_mm, e^(growth ln^2(r / most_mm)) - 1 is added, or INFINITY if growth ln^2(r
 * / most_mm) is 7 or more. */
typedef struct core_reach {
  double most_mm; /* INFINITY if the error holds everywhere */
  double growth;
} core_reach;

/* A model with a medium and an evaluator, prepared. Copies are allowed: they share the owned
 * memory, which is freed once, through any of them. Callers read the fields down to `cost`; the
 * others belong to core. */
typedef struct core_profile {
  core_medium medium; /* the top layer */
  enum core_model model;
  enum core_moments moments;
  enum core_evaluator evaluator;
  unsigned notes; /* bits of enum core_note */
  double albedo;  /* integral of 2 pi r R(r) from 0 to infinity; 0 when nothing scatters */
  /* Numerical error: a value at radius r is off from the model's exact formula by at most
   * numerical_error + numerical_error_per_mm * r, relative, or by 16 of the smallest subnormal
   * numbers, whichever is more. A value that is larger than the largest finite number of its
   * precision is infinity. 2 pi r R, pdf and S are R times a number: what R loses by underflow or
   * overflow, they lose times that number. The relative error of S is CORE_S_ERROR more. The bound
   * holds for these, R and cdf, and for the albedo with r = 0, since every evaluator computes the
   * albedo in double precision. It holds for dR/dr with sigma_t' from 1e-6 to 1e6 per mm, sigma_a
   * up to 1e6 sigma_s', eta from 0.2 to 5, and r either 0 or from 1e-12 to 1e6 mean free paths
   * 1 / sigma_t'; beyond, it may underflow too early. Next to the source, at positive radii below
   * CORE_RADIUS_SMALL_MM, and for dR/dr below CORE_RADIUS_SMALL_MFP mean free paths, numbers on the
   * way to a value may underflow: core_profile_errors() states an infinite error there. For ln R see core_eval_f64(). Where the albedo has
   * underflowed to 0, cdf and pdf are 0 at every radius, infinity included. The bound holds for
   * radii within `reach`; core_profile_errors() gives the error for any radii and quantities. */
  double numerical_error;
  double numerical_error_per_mm;
  /* The same for R, 2 pi r R, S and ln R in each band of radii (core/model_error.h), then for the
   * albedo. None is larger than numerical_error, and all are equal to it unless the model is
   * `transport` and g is not 0. Below the first band and above the last one, their errors hold. */
  double numerical_errors[CORE_ERROR_BANDS + 1];
  double slope_error; /* the relative error of dR/dr, if it is larger than these; else 0 */
  /* The error of BY_SIGMA_A and BY_SIGMA_S: absolute, at radii within 0.9 of `reach`. */
  double derivative_error;
  double derivative_error_per_mm;
  double derivative_errors[CORE_ERROR_BANDS + 1]; /* further error in each band; the last is 0 */
  core_reach reach;
  double T_errors[CORE_ERROR_BANDS + 1]; /* of T, as numerical_errors; 0 where T is 0 */
  core_reach T_reach;
  double balance[CORE_BALANCE_SHARES]; /* of `transport` and `transport-transmitted`; else 0 */
  double balance_error;                /* absolute */
  core_radii_range radii;              /* the profile may be evaluated from least to most */
  double cost;                         /* of one radius, in evaluations of a dipole */

  const struct core_kernels *kernels; /* NULL for a sum of two parts */
  struct core_profile *parts;         /* [2], owned; NULL unless the profile is a sum */
  double *table;                      /* holds the coefficients if they need more room; owned */
  size_t table_bytes;
  float *lut;                         /* table of the evaluator lut (core/lut/lut.h); owned */
  size_t lut_count;                   /* number of words of lut */
  struct core_profile *source;        /* from which lut was made, NULL if downloaded; owned */
  double scale_mm;                    /* order of magnitude of the radii that matter */
  double path_sigma_a_per_mm;         /* of the layer whose PATH is evaluated */
  double path_index;                  /* that of its speed of light */
  struct core_profile *paths;         /* of evaluator f64, for PATH where sigma_a is low; owned */
  struct core_modulation *modulation; /* NULL without the parameter `mhz`; owned */
  double cos_in;                      /* cosines of the angles of S */
  double cos_out;
  double part_shares[2]; /* share of the albedo of each part, if the model is a sum of two parts */
  union {
    double f64[CORE_COEFFICIENTS_MAX];
    float f32[CORE_COEFFICIENTS_MAX];
  } coefficients;
} core_profile;

/* Returns the fault that core_profile_prepare() would return for the same arguments, but takes less
 * time. If there is no fault, *radii is the range where such a profile may be evaluated. Some
 * faults show only in preparing: that memory has run out, that a fit or table misses the tolerance,
 * that a model does not cover the media which modulated light needs (`mhz`), and that the solver
 * refuses layers (`sigma_s`) or finds none of their light (`thickness`).
 * parameters and radii may be NULL. */
core_fault core_profile_check(unsigned model, unsigned moments, unsigned evaluator,
                              const core_medium *medium, const core_parameters *parameters,
                              core_radii_range *radii);

/* Whether preparing may take longer than a millisecond. A server should then prepare on a separate
 * thread. medium and parameters: those of the profile, which have been checked; medium is NULL for
 * media that vary. */
bool core_prepares_slowly(unsigned model, unsigned evaluator, const core_medium *medium,
                          const core_parameters *parameters);

/* Whether preparing solves transport, which takes seconds. core_prepares_slowly() then is true, too. */
bool core_has_to_solve(unsigned model, const core_medium *medium,
                       const core_parameters *parameters);

/* Whether core_albedo() takes as long as preparing does, and that is long. */
bool core_finds_albedo_slowly(unsigned model);

/* Whether a model has the quantities BY_SIGMA_A and BY_SIGMA_S. */
bool core_has_derivatives(unsigned model);

/* The illumination to which a colour, a diffuse albedo painted by an artist, refers. */
enum core_light {
  CORE_LIGHT_BEAM,    /* a beam at normal incidence */
  CORE_LIGHT_DIFFUSE, /* the same radiance from all directions: a furnace */
  CORE_LIGHTS
};

/* Sets *albedo to the share that leaves of the power that entered, and *error to its relative numerical
 * error; both to NaN on a fault. For a beam
 * it is what core_profile_prepare() would set core_profile.albedo to, for CORE_EVALUATOR_F64 without
 * parameters. Diffuse light needs `transport` (asserted). Arguments and
 * faults are those of core_profile_prepare(). It takes as long as preparing, or some ten
 * milliseconds where core_finds_albedo_slowly() is false. */
core_fault core_albedo(const core_isa *isa, unsigned model, unsigned moments, enum core_light light,
                       const core_medium *medium, double *albedo, double *error);

/* Whether preparing takes longer than some ten microseconds, so that caching the profile pays, or the
 * profile owns memory. It is true wherever core_prepares_slowly() is. parameters: may be NULL. */
bool core_worth_keeping(unsigned model, unsigned evaluator, const core_parameters *parameters);

/* Prepares *profile for the kernels of isa. model, moments and evaluator may be any integers, as a
 * peer may have sent them; parameters may be NULL if none is given. On a fault *profile is
 * unspecified. Otherwise the caller frees it with core_profile_free(). */
core_fault core_profile_prepare(core_profile *profile, const core_isa *isa, unsigned model,
                                unsigned moments, unsigned evaluator, const core_medium *medium,
                                const core_parameters *parameters);

/* The same, and gives up within a second of `stop` being true where transport is solved: fault
 * CORE_FIELD_STOPPED. stop: NULL, or set by any thread. */
core_fault core_profile_prepare_until(core_profile *profile, const core_isa *isa, unsigned model,
                                      unsigned moments, unsigned evaluator,
                                      const core_medium *medium, const core_parameters *parameters,
                                      const atomic_bool *stop);

/* The relative error of S / R: of the Fresnel moment and of both transmittances. */
#define CORE_S_ERROR 0x1p-49

/* What the transformation of R to TRANSFER adds to the numerical error. */
#define CORE_TRANSFER_ERROR 1e-9

/* The quantities of core/paths.h. Their errors are absolute, and their model errors not known. */
enum {
  CORE_PATHS = CORE_QUANTITY_PATH | CORE_QUANTITY_DPF | CORE_QUANTITY_TIME,
  CORE_MODULATED_F = CORE_QUANTITY_PHASE_F | CORE_QUANTITY_MODULATION_F,
  CORE_MODULATED = CORE_QUANTITY_PHASE | CORE_QUANTITY_MODULATION | CORE_MODULATED_F
};

/* The quantities at spatial frequencies, in place of radii. */
enum { CORE_AT_FREQUENCIES = CORE_QUANTITY_TRANSFER | CORE_MODULATED_F };

/* Whether all of the quantities (bits) with values are at frequencies, and there is one. */
static inline bool core_is_at_frequencies(unsigned wanted) {
  const unsigned values = wanted & CORE_ARRAYS & ~(unsigned)CORE_QUANTITY_MODEL_ERRORS;
  return values != 0 && (values & ~(unsigned)CORE_AT_FREQUENCIES) == 0;
}

/* True if any of the quantities (bits) is a derivative of ln R, or follows from one. Their errors are
 * absolute. */
static inline bool core_wants_derivatives(unsigned wanted) {
  return (wanted & (CORE_QUANTITY_BY_SIGMA_A | CORE_QUANTITY_BY_SIGMA_S | CORE_PATHS)) != 0;
}

/* Returns the fault of CORE_PATHS or CORE_MODULATED, if they are wanted, for a medium and parameters
 * that core_profile_check() accepts: without absorption only dipoles, `single` and their sums know
 * the first's limit, and the second need the parameter `mhz`. */
core_fault core_paths_check(unsigned model, unsigned wanted, const core_medium *medium,
                            const core_parameters *parameters);

/* The numerical errors of a profile's values that a reply states. */
typedef struct core_stated_errors {
  double numerical;        /* as core_profile.numerical_error, for all of the radii */
  double numerical_per_mm; /* as core_profile.numerical_error_per_mm */
} core_stated_errors;

#define CORE_RADIUS_SMALL_MM 1e-260
#define CORE_RADIUS_SMALL_MFP 1e-100

/* The errors of the wanted quantities (bits) at radii from least to most; there are no radii if
 * least is above most. core/model_error.h finds how far the model is from transport. */
core_stated_errors core_profile_errors(const core_profile *profile, unsigned wanted,
                                       core_radii_range radii);

/* Sets the angles of S to those of the parameters, or to normal incidence and exit if they are not
 * given. Only S depends on the angles, so one preparation serves all of them. */
void core_profile_set_angles(core_profile *profile, const core_parameters *parameters);

/* Frees the memory that the profile owns. Its copies share that memory and must not be used again.
 */
void core_profile_free(core_profile *profile);

/* Size in bytes of the memory that a profile owns, without the structure itself. */
size_t core_profile_bytes(const core_profile *profile);

/* Evaluates one elementwise quantity of a profile prepared with evaluator f64 (both asserted) at n
 * radii: r[n] in mm, from 0 to infinity inclusive; out[n] in the quantity's unit:
 *   R      1/mm^2; underflows gradually
 *   CDF    the energy within r over the albedo, from 0 to 1
 *   SLOPE  dR/dr, 1/mm^3, never positive
 *   LN_R   the natural logarithm of R, also where R has underflowed: finite up to 1e100
 *          (f32: 1e12) mean free paths 1 / sigma_t', -infinity from there on and where R is 0.
 *          Its error is absolute: numerical_error + numerical_error_per_mm r + 8 epsilon |ln R|
 *   PDF    the density of radii, 2 pi r R over the albedo, 1/mm
 *   T      as R, of the light that leaves below the last layer: 0 below a half space. Only the model
 *          `transport` has it for other media
 *   RING   2 pi r R, the power that leaves per mm of radius; finite at r = 0 where R is not, 1/mm
 *   S      the BSSRDF for the two angles of the parameters (normal when not given), 1/(mm^2 sr):
 *          F_t(cos_in) R(r) F_t(cos_out) / (pi (1 - 2 C1(1 / eta))), with the exact C1
 *          (d'Eon 2012, Eq. 1; Jensen et al. 2001, Eq. 5)
 *   TRANSFER the reflectance for striped light, the Hankel transform of R(r): the numbers r[n] are
 *          spatial frequencies f in 1/mm, and R(f) is int 2 pi r R(r) J0(2 pi f r) dr. R(0) is the
 *          albedo, R(infinity) 0. Its error is absolute: the numerical error times the albedo
 *   BY_SIGMA_A  d ln R / d ln sigma_a at fixed r, sigma_s, g and eta, if core_has_derivatives(); 1
 *   BY_SIGMA_S  d ln R / d ln sigma_s at fixed r, sigma_a, g and eta, which is also that by ln
 *          sigma_s'; 1. Both are 0 where ln R is -infinity, and at r = 0 they are the limit. Of
 *          layers they are those by the coefficients of one, CORE_PARAMETER_DERIVATIVE_LAYER. Their
 *          error is absolute: derivative_error + derivative_error_per_mm r. The profile has to be
 *          prepared with CORE_PARAMETER_DERIVATIVES
 *   PATH   the mean length of the paths in the medium of the light that leaves at r, mm:
 *          -BY_SIGMA_A / sigma_a; of layers, in the layer CORE_PARAMETER_DERIVATIVE_LAYER
 *   DPF    PATH / r, infinity at r = 0; TIME  PATH n / c, ps, n = CORE_PARAMETER_INDEX or eta.
 *          The profile has to be prepared as for BY_SIGMA_A. Without absorption it is the limit,
 *          which core_paths_check() refuses for models without one
 *   PHASE  the lag of light modulated with CORE_PARAMETER_MHZ, -arg R~ in degrees, not reduced to a
 *          circle; MODULATION  |R~| / R. R~ is R at the complex absorption sigma_a + i omega n / c
 *   PHASE_F and MODULATION_F  likewise, of R(f) at spatial frequencies as of TRANSFER
 * The arrays need only their type's alignment and must not overlap. Values for radii that
 * core_radii_check_f64() faults are unspecified. */
void core_eval_f64(const core_profile *profile, enum core_quantity quantity, size_t n,
                   const double *r, double *out);

/* Returns the cost of evaluating the wanted quantities (bits) at one radius, in evaluations of one
 * quantity of a dipole. */
double core_radius_cost(const core_profile *profile, unsigned wanted);

/* Returns what each call costs besides its radii, in evaluations of one quantity of a dipole: 0, but
 * for TRANSFER without a closed form hundreds of evaluations of R. */
double core_call_cost(const core_profile *profile, unsigned wanted);

/* Does the same as core_eval_f64() for profiles of the evaluators f32 and lut. */
void core_eval_f32(const core_profile *profile, enum core_quantity quantity, size_t n,
                   const float *r, float *out);

/* Does the same for profiles of any evaluator. Radii and values are those of its precision, at most
 * CORE_EVAL_ANY_MAX. */
enum { CORE_EVAL_ANY_MAX = 1024 };
void core_eval_any(const core_profile *profile, enum core_quantity quantity, size_t n,
                   const double *r, double *out);

/* Inverts the cdf: writes r[n] in mm such that cdf(r) = u, for u[n] from 0 to 1 inclusive. u = 0
 * gives r = 0, and u = 1 gives infinity. Uniform random u give radii whose density is proportional
 * to r R(r). For u up to 1 - 1e-7, |cdf(r) - u| is at most CORE_SAMPLE_ERROR_F64 or _F32 plus the
 * numerical error of the cdf. If nothing scatters, r is 0. */
void core_sample_f64(const core_profile *profile, size_t n, const double *u, double *r);
void core_sample_f32(const core_profile *profile, size_t n, const float *u, float *r);

/* With the evaluator lut the radius itself has the profile's numerical error, as a relative error
 * against the radius at which the cdf is u. */

#define CORE_SAMPLE_ERROR_F64 1e-14
#define CORE_SAMPLE_ERROR_F32 4e-7

/* ---- tables ---------------------------------------------------------------------------------- */

/* The radii in mm between which the table of a profile of evaluator lut has pieces. At other radii
 * the profile follows its asymptotes. */
core_radii_range core_table_pieces(const core_profile *profile);

/* Makes a profile from a table that was built elsewhere. The caller has filled in the public part
 * of *profile, the rest is 0; the function sets that and copies the `count` words. The profile can be
 * sampled and evaluates the quantities of core_table_has(), with the same bits as the profile that
 * the table was built for. Faults: `table` if the words are not a table, and `memory`. */
core_fault core_profile_from_table(core_profile *profile, const core_isa *isa, const float *words,
                                   size_t count);

/* Whether a table holds a quantity without help from the profile that it was made from. */
bool core_table_has(enum core_quantity quantity);

/* ---- from albedo to coefficients: core/inverter.h -------------------------------------------- */

#define CORE_MEAN_FREE_PATH_MIN_MM 1e-14 /* narrower than a medium's limits, for rounding */
#define CORE_MEAN_FREE_PATH_MAX_MM 1e14

/* ---- radii ----------------------------------------------------------------------------------- */

/* Returns the fault of the first radius that is negative or NaN; -0.0 counts as 0. If there is
 * none, sets *range to the least and the largest of the finite radii. Infinite radii are left out,
 * because every model has R = 0 there. Without a finite radius the range is from INFINITY to 0. */
core_fault core_radii_check_f64(size_t n, const double *r, core_radii_range *range);
core_fault core_radii_check_f32(size_t n, const float *r, core_radii_range *range);

/* Returns the fault of the first radius outside a profile's range. No radius is NaN. r: [n], of type
 * float if `single`, else double. */
core_fault core_radii_range_check(const core_radii_range *range, size_t n, bool single,
                                  const void *r);

/* Radii by rule: `count` radii from start to stop, both included; count = 1 gives start alone.
 * linear:       start + i (stop - start) / (count - 1)
 * logarithmic:  start (stop / start)^(i / (count - 1)), each within 1e-12 of it, relative
 * In single precision each radius is the double precision one, rounded. */
typedef struct core_grid {
  enum core_spacing spacing; /* LINEAR or LOGARITHMIC */
  uint64_t count;            /* at least 1, at most CORE_GRID_COUNT_MAX */
  double start_mm;           /* finite, at least 0; logarithmic: at least CORE_GRID_LOG_MIN_MM */
  double stop_mm;            /* finite, at least start */
} core_grid;

#define CORE_GRID_COUNT_MAX ((uint64_t)1 << 53)
#define CORE_GRID_LOG_MIN_MM 1e-300

/* Returns the fault of a grid. It names the field of the wire: radius_count, radius_start or
 * radius_stop. */
core_fault core_grid_check(const core_grid *grid);

/* Writes the radii first, first + 1, ..., first + n - 1 of the grid to r[n], of type float if `single`,
 * else double. */
void core_grid_radii(const core_grid *grid, uint64_t first, size_t n, bool single, void *r);

#endif
