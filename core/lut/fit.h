/* fit: cuts one function of a table into pieces, octave by octave. Internal to core/lut. */
#ifndef DIPOLED_CORE_LUT_FIT_H
#define DIPOLED_CORE_LUT_FIT_H

#include "core/lut/piece.h"

/* A function that writes its value at x[i] to y[i], for i from 0 to n - 1. */
typedef void core_lut_function(const void *context, size_t n, const double *x, double *y);

/* The function that is fitted. An absolute error up to `negligible` always counts as within the
 * tolerance. */
struct lut_subject {
  core_lut_function *function;
  const void *context;
  double tolerance; /* largest relative error of each value */
  double negligible;
  bool monotone; /* the function rises, so the rounded values must not fall */
};

/* The pieces of all functions that have been fitted so far. */
struct lut_pieces {
  float (*c)[CORE_LUT_TERMS]; /* malloc()ed */
  size_t count;
  size_t room; /* number of pieces for which c has memory */
};

/* The fault if no table is within the tolerance: the tolerance is too small. */
extern const core_fault lut_too_rough;

/* Appends the pieces for [2^exponent, 2^(exponent + 1)). It begins with 2^*cuts equal pieces and
 * doubles their number until they keep the tolerance. Sets *cuts to the log2 of that number and
 * *entry to the entry that finds the pieces. Faults: lut_too_rough and `memory`. */
core_fault lut_fit_octave(const struct lut_subject *subject, int exponent, unsigned *cuts,
                          struct lut_pieces *pieces, uint32_t *entry);

/* Appends one piece that has the same value everywhere. */
core_fault lut_fit_constant(float value, struct lut_pieces *pieces, uint32_t *entry);

/* Returns the largest relative error of the pieces of an octave. Each piece is compared at five
 * arguments that the fit itself has not looked at, and at many more if its error there is among the
 * largest of the octave and of those that are `known`. */
double lut_fit_error(const struct lut_subject *subject, int exponent, uint32_t entry,
                     const struct lut_pieces *pieces, double known);

#endif
