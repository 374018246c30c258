/* blocks: kernels that sum many terms for each radius, or integrate over them.
 *
 * A kernel works on blocks of BLOCK_LANES radii. The loop over the terms is the outer one and the
 * loop over the radii of a block is the inner one, so that compilers vectorize it. Every radius
 * goes through the same operations in the same order, whatever the length of its block. This header
 * serves files whose kernels exist in double precision only.
 */
#ifndef DIPOLED_CORE_MODELS_BLOCKS_H
#define DIPOLED_CORE_MODELS_BLOCKS_H

#include "core/kernel.h"

enum { BLOCK_LANES = 32 };

/* BLOCK_SUM(name, terms, term) defines a function that sets sum[i] to the sum of term(c, k, x[i])
 * over all k from 0 to terms(c) - 1, for each of the n numbers x. */
#define BLOCK_SUM(name, terms, term)                                                               \
  static void name(const double *c, size_t n, const double *x, double *sum) {                      \
    const size_t count = terms(c);                                                                 \
    for (size_t i = 0; i < CORE_WHOLE(n); i++) {                                                   \
      sum[i] = 0;                                                                                  \
    }                                                                                              \
    for (size_t k = 0; k < count; k++) {                                                           \
      for (size_t i = 0; i < CORE_WHOLE(n); i++) {                                                 \
        sum[i] += term(c, k, x[i]);                                                                \
      }                                                                                            \
    }                                                                                              \
  }

/* BLOCK_KERNEL(name, begin, sum_up, finish) defines a kernel as in core/kernels.h. For each radius
 * r in mm, x = begin(c, r) is the argument of the sum, sum_up is a function such as BLOCK_SUM
 * makes, and out = finish(c, r, x, sum). */
#define BLOCK_KERNEL(name, begin, sum_up, finish)                                                  \
  static void name(const double *restrict c, size_t n, const double *restrict r,                   \
                   double *restrict out) {                                                         \
    for (size_t done = 0; done < n; done += BLOCK_LANES) {                                         \
      const size_t count = CORE_WHOLE(n - done < BLOCK_LANES ? n - done : BLOCK_LANES);            \
      double x[BLOCK_LANES];                                                                       \
      double sum[BLOCK_LANES];                                                                     \
      for (size_t i = 0; i < count; i++) {                                                         \
        x[i] = begin(c, r[done + i] + 0); /* adding 0 turns -0 into 0 */                           \
      }                                                                                            \
      sum_up(c, count, x, sum);                                                                    \
      for (size_t i = 0; i < count; i++) {                                                         \
        out[done + i] = finish(c, r[done + i] + 0, x[i], sum[i]);                                  \
      }                                                                                            \
    }                                                                                              \
  }

#endif
