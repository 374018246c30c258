/* fit: one function of a table cut into pieces, octave by octave. Internal to core/lut. */
#ifndef DIPOLED_CORE_LUT_FIT_H
#define DIPOLED_CORE_LUT_FIT_H

#include "core/lut/piece.h"

/* y[i] of x[i] in double precision, for n numbers. */
typedef void core_lut_function(const void *context, size_t n, const double *x, double *y);

/* The function of a fit. Values below `negligible` may be off by as much as that. */
struct lut_subject {
  core_lut_function *function;
  const void *context;
  double tolerance; /* relative, of each value */
  double negligible;
  bool monotone; /* rounding must not make it turn back */
};

/* The pieces gathered so far, of all functions. */
struct lut_pieces {
  float (*c)[CORE_LUT_TERMS]; /* malloc()ed */
  size_t count;
  size_t room;
};

enum lut_fit { LUT_FITTED, LUT_TOO_ROUGH, LUT_NO_MEMORY };

/* Appends the pieces for [2^exponent, 2^(exponent + 1)), as few as serve, from 2^*cuts of them on;
 * *entry finds them, *cuts is how many it took. */
enum lut_fit lut_fit_octave(const struct lut_subject *subject, int exponent, unsigned *cuts,
                            struct lut_pieces *pieces, uint32_t *entry);

/* One piece with the same value everywhere. */
enum lut_fit lut_fit_constant(float value, struct lut_pieces *pieces, uint32_t *entry);

/* The largest relative error of the pieces of an octave at COUNT radii each, between those that
 * the fit has looked at. */
double lut_fit_error(const struct lut_subject *subject, int exponent, uint32_t entry,
                     const struct lut_pieces *pieces);

#endif
