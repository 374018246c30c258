/* cells: piecewise cubic polynomials over cells of one or two coordinates. Tables of one profile
 * (core/lut/lut.h) and surfaces (core/varying/surface.h) store functions so. This header makes and
 * checks cells; core/cells/find.h finds and evaluates them in kernels.
 *
 * Each octave [2^e, 2^(e+1)) of a coordinate is divided into 2^cuts equal cells. An octave's entry
 * is a word: the index of its first cell, shifted left by CORE_CELLS_ENTRY_BITS, plus either the
 * cuts (surfaces) or the number of mantissa bits below them (tables). A coordinate's place t in its
 * cell goes from 0 to 1. All words have 32 bits: IEEE single precision or integers. */
#ifndef DIPOLED_CORE_CELLS_H
#define DIPOLED_CORE_CELLS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum {
  CORE_CELLS_TERMS = 4,                    /* coefficients of a cell for each coordinate */
  CORE_CELLS_STEPS = CORE_CELLS_TERMS - 1, /* intervals between the points of a cell */
  /* coefficients of a cell of two coordinates */
  CORE_CELLS_PATCH = CORE_CELLS_TERMS * CORE_CELLS_TERMS,
  CORE_CELLS_ENTRY_BITS = 5,
};

/* The places t in a cell where its polynomial equals the function: 0, 1/4, 3/4 and 1. Neighbouring
 * cells share the points at their ends. */
extern const double core_cells_points[CORE_CELLS_TERMS]; /* 0, 1/4, 3/4, 1 */

static inline uint32_t core_cells_bits(float x) {
  uint32_t bits;
  memcpy(&bits, &x, sizeof bits);
  return bits;
}

static inline float core_cells_float(uint32_t bits) {
  float x;
  memcpy(&x, &bits, sizeof x);
  return x;
}

/* Sets c[CORE_CELLS_TERMS] to the coefficients, from the constant on, of the polynomial in t through
 * y[0], y[stride], ... at t = 0, 1 (degree 1), at 0, 1/2, 1 (2), or at the points of a cell (3). */
void core_cells_through(int degree, const double *y, size_t stride, double *c);

/* Fits a function of one coordinate. values[CORE_CELLS_STEPS cells + 1]: the function at the points
 * of all cells in ascending order. Sets out[CORE_CELLS_TERMS cells] to the coefficients. */
void core_cells_fit_lines(const double *values, size_t cells, float *out);

/* Fits a function of two coordinates. values: (CORE_CELLS_STEPS rows + 1) rows of (CORE_CELLS_STEPS
 * columns + 1) numbers. Sets out[CORE_CELLS_PATCH rows columns], cell by cell in the order of rows:
 * the coefficient of t^k p^i is at CORE_CELLS_TERMS i + k. p is the place in the direction from row
 * to row, and t the place within a row. */
void core_cells_fit_patches(const double *values, size_t rows, size_t columns, float *out);

/* Return a cell's value at t, and at p and t, in double precision. */
double core_cells_line(const float *c, double t);
double core_cells_patch(const float *c, double p, double t);

/* Returns whether 2^cuts cells from index `first` on are among the first `cells`, and cuts is at
 * most cuts_most. Any numbers may be passed. */
bool core_cells_hold(uint32_t first, uint32_t cuts, uint32_t cuts_most, size_t cells);

#endif
