/* The innermost loops of dense.c, compiled once for each instruction set. All have the same bits,
 * because no product is contracted with a sum. */
#include "core/transport/dense.h"

enum { TILE_ROWS = 4 };

/* A tile of TILE_ROWS by DENSE_TILE numbers stays in registers. */
typedef double lanes __attribute__((vector_size(DENSE_TILE * sizeof(double)), aligned(32)));

/* Adds sign times a b to `to`, for TILE_ROWS rows or fewer. Columns are multiples of DENSE_TILE.
 */
static inline __attribute__((always_inline)) void add_rows(dense_part to, dense_part a,
                                                           dense_part b, size_t rows, size_t inner,
                                                           size_t columns, double sign) {
  for (size_t column = 0; column < columns; column += DENSE_TILE) {
    lanes sum[TILE_ROWS] = {{0}};
    for (size_t i = 0; i < inner; i++) {
      const lanes right = *(const lanes *)(b.at + i * b.stride + column);
#pragma GCC unroll 4
      for (size_t row = 0; row < rows; row++) {
        sum[row] += a.at[row * a.stride + i] * right;
      }
    }
    for (size_t row = 0; row < rows; row++) {
      lanes *here = (lanes *)(to.at + row * to.stride + column);
      *here += sign * sum[row];
    }
  }
}

/* The one symbol that this object exports. */
#define PASTE_(a, b) a##b
#define PASTE(a, b) PASTE_(a, b)
extern dense_add_product PASTE(transport_dense_product_, CORE_ISA);
void PASTE(transport_dense_product_, CORE_ISA)(dense_part to, dense_part a, dense_part b,
                                               size_t rows, size_t inner, size_t columns,
                                               double sign) {
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
