/* blocks: kernels that sum many terms for each radius, or integrate over them.
 *
 * Radii are taken in blocks; the loop over the terms is outside and the loop over the block's radii
 * inside, where compilers vectorize it. Every radius sees the same operations in the same order,
 * whatever the length of its block. For files that have kernels in double precision alone.
 */
#ifndef DIPOLED_CORE_MODELS_BLOCKS_H
#define DIPOLED_CORE_MODELS_BLOCKS_H

#include "core/kernel.h"

enum { BLOCK_LANES = 32 };

/* BLOCK_SUM(name, terms, term): *sum over the k from 0 to terms(c) - 1 of term(c, k, x). */
#define BLOCK_SUM(name, terms, term)                                                               \
  static void name(const double *c, size_t n, const double *x, double *sum) {                      \
    const size_t count = terms(c);                                                                 \
    for (size_t i = 0; i < n; i++) {                                                               \
      sum[i] = 0;                                                                                  \
    }                                                                                              \
    for (size_t k = 0; k < count; k++) {                                                           \
      for (size_t i = 0; i < n; i++) {                                                             \
        sum[i] += term(c, k, x[i]);                                                                \
      }                                                                                            \
    }                                                                                              \
  }

/* BLOCK_KERNEL(name, begin, sum, finish): a kernel; x = begin(c, r) is what is summed over, and
 * finish(c, r, x, sum) is the value. */
#define BLOCK_KERNEL(name, begin, sum_up, finish)                                                  \
  static void name(const double *restrict c, size_t n, const double *restrict r,                   \
                   double *restrict out) {                                                         \
    for (size_t done = 0; done < n; done += BLOCK_LANES) {                                         \
      const size_t count = n - done < BLOCK_LANES ? n - done : BLOCK_LANES;                        \
      double x[BLOCK_LANES];                                                                       \
      double sum[BLOCK_LANES];                                                                     \
      for (size_t i = 0; i < count; i++) {                                                         \
        x[i] = begin(c, r[done + i] + 0); /* which makes 0 of -0 */                                \
      }                                                                                            \
      sum_up(c, count, x, sum);                                                                    \
      for (size_t i = 0; i < count; i++) {                                                         \
        out[done + i] = finish(c, r[done + i] + 0, x[i], sum[i]);                                  \
      }                                                                                            \
    }                                                                                              \
  }

#endif
