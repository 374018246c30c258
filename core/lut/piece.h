/* piece: finds and evaluates a table's pieces, for the kernels and for building tables. The
 * functions are elementwise and branch-free, and round each sum and product separately. */
#ifndef DIPOLED_CORE_LUT_PIECE_H
#define DIPOLED_CORE_LUT_PIECE_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "core/lut/lut.h"

static inline uint32_t core_lut_bits(float x) {
  uint32_t bits;
  memcpy(&bits, &x, sizeof bits);
  return bits;
}

static inline float core_lut_float(uint32_t bits) {
  float x;
  memcpy(&x, &bits, sizeof x);
  return x;
}

/* The position of a piece's first word, and an argument's position t in the piece, from 0 to 1. */
struct lut_place {
  int32_t at;
  float t;
};

/* Finds the place of a positive x, for a function whose entries begin at word `octaves`. The
 * integers are signed, because compilers use gather instructions with signed indices. */
static inline struct lut_place core_lut_find(const float *words, int32_t octaves, float x) {
  const int32_t bits = (int32_t)core_lut_bits(x);
  const int32_t octave = octaves + (bits >> CORE_LUT_MANTISSA_BITS & 0xff);
  const int32_t entry = (int32_t)core_lut_bits(words[octave]);
  const int32_t shift = entry & 31;
  const int32_t mantissa = bits & ((1 << CORE_LUT_MANTISSA_BITS) - 1);
  const int32_t index = mantissa >> shift;
  const int32_t rest = mantissa - (index << shift);
  const float unit = core_lut_float((uint32_t)((127 - shift) << CORE_LUT_MANTISSA_BITS));
  return (struct lut_place){CORE_LUT_PIECES + CORE_LUT_TERMS * ((entry >> 5) + index),
                            (float)rest * unit};
}

/* Evaluates the piece at word `at`: |c0| + w (c1 + w (c2 + w c3)). w is t, or 1 - t if c0 has a
 * minus sign, which marks a piece that is written from its right end. */
static inline float core_lut_piece(const float *c, int32_t at, float t) {
  const float c0 = c[at];
  const int32_t bits = (int32_t)core_lut_bits(c0);
  const float w = bits < 0 ? 1 - t : t;
  return fabsf(c0) + w * (c[at + 1] + w * (c[at + 2] + w * c[at + 3]));
}

static inline float core_lut_look(const float *words, int32_t octaves, float x) {
  const struct lut_place place = core_lut_find(words, octaves, x);
  return core_lut_piece(words, place.at, place.t);
}

#endif
