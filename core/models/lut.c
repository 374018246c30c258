/* The kernels of tables: R, cdf, 2 pi r R, pdf, and radii for given cdf, in single precision.
 *
 * core/lut/lut.h says what a table holds. Every number is looked up as if it were inside; where a
 * chunk has some that are not, they are then replaced by the asymptotics: so the usual case pays
 * nothing for them, and what a number becomes does not depend on its neighbours.
 *
 * Error: what core_lut_build() has measured.
 */
#ifdef CORE_ISA

#include "core/kernel.h"

#if CORE_REAL == 32

#include "core/lut/piece.h"

enum { CHUNK = 1024 };

/* log2(x) for normal x; 2 artanh(s) / ln 2 of the mantissa (1 + s) / (1 - s), s from 0 to 1/3, to 1e-8;
 * no fused products, like all of a table. */
static inline float lut_log2(float x) {
  const uint32_t bits = core_lut_bits(x);
  const float exponent = (float)((int32_t)(bits >> 23 & 0xff) - 127);
  const float m = core_lut_float((bits & 0x7fffff) | 0x3f800000);
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

/* log2(FIRST_MM / r) */
static inline float octaves_below(const float *c, float r) {
  return lut_log2(c[CORE_LUT_FIRST_MM]) - (lut_log2(r * 0x1p24f) - 24);
}

/* ---- outside: below the first radius, from the last one on ------------------------------------ */

/* R over SCALE, of a profile that is not steep. */
static inline float near_flat(const float *c, float r) {
  const float log = c[CORE_LUT_NEAR_LOG];
  const float rising = r > 0 ? octaves_below(c, r) : (float)INFINITY;
  return log > 0 ? c[CORE_LUT_NEAR_R] + log * rising : c[CORE_LUT_NEAR_R];
}

/* The factors in the order in which none overflows or underflows before the product does. */
static inline float near_R(const float *c, float r) {
  const float steep = r < 1 ? c[CORE_LUT_NEAR_R] * (c[CORE_LUT_SCALE] / r)
                            : c[CORE_LUT_NEAR_R] / r * c[CORE_LUT_SCALE];
  return c[CORE_LUT_NEAR_POWER] > 0 ? (c[CORE_LUT_LIMIT] > 0 ? steep : 0)
                                    : near_flat(c, r) * c[CORE_LUT_SCALE];
}

/* The factors in the order in which nothing underflows before the product does. */
static inline float times_radius(float piece, float r, float scale) {
  return scale > 1 ? piece * (r * scale) : piece * r * scale;
}

/* r R times what `scale` is over SCALE */
static inline float near_ring(const float *c, float r, float scale) {
  return c[CORE_LUT_NEAR_POWER] > 0 ? c[CORE_LUT_NEAR_R] * scale
         : r > 0                    ? times_radius(near_flat(c, r), r, scale)
                                    : 0;
}

/* The cdf over r^2, of a profile that is not steep. */
static inline float near_cdf_factor(const float *c, float r) {
  const float rising = r > 0 ? octaves_below(c, r) : 0;
  return c[CORE_LUT_NEAR_CDF] + c[CORE_LUT_NEAR_CDF_LOG] * rising;
}

static inline float near_cdf(const float *c, float r) {
  return c[CORE_LUT_NEAR_POWER] > 0 ? c[CORE_LUT_NEAR_CDF] * r : near_cdf_factor(c, r) * r * r;
}

/* R over SCALE, and r R over it */
static inline float far_R(const float *c, float r) {
  const float ratio = c[CORE_LUT_LAST_MM] / r;
  return c[CORE_LUT_FAR] * ratio * ratio * ratio;
}

static inline float far_ring(const float *c, float r) {
  const float ratio = c[CORE_LUT_LAST_MM] / r;
  return c[CORE_LUT_FAR] * c[CORE_LUT_LAST_MM] * ratio * ratio;
}

/* ---- the functions, inside and outside -------------------------------------------------------- */

static inline float look_R(const float *c, float r) {
  return core_lut_look(c, CORE_LUT_R_OCTAVES, r);
}

static inline float inside_R(const float *c, float r) {
  return look_R(c, r) * c[CORE_LUT_SCALE];
}

static inline float outside_R(const float *c, float r) {
  return r < c[CORE_LUT_FIRST_MM] ? near_R(c, r) : far_R(c, r) * c[CORE_LUT_SCALE];
}

static inline float inside_ring(const float *c, float r) {
  return times_radius(look_R(c, r), r, c[CORE_LUT_RING_SCALE]);
}

static inline float outside_ring(const float *c, float r) {
  return r < c[CORE_LUT_FIRST_MM] ? near_ring(c, r, c[CORE_LUT_RING_SCALE])
                                  : far_ring(c, r) * c[CORE_LUT_RING_SCALE];
}

static inline float inside_pdf(const float *c, float r) {
  return times_radius(look_R(c, r), r, c[CORE_LUT_PDF_SCALE]);
}

static inline float outside_pdf(const float *c, float r) {
  return r < c[CORE_LUT_FIRST_MM] ? near_ring(c, r, c[CORE_LUT_PDF_SCALE])
                                  : far_ring(c, r) * c[CORE_LUT_PDF_SCALE];
}

static inline float inside_cdf(const float *c, float r) {
  return real_min(core_lut_look(c, CORE_LUT_CDF_OCTAVES, r), 1);
}

static inline float outside_cdf(const float *c, float r) {
  return r < c[CORE_LUT_FIRST_MM] ? near_cdf(c, r) : c[CORE_LUT_LIMIT];
}

/* Both halves are looked up by what is next to their end: u, or 1 - u, which is exact. What is no
 * cdf at all must not be looked up beyond their octaves. */
static inline float inside_radius(const float *c, float u) {
  const float near = u <= 0.5f ? u : 1 - u;
  const int32_t octaves = u <= 0.5f ? CORE_LUT_RADIUS_OCTAVES : CORE_LUT_COMPLEMENT_OCTAVES;
  return core_lut_look(c, octaves, near > 0 ? near : 0);
}

/* Where the cdf is factor r^2 and the factor depends on ln r, which hardly moves it: each round
 * brings the radius nearer by more than a factor of 30. */
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

/* LUT_KERNEL(name, function, least, most): function(c, x) for all x, inside from least to below
 * most. Adding 0 makes 0 of -0. */
#define LUT_KERNEL(name, function, least, most)                                                    \
  static unsigned name##_inside(const float *restrict c, size_t n, const float *restrict in,       \
                                float *restrict out) {                                             \
    const float from = (least);                                                                    \
    const float to = (most);                                                                       \
    unsigned outside = 0;                                                                          \
    for (size_t i = 0; i < n; i++) {                                                               \
      const float x = in[i] + 0;                                                                   \
      out[i] = inside_##function(c, x);                                                            \
      outside |= x < from ? 1 : 0;                                                                 \
      outside |= x >= to ? 1 : 0;                                                                  \
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

LUT_KERNEL(lut_R, R, c[CORE_LUT_FIRST_MM], c[CORE_LUT_LAST_MM])
LUT_KERNEL(lut_ring, ring, c[CORE_LUT_FIRST_MM], c[CORE_LUT_LAST_MM])
LUT_KERNEL(lut_pdf, pdf, c[CORE_LUT_FIRST_MM], c[CORE_LUT_LAST_MM])
LUT_KERNEL(lut_cdf, cdf, c[CORE_LUT_FIRST_MM], c[CORE_LUT_LAST_MM])
LUT_KERNEL(lut_radius, radius, c[CORE_LUT_FIRST_U], 1)

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
