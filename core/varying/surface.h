/* surface: the words that media which vary share (core/varying.h): from colours to media for every
 * model, and for `transport` the profile over albedo and radius for one g and eta. They have the
 * same form in memory and on the wire.
 *
 * The words are 32-bit, little-endian. A function is cut into cells (core/cells/cells.h), which are
 * polynomials of the third degree in each coordinate, with all coefficients side by side: 16 words,
 * one cache line, in two dimensions. Sums and products are each rounded, so any program with IEEE
 * arithmetic gets the same bits.
 *
 * Coordinates. An axis is CORE_SURFACE_AXIS entries, for the octaves from 2^CORE_SURFACE_EXPONENT on,
 * with cuts below the first cell. Coordinates are clamped to the axis first.
 *
 *   albedo  s = sqrt(sigma_a / sigma_t') up to 1/2, as what diffuses is smooth in s where little is
 *           absorbed; and w = 1 - s, which is nearly in proportion to the albedo, beyond. The rows
 *           of cells along s come first.
 *   radius  x = r sigma_t', in mean free paths
 *   u       the cdf, up to 1/2; and 1 - u beyond
 *   colour  v, the colour over the largest that a medium has, up to 1/2; and 1 - v beyond
 *
 * Functions:
 *   Q(s, x)        R = sigma_t'^2 a (1 + k x) / x e^(Q - k x), with the reduced albedo a and k = s
 *                  times a polynomial of s, the words CORE_SURFACE_KAPPA: nearly the rate at which
 *                  diffuse light decays (core/transport/table.h). Below the axis Q is constant.
 *   cdf(s, x)      below the axis in proportion to x
 *   x(s, u)        the radius whose cdf is u, below the axis in proportion to u; and x(s, 1 - u)
 *   total(s)       the energy that leaves per power that has entered
 *   w(v), s(1 - v) for each light; below the axis s is in proportion to 1 - v
 */
#ifndef DIPOLED_CORE_SURFACE_H
#define DIPOLED_CORE_SURFACE_H

#include "core/varying.h"

enum core_surface_axis {
  CORE_SURFACE_S,
  CORE_SURFACE_W,
  CORE_SURFACE_RADIUS,
  CORE_SURFACE_U,
  CORE_SURFACE_REST, /* 1 - u */
  CORE_SURFACE_COLOUR,
  CORE_SURFACE_COLOUR_REST,
  CORE_SURFACE_AXES
};

enum core_surface_function {
  CORE_SURFACE_Q,
  CORE_SURFACE_CDF,
  CORE_SURFACE_X_OF_U,
  CORE_SURFACE_X_OF_REST,
  CORE_SURFACE_TOTAL,
  CORE_SURFACE_W_OF_COLOUR, /* for each light: w as a function of the colour */
  /* for each light: s as a function of the largest colour minus the colour */
  CORE_SURFACE_S_OF_REST = CORE_SURFACE_W_OF_COLOUR + CORE_LIGHTS,
  CORE_SURFACE_FUNCTIONS = CORE_SURFACE_S_OF_REST + CORE_LIGHTS
};

enum {
  /* 2 to this power is where the first octave of every axis would begin */
  CORE_SURFACE_EXPONENT = -40,
  CORE_SURFACE_AXIS = 64,
  CORE_SURFACE_CUTS_MAX = 7,
  CORE_SURFACE_KAPPA_TERMS = 5,
  CORE_SURFACE_VERSION = 1
};

/* Positions of the words. */
enum core_surface_word {
  CORE_SURFACE_VERSION_WORD,                                  /* integer */
  CORE_SURFACE_LEAST,                                         /* least coordinate of each axis */
  CORE_SURFACE_MOST = CORE_SURFACE_LEAST + CORE_SURFACE_AXES, /* largest coordinate of each axis */
  CORE_SURFACE_CELLS = CORE_SURFACE_MOST + CORE_SURFACE_AXES, /* integers */
  /* integers: position of each function's first word; 0: there is no such function */
  CORE_SURFACE_AT = CORE_SURFACE_CELLS + CORE_SURFACE_AXES,
  CORE_SURFACE_KAPPA = CORE_SURFACE_AT + CORE_SURFACE_FUNCTIONS, /* function begins, 0: none */
  CORE_SURFACE_COLOUR_MOST = /* largest colour for each light; 0 if the light is not known */
  CORE_SURFACE_KAPPA + CORE_SURFACE_KAPPA_TERMS,
  CORE_SURFACE_COLOUR_LEAST = CORE_SURFACE_COLOUR_MOST + CORE_LIGHTS,
  CORE_SURFACE_SCATTERED_LEAST = CORE_SURFACE_COLOUR_LEAST + CORE_LIGHTS,
  CORE_SURFACE_FAR, /* three words: the coefficients LANES_FAR of core/models/lanes.h */
  CORE_SURFACE_ERROR = CORE_SURFACE_FAR + 3, /* largest relative error found in R, cdf and radius */
  CORE_SURFACE_ENTRIES = 64,                 /* the axes */
  CORE_SURFACE_PATCHES = CORE_SURFACE_ENTRIES + CORE_SURFACE_AXES * CORE_SURFACE_AXIS
};
_Static_assert((int)CORE_SURFACE_ERROR < CORE_SURFACE_ENTRIES, "the words do not overlap");

/* The inputs of making the words. */
typedef struct core_surface_inputs {
  double g; /* parameter of the scattering of `transport` */
  double eta;
  double tolerance;
  bool is_transport;
  const double *shared; /* constants of dipoles (core/models/lanes.h) */
} core_surface_inputs;

/* Prepares everything but the words; the arguments are those of core_varying_prepare(). It checks
 * what evaluation needs. A client that has the words can thus evaluate without preparing
 * profiles. */
core_fault core_surface_begin(core_varying *varying, const core_isa *isa, unsigned model,
                              unsigned moments, unsigned evaluator, double g, double eta,
                              const core_parameters *parameters);

/* Derives what all media share from varying->words, which are set. Fault: `memory`. */
core_fault core_surface_share(core_varying *varying);

/* Makes the words; the caller frees them. Faults: `tolerance`, `memory`. */
core_fault core_surface_build(const core_surface_inputs *inputs, float **words, size_t *count);

/* Returns the words for kernels in double precision (core/cells/find.h), which the caller frees,
 * or NULL if memory runs out. */
double *core_surface_widen(const float *words, size_t count);

/* Checks words that a peer or a file has given. Without a fault, evaluating reads no words outside
 * of them, whatever numbers they hold. The fault's field is `table`. */
core_fault core_surface_check(const float *words, size_t count, bool is_transport);

#endif
