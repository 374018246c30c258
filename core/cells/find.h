/* find: how kernels find and evaluate cells (core/cells/cells.h), in particular those of a surface
 * (core/varying/surface.h). Each sum and product is rounded separately, never fused. */
#ifndef DIPOLED_CORE_CELLS_FIND_H
#define DIPOLED_CORE_CELLS_FIND_H

#include "core/cells/cells.h"
#include "core/kernel.h"
#include "core/varying/surface.h"

#if CORE_REAL == 64
typedef int64_t cells_integer;
#else
typedef int32_t cells_integer;
#endif

/* Reads a word as an integer. In kernels of double precision words are doubles and integers have 64
 * bits, because gather instructions need indices as wide as the data. */
static inline cells_integer cells_word(const real *words, cells_integer at) {
  const real number = words[at];
  cells_integer word;
  memcpy(&word, &number, sizeof word);
  return word;
}

/* A cell and the place in it, from 0 to 1. */
struct cells_place {
  cells_integer cell;
  real t;
  real per_unit; /* dt / d(coordinate); cells_in_octave() leaves it unset */
};

/* Finds the cell of a number in its octave. bits: the number's bits. The octave has
 * 2^(REAL_MANTISSA_BITS - shift) cells. t has the bits of the mantissa that are below those of the cell:
 * no integer becomes a number, which AVX2 cannot do with 64 bits. */
static inline struct cells_place cells_in_octave(cells_integer bits, cells_integer shift) {
  const real_bits mantissa = ((real_bits)1 << REAL_MANTISSA_BITS) - 1;
  const real_bits rest = (real_bits)bits << (REAL_MANTISSA_BITS - shift) & mantissa;
  return (struct cells_place){
      .cell = (cells_integer)(((real_bits)bits & mantissa) >> shift),
      .t = real_from_bits(rest | REAL_ONE_BITS) - 1,
  };
}

/* Finds the cell of a coordinate on an axis of a surface. axis: enum core_surface_axis; kept: the
 * coordinate, limited to the axis's range. */
static inline struct cells_place cells_find(const real *words, cells_integer axis, real kept) {
  const cells_integer bits = (cells_integer)real_to_bits(kept);
  const cells_integer octave = (cells_integer)((real_bits)bits >> REAL_MANTISSA_BITS) -
                               (REAL_EXPONENT_BIAS + CORE_SURFACE_EXPONENT);
  const cells_integer entry =
      cells_word(words, CORE_SURFACE_ENTRIES + CORE_SURFACE_AXIS * axis + octave);
  struct cells_place place = cells_in_octave(bits, REAL_MANTISSA_BITS - (entry & 31));
  place.cell += (cells_integer)((real_bits)entry >> CORE_CELLS_ENTRY_BITS);
  /* cells for each unit of the coordinate: 2^(cuts - exponent) */
  place.per_unit =
      real_from_bits((real_bits)(REAL_EXPONENT_BIAS - octave - CORE_SURFACE_EXPONENT + (entry & 31))
                     << REAL_MANTISSA_BITS);
  return place;
}

static inline real cells_kept(const real *words, cells_integer axis, real x) {
  return real_min(real_max(x, words[CORE_SURFACE_LEAST + axis]), words[CORE_SURFACE_MOST + axis]);
}

/* Returns the cubic polynomial whose coefficients begin at word `at`, at the place t. */
static inline real cells_line(const real *words, cells_integer at, real t) {
  return words[at] + t * (words[at + 1] + t * (words[at + 2] + t * words[at + 3]));
}

/* Returns the derivative by t of the polynomial of cells_line(). */
static inline real cells_slope(const real *words, cells_integer at, real t) {
  return words[at + 1] + t * (2 * words[at + 2] + t * (3 * words[at + 3]));
}

/* Returns the bicubic polynomial whose coefficients begin at word `at`. p: the place in the
 * direction from row to row; t: within a row. */
static inline real cells_patch(const real *words, cells_integer at, real p, real t) {
  return cells_line(words, at, t) +
         p * (cells_line(words, at + 4, t) +
              p * (cells_line(words, at + 8, t) + p * cells_line(words, at + 12, t)));
}

#endif
