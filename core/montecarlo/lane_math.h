/* lane_math: random numbers and elementary functions for photons that are walked in lanes.
 *
 * The functions work on one element and have no branches, so that compilers vectorize the loops
 * around them. They use only additions, multiplications, divisions and square roots, so that every
 * instruction set gives the same bits. They do not use fused multiply-adds: instruction sets
 * without them would have to call the C library in the walk's inner loop, and a random walk gains
 * nothing from the last half ulp.
 */
#ifndef DIPOLED_CORE_MONTECARLO_LANE_MATH_H
#define DIPOLED_CORE_MONTECARLO_LANE_MATH_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#ifdef __SSE2__
#include <immintrin.h>
#endif

static inline uint32_t lane_bits(float x) {
  uint32_t bits;
  memcpy(&bits, &x, sizeof bits);
  return bits;
}

static inline float lane_float(uint32_t bits) {
  float x;
  memcpy(&x, &bits, sizeof x);
  return x;
}

/* A mask has all bits set where a condition holds and no bit set elsewhere. Masks replace truth
 * values, because compilers vectorize masks in every case. */
typedef uint32_t lane_mask;

static inline lane_mask lane_mask_if(int condition) {
  return condition ? ~UINT32_C(0) : 0;
}

static inline uint32_t lane_choose(lane_mask mask, uint32_t yes, uint32_t no) {
  return (mask & yes) | (~mask & no);
}

static inline float lane_select(lane_mask mask, float yes, float no) {
  return lane_float(lane_choose(mask, lane_bits(yes), lane_bits(no)));
}

/* ---- random numbers -------------------------------------------------------------------------- */

/* Words of 32 bits in the lower halves of 64 bits each: as many as a register holds. What stands in the
 * upper halves has no meaning. lane_products() returns their products with b. */
#if defined __AVX512F__
typedef uint64_t lane_words __attribute__((vector_size(64)));
static inline lane_words lane_products(lane_words a, uint32_t b) {
  return (lane_words)_mm512_mul_epu32((__m512i)a, _mm512_set1_epi64(b));
}
#elif defined __AVX2__
typedef uint64_t lane_words __attribute__((vector_size(32)));
static inline lane_words lane_products(lane_words a, uint32_t b) {
  return (lane_words)_mm256_mul_epu32((__m256i)a, _mm256_set1_epi64x(b));
}
#elif defined __SSE2__
typedef uint64_t lane_words __attribute__((vector_size(16)));
static inline lane_words lane_products(lane_words a, uint32_t b) {
  return (lane_words)_mm_mul_epu32((__m128i)a, _mm_set1_epi64x(b));
}
#else
typedef uint64_t lane_words;
static inline lane_words lane_products(lane_words a, uint32_t b) {
  return (uint64_t)(uint32_t)a * b;
}
#endif

typedef struct lane_random {
  lane_words word[4];
} lane_random;

/* Philox4x32-10: J. Salmon, M. Moraes, R. Dror, D. Shaw, "Parallel Random Numbers: As Easy as 1, 2,
 * 3", 2011. For each key it is a bijection of the counter, so a photon's random numbers depend only
 * on its own counter. */
static inline lane_random lane_philox(lane_random counter, const uint32_t key[2]) {
  lane_words c0 = counter.word[0];
  lane_words c1 = counter.word[1];
  lane_words c2 = counter.word[2];
  lane_words c3 = counter.word[3];
  uint32_t k0 = key[0];
  uint32_t k1 = key[1];
  for (int round = 0; round < 10; round++) {
    const lane_words product0 = lane_products(c0, UINT32_C(0xd2511f53));
    const lane_words product1 = lane_products(c2, UINT32_C(0xcd9e8d57));
    c0 = product1 >> 32 ^ c1 ^ k0;
    c1 = product1;
    c2 = product0 >> 32 ^ c3 ^ k1;
    c3 = product0;
    k0 += UINT32_C(0x9e3779b9);
    k1 += UINT32_C(0xbb67ae85);
  }
  return (lane_random){{c0, c1, c2, c3}};
}

/* A number v from (0, 1) and w = 1 - v, each to the relative precision of float. v is one of the
 * 2^31 equally likely points (i + 1/2) / 2^31. */
typedef struct lane_uniform {
  float v;
  float w;
} lane_uniform;

/* Returns the uniform number that is point i of `count` equally likely points; inverse: 1 /
 * count. */
static inline lane_uniform lane_uniform_within(uint32_t i, uint32_t count, float inverse) {
  const int32_t complement = (int32_t)(count - 1 - i);
  return (lane_uniform){((float)(int32_t)i + 0.5f) * inverse, ((float)complement + 0.5f) * inverse};
}

static inline lane_uniform lane_uniform_from(uint32_t bits) {
  return lane_uniform_within(bits >> 1, UINT32_C(1) << 31, 0x1p-31f);
}

/* ---- functions ------------------------------------------------------------------------------- */

/* Returns -ln(w) for w from 2^-100 to 1. The caller also passes v = 1 - w, so that small results
 * keep their digits. With w = 2^k (1 + f), ln(1 + f) = 2 artanh(f / (2 + f)). The relative error is
 * 2.5e-7. */
static inline float lane_minus_log(float v, float w) {
  const uint32_t one = UINT32_C(0x3f800000);
  const uint32_t sqrt_half = UINT32_C(0x3f3504f3);
  const uint32_t bits = lane_bits(w);
  const uint32_t biased = (bits + (one - sqrt_half)) >> 23;
  const float mantissa = lane_float(bits - (biased << 23) + one);
  const float k = (float)((int32_t)biased - 127);
  const float f = lane_select(lane_mask_if(k == 0.0f), -v, mantissa - 1.0f);
  const float s = f / (2.0f + f);
  const float t = s * s;
  float series = 1.0f / 9;
  series = series * t + 1.0f / 7;
  series = series * t + 1.0f / 5;
  series = series * t + 1.0f / 3;
  return -(k * 0x1.62e430p-1f + (2.0f * s + 2.0f * s * t * series));
}

/* Returns the cube root of x from -1 to 1. Two steps of Halley's method follow a guess that divides
 * the exponent by three. The relative error is 2.5e-7 for |x| from 2^-100 on; below, the result is
 * at most 2e-10. */
static inline float lane_cube_root(float x) {
  const uint32_t sign = lane_bits(x) & UINT32_C(0x80000000);
  const float size = lane_float(lane_bits(x) ^ sign);
  float y = lane_float(lane_bits(size) / 3 + UINT32_C(0x2a512400));
  for (int step = 0; step < 2; step++) {
    const float cube = y * y * y;
    y = y * ((cube + 2.0f * size) / (2.0f * cube + size));
  }
  return lane_float(lane_bits(y) | sign);
}

/* Cosine and sine of a random angle from 0 to 2 pi. 23 bits give an angle in an eighth of the
 * circle, where polynomials interpolate both functions at Chebyshev points (error: 1.5e-7). Three
 * more bits say which eighth it is. */
typedef struct lane_direction {
  float cosine;
  float sine;
} lane_direction;

static inline lane_direction lane_azimuth(uint32_t bits) {
  const float share = ((float)(int32_t)(bits >> 9) + 0.5f) * 0x1p-23f;
  const float t = share * 0x1.921fb6p-1f;
  const float x = t * t;
  const float sine =
      t * (1.0f + x * (-0x1.55554p-3f + x * (0x1.11062ep-7f + x * -0x1.9906cap-13f)));
  const float cosine = 1.0f + x * (-0x1.ffffap-2f + x * (0x1.553ce6p-5f + x * -0x1.6424ap-10f));
  const lane_mask swapped = -((bits >> 2) & 1);
  const float first = lane_select(swapped, sine, cosine);
  const float second = lane_select(swapped, cosine, sine);
  return (lane_direction){
      .cosine = lane_float(lane_bits(first) ^ ((bits & 1) << 31)),
      .sine = lane_float(lane_bits(second) ^ ((bits & 2) << 30)),
  };
}

#endif
