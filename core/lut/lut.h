/* lut: the table that stands for a profile in single precision, in memory and on the wire alike.
 *
 * A table is an array of 32-bit words, little-endian: numbers in IEEE single precision, and
 * entries, which are unsigned integers. It holds three functions, R and cdf of the radius and the
 * radius for a cdf, each in pieces: polynomials of the third degree over equal parts of an octave
 * [2^e, 2^(e+1)) of the argument. The bits of the argument find the piece without arithmetic (core/lut/piece.h), and
 * it is evaluated by sums and products alone, no fused ones: so any program with IEEE
 * arithmetic gets the same bits.
 *
 * An octave is cut into as many pieces as its function needs. Coefficients of a piece have one sign
 * (of the cdf and the radius always, of R where that serves): so rounding cannot make it turn back,
 * and it is rounded to its last digit or two everywhere.
 *
 * A piece is |c0| + w (c1 + w (c2 + w c3)). The argument's mantissa (23 bits), shifted right by an
 * entry's shift, counts the piece from the entry's; the bits shifted out, over 2^shift, are t, and w
 * is t, or 1 - t where c0 has a minus sign. Then, factors taken from left to right:
 *   R         piece SCALE
 *   2 pi r R  piece r RING_SCALE, or piece (r RING_SCALE) where RING_SCALE is more than 1
 *   pdf       likewise, with PDF_SCALE
 *   cdf       the smaller of the piece and 1
 *   radius    piece; of u up to 1/2, else of 1 - u
 *
 * Outside of the octaves the known asymptotics go on: R is constant, or grows like 1 / r or like
 * -ln r towards the source (with log2 as in core/models/lut.c); far away it falls like 1 / r^3 where nothing absorbs, or has underflowed.
 */
#ifndef DIPOLED_CORE_LUT_H
#define DIPOLED_CORE_LUT_H

#include "core/core.h"

/* Positions of the words. */
enum core_lut_word {
  CORE_LUT_FIRST_MM,     /* where the pieces of R and cdf begin, a power of two */
  CORE_LUT_LAST_MM,      /* and where they end, likewise */
  CORE_LUT_SCALE,        /* 1/mm^2: R is that times its piece; a power of two */
  CORE_LUT_RING_SCALE,   /* 2 pi times that */
  CORE_LUT_PDF_SCALE,    /* and over the albedo */
  CORE_LUT_NEAR_POWER,   /* below the first radius R is SCALE times, if 1: NEAR_R / r (mm), */
  CORE_LUT_NEAR_R,       /*   if 0: NEAR_R + NEAR_LOG log2(FIRST_MM / r) */
  CORE_LUT_NEAR_LOG,
  CORE_LUT_NEAR_CDF,     /* the cdf of that is NEAR_CDF r, 1/mm, or */
  CORE_LUT_NEAR_CDF_LOG, /* (NEAR_CDF + NEAR_CDF_LOG log2(FIRST_MM / r)) r^2, 1/mm^2 */
  CORE_LUT_FAR,         /* from the last radius on, R is SCALE FAR (LAST_MM / r)^3, and the cdf 1 */
  CORE_LUT_LIMIT,       /* of the cdf: 1, or 0 when nothing scatters */
  CORE_LUT_FIRST_U,     /* where the pieces of the radius begin, a power of two */
  CORE_LUT_NEAR_RADIUS, /* below, the radius is, with NEAR_POWER: NEAR_RADIUS u, mm, else from
                           NEAR_RADIUS sqrt(u) on solved for by that formula of the cdf */
  CORE_LUT_SPARE,       /* 0, as are the next */
  CORE_LUT_R_OCTAVES = 16,                                     /* an entry for each exponent */
  CORE_LUT_CDF_OCTAVES = CORE_LUT_R_OCTAVES + 256,             /* likewise */
  CORE_LUT_RADIUS_OCTAVES = CORE_LUT_CDF_OCTAVES + 256,        /* of u up to 1/2, */
  CORE_LUT_COMPLEMENT_OCTAVES = CORE_LUT_RADIUS_OCTAVES + 128, /* and of 1 - u below it */
  CORE_LUT_PIECES = CORE_LUT_COMPLEMENT_OCTAVES + 128,         /* CORE_LUT_TERMS each */
  CORE_LUT_TERMS = 4
};

#define CORE_LUT_PIECES_MAX 65536
#define CORE_LUT_TOLERANCE 1e-4 /* when none is asked for */
#define CORE_LUT_TOLERANCE_MIN 1e-6
#define CORE_LUT_TOLERANCE_MAX 0.1 /* more is taken for it */

/* An entry: the number of its octave's first piece, and by how many bits the mantissa is shifted
 * to count from there. */
#define CORE_LUT_ENTRY(piece, shift) ((uint32_t)(piece) << 5 | (uint32_t)(shift))
#define CORE_LUT_ENTRY_PIECE(entry) ((entry) >> 5)
#define CORE_LUT_ENTRY_SHIFT(entry) ((entry)&31)
enum { CORE_LUT_MANTISSA_BITS = 23, CORE_LUT_CUTS_MAX = 11 };

/* A table in memory; words is malloc()ed. */
typedef struct core_lut {
  float *words;
  size_t count; /* of words, a multiple of 4 */
  double error; /* largest relative error found in R and cdf, between all nodes, after building */
} core_lut;

/* Makes the table of a profile in double precision, whose numerical error is not counted, so that R,
 * cdf and radii for given cdf are within `tolerance`, relative; *lut is then the caller's. Faults:
 * `tolerance`, where the profile is such that no table of at most CORE_LUT_PIECES_MAX pieces keeps
 * it; `memory`. */
core_fault core_lut_build(core_lut *lut, const core_profile *source, double tolerance);

/* The fault of a table from elsewhere, `table`, that could not be evaluated: after this nothing
 * outside of it will be read, whatever its numbers. words need be aligned for float. */
core_fault core_lut_check(const float *words, size_t count);

#endif
