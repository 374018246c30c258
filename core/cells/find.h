/* find: how kernels find and evaluate cells (core/cells/cells.h), and those of a surface in particular
 * (core/varying/surface.h). Each sum and product is rounded separately. */
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

/* Words are of the kernels' precision, integers as the bits of such a number, because compilers
 * gather only with indices of the same size. */
static inline cells_integer cells_word(const real *words, cells_integer at) {
  const real number = words[at];
  cells_integer word;
  memcpy(&word, &number, sizeof word);
  return word;
}

/* A cell of an octave or an axis, and the place in it, from 0 to 1. */
struct cells_place {
  cells_integer cell;
  real t;
  real per_unit; /* by how much t grows for each unit of the coordinate; not set in an octave */
};

/* Finds a number with these bits in its octave, which has 2^(REAL_MANTISSA_BITS - shift) cells. */
static inline struct cells_place cells_in_octave(cells_integer bits, cells_integer shift) {
  const cells_integer mantissa = bits & (((cells_integer)1 << REAL_MANTISSA_BITS) - 1);
  const cells_integer index = mantissa >> shift;
  const cells_integer rest = mantissa - (index << shift);
  const real unit = real_from_bits((real_bits)(REAL_EXPONENT_BIAS - shift) << REAL_MANTISSA_BITS);
  return (struct cells_place){.cell = index, .t = (real)rest * unit};
}

/* axis: of enum core_surface_axis; kept: the coordinate, clamped to the axis. */
static inline struct cells_place cells_find(const real *words, cells_integer axis, real kept) {
  const cells_integer bits = (cells_integer)real_to_bits(kept);
  const cells_integer octave =
      (bits >> REAL_MANTISSA_BITS) - (REAL_EXPONENT_BIAS + CORE_SURFACE_EXPONENT);
  const cells_integer entry =
      cells_word(words, CORE_SURFACE_ENTRIES + CORE_SURFACE_AXIS * axis + octave);
  struct cells_place place = cells_in_octave(bits, REAL_MANTISSA_BITS - (entry & 31));
  place.cell += entry >> CORE_CELLS_ENTRY_BITS;
  /* cells for each unit of the coordinate: 2^(cuts - exponent) */
  place.per_unit =
      real_from_bits((real_bits)(REAL_EXPONENT_BIAS - octave - CORE_SURFACE_EXPONENT + (entry & 31))
                     << REAL_MANTISSA_BITS);
  return place;
}

static inline real cells_kept(const real *words, cells_integer axis, real x) {
  return real_min(real_max(x, words[CORE_SURFACE_LEAST + axis]), words[CORE_SURFACE_MOST + axis]);
}

/* Returns the polynomial at word `at`. */
static inline real cells_line(const real *words, cells_integer at, real t) {
  return words[at] + t * (words[at + 1] + t * (words[at + 2] + t * words[at + 3]));
}

/* Returns its derivative by t. */
static inline real cells_slope(const real *words, cells_integer at, real t) {
  return words[at + 1] + t * (2 * words[at + 2] + t * (3 * words[at + 3]));
}

/* Returns the polynomial of two coordinates at word `at`; p is that of the rows. */
static inline real cells_patch(const real *words, cells_integer at, real p, real t) {
  return cells_line(words, at, t) +
         p * (cells_line(words, at + 4, t) +
              p * (cells_line(words, at + 8, t) + p * cells_line(words, at + 12, t)));
}

#endif
