/* lut: builds tables that replace a profile in single precision. A table has the same form in
 * memory and on the wire.
 *
 * A table is an array of 32-bit words, little-endian: numbers in IEEE single precision, and
 * entries, which are unsigned integers. It holds three functions: R and cdf of the radius, and the
 * radius for a cdf. Each is cut into pieces, which are polynomials of the third degree over equal
 * parts of an octave [2^e, 2^(e+1)) of the argument. The bits of the argument give the position of
 * its piece (core/lut/piece.h). A piece is evaluated by sums and products that are each rounded,
 * without fused operations, so any program with IEEE arithmetic gets the same bits.
 *
 * An octave is cut into as many pieces as its function needs. The coefficients c1, c2 and c3 of a
 * piece have one sign, always for the cdf and the radius, and for R where such a fit is the best. A
 * piece of one sign stays monotone when it is rounded, and its rounding error is one or two units
 * of the last digit.
 *
 * A piece is |c0| + w (c1 + w (c2 + w c3)). The argument's mantissa (23 bits), shifted right by the
 * entry's shift, is added to the entry's piece number. The bits shifted out, divided by 2^shift,
 * are t; w is t, or 1 - t if c0 has a minus sign. The values follow from the piece, where products
 * are evaluated from left to right:
 *   R         piece SCALE
 *   2 pi r R  piece r RING_SCALE, or piece (r RING_SCALE) where RING_SCALE is more than 1
 *   pdf       like 2 pi r R, with PDF_SCALE in place of RING_SCALE
 *   cdf       the smaller of the piece and 1
 *   radius    piece; its argument is u up to 1/2, and 1 - u above
 *
 * Outside of the octaves the functions follow their asymptotes. Towards the source R is constant or
 * grows like 1 / r or like -ln r (core/models/lut.c has the log2 that is used). Far away R falls
 * like 1 / r^3 if nothing absorbs, and has otherwise underflowed.
 */
#ifndef DIPOLED_CORE_LUT_H
#define DIPOLED_CORE_LUT_H

#include "core/core.h"

/* Positions of the words. */
enum core_lut_word {
  CORE_LUT_FIRST_MM,   /* radius where the pieces of R and cdf begin, mm, a power of two */
  CORE_LUT_LAST_MM,    /* radius where these pieces end, mm, a power of two */
  CORE_LUT_SCALE,      /* 1/mm^2, a power of two: R is its piece times SCALE */
  CORE_LUT_RING_SCALE, /* 2 pi SCALE */
  CORE_LUT_PDF_SCALE,  /* 2 pi SCALE / albedo */
  CORE_LUT_NEAR_POWER, /* R at r < FIRST_MM, if 1: SCALE NEAR_R / r, with NEAR_R in mm; */
  CORE_LUT_NEAR_R,     /* if 0: SCALE (NEAR_R + NEAR_LOG log2(FIRST_MM / r)) */
  CORE_LUT_NEAR_LOG,
  CORE_LUT_NEAR_CDF,     /* cdf at r < FIRST_MM, if NEAR_POWER is 1: NEAR_CDF r; */
  CORE_LUT_NEAR_CDF_LOG, /* if 0: (NEAR_CDF + NEAR_CDF_LOG log2(FIRST_MM / r)) r^2 */
  CORE_LUT_FAR,          /* at r >= LAST_MM R is SCALE FAR (LAST_MM / r)^3, and the cdf is LIMIT */
  CORE_LUT_LIMIT,        /* the cdf's limit for large r: 1, or 0 if nothing scatters */
  CORE_LUT_FIRST_U,      /* smallest u that has a piece of the radius, a power of two */
  /* Below FIRST_U the radius in mm is NEAR_RADIUS u if NEAR_POWER is 1. Otherwise the formula of
 * NEAR_CDF is solved for it, starting from NEAR_RADIUS sqrt(u). */
  CORE_LUT_NEAR_RADIUS,
  CORE_LUT_SAMPLES_MM,     /* the least radius of the samples, a power of two */
  CORE_LUT_SPARE,          /* this word is 0 */
  CORE_LUT_R_OCTAVES = 16, /* first entry of R; one for each exponent of r */
  /* first entry of the cdf; one for each exponent of r */
  CORE_LUT_CDF_OCTAVES = CORE_LUT_R_OCTAVES + 256,
  /* first entry of the radius; one for each exponent of u */
  CORE_LUT_RADIUS_OCTAVES = CORE_LUT_CDF_OCTAVES + 256,
  /* first entry of the radius; one for each exponent of 1 - u */
  CORE_LUT_COMPLEMENT_OCTAVES = CORE_LUT_RADIUS_OCTAVES + 128,
  /* first piece; each has CORE_LUT_TERMS words */
  CORE_LUT_PIECES = CORE_LUT_COMPLEMENT_OCTAVES + 128,
  CORE_LUT_TERMS = 4
};

#define CORE_LUT_PIECES_MAX 65536

/* After the pieces there are samples: R of the profile in double precision, two words each. From
 * them core/gather bounds how R varies with the radius. */
enum {
  CORE_LUT_OCTAVE_SAMPLES_LOG2 = 5,
  CORE_LUT_SAMPLES = 29 << CORE_LUT_OCTAVE_SAMPLES_LOG2,
  CORE_LUT_SAMPLE_WORDS = 2 * CORE_LUT_SAMPLES,
  CORE_LUT_WORDS_MAX =
      CORE_LUT_PIECES + CORE_LUT_TERMS * CORE_LUT_PIECES_MAX + CORE_LUT_SAMPLE_WORDS
};

/* The number, among the samples' octaves, of the octave that contains scale_mm. */
enum { CORE_LUT_SCALE_OCTAVE = 14 };

/* Sets R[CORE_LUT_SAMPLES] to samples of R in 1/mm^2 and r[] to their radii in mm. If the profile
 * is a table, it reads the samples stored in it; else it evaluates R. With n samples in an octave,
 * radius k n + j is the least radius times 2^k (1 + j / n); the last radius is 0. */
void core_lut_samples(const core_profile *profile, double *r, double *R);

/* An octave's entry: the index of its first piece, and a shift. An argument's mantissa shifted
 * right by it is the number of its piece within the octave. */
#define CORE_LUT_ENTRY(piece, shift) ((uint32_t)(piece) << 5 | (uint32_t)(shift))
#define CORE_LUT_ENTRY_PIECE(entry) ((entry) >> 5)
#define CORE_LUT_ENTRY_SHIFT(entry) ((entry)&31)
enum { CORE_LUT_MANTISSA_BITS = 23, CORE_LUT_CUTS_MAX = 11 };

/* A table in memory. */
typedef struct core_lut {
  float *words; /* malloc()ed */
  size_t count; /* number of words, a multiple of 4 */
  /* largest relative error found in R and cdf at arguments that the fits did not use */
  double error;
} core_lut;

/* Makes the table of a profile in double precision. R, cdf and the radius for a cdf then have a
 * relative error of at most `tolerance` against the profile, whose own error comes on top. The
 * caller frees lut->words. Faults: `tolerance` if no table of at most CORE_LUT_PIECES_MAX pieces
 * keeps it, and `memory`. */
core_fault core_lut_build(core_lut *lut, const core_profile *source, double tolerance);

/* Checks a table that a peer or a file has given. Without a fault, evaluating it reads no words
 * outside of it, whatever numbers it holds. The fault's field is `table`. words are aligned for
 * float. */
core_fault core_lut_check(const float *words, size_t count);

#endif
