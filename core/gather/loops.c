/* The innermost loops of gathering. core/MODELS.md explains the pairs. */
#include "core/gather/loops.h"

#include <math.h>

static inline double larger(double a, double b) {
  return a > b ? a : b;
}

static inline double smaller(double a, double b) {
  return a < b ? a : b;
}

/* With D the vector from a node's centroid to x and d that to a point, s = |x - x_i|^2 is
 * |D - d|^2. Its mean is |D|^2 + E |d|^2, and its difference from it is y = -2 D.d + |d|^2 - E |d|^2.
 * The pair has the mean, E y^2 and nearly E y^3, and lies between the squares of the least and the
 * largest distance that a point may have. */
enum { AT, RADIUS = 3, FOURTH, SECOND, THIRD = 11 };

static void pair(size_t n, const gather_rows *restrict rows, const double x[3],
                 gather_pairs *restrict pairs) {
  const double qx = x[0], qy = x[1], qz = x[2];
  const double(*restrict at)[GATHER_ROW] = rows->field + AT;
  const double(*restrict second)[GATHER_ROW] = rows->field + SECOND;
  const double(*restrict t)[GATHER_ROW] = rows->field + THIRD;
  const double third = 1.0 / 3;
  for (size_t i = 0; i < n; i++) {
    const double X = qx - at[0][i], Y = qy - at[1][i], Z = qz - at[2][i];
    const double xx = X * X, yy = Y * Y, zz = Z * Z;
    const double square = xx + yy + zz;
    const double cxx = second[0][i], cyy = second[1][i], czz = second[2][i];
    const double spread = cxx + cyy + czz;
    const double along = cxx * xx + cyy * yy + czz * zz + second[3][i] * (X * Y) +
                         second[4][i] * (X * Z) + second[5][i] * (Y * Z);
    const double cubic = X * (t[0][i] * xx + t[3][i] * (X * Y) + t[4][i] * (X * Z) + t[5][i] * yy +
                              t[9][i] * (Y * Z)) +
                         Y * (t[1][i] * yy + t[6][i] * (Y * Z)) +
                         Z * (t[2][i] * zz + t[7][i] * (X * Z) + t[8][i] * (Y * Z));
    /* D . E |d|^2 d; what occurs three times is in the rows times 3 */
    const double trace = X * (t[0][i] + (t[5][i] + t[7][i]) * third) +
                         Y * (t[1][i] + (t[3][i] + t[8][i]) * third) +
                         Z * (t[2][i] + (t[4][i] + t[6][i]) * third);
    const double fourth = rows->field[FOURTH][i], radius = rows->field[RADIUS][i];
    const double distance = sqrt(square);
    const double mean = square + spread;
    const double least = larger(distance - radius, 0);
    const double most = distance + radius;
    const double least_square = least * least;
    const double below = larger(mean - least_square, 1e-300);
    const double above = larger(most * most - mean, 1e-300);
    const double variance =
        smaller(larger(4 * along - 4 * trace + (fourth - spread * spread), 0), below * above);
    const double ratio = spread > 0 ? fourth / spread - spread : 0;
    const double raised = 12 * along * ratio - 8 * cubic;
    const double raw = variance > 0 ? raised / variance : 0;
    const double skew = smaller(larger(raw, variance / below - below), above - variance / above);
    const double apart = sqrt(skew * skew + 4 * variance);
    const double up = 0.5 * (skew + apart);
    pairs->r[0][i] = sqrt(larger(mean + 0.5 * (skew - apart), least_square));
    pairs->r[1][i] = sqrt(mean + up);
    pairs->share[i] = apart > 0 ? up / apart : 0.5;
  }
}

static void distances(size_t n, const double *restrict px, const double *restrict py,
                      const double *restrict pz, const double x[3], double *restrict r) {
  const double qx = x[0], qy = x[1], qz = x[2];
  for (size_t i = 0; i < n; i++) {
    const double X = qx - px[i], Y = qy - py[i], Z = qz - pz[i];
    r[i] = sqrt(X * X + Y * Y + Z * Z);
  }
}

static void narrow(size_t n, const double *restrict in, float *restrict out) {
  for (size_t i = 0; i < n; i++) {
    out[i] = (float)in[i];
  }
}

static void widen(size_t n, const float *restrict in, double *restrict out) {
  for (size_t i = 0; i < n; i++) {
    out[i] = (double)in[i];
  }
}

typedef double lanes __attribute__((vector_size(GATHER_LANES * sizeof(double)), may_alias));
typedef long long lane_bits __attribute__((vector_size(GATHER_LANES * sizeof(double)), may_alias));

static double total(const double sum[GATHER_LANES]) {
  return ((sum[0] + sum[4]) + (sum[2] + sum[6])) + ((sum[1] + sum[5]) + (sum[3] + sum[7]));
}

/* A radius of 0 may have an infinite R, which counts only where there is power: bits of other
 * products are cleared. */

static double sum(size_t n, const double *power, const double *R) {
  const lanes *powers = (const lanes *)power, *values = (const lanes *)R;
  _Alignas(64) double added[GATHER_LANES] = {0};
  for (size_t i = 0; i < n / GATHER_LANES; i++) {
    const lanes product = powers[i] * values[i];
    *(lanes *)added += (lanes)((lane_bits)product & (powers[i] > 0));
  }
  return total(added);
}

static double sum_pairs(size_t n, const double *power, const double *share, const double *first,
                        const double *second) {
  const lanes *powers = (const lanes *)power, *shares = (const lanes *)share,
              *firsts = (const lanes *)first, *seconds = (const lanes *)second;
  _Alignas(64) double added[GATHER_LANES] = {0};
  for (size_t i = 0; i < n / GATHER_LANES; i++) {
    const lanes product = powers[i] * (shares[i] * firsts[i] + (1 - shares[i]) * seconds[i]);
    *(lanes *)added += (lanes)((lane_bits)product & (powers[i] > 0));
  }
  return total(added);
}

#define PASTE_(a, b) a##b
#define PASTE(a, b) PASTE_(a, b)

/* The one symbol that this object exports. */
extern const gather_loops PASTE(gather_loops_, CORE_ISA);
const gather_loops PASTE(gather_loops_, CORE_ISA) = {pair,  distances, narrow,
                                                     widen, sum,       sum_pairs};
