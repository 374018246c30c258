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
enum { AT, RADIUS = 3, SECOND, FOURTH = 10, THIRD = 16 };

static void pair(size_t n, const gather_rows *restrict rows, const double x[3], double *restrict r,
                 double *restrict share) {
  const double qx = x[0], qy = x[1], qz = x[2];
  const double(*restrict at)[GATHER_ROW] = rows->field + AT;
  const double(*restrict second)[GATHER_ROW] = rows->field + SECOND;
  const double(*restrict fourth)[GATHER_ROW] = rows->field + FOURTH;
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
    const double fxx = fourth[0][i], fyy = fourth[1][i], fzz = fourth[2][i];
    const double raised_along = fxx * xx + fyy * yy + fzz * zz + fourth[3][i] * (X * Y) +
                                fourth[4][i] * (X * Z) + fourth[5][i] * (Y * Z);
    const double radius = rows->field[RADIUS][i];
    const double distance = sqrt(square);
    const double mean = square + spread;
    const double least = larger(distance - radius, 0);
    const double most = distance + radius;
    const double least_square = least * least;
    const double below = larger(mean - least_square, 1e-300);
    const double above = larger(most * most - mean, 1e-300);
    const double variance = smaller(
        larger(4 * along - 4 * trace + (fxx + fyy + fzz - spread * spread), 0), below * above);
    const double raised = 12 * (raised_along - spread * along) - 8 * cubic;
    const double raw = variance > 0 ? raised / variance : 0;
    const double skew = smaller(larger(raw, variance / below - below), above - variance / above);
    const double apart = sqrt(skew * skew + 4 * variance);
    const double up = 0.5 * (skew + apart);
    r[i] = sqrt(larger(mean + 0.5 * (skew - apart), least_square));
    r[n + i] = sqrt(mean + up);
    share[i] = apart > 0 ? up / apart : 0.5;
  }
}

/* Returns the square root of the norm of a symmetric tensor, which is at least the root of its
 * largest eigenvalue. */
static inline double root_norm(double xx, double yy, double zz, double xy, double xz, double yz) {
  return sqrt(sqrt(xx * xx + yy * yy + zz * zz + 2 * (xy * xy + xz * xz + yz * yz)));
}

static void view(const gather_seen *restrict seen, const double x[3], double cell_mm,
                 gather_views *restrict views) {
  const double qx = x[0], qy = x[1], qz = x[2], up = 1 + 0x1p-30, down = 1 - 0x1p-30;
  const double(*restrict at)[GATHER_LANES] = seen->field + AT;
  const double(*restrict c)[GATHER_LANES] = seen->field + SECOND;
  const double(*restrict f)[GATHER_LANES] = seen->field + FOURTH;
  for (size_t i = 0; i < GATHER_LANES; i++) {
    const double X = qx - at[0][i], Y = qy - at[1][i], Z = qz - at[2][i];
    const double square = X * X + Y * Y + Z * Z;
    const double distance = sqrt(square);
    const double least = (distance - cell_mm) * (1 - 0x1p-40);
    const double most = (distance + cell_mm) * (1 + 0x1p-40);
    const double radius = seen->field[RADIUS][i];
    const double cxx = c[0][i], cyy = c[1][i], czz = c[2][i];
    const double fxx = f[0][i], fyy = f[1][i], fzz = f[2][i];
    const double spread = cxx + cyy + czz, fourths = fxx + fyy + fzz;
    const double mean_least = sqrt(least * least + spread);
    /* Directions to queries differ from that to the cell's centre by a vector up to `turn`. */
    const double turn = cell_mm / distance;
    const double z2 = larger(fourths - spread * spread, 0) + fourths * 0x1p-40;
    const double z_most = larger(radius * radius - spread, spread);
    const double C = root_norm(cxx, cyy, czz, c[3][i], c[4][i], c[5][i]);
    const double F = root_norm(fxx, fyy, fzz, f[3][i], f[4][i], f[5][i]);
    const double xCx = cxx * (X * X) + cyy * (Y * Y) + czz * (Z * Z) +
                       2 * (c[3][i] * (X * Y) + c[4][i] * (X * Z) + c[5][i] * (Y * Z));
    const double xFx = fxx * (X * X) + fyy * (Y * Y) + fzz * (Z * Z) +
                       2 * (f[3][i] * (X * Y) + f[4][i] * (X * Z) + f[5][i] * (Y * Z));
    const double nF = sqrt(larger(xFx, 0) / square + F * F * 0x1p-40) + turn * F;
    const double nC = sqrt(larger(1 - turn * turn, 0) * (larger(xCx, 0) / square)) - turn * C;
    const double by_least = 1 / least;
    const double first = 2 * sqrt(nF) + sqrt(z_most * sqrt(z2)) * by_least;
    const double sigma = larger(2 * nC - sqrt(z2) * by_least, 0) * (least / mean_least);
    const double by_e = up * (6 * radius + z_most * by_least) * z2;
    views->nearest[i] = least - radius;
    views->ratio[i] =
        least > 0 ? up * (mean_least - least + radius) / mean_least : (double)INFINITY;
    views->least[i] = mean_least;
    views->most[i] = sqrt(most * most + spread) * (1 + 0x1p-40);
    views->fourth[i] = up * (first * first) * (first * first);
    views->second[i] = down * (sigma * sigma) * (sigma * sigma);
    views->rest[i] = by_e;
    views->twice[i] =
        up * 2 * (2 * radius + radius * radius * by_least) * by_e / (mean_least * mean_least);
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

typedef double loose_lanes
    __attribute__((vector_size(GATHER_LANES * sizeof(double)), may_alias, aligned(sizeof(double))));

/* Sets a to the larger of both, in each lane. */
static inline __attribute__((always_inline)) void raise_to(lanes *a, const lanes *b) {
  const lane_bits which = *a > *b;
  *a = (lanes)(((lane_bits)*a & which) | ((lane_bits)*b & ~which));
}

static double error(const gather_bounds *bounds, const gather_views *views, size_t node) {
  const double nearest = views->nearest[node];
  const double least = views->least[node], most = views->most[node];
  const double top = gather_top(bounds, nearest > 0 ? nearest : 0);
  const double spread = views->ratio[node] * GATHER_SPREADS_PER_ONE;
  if (!(spread < GATHER_SPREADS && least >= bounds->least_mm && most < bounds->most_mm)) {
    return top;
  }
  const gather_near *near = &bounds->near[(size_t)spread];
  const double fourth = views->fourth[node], second = views->second[node];
  const double less = larger(fourth - second, 0);
  const double rest = views->rest[node], twice = views->twice[node];
  const size_t first = gather_band(bounds, least), last = gather_band(bounds, most) + 1;
  /* Blocks may end behind the last edge: what is there only adds to the bound. */
  lanes most_of = {0};
  for (size_t i = first; i <= last; i += GATHER_LANES) {
    const lanes range = *(const loose_lanes *)(near->range + i);
    const lanes same = *(const loose_lanes *)(near->same + i);
    const lanes cubic = *(const loose_lanes *)(near->cubic + i);
    lanes other = same * less;
    const lanes twofold = (same + range) * twice;
    raise_to(&other, &twofold);
    const lanes sum = range * fourth + cubic * rest + other;
    raise_to(&most_of, &sum);
  }
  double each = 0;
  for (size_t k = 0; k < GATHER_LANES; k++) {
    each = larger(most_of[k], each);
  }
  return each < top ? each : top;
}

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

static double sum_pairs(size_t n, const double *power, const double *share, const double *R) {
  const lanes *powers = (const lanes *)power, *shares = (const lanes *)share,
              *firsts = (const lanes *)R, *seconds = (const lanes *)(R + n);
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
const gather_loops PASTE(gather_loops_, CORE_ISA) = {view,   error, pair, distances,
                                                     narrow, widen, sum,  sum_pairs};
