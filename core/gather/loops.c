/* Implements the innermost loops of gathering. core/gather/loops.h derives their formulas. */
#include "core/gather/loops.h"

#include <math.h>

#include "core/kernels.h"
#include "core/lut/piece.h"

#ifdef __AVX2__
#include <immintrin.h>
#endif

static inline double larger(double a, double b) {
  return a > b ? a : b;
}

static inline double smaller(double a, double b) {
  return a < b ? a : b;
}

/* Where the fields of gather_moments begin in a row: centroid, radius, second, fourth and third
 * moments. */
enum { AT, RADIUS = 3, SECOND, FOURTH = 10, THIRD = 16 };

typedef struct squares {
  double square; /* |D|^2 */
  double radius; /* a = largest |d|, mm */
  double mean;   /* E s */
  double second; /* E y^2, mm^4; at least 0 in spite of rounding */
  double third;  /* E y^3 without its remainder e, mm^6 */
} squares;

/* Returns the moments of s = |x - x_i|^2 for the query (qx, qy, qz) and one node. row: the node's
 * first field; the others follow at distances of GATHER_ROW. */
static inline __attribute__((always_inline)) squares squares_at(const double *row, double qx,
                                                                double qy, double qz) {
#define OF(field, i) row[((field) + (i)) * GATHER_ROW]
  const double third = 1.0 / 3;
  const double X = qx - OF(AT, 0), Y = qy - OF(AT, 1), Z = qz - OF(AT, 2);
  const double xx = X * X, yy = Y * Y, zz = Z * Z;
  const double cxx = OF(SECOND, 0), cyy = OF(SECOND, 1), czz = OF(SECOND, 2);
  const double trace_C = cxx + cyy + czz;
  const double along = cxx * xx + cyy * yy + czz * zz + OF(SECOND, 3) * (X * Y) +
                       OF(SECOND, 4) * (X * Z) + OF(SECOND, 5) * (Y * Z);
  const double cubic = X * (OF(THIRD, 0) * xx + OF(THIRD, 3) * (X * Y) + OF(THIRD, 4) * (X * Z) +
                            OF(THIRD, 5) * yy + OF(THIRD, 9) * (Y * Z)) +
                       Y * (OF(THIRD, 1) * yy + OF(THIRD, 6) * (Y * Z)) +
                       Z * (OF(THIRD, 2) * zz + OF(THIRD, 7) * (X * Z) + OF(THIRD, 8) * (Y * Z));
  /* D . E |d|^2 d. The rows hold third moments times their multiplicity, which is 3 for these. */
  const double trace = X * (OF(THIRD, 0) + (OF(THIRD, 5) + OF(THIRD, 7)) * third) +
                       Y * (OF(THIRD, 1) + (OF(THIRD, 3) + OF(THIRD, 8)) * third) +
                       Z * (OF(THIRD, 2) + (OF(THIRD, 4) + OF(THIRD, 6)) * third);
  const double fxx = OF(FOURTH, 0), fyy = OF(FOURTH, 1), fzz = OF(FOURTH, 2);
  const double raised_along = fxx * xx + fyy * yy + fzz * zz + OF(FOURTH, 3) * (X * Y) +
                              OF(FOURTH, 4) * (X * Z) + OF(FOURTH, 5) * (Y * Z);
  const double square = xx + yy + zz;
  return (squares){
      .square = square,
      .radius = OF(RADIUS, 0),
      .mean = square + trace_C,
      .second = larger(4 * along - 4 * trace + (fxx + fyy + fzz - trace_C * trace_C), 0),
      .third = 12 * (raised_along - trace_C * along) - 8 * cubic,
  };
#undef OF
}

static inline __attribute__((always_inline)) void pair_at(const double *row, double qx, double qy,
                                                          double qz, double *first, double *last,
                                                          double *share) {
  const squares s = squares_at(row, qx, qy, qz);
  const double distance = sqrt(s.square);
  const double least = larger(distance - s.radius, 0);
  const double most = distance + s.radius;
  const double least_square = least * least;
  const double below = larger(s.mean - least_square, 1e-300);
  const double above = larger(most * most - s.mean, 1e-300);
  const double variance = smaller(s.second, below * above);
  const double raw = variance > 0 ? s.third / variance : 0;
  const double skew = smaller(larger(raw, variance / below - below), above - variance / above);
  const double apart = sqrt(skew * skew + 4 * variance);
  const double up = 0.5 * (skew + apart);
  *first = sqrt(larger(s.mean + 0.5 * (skew - apart), least_square));
  *last = sqrt(s.mean + up);
  *share = apart > 0 ? up / apart : 0.5;
}

/* Computes the same as pair_at() without limiting the pair to possible distances. Returns a
 * negative number if a limit might apply; the caller then calls pair_at(). It saves three roots and
 * quotients, which take most of the time. */
static inline __attribute__((always_inline)) double free_pair_at(const double *row, double qx,
                                                                 double qy, double qz,
                                                                 double *first, double *last,
                                                                 double *share) {
  const squares s = squares_at(row, qx, qy, qz);
  const double variance = s.second;
  const double skew = variance > 0 ? s.third / variance : 0;
  const double apart = sqrt(skew * skew + 4 * variance);
  const double up = 0.5 * (skew + apart);
  const double first_square = s.mean + 0.5 * (skew - apart);
  *first = sqrt(first_square);
  *last = sqrt(s.mean + up);
  *share = apart > 0 ? up / apart : 0.5;
  /* The same limits, tightened by 1e-6 to allow for rounding. */
  const double rough = (double)sqrtf((float)s.square);
  const double least = larger(rough * (1 + 0x1p-20) - s.radius, 0);
  const double most = rough * (1 - 0x1p-20) + s.radius;
  const double below = (s.mean - least * least) * (1 - 0x1p-20);
  const double above = (most * most - s.mean) * (1 - 0x1p-20);
  /* smaller() drops a first argument that is NaN. If one is NaN, another one is negative. */
  double spare = smaller(s.square - 1e-30, first_square - least * least);
  spare = smaller((skew + below) * below - variance, spare);
  spare = smaller((above - skew) * above - variance, spare);
  spare = smaller(below * above - variance, spare);
  return smaller(below, smaller(above, spare));
}

static void pair(size_t n, const gather_rows *restrict rows, const double x[3], double *restrict r,
                 double *restrict share) {
  const double qx = x[0], qy = x[1], qz = x[2];
  for (size_t i = 0; i < n; i++) {
    pair_at(&rows->field[0][i], qx, qy, qz, &r[i], &r[n + i], &share[i]);
  }
}

/* Returns the square root of the Frobenius norm of a symmetric tensor. It is an upper bound of the
 * square root of the largest eigenvalue. */
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
    /* The largest change of the unit direction from the node to a query of the cell. */
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

/* A register holds WIDE of the lanes, and VECTORS of them all. Wider vectors would be compared lane by
 * lane. */
#if defined __AVX512F__
enum { WIDE = 8 };
#elif defined __AVX2__
enum { WIDE = 4 };
#else
enum { WIDE = 2 };
#endif
enum { VECTORS = GATHER_LANES / WIDE };

typedef double lanes __attribute__((vector_size(WIDE * sizeof(double)), may_alias));
typedef long long lane_bits __attribute__((vector_size(WIDE * sizeof(double)), may_alias));

typedef double loose_lanes
    __attribute__((vector_size(WIDE * sizeof(double)), may_alias, aligned(sizeof(double))));

/* Sets each lane of a to the larger of a and b. A lane of b that is NaN changes nothing. */
static inline __attribute__((always_inline)) void raise_to(lanes *a, const lanes *b) {
  const lane_bits which = *b > *a;
  *a = (lanes)(((lane_bits)*b & which) | ((lane_bits)*a & ~which));
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
  /* The last block may extend beyond the last edge. Its further values can only raise the bound. */
  lanes most_of[VECTORS] = {{0}};
  for (size_t i = first; i <= last; i += GATHER_LANES) {
    for (size_t k = 0; k < VECTORS; k++) {
      const lanes range = *(const loose_lanes *)(near->range + i + WIDE * k);
      const lanes same = *(const loose_lanes *)(near->same + i + WIDE * k);
      const lanes cubic = *(const loose_lanes *)(near->cubic + i + WIDE * k);
      lanes other = same * less;
      const lanes twofold = (same + range) * twice;
      raise_to(&other, &twofold);
      const lanes sum = range * fourth + cubic * rest + other;
      raise_to(&most_of[k], &sum);
    }
  }
  double each = 0;
  for (size_t i = 0; i < GATHER_LANES; i++) {
    each = larger(each, most_of[i / WIDE][i % WIDE]);
  }
  return each < top ? each : top;
}

static double total(const double sum[GATHER_LANES]) {
  return ((sum[0] + sum[4]) + (sum[2] + sum[6])) + ((sum[1] + sum[5]) + (sum[3] + sum[7]));
}

/* R may be infinite at r = 0. Products of points without power are masked, so that 0 * INFINITY
 * does not become NaN. */

static double sum(size_t n, const double *power, const double *R) {
  const lanes *powers = (const lanes *)power, *values = (const lanes *)R;
  lanes added[VECTORS] = {{0}};
  for (size_t i = 0; i < n / WIDE; i += VECTORS) {
    for (size_t k = 0; k < VECTORS; k++) {
      const lanes product = powers[i + k] * values[i + k];
      added[k] += (lanes)((lane_bits)product & (powers[i + k] > 0));
    }
  }
  return total((const double *)added);
}

static double sum_pairs(size_t n, const double *power, const double *share, const double *R) {
  const lanes *powers = (const lanes *)power, *shares = (const lanes *)share,
              *firsts = (const lanes *)R, *seconds = (const lanes *)(R + n);
  lanes added[VECTORS] = {{0}};
  for (size_t i = 0; i < n / WIDE; i += VECTORS) {
    for (size_t k = i; k < i + VECTORS; k++) {
      const lanes product = powers[k] * (shares[k] * firsts[k] + (1 - shares[k]) * seconds[k]);
      added[k - i] += (lanes)((lane_bits)product & (powers[k] > 0));
    }
  }
  return total((const double *)added);
}

/* ---- all queries of a cell ------------------------------------------------------------------- */

static void close_pairs(size_t count, const gather_rows *restrict rows, size_t from, size_t queries,
                        const double x[3][GATHER_QUERIES], float *restrict r,
                        double *restrict share) {
  for (size_t k = 0; k < count; k++) {
    const double *row = &rows->field[0][from + k];
    float *restrict firsts = &r[queries * 2 * k], *restrict lasts = firsts + queries;
    double *restrict shares = &share[queries * k];
    double first, last;
    long limited = 0;
    for (size_t q = 0; q < queries; q++) {
      limited |=
          free_pair_at(row, x[0][q], x[1][q], x[2][q], &first, &last, &shares[q]) >= 0 ? 0 : 1;
      firsts[q] = (float)first;
      lasts[q] = (float)last;
    }
    for (size_t q = 0; limited && q < queries; q++) {
      pair_at(row, x[0][q], x[1][q], x[2][q], &first, &last, &shares[q]);
      firsts[q] = (float)first;
      lasts[q] = (float)last;
    }
  }
}

static void close_distances(size_t count, const double *restrict px, const double *restrict py,
                            const double *restrict pz, size_t queries,
                            const double x[3][GATHER_QUERIES], float *restrict r) {
  for (size_t k = 0; k < count; k++) {
    for (size_t q = 0; q < queries; q++) {
      const double X = x[0][q] - px[k], Y = x[1][q] - py[k], Z = x[2][q] - pz[k];
      r[queries * k + q] = (float)sqrt(X * X + Y * Y + Z * Z);
    }
  }
}

static void add_close(size_t count, const double *restrict power, size_t queries,
                      const float *restrict R, double part[restrict][GATHER_QUERIES]) {
  for (size_t k = 0; k < count; k++) {
    const double P = power[k];
    for (size_t q = 0; P > 0 && q < queries; q++) {
      part[k][q] += P * (double)R[queries * k + q];
    }
  }
}

static void add_close_pairs(size_t count, const double *restrict power, size_t queries,
                            const double *restrict share, const float *restrict R,
                            double part[restrict][GATHER_QUERIES]) {
  for (size_t k = 0; k < count; k++) {
    const double P = power[k];
    for (size_t q = 0; P > 0 && q < queries; q++) {
      const double own = share[queries * k + q];
      part[k][q] += P * (own * (double)R[queries * 2 * k + q] +
                         (1 - own) * (double)R[queries * (2 * k + 1) + q]);
    }
  }
}

#ifdef __AVX2__
/* CLOSE radii fill a register. pick() returns words[i] for each index i, from 0 to CLOSE - 1, and
 * pick_of_two() the same for indices up to 2 CLOSE - 1. */
enum { CLOSE = 2 * WIDE };
typedef float reals __attribute__((vector_size(4 * CLOSE), may_alias));
typedef int32_t ints __attribute__((vector_size(4 * CLOSE), may_alias));
typedef uint32_t naturals __attribute__((vector_size(4 * CLOSE), may_alias));

#ifdef __AVX512F__
static inline ints pick(const float *words, ints index) {
  return (ints)_mm512_permutexvar_epi32((__m512i)index, _mm512_loadu_si512(words));
}

static inline reals pick_of_two(const float *words, ints index) {
  return (reals)_mm512_permutex2var_ps(_mm512_loadu_ps(words), (__m512i)index,
                                       _mm512_loadu_ps(words + CLOSE));
}

static inline bool has_any(ints words, int32_t bits) {
  return _mm512_test_epi32_mask((__m512i)words, _mm512_set1_epi32(bits)) != 0;
}
#else
static inline ints pick(const float *words, ints index) {
  return (ints)_mm256_permutevar8x32_ps(_mm256_loadu_ps(words), (__m256i)index);
}

static inline reals pick_of_two(const float *words, ints index) {
  const reals low = (reals)pick(words, index), high = (reals)pick(words + CLOSE, index);
  return (reals)_mm256_blendv_ps((__m256)low, (__m256)high, (__m256)(index << 28));
}

static inline bool has_any(ints words, int32_t bits) {
  return _mm256_testz_si256((__m256i)words, _mm256_set1_epi32(bits)) == 0;
}
#endif

/* Keeps the entries of the octaves and the pieces around the first radius in registers, and selects
 * each radius's own from there. */
static uint64_t look_up_close(const float *restrict table, const gather_pieces *pieces, size_t n,
                              const float *restrict in, float *restrict out) {
  uint64_t missed = 0;
  const float from = table[CORE_LUT_FIRST_MM], to = table[CORE_LUT_LAST_MM];
  const int32_t mantissa = (1 << CORE_LUT_MANTISSA_BITS) - 1, one = (int32_t)core_cells_bits(1);
  for (size_t i = 0; i < n; i += CLOSE) {
    const reals r = *(const reals *)(in + i);
    const ints bits = (ints)r;
    const int32_t octave =
        ((int32_t)core_cells_bits(in[i]) >> CORE_LUT_MANTISSA_BITS & 0xff) - CLOSE / 2;
    const ints place = (bits >> CORE_LUT_MANTISSA_BITS) - octave;
    const ints entry = pick(table + CORE_LUT_R_OCTAVES + octave, place);
    const ints shift = entry & 31;
    const ints piece = (ints)((naturals)entry >> 5) + ((bits & mantissa) >> shift);
    const int32_t first = piece[0] - CLOSE;
    const ints own = piece - first;
    /* place has to be less than CLOSE, and own less than twice that. */
    if (has_any((2 * place) | own | (r < from) | (r >= to), -2 * CLOSE)) {
      missed |= (uint64_t)1 << i / GATHER_CLOSE;
      continue;
    }
    /* t in [0, 1) has the bits of the mantissa that are below those of the piece. */
    const ints rest = bits << (CORE_LUT_MANTISSA_BITS - shift);
    const reals t = (reals)((rest & mantissa) | one) - 1;
    reals c[CORE_LUT_TERMS];
    for (size_t k = 0; k < CORE_LUT_TERMS; k++) {
      c[k] = pick_of_two(pieces->first + k * pieces->stride + first, own);
    }
    const ints back = (ints)c[0] < 0;
    const reals w = (reals)((back & (ints)(1 - t)) | (~back & (ints)t));
    const reals start = (reals)((ints)c[0] & 0x7fffffff);
    *(reals *)(out + i) = (start + w * (c[1] + w * (c[2] + w * c[3]))) * table[CORE_LUT_SCALE];
  }
  return missed;
}
#else
#define look_up_close NULL
#endif

/* The only symbol with external linkage, one for each instruction set. */
extern const gather_loops CORE_PASTE2(gather_loops_, CORE_ISA);
const gather_loops CORE_PASTE2(gather_loops_, CORE_ISA) = {
    view,      error, pair,        distances,       narrow,    widen,           sum,
    sum_pairs, total, close_pairs, close_distances, add_close, add_close_pairs, look_up_close};
