/* The kernels of tables, in single precision: R, cdf, 2 pi r R, pdf, and the radius for a given
 * cdf.
 *
 * core/lut/lut.h describes a table. A kernel first looks up every argument as if it lay inside of
 * the table. If a chunk has arguments outside, the kernel then replaces their values by the
 * asymptotics. So chunks without such arguments pay nothing, and a value does not depend on its
 * neighbours.
 *
 * Error: the error that core_lut_build() has measured.
 */
#ifdef CORE_ISA

#include "core/kernel.h"

#if CORE_REAL == 32

#include "core/cells/find.h"
#include "core/lut/piece.h"

enum { CHUNK = 1024, BLOCK = 64 };

/* Returns log2(x) for a normal x, to 1e-8. With the mantissa (1 + s) / (1 - s), s from 0 to 1/3,
 * the logarithm of the mantissa is 2 artanh(s) / ln 2. No products are fused, as everywhere in the
 * kernels of tables. */
static inline float lut_log2(float x) {
  const uint32_t bits = core_cells_bits(x);
  const float exponent = (float)((int32_t)(bits >> 23 & 0xff) - 127);
  const float m = core_cells_float((bits & 0x7fffff) | 0x3f800000);
  const float s = (m - 1) / (m + 1);
  const float t = s * s;
  float series = 1.0f / 13;
  series = series * t + 1.0f / 11;
  series = series * t + 1.0f / 9;
  series = series * t + 1.0f / 7;
  series = series * t + 1.0f / 5;
  series = series * t + 1.0f / 3;
  return exponent + 2.88539008f * (s + s * t * series);
}

/* Returns log2(FIRST_MM / r). */
static inline float octaves_below(const float *c, float r) {
  return lut_log2(c[CORE_LUT_FIRST_MM]) - (lut_log2(r * 0x1p24f) - 24);
}

/* ---- outside: below the first radius, from the last one on ---------------------------------- */

/* Returns R / SCALE below the first radius, for a profile that does not rise like 1 / r. */
static inline float near_flat(const float *c, float r) {
  const float log = c[CORE_LUT_NEAR_LOG];
  const float rising = r > 0 ? octaves_below(c, r) : (float)INFINITY;
  return log > 0 ? c[CORE_LUT_NEAR_R] + log * rising : c[CORE_LUT_NEAR_R];
}

/* Returns R below the first radius. The factors are multiplied in an order in which no intermediate
 * product overflows or underflows before the result does. */
static inline float near_R(const float *c, float r) {
  const float steep = r < 1 ? c[CORE_LUT_NEAR_R] * (c[CORE_LUT_SCALE] / r)
                            : c[CORE_LUT_NEAR_R] / r * c[CORE_LUT_SCALE];
  return c[CORE_LUT_NEAR_POWER] > 0 ? (c[CORE_LUT_LIMIT] > 0 ? steep : 0)
                                    : near_flat(c, r) * c[CORE_LUT_SCALE];
}

/* Returns piece r scale, multiplied in an order in which no intermediate product underflows before
 * the result does. */
static inline float times_radius(float piece, float r, float scale) {
  return scale > 1 ? piece * (r * scale) : piece * r * scale;
}

/* Returns r R scale / SCALE below the first radius. */
static inline float near_ring(const float *c, float r, float scale) {
  return c[CORE_LUT_NEAR_POWER] > 0 ? c[CORE_LUT_NEAR_R] * scale
         : r > 0                    ? times_radius(near_flat(c, r), r, scale)
                                    : 0;
}

/* Returns cdf / r^2 below the first radius, for a profile that does not rise like 1 / r. */
static inline float near_cdf_factor(const float *c, float r) {
  const float rising = r > 0 ? octaves_below(c, r) : 0;
  return c[CORE_LUT_NEAR_CDF] + c[CORE_LUT_NEAR_CDF_LOG] * rising;
}

static inline float near_cdf(const float *c, float r) {
  return c[CORE_LUT_NEAR_POWER] > 0 ? c[CORE_LUT_NEAR_CDF] * r : near_cdf_factor(c, r) * r * r;
}

/* far_R() returns R / SCALE from the last radius on, and far_ring() returns r R / SCALE there. */
static inline float far_R(const float *c, float r) {
  const float ratio = c[CORE_LUT_LAST_MM] / r;
  return c[CORE_LUT_FAR] * ratio * ratio * ratio;
}

static inline float far_ring(const float *c, float r) {
  const float ratio = c[CORE_LUT_LAST_MM] / r;
  return c[CORE_LUT_FAR] * c[CORE_LUT_LAST_MM] * ratio * ratio;
}

/* ---- looking up ------------------------------------------------------------------------------ */

/* Which pieces an argument is looked up in: those whose entries begin at word `octaves`. */
struct lut_key {
  int32_t octaves;
  float x;
};

static inline struct lut_key key_R(float r) {
  return (struct lut_key){CORE_LUT_R_OCTAVES, r};
}

static inline struct lut_key key_cdf(float r) {
  return (struct lut_key){CORE_LUT_CDF_OCTAVES, r};
}

/* The radius for the cdf u is looked up by u up to 1/2, and by 1 - u, which is exact, beyond. A u
 * outside of 0 to 1 or NaN is looked up as 0 or 1, so that no index leaves the table. */
static inline struct lut_key key_radius(float u) {
  const float near = u <= 0.5f ? u : 1 - u;
  const int32_t octaves = u <= 0.5f ? CORE_LUT_RADIUS_OCTAVES : CORE_LUT_COMPLEMENT_OCTAVES;
  return (struct lut_key){octaves, near > 0 ? near : 0};
}

/* Sets values to the pieces at up to BLOCK arguments. Entries and pieces are copied in loops of
 * their own, one after the other: gathering them into vectors takes twice as long. */
static inline __attribute__((always_inline)) void look_up(const float *restrict c,
                                                          struct lut_key (*key_of)(float), size_t n,
                                                          const float *restrict in,
                                                          float *restrict values) {
  _Alignas(64) int32_t entry[BLOCK], at[BLOCK];
  _Alignas(64) float t[BLOCK], piece[BLOCK][CORE_LUT_TERMS];
  for (size_t i = 0; i < n; i++) {
    const struct lut_key key = key_of(in[i] + 0);
    const int32_t octave = (int32_t)core_cells_bits(key.x) >> CORE_LUT_MANTISSA_BITS & 0xff;
    entry[i] = (int32_t)core_cells_bits(c[key.octaves + octave]);
  }
  for (size_t i = 0; i < n; i++) {
    const int32_t bits = (int32_t)core_cells_bits(key_of(in[i] + 0).x);
    const struct cells_place place = cells_in_octave(bits, CORE_LUT_ENTRY_SHIFT(entry[i]));
    at[i] = CORE_LUT_PIECES + CORE_LUT_TERMS * (CORE_LUT_ENTRY_PIECE(entry[i]) + place.cell);
    t[i] = place.t;
  }
  for (size_t i = 0; i < n; i++) {
    memcpy(piece[i], c + at[i], sizeof piece[i]);
  }
  for (size_t i = 0; i < n; i++) {
    values[i] = core_lut_piece(piece[i], t[i]);
  }
}

/* ---- the functions, inside and outside ------------------------------------------------------ */

/* inside_<function>() makes a value from that of the piece. */
static inline float inside_R(const float *c, float r, float piece) {
  (void)r;
  return piece * c[CORE_LUT_SCALE];
}

static inline float outside_R(const float *c, float r) {
  return r < c[CORE_LUT_FIRST_MM] ? near_R(c, r) : far_R(c, r) * c[CORE_LUT_SCALE];
}

static inline float inside_ring(const float *c, float r, float piece) {
  return times_radius(piece, r, c[CORE_LUT_RING_SCALE]);
}

static inline float outside_ring(const float *c, float r) {
  return r < c[CORE_LUT_FIRST_MM] ? near_ring(c, r, c[CORE_LUT_RING_SCALE])
                                  : far_ring(c, r) * c[CORE_LUT_RING_SCALE];
}

static inline float inside_pdf(const float *c, float r, float piece) {
  return times_radius(piece, r, c[CORE_LUT_PDF_SCALE]);
}

static inline float outside_pdf(const float *c, float r) {
  return r < c[CORE_LUT_FIRST_MM] ? near_ring(c, r, c[CORE_LUT_PDF_SCALE])
                                  : far_ring(c, r) * c[CORE_LUT_PDF_SCALE];
}

static inline float inside_cdf(const float *c, float r, float piece) {
  (void)c;
  (void)r;
  return real_min(piece, 1);
}

static inline float outside_cdf(const float *c, float r) {
  return r < c[CORE_LUT_FIRST_MM] ? near_cdf(c, r) : c[CORE_LUT_LIMIT];
}

static inline float inside_radius(const float *c, float u, float piece) {
  (void)c;
  (void)u;
  return piece;
}

/* Solves cdf = u for the radius where cdf = factor r^2. The factor depends on ln r and varies
 * little with r: each round divides the error of the radius by more than 30. */
static inline float near_radius(const float *c, float u) {
  const float root = real_sqrt(u);
  float r = c[CORE_LUT_NEAR_RADIUS] * root;
  for (int round = 0; round < 4; round++) {
    r = root / real_sqrt(near_cdf_factor(c, r));
  }
  return r;
}

static inline float outside_radius(const float *c, float u) {
  const float near = c[CORE_LUT_NEAR_POWER] > 0 ? c[CORE_LUT_NEAR_RADIUS] * u : near_radius(c, u);
  return u < 1 ? near : c[CORE_LUT_LIMIT] > 0 ? (float)INFINITY : 0;
}

/* LUT_KERNEL(name, function, key, least, most) defines a kernel as in core/kernels.h. It looks
 * key_<key>(x) up and uses inside_<function>() for x from least to below most, and
 * outside_<function>(c, x) for other x. Adding 0 turns -0 into 0. */
#define LUT_KERNEL(name, function, key, least, most)                                               \
  static unsigned name##_inside(const float *restrict c, size_t n, const float *restrict in,       \
                                float *restrict out) {                                             \
    const float from = (least);                                                                    \
    const float to = (most);                                                                       \
    unsigned outside = 0;                                                                          \
    _Alignas(64) float piece[BLOCK];                                                               \
    for (size_t done = 0; done < n; done += BLOCK) {                                               \
      const size_t count = CORE_WHOLE(n - done < BLOCK ? n - done : BLOCK);                        \
      if (count == BLOCK) {                                                                        \
        look_up(c, key_##key, BLOCK, in + done, piece);                                            \
      } else {                                                                                     \
        look_up(c, key_##key, count, in + done, piece);                                            \
      }                                                                                            \
      for (size_t i = 0; i < count; i++) {                                                         \
        const float x = in[done + i] + 0;                                                          \
        out[done + i] = inside_##function(c, x, piece[i]);                                         \
        outside |= x < from ? 1 : 0;                                                               \
        outside |= x >= to ? 1 : 0;                                                                \
      }                                                                                            \
    }                                                                                              \
    return outside;                                                                                \
  }                                                                                                \
  static void name(const float *restrict c, size_t n, const float *restrict in,                    \
                   float *restrict out) {                                                          \
    for (size_t done = 0; done < n; done += CHUNK) {                                               \
      const size_t end = n - done < CHUNK ? n : done + CHUNK;                                      \
      const unsigned outside = name##_inside(c, end - done, in + done, out + done);                \
      for (size_t i = done; outside && i < end; i++) {                                             \
        const float x = in[i] + 0;                                                                 \
        out[i] = x < (least) || x >= (most) ? outside_##function(c, x) : out[i];                   \
      }                                                                                            \
    }                                                                                              \
  }

LUT_KERNEL(lut_R, R, R, c[CORE_LUT_FIRST_MM], c[CORE_LUT_LAST_MM])
LUT_KERNEL(lut_ring, ring, R, c[CORE_LUT_FIRST_MM], c[CORE_LUT_LAST_MM])
LUT_KERNEL(lut_pdf, pdf, R, c[CORE_LUT_FIRST_MM], c[CORE_LUT_LAST_MM])
LUT_KERNEL(lut_cdf, cdf, cdf, c[CORE_LUT_FIRST_MM], c[CORE_LUT_LAST_MM])
LUT_KERNEL(lut_radius, radius, radius, c[CORE_LUT_FIRST_U], 1)

CORE_KERNEL_TABLE(lut,
                  .evaluate =
                      {
                          [CORE_ELEMENTWISE_R] = lut_R,
                          [CORE_ELEMENTWISE_CDF] = lut_cdf,
                          [CORE_ELEMENTWISE_PDF] = lut_pdf,
                          [CORE_ELEMENTWISE_RING] = lut_ring,
                      },
                  .sample = lut_radius);

#else
CORE_KERNEL_TABLE(lut, .sample = NULL);
#endif

#endif
