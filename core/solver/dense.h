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

/* A matrix in row-major order. Real and imaginary parts are separate arrays; im is NULL for a real
 * matrix. Rows are `stride` numbers apart, a multiple of 8; numbers after the last column are
 * padding. */
typedef struct dense {
  const core_isa *isa; /* the instruction set for products whose result this is */
  size_t rows, columns, stride;
  double *re, *im;
} dense;

/* Returns the number of doubles that one part of a matrix takes. */
size_t solver_dense_size(size_t rows, size_t columns);

/* Returns a matrix with its parts at *memory, and moves *memory past them. Its numbers are not set.
 * *memory: aligned to 64 bytes, with room for solver_dense_size() numbers; twice as many for a
 * complex matrix. */
dense solver_dense_at(const core_isa *isa, double **memory, size_t rows, size_t columns,
                      bool is_complex);

/* Get and set one number of a matrix. For a real matrix the imaginary part is 0, and is ignored
 * when setting. */
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

/* clear: sets all numbers to 0. combine: sets to = x a + y b; all have one shape, and `to` may be a
 * or b. */
void solver_dense_clear(const dense *of);
void solver_dense_combine(const dense *to, double x, const dense *a, double y, const dense *b);

/* Sets to = a b. Either all are real or all complex. `to` is neither a nor b. */
void solver_dense_multiply(const dense *to, const dense *a, const dense *b);

/* Sets the upper triangle of `to` to that of the square of a matrix; what is below it has no
 * meaning. */
void solver_dense_square(const dense *to, const dense *of);

/* Copies the numbers above the diagonal of the first columns to below it. */
void solver_dense_mirror(const dense *of);

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

/* A rectangle of the real part, or of the imaginary part, of a matrix. */
typedef struct dense_part {
  double *at;
  size_t stride;
} dense_part;

typedef struct dense_loops {
  /* Adds sign times a b to `to`. a: rows by inner numbers. b: inner by columns numbers. columns: a
   * multiple of 8. b and `to`: 16-byte aligned. [1]: imaginary parts, with a NULL of `to` if numbers
   * are real. */
  void (*add_product)(const dense_part to[2], const dense_part a[2], const dense_part b[2],
                      size_t rows, size_t inner, size_t columns, double sign);
  /* Sets to = x a + y b. numbers: a multiple of 8. */
  void (*combine)(double *to, double x, const double *a, double y, const double *b, size_t numbers);
  /* Subtract factor times one row from another row: of real numbers, and of complex ones. */
  void (*subtract_real)(double *restrict to, const double *restrict from, double factor,
                        size_t columns);
  void (*subtract_complex)(double *restrict to_re, double *restrict to_im,
                           const double *restrict from_re, const double *restrict from_im,
                           double re, double im, size_t columns);
} dense_loops;

#endif
