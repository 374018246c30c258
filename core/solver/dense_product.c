/* The innermost loops of dense.c, compiled for each instruction set. Results have the same bits on
 * all: products and sums are rounded separately, and each sum has the same order. */
#include "core/solver/dense.h"

/* Tiles of so many rows by so many groups of LANES numbers are kept in registers, of complex numbers
 * three times. With at least eight groups, latencies of sums overlap. */
#if defined __AVX512F__
enum { LANES = 8, REAL_ROWS = 8, REAL_GROUPS = 2, COMPLEX_ROWS = 4, COMPLEX_GROUPS = 2 };
#elif defined __AVX__
enum { LANES = 4, REAL_ROWS = 4, REAL_GROUPS = 2, COMPLEX_ROWS = 4, COMPLEX_GROUPS = 1 };
#else
enum { LANES = 2, REAL_ROWS = 4, REAL_GROUPS = 2, COMPLEX_ROWS = 4, COMPLEX_GROUPS = 1 };
#endif
typedef double lanes __attribute__((vector_size(LANES * sizeof(double)), aligned(16), may_alias));

/* A product of complex numbers is three real ones, of the real parts, of the imaginary parts, and of
 * the sums of both, which are kept for blocks of so many rows and columns of the right factor. */
enum { PARTS = 3, ROWS_MAX = 8, INNER = 64, COLUMNS = 64 };

/* Each function adds sign * a b to `to`, and is made for constant `parts`: 1 for real numbers, else
 * PARTS. A tile is one of `rows` rows and a few groups of columns. */
#define INLINE static inline __attribute__((always_inline))

INLINE void add_tile(const dense_part *to, const dense_part *a, const dense_part *b, size_t parts,
                     size_t rows, size_t groups, size_t inner, double sign) {
  lanes sum[PARTS][ROWS_MAX][2] = {0};
  for (size_t i = 0; i < inner; i++) {
#pragma GCC unroll 8
    for (size_t part = 0; part < parts; part++) {
      const lanes *right = (const lanes *)(b[part].at + i * b[part].stride);
#pragma GCC unroll 8
      for (size_t row = 0; row < rows; row++) {
#pragma GCC unroll 8
        for (size_t group = 0; group < groups; group++) {
          sum[part][row][group] += a[part].at[row * a[part].stride + i] * right[group];
        }
      }
    }
  }
#pragma GCC unroll 8
  for (size_t row = 0; row < rows; row++) {
#pragma GCC unroll 8
    for (size_t group = 0; group < groups; group++) {
      const lanes one = sum[0][row][group];
      lanes *re = (lanes *)(to[0].at + row * to[0].stride) + group;
      if (parts == 1) {
        *re += sign * one;
      } else {
        const lanes two = sum[1][row][group];
        lanes *im = (lanes *)(to[1].at + row * to[1].stride) + group;
        *re += sign * (one - two);
        *im += sign * (sum[2][row][group] - one - two);
      }
    }
  }
}

INLINE void shift(dense_part *to, const dense_part *of, size_t parts, size_t row, size_t column) {
  for (size_t part = 0; part < parts; part++) {
    to[part] = (dense_part){of[part].at + row * of[part].stride + column, of[part].stride};
  }
}

INLINE void add_rows(const dense_part *to, const dense_part *a, const dense_part *b, size_t parts,
                     size_t rows, size_t groups, size_t inner, size_t columns, double sign) {
  for (size_t column = 0; column < columns; column += groups * LANES) {
    dense_part to_here[2], b_here[PARTS];
    shift(to_here, to, parts == 1 ? 1 : 2, 0, column);
    shift(b_here, b, parts, 0, column);
    if (columns - column >= groups * LANES) {
      add_tile(to_here, a, b_here, parts, rows, groups, inner, sign);
    } else {
      add_tile(to_here, a, b_here, parts, rows, 1, inner, sign);
    }
  }
}

/* Sets *to to the sum of both parts. */
INLINE void add_parts(dense_part to, const dense_part *of, size_t rows, size_t columns) {
  for (size_t row = 0; row < rows; row++) {
    for (size_t i = 0; i < columns; i++) {
      to.at[row * to.stride + i] =
          of[0].at[row * of[0].stride + i] + of[1].at[row * of[1].stride + i];
    }
  }
}

/* Adds what a block of b contributes. */
INLINE void add_block(const dense_part *to, const dense_part *a, const dense_part *b, size_t parts,
                      size_t tile_rows, size_t groups, size_t rows, size_t inner, size_t columns,
                      double sign) {
  double left[ROWS_MAX * INNER], right[INNER * COLUMNS] __attribute__((aligned(64)));
  const size_t given = parts == 1 ? 1 : 2;
  dense_part to_here[2], a_here[PARTS] = {[2] = {left, INNER}};
  dense_part b_here[PARTS] = {b[0], b[given - 1], {right, COLUMNS}};
  if (parts > 1) {
    add_parts(b_here[2], b, inner, columns);
  }
  for (size_t row = 0; row < rows;) {
    shift(to_here, to, given, row, 0);
    shift(a_here, a, given, row, 0);
    const bool whole = rows - row >= tile_rows;
    if (parts > 1) {
      add_parts(a_here[2], a_here, whole ? tile_rows : 1, inner);
    }
    if (whole) {
      add_rows(to_here, a_here, b_here, parts, tile_rows, groups, inner, columns, sign);
    } else {
      add_rows(to_here, a_here, b_here, parts, 1, groups, inner, columns, sign);
    }
    row += whole ? tile_rows : 1;
  }
}

static void add_product(const dense_part to[2], const dense_part a[2], const dense_part b[2],
                        size_t rows, size_t inner, size_t columns, double sign) {
  const size_t parts = to[1].at == NULL ? 1 : 2;
  dense_part to_here[2], a_here[2], b_here[2];
  for (size_t column = 0; column < columns; column += COLUMNS) {
    const size_t wide = columns - column < COLUMNS ? columns - column : COLUMNS;
    for (size_t i = 0; i < inner; i += INNER) {
      const size_t deep = inner - i < INNER ? inner - i : INNER;
      shift(to_here, to, parts, 0, column);
      shift(a_here, a, parts, 0, i);
      shift(b_here, b, parts, i, column);
      if (parts == 1) {
        add_block(to_here, a_here, b_here, 1, REAL_ROWS, REAL_GROUPS, rows, deep, wide, sign);
      } else {
        add_block(to_here, a_here, b_here, PARTS, COMPLEX_ROWS, COMPLEX_GROUPS, rows, deep, wide,
                  sign);
      }
    }
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
