/* cells: functions as polynomials of the third degree over cells of their coordinates, as tables of one
 * profile (core/lut/lut.h) and surfaces (core/varying/surface.h) hold them. This makes and checks them;
 * core/cells/find.h finds and evaluates them in kernels.
 *
 * The octaves [2^e, 2^(e+1)) of a coordinate are cut into equal cells, a power of two of them for each
 * octave: 2^cuts. An octave's entry is a word that holds the number of its first cell, shifted left by
 * CORE_CELLS_ENTRY_BITS, and below that the cuts, or what is left of a number's mantissa without them. A
 * coordinate's place t in its cell goes from 0 to 1. All words have 32 bits: numbers in IEEE single
 * precision, and integers. */
#ifndef DIPOLED_CORE_CELLS_H
#define DIPOLED_CORE_CELLS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum {
  CORE_CELLS_TERMS = 4,                                   /* of a cell, in each direction */
  CORE_CELLS_STEPS = CORE_CELLS_TERMS - 1,                /* between the points of a cell */
  CORE_CELLS_PATCH = CORE_CELLS_TERMS * CORE_CELLS_TERMS, /* words of a cell of two coordinates */
  CORE_CELLS_ENTRY_BITS = 5,
};

/* The points of a cell: it is fitted through the values there, as its neighbours are at its ends. */
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

/* Sets out[CORE_CELLS_TERMS] of each cell of a function of one coordinate; the points of all cells have
 * the values[CORE_CELLS_STEPS cells + 1]. */
void core_cells_fit_lines(const double *values, size_t cells, float *out);

/* Sets out[CORE_CELLS_PATCH] of each cell, row by row, of a function of two coordinates: the term t^k
 * p^i is at CORE_CELLS_TERMS i + k, where p is the place along the rows. Values have a row for each of
 * CORE_CELLS_STEPS rows + 1 points, of CORE_CELLS_STEPS columns + 1 numbers. */
void core_cells_fit_patches(const double *values, size_t rows, size_t columns, float *out);

/* Return a cell's value at t, and at p and t, in double precision. */
double core_cells_line(const float *c, double t);
double core_cells_patch(const float *c, double p, double t);

/* Returns whether the cells of an octave, whose entry holds these numbers, are among the first
 * `cells`. Any numbers may be passed. */
bool core_cells_hold(uint32_t first, uint32_t cuts, uint32_t cuts_most, size_t cells);

#endif
