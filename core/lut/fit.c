/* Fits pieces. A piece is a polynomial through the function's values at both ends and at points
 * between. It is written from the end where its terms have one sign. Its rounding error is then one
 * or two units of the last digit, and it stays monotone: sums and products of rising positive
 * numbers rise, or stay equal, after rounding. */
#include "core/lut/fit.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

#include "core/kernels.h"

/* The places in a piece at which fits are compared with the function, in 1/64 of its length. They
 * are exact in single precision. */
enum { PLACES = 11, STEP = 64, FOUND_PER_PIECE = 5, SCANNED_PER_PIECE = 16 };

/* Each piece is checked at FOUND_PER_PIECE arguments. If its error exceeds this share of the
 * largest error so far, it is checked at SCANNED_PER_PIECE further ones. */
#define SCAN_SHARE 0.8

static const int places[PLACES] = {0, 3, 9, 16, 24, 32, 40, 48, 55, 61, 64};

/* points[degree - 1]: indices of the places that a polynomial of degree 1, 2 or 3 interpolates, as
 * by core_cells_through(). */
static const int points[3][4] = {{0, 10}, {0, 5, 10}, {0, 3, 7, 10}};

/* A term of the wrong sign is set to 0 if it is at most this times the first term. */
#define ALMOST_NONE 1e-9

const core_fault lut_too_rough = {"tolerance", "larger: no table of this profile keeps it", 0};

/* ---- candidates ------------------------------------------------------------------------------ */

/* Sets c[] to the coefficients, in powers of w, of the polynomial of this degree that interpolates
 * y at its points. The points are symmetric: from the right, their order is reversed. */
static void interpolate(int degree, bool from_right, const double *y, double *c) {
  double through[CORE_LUT_TERMS];
  for (int i = 0; i <= degree; i++) {
    through[i] = y[points[degree - 1][from_right ? degree - i : i]];
  }
  core_cells_through(degree, through, 1, c);
}

/* Makes all terms after the first have the sign of the total change. Returns false if a term of the
 * other sign is larger than rounding. */
static bool one_sign(double *c) {
  const double change = c[1] + c[2] + c[3];
  for (int k = 1; k < CORE_LUT_TERMS; k++) {
    if (change > 0 ? c[k] < 0 : c[k] > 0) {
      if (fabs(c[k]) > ALMOST_NONE * fabs(c[0])) {
        return false;
      }
      c[k] = 0;
    }
  }
  return true;
}

/* Returns whether all Bernstein coefficients of a polynomial are positive, which makes it positive
 * on [0, 1]. */
static bool positive(const double *c) {
  return c[0] > 0 && c[0] + c[1] / 3 > 0 && c[0] + 2 * c[1] / 3 + c[2] / 3 > 0 &&
         c[0] + c[1] + c[2] + c[3] > 0;
}

static void round_piece(const double *c, bool from_right, float *piece) {
  piece[0] = (float)c[0];
  for (int k = 1; k < CORE_LUT_TERMS; k++) {
    piece[k] = (float)c[k];
  }
  if (from_right) {
    piece[0] = core_cells_float(core_cells_bits(piece[0]) | UINT32_C(0x80000000));
  }
}

/* Lowers a monotone piece, if needed, so that its far end does not exceed the function's value
 * there. The next piece starts from that value, so the whole function stays monotone. */
static void stop_at(float *piece, bool from_right, double far_end) {
  const float limit = (float)far_end;
  const float t = from_right ? 0 : 1;
  const float near_end = fabsf(piece[0]);
  if (!(limit > near_end || limit < near_end)) {
    piece[1] = piece[2] = piece[3] = 0;
  }
  for (float end = core_lut_piece(piece, t); limit > near_end ? end > limit : end < limit;
       end = core_lut_piece(piece, t)) {
    float *largest = &piece[1];
    for (int k = 2; k < CORE_LUT_TERMS; k++) {
      largest = fabsf(piece[k]) > fabsf(*largest) ? &piece[k] : largest;
    }
    /* Reduces the largest term by at least one unit in its last place. */
    const float less = fmaxf(fabsf(end - limit), fabsf(*largest) * 0x1p-23f);
    *largest = copysignf(fmaxf(fabsf(*largest) - less, 0), *largest);
  }
}

/* ---- errors ---------------------------------------------------------------------------------- */

/* Returns the relative error of a value, or 0 if its absolute error is negligible. */
static double error_of(const struct lut_subject *subject, float value, double truth) {
  const double off = fabs((double)value - truth);
  return off <= subject->negligible ? 0 : truth > 0 ? off / truth : (double)INFINITY;
}

static double worst_of(const struct lut_subject *subject, const float *piece, const double *y) {
  double worst = 0;
  for (int i = 0; i < PLACES; i++) {
    const double error = error_of(subject, core_lut_piece(piece, (float)places[i] / STEP), y[i]);
    worst = error > worst || isnan(error) ? error : worst;
  }
  return worst;
}

/* Sets *best to the coefficients of the best piece for the function values y[] at the places.
 * Returns false if none is within the tolerance. */
static bool fit_piece(const struct lut_subject *subject, const double *y, float *best) {
  double least = (double)INFINITY;
  for (int degree = 3; degree >= 1; degree--) {
    for (int side = 0; side < 2; side++) {
      double c[CORE_LUT_TERMS];
      float piece[CORE_LUT_TERMS];
      interpolate(degree, side == 1, y, c);
      const bool turns = !one_sign(c);
      const bool usable = turns ? !subject->monotone && positive(c) : c[0] >= 0;
      round_piece(c, side == 1, piece);
      if (usable && !turns) {
        stop_at(piece, side == 1, y[side == 1 ? 0 : PLACES - 1]);
      }
      const double worst = usable ? worst_of(subject, piece, y) : (double)INFINITY;
      if (worst < least) {
        least = worst;
        memcpy(best, piece, sizeof piece);
      }
    }
  }
  return least <= subject->tolerance;
}

/* ---- octaves --------------------------------------------------------------------------------- */

static bool make_room(struct lut_pieces *pieces, size_t more) {
  if (pieces->count + more <= pieces->room) {
    return true;
  }
  const size_t room = 2 * pieces->room + more;
  float(*c)[CORE_LUT_TERMS] = realloc(pieces->c, room * sizeof *c);
  if (c != NULL) {
    pieces->c = c;
    pieces->room = room;
  }
  return c != NULL;
}

/* Writes the function's values at the places of piece `index` of 2^cuts. */
static void sample_piece(const struct lut_subject *subject, int exponent, unsigned cuts,
                         uint32_t index, double *y) {
  double x[PLACES];
  for (int i = 0; i < PLACES; i++) {
    const double at = (double)index + (double)places[i] / STEP;
    x[i] = ldexp(1 + ldexp(at, -(int)cuts), exponent);
  }
  subject->function(subject->context, PLACES, x, y);
}

/* Fits all 2^cuts pieces of an octave. Returns false if one of them does not keep the tolerance. */
static bool fit_all(const struct lut_subject *subject, int exponent, unsigned cuts,
                    float (*c)[CORE_LUT_TERMS]) {
  for (uint32_t i = 0; i < UINT32_C(1) << cuts; i++) {
    double y[PLACES];
    sample_piece(subject, exponent, cuts, i, y);
    if (!fit_piece(subject, y, c[i])) {
      return false;
    }
  }
  return true;
}

core_fault lut_fit_octave(const struct lut_subject *subject, int exponent, unsigned *cuts,
                          struct lut_pieces *pieces, uint32_t *entry) {
  for (; *cuts <= CORE_LUT_CUTS_MAX; ++*cuts) {
    const size_t more = (size_t)1 << *cuts;
    if (pieces->count + more > CORE_LUT_PIECES_MAX) {
      break;
    }
    if (!make_room(pieces, more)) {
      return CORE_OUT_OF_MEMORY;
    }
    *entry = CORE_LUT_ENTRY(pieces->count, CORE_LUT_MANTISSA_BITS - *cuts);
    if (fit_all(subject, exponent, *cuts, &pieces->c[pieces->count]) &&
        lut_fit_error(subject, exponent, *entry, pieces, (double)INFINITY) <= subject->tolerance) {
      pieces->count += more;
      return (core_fault){0};
    }
  }
  return lut_too_rough;
}

core_fault lut_fit_constant(float value, struct lut_pieces *pieces, uint32_t *entry) {
  if (pieces->count == CORE_LUT_PIECES_MAX) {
    return lut_too_rough;
  }
  if (!make_room(pieces, 1)) {
    return CORE_OUT_OF_MEMORY;
  }
  const float piece[CORE_LUT_TERMS] = {value, 0, 0, 0};
  memcpy(pieces->c[pieces->count], piece, sizeof piece);
  *entry = CORE_LUT_ENTRY(pieces->count, CORE_LUT_MANTISSA_BITS);
  pieces->count++;
  return (core_fault){0};
}

/* Returns the largest relative error of piece `index` of 2^cuts at n arguments, which are given as
 * shares of the piece. */
static double error_at(const struct lut_subject *subject, int exponent, unsigned cuts,
                       uint32_t index, const float *piece, size_t n, const double *shares) {
  double x[SCANNED_PER_PIECE];
  double y[SCANNED_PER_PIECE];
  double worst = 0;
  assert(n > 0 && n <= SCANNED_PER_PIECE);
  for (size_t k = 0; k < n; k++) {
    x[k] = ldexp(1 + ldexp((double)index + shares[k], -(int)cuts), exponent);
  }
  subject->function(subject->context, n, x, y);
  for (size_t k = 0; k < n; k++) {
    const double error = error_of(subject, core_lut_piece(piece, (float)shares[k]), y[k]);
    worst = error > worst || isnan(error) ? error : worst;
  }
  return worst;
}

double lut_fit_error(const struct lut_subject *subject, int exponent, uint32_t entry,
                     const struct lut_pieces *pieces, double known) {
  /* Arguments between the places, near the largest errors of polynomials of degrees 3, 2 and 1. */
  static const double between[FOUND_PER_PIECE] = {6.5 / 64, 13.5 / 64, 31.5 / 64, 50.5 / 64,
                                                  57.5 / 64};
  const unsigned cuts = CORE_LUT_MANTISSA_BITS - CORE_LUT_ENTRY_SHIFT(entry);
  double scanned[SCANNED_PER_PIECE];
  for (int k = 0; k < SCANNED_PER_PIECE; k++) {
    scanned[k] = (k + 0.5) / SCANNED_PER_PIECE;
  }
  double worst = 0;
  for (uint32_t i = 0; i < UINT32_C(1) << cuts; i++) {
    const float *piece = pieces->c[CORE_LUT_ENTRY_PIECE(entry) + i];
    double error = error_at(subject, exponent, cuts, i, piece, FOUND_PER_PIECE, between);
    if (error > SCAN_SHARE * fmax(known, worst)) {
      const double more = error_at(subject, exponent, cuts, i, piece, SCANNED_PER_PIECE, scanned);
      error = more > error || isnan(more) ? more : error;
    }
    worst = error > worst || isnan(error) ? error : worst;
  }
  return worst;
}
