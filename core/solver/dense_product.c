/* The innermost loops of dense.c, compiled for each instruction set. Results have the same bits on
 * all: products and sums are rounded separately, and each sum has the same order. */
#include "core/solver/dense.h"

/* TILE_ROWS by TILE_LANES groups of LANES numbers are kept in registers. With at least eight
 * groups, latencies of sums overlap. */
#if defined __AVX512F__
enum { LANES = 8, TILE_ROWS = 8, TILE_LANES = 2 };
#elif defined __AVX__
enum { LANES = 4, TILE_ROWS = 4, TILE_LANES = 2 };
#else
enum { LANES = 2, TILE_ROWS = 4, TILE_LANES = 2 };
#endif
typedef double lanes __attribute__((vector_size(LANES * sizeof(double)), aligned(16), may_alias));

/* Adds sign * a b to `to` for at most TILE_ROWS rows and a few groups of columns. */
static inline __attribute__((always_inline)) void add_tile(dense_part to, dense_part a,
                                                           dense_part b, size_t rows, size_t groups,
                                                           size_t inner, double sign) {
  lanes sum[TILE_ROWS][TILE_LANES] = {0};
  for (size_t i = 0; i < inner; i++) {
    const lanes *right = (const lanes *)(b.at + i * b.stride);
#pragma GCC unroll 8
    for (size_t row = 0; row < rows; row++) {
#pragma GCC unroll 8
      for (size_t group = 0; group < groups; group++) {
        sum[row][group] += a.at[row * a.stride + i] * right[group];
      }
    }
  }
#pragma GCC unroll 8
  for (size_t row = 0; row < rows; row++) {
    lanes *here = (lanes *)(to.at + row * to.stride);
#pragma GCC unroll 8
    for (size_t group = 0; group < groups; group++) {
      here[group] += sign * sum[row][group];
    }
  }
}

static inline __attribute__((always_inline)) void add_rows(dense_part to, dense_part a,
                                                           dense_part b, size_t rows, size_t inner,
                                                           size_t columns, double sign) {
  size_t column = 0;
  for (; column + TILE_LANES * LANES <= columns; column += TILE_LANES * LANES) {
    add_tile((dense_part){to.at + column, to.stride}, a, (dense_part){b.at + column, b.stride},
             rows, TILE_LANES, inner, sign);
  }
  for (; column < columns; column += LANES) {
    add_tile((dense_part){to.at + column, to.stride}, a, (dense_part){b.at + column, b.stride},
             rows, 1, inner, sign);
  }
}

static void add_product(dense_part to, dense_part a, dense_part b, size_t rows, size_t inner,
                        size_t columns, double sign) {
  size_t row = 0;
  for (; row + TILE_ROWS <= rows; row += TILE_ROWS) {
    const dense_part to_rows = {to.at + row * to.stride, to.stride};
    const dense_part a_rows = {a.at + row * a.stride, a.stride};
    add_rows(to_rows, a_rows, b, TILE_ROWS, inner, columns, sign);
  }
  for (; row < rows; row++) {
    const dense_part to_row = {to.at + row * to.stride, to.stride};
    const dense_part a_row = {a.at + row * a.stride, a.stride};
    add_rows(to_row, a_row, b, 1, inner, columns, sign);
  }
}

static void combine(double *to, double x, const double *a, double y, const double *b,
                    size_t numbers) {
  for (size_t i = 0; i < numbers; i += LANES) {
    *(lanes *)(to + i) = x * *(const lanes *)(a + i) + y * *(const lanes *)(b + i);
  }
}

static void subtract_real(double *restrict to, const double *restrict from, double factor,
                          size_t columns) {
  for (size_t i = 0; i < columns; i++) {
    to[i] -= factor * from[i];
  }
}

static void subtract_complex(double *restrict to_re, double *restrict to_im,
                             const double *restrict from_re, const double *restrict from_im,
                             double re, double im, size_t columns) {
  for (size_t i = 0; i < columns; i++) {
    to_re[i] -= re * from_re[i] - im * from_im[i];
    to_im[i] -= re * from_im[i] + im * from_re[i];
  }
}

/* The only symbol with external linkage. */
#define PASTE_(a, b) a##b
#define PASTE(a, b) PASTE_(a, b)
extern const dense_loops PASTE(solver_dense_loops_, CORE_ISA);
const dense_loops PASTE(solver_dense_loops_, CORE_ISA) = {add_product, combine, subtract_real,
                                                          subtract_complex};
