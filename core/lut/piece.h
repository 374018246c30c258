/* piece: evaluates a table's pieces, for the kernels and for building tables. The functions are
 * elementwise and branch-free, and round each sum and product separately. */
#ifndef DIPOLED_CORE_LUT_PIECE_H
#define DIPOLED_CORE_LUT_PIECE_H

#include <math.h>

#include "core/cells/cells.h"
#include "core/lut/lut.h"

/* Evaluates a piece: |c0| + w (c1 + w (c2 + w c3)). w is t, or 1 - t if c0 has a minus sign, which
 * marks a piece that is written from its right end. t: the argument's position in the piece, from 0
 * to 1. */
static inline float core_lut_piece(const float *c, float t) {
  const int32_t bits = (int32_t)core_cells_bits(c[0]);
  const float w = bits < 0 ? 1 - t : t;
  return fabsf(c[0]) + w * (c[1] + w * (c[2] + w * c[3]));
}

#endif
