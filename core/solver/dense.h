/* dense: products and solutions of small dense systems, real and complex.
 *
 * The functions use IEEE products and sums in a fixed order, so that the results have the same bits
 * on every machine. A library of linear algebra would choose another order on each processor. */
#ifndef DIPOLED_CORE_SOLVER_DENSE_H
#define DIPOLED_CORE_SOLVER_DENSE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/core.h"
#include "core/transport/functions.h"

/* A matrix, row by row. The real and the imaginary parts are apart. im is NULL for a real matrix.
 * Rows are stride numbers apart, and stride is a multiple of 8. Numbers behind the last column
 * exist and have no meaning. */
typedef struct dense {
  const core_isa *isa; /* the instruction set that products with this result use */
  size_t rows, columns, stride;
  double *re, *im;
} dense;

/* Returns the number of doubles that one part of a matrix takes. */
size_t solver_dense_size(size_t rows, size_t columns);

/* Returns a matrix whose parts lie at *memory, and moves *memory behind them. The matrix is not
 * filled. *memory: 64-byte aligned, with room for solver_dense_size() numbers, or for twice as
 * many for a complex matrix. */
dense solver_dense_at(const core_isa *isa, double **memory, size_t rows, size_t columns,
                      bool is_complex);

/* Returns one number of a matrix, and sets one; the imaginary part of a real matrix is left out. */
static inline double complex solver_dense_get(const dense *of, size_t row, size_t column) {
  const size_t at = row * of->stride + column;
  return CMPLX(of->re[at], of->im == NULL ? 0 : of->im[at]);
}

static inline void solver_dense_put(const dense *to, size_t row, size_t column,
                                    double complex value) {
  to->re[row * to->stride + column] = creal(value);
  if (to->im != NULL) {
    to->im[row * to->stride + column] = cimag(value);
  }
}

/* Sets all numbers to 0; sets to = x a + y b, where `to` may be a or b. Shapes are equal. */
void solver_dense_clear(const dense *of);
void solver_dense_combine(const dense *to, double x, const dense *a, double y, const dense *b);

/* Sets to = a b. The three are all real or all complex, their shapes fit, and `to` is neither of
 * the others. */
void solver_dense_multiply(const dense *to, const dense *a, const dense *b);

/* Replaces b by the solution x of a x = b, by elimination with partial pivoting in blocks. The
 * content of a, which is square, is lost. Returns false if a is singular; then b has no meaning. */
bool solver_dense_solve(const dense *a, const dense *b);

/* Sets to = g^T a^-1 [g, h] for symmetric matrices a and g of the same size and a b = [g, h] with
 * as many columns as `to`, by elimination without pivoting: with some rows exchanged, a has to be
 * [c d; d^T -e] with c and e whose real parts are positive definite (Vanderbei 1995, "Symmetric
 * quasidefinite matrices"). The contents of a, b and of *spare, which has the shape of b, are
 * lost. Returns false if a pivot is 0; then `to` has no meaning. */
bool solver_dense_congruence(const dense *to, const dense *a, const dense *b, const dense *spare);

/* ---- dense_product.c, for dense.c alone ----------------------------------------------------- */

/* A rectangle of the real or the imaginary part of a matrix. */
typedef struct dense_part {
  double *at;
  size_t stride;
} dense_part;

typedef struct dense_loops {
  /* Adds sign times a b to `to`. a: rows by inner numbers. b: inner by columns numbers. columns: a
   * multiple of 8. b and `to`: 16-byte aligned. */
  void (*add_product)(dense_part to, dense_part a, dense_part b, size_t rows, size_t inner,
                      size_t columns, double sign);
  /* Subtracts a factor times one row from another one, for real and for complex rows. */
  void (*subtract_real)(double *restrict to, const double *restrict from, double factor,
                        size_t columns);
  void (*subtract_complex)(double *restrict to_re, double *restrict to_im,
                           const double *restrict from_re, const double *restrict from_im,
                           double re, double im, size_t columns);
} dense_loops;

#endif
