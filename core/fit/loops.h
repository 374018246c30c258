/* loops: the inner loops of fits, compiled once for each instruction set (core/fit/loops.c). All have
 * the same bits. Internal to core/fit. */
#ifndef DIPOLED_CORE_FIT_LOOPS_H
#define DIPOLED_CORE_FIT_LOOPS_H

#include "core/fit/table.h"

/* fit_loops_measure() takes this many media at a time. */
enum { FIT_LOOPS_MEDIA = 16 };

/* Evaluates the quantity at[n], in mm above 0 or in 1/mm, for a medium by ln(sigma_a / sigma_s')
 * and ln(sigma_s'). ln_at[n] holds the logarithms of at[n], of any very small number for 0. Sets
 * value[n] and its derivatives by both. */
typedef void fit_loops_look_up(const fit_table *table, double ln_ratio, double ln_scattering,
                               size_t n, const double *at, const double *ln_at, double *value,
                               double *by_ratio, double *by_scattering);

/* Sets out[n] to ln x, or that of the least normal number if x is less. */
typedef void fit_loops_logarithms(size_t n, const double *x, double *out);

/* Sets chi[i] for each of `media`, a multiple of FIT_LOOPS_MEDIA, to the sum over k of weight[k]
 * off^2 with off = value[k] - model[k * media + i]; less (sum weight off)^2 / sum weight if an
 * offset of all values is free. Returns the least of them, INFINITY if all are NAN. */
typedef double fit_loops_measure(size_t media, const double *model, size_t count,
                                 const double *value, const double *weight, bool free_offset,
                                 double *chi);

typedef struct fit_loops {
  fit_loops_look_up *look_up;
  fit_loops_logarithms *logarithms;
  fit_loops_measure *measure;
} fit_loops;

#endif
