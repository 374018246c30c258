/* Tables in memory: invalid tables are refused, and the kernels follow the description in
 * core/lut/lut.h bit for bit. tests/fuzz/client.c evaluates whatever passes. */
#include <math.h>

#include "core/lut/lut.h"
#include "tests/unit/unit.h"

static const enum core_quantity held[] = {CORE_QUANTITY_R, CORE_QUANTITY_CDF, CORE_QUANTITY_PDF,
                                          CORE_QUANTITY_RING};
enum { HELD = sizeof held / sizeof held[0] };

static const core_medium skin = {0.032, 0.74, 0, 1.3};
static const core_medium no_absorption = {0, 1, 0, 1.3};
static const core_medium dense = {1e10, 1e12, 0, 1.3};
static const core_medium nothing_scatters = {0.3, 0, 0, 1.3};

/* Profiles that are steep, rising or flat towards the source, some up to a largest radius. */
static const struct subject {
  unsigned model;
  const core_medium *medium;
} subjects[] = {
    {CORE_MODEL_BETTER, &skin},
    {CORE_MODEL_BETTER, &no_absorption},
    {CORE_MODEL_BETTER, &dense},
    {CORE_MODEL_BURLEY, &skin},
    {CORE_MODEL_BEAM, &skin},
    {CORE_MODEL_SKIN_RED, &skin},
    {CORE_MODEL_SINGLE, &no_absorption},
    {CORE_MODEL_BETTER, &nothing_scatters},
};
enum { SUBJECTS = sizeof subjects / sizeof subjects[0] };

static core_profile prepared(const struct subject *subject, double tolerance) {
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = tolerance;
  core_profile profile;
  unit_accept(core_profile_prepare(&profile, core_isa_select(NULL), subject->model,
                                   CORE_MOMENTS_EXACT, CORE_EVALUATOR_LUT, subject->medium,
                                   &parameters));
  return profile;
}

/* ---- the description, as a plain loop ------------------------------------------------------ */

static uint32_t bits_of(float x) {
  uint32_t bits;
  memcpy(&bits, &x, sizeof bits);
  return bits;
}

static float plain_piece(const float *words, size_t octaves, float x) {
  const uint32_t bits = bits_of(x);
  const uint32_t entry = bits_of(words[octaves + (bits >> 23 & 255)]);
  const uint32_t shift = entry % 32;
  const uint32_t mantissa = bits % (1u << 23);
  const uint32_t piece = entry / 32 + mantissa / (1u << shift);
  const float *c = &words[CORE_LUT_PIECES + CORE_LUT_TERMS * piece];
  const float t = (float)ldexp(mantissa % (1u << shift), -(int)shift);
  const float w = signbit(c[0]) ? 1 - t : t;
  return fabsf(c[0]) + w * (c[1] + w * (c[2] + w * c[3]));
}

static float plain_scaled(float piece, float r, float scale) {
  return scale > 1 ? piece * (r * scale) : piece * r * scale;
}

static float plain_value(const float *words, enum core_quantity quantity, float r) {
  const float R = plain_piece(words, CORE_LUT_R_OCTAVES, r);
  return quantity == CORE_QUANTITY_R      ? R * words[CORE_LUT_SCALE]
         : quantity == CORE_QUANTITY_PDF  ? plain_scaled(R, r, words[CORE_LUT_PDF_SCALE])
         : quantity == CORE_QUANTITY_RING ? plain_scaled(R, r, words[CORE_LUT_RING_SCALE])
                                          : fminf(plain_piece(words, CORE_LUT_CDF_OCTAVES, r), 1);
}

static float plain_radius(const float *words, float u) {
  return u <= 0.5f ? plain_piece(words, CORE_LUT_RADIUS_OCTAVES, u)
                   : plain_piece(words, CORE_LUT_COMPLEMENT_OCTAVES, 1 - u);
}

/* Returns a random argument within the octaves of a table, where no asymptotic formula is used. */
static float random_argument(uint64_t *random, float from, float to) {
  const uint32_t first = bits_of(from);
  const uint32_t bits = first + (uint32_t)unit_random_below(random, bits_of(to) - first);
  float x;
  memcpy(&x, &bits, sizeof x);
  return x;
}

enum { ARGUMENTS = 20000 };

static void assert_plain_bits(const core_profile *profile, uint64_t *random) {
  static float in[ARGUMENTS], out[ARGUMENTS];
  const float *words = profile->lut;
  for (size_t i = 0; i < ARGUMENTS; i++) {
    in[i] = random_argument(random, words[CORE_LUT_FIRST_MM], words[CORE_LUT_LAST_MM]);
  }
  for (size_t q = 0; q < HELD; q++) {
    core_eval_f32(profile, held[q], ARGUMENTS, in, out);
    for (size_t i = 0; i < ARGUMENTS; i++) {
      assert_int_equal(bits_of(out[i]), bits_of(plain_value(words, held[q], in[i])));
    }
  }
  for (size_t i = 0; i < ARGUMENTS; i++) {
    in[i] = i % 2 ? random_argument(random, words[CORE_LUT_FIRST_U], 1)
                  : random_argument(random, 0.25f, 1);
  }
  core_sample_f32(profile, ARGUMENTS, in, out);
  for (size_t i = 0; i < ARGUMENTS; i++) {
    assert_int_equal(bits_of(out[i]), bits_of(plain_radius(words, in[i])));
  }
}

UNIT_TEST(the_description_gives_the_kernels_bits) {
  uint64_t random = unit_seed();
  for (size_t i = 0; i < SUBJECTS; i++) {
    if (subjects[i].medium == &nothing_scatters) {
      continue;
    }
    core_profile profile = prepared(&subjects[i], i % 2 ? 1e-3 : 1e-5);
    assert_plain_bits(&profile, &random);
    core_profile_free(&profile);
  }
}

/* ---- damage --------------------------------------------------------------------------------- */

static float *copy_of(const float *words, size_t count) {
  float *copy = malloc(count * sizeof *copy);
  assert_non_null(copy);
  memcpy(copy, words, count * sizeof *copy);
  return copy;
}

static void put_entry(float *words, size_t at, uint32_t entry) {
  memcpy(&words[at], &entry, sizeof entry);
}

static void assert_count_refused(size_t count) {
  float *words = calloc(count > 0 ? count : 1, sizeof *words);
  assert_non_null(words);
  for (size_t i = CORE_LUT_R_OCTAVES; i < CORE_LUT_PIECES && i < count; i++) {
    put_entry(words, i, CORE_LUT_ENTRY(0, CORE_LUT_MANTISSA_BITS));
  }
  unit_assert_fault(core_lut_check(words, count), "table", 0);
  free(words);
}

UNIT_TEST(wrong_counts_are_refused) {
  const size_t none = CORE_LUT_PIECES + CORE_LUT_SAMPLE_WORDS;
  const size_t counts[] = {0,
                           1,
                           4,
                           CORE_LUT_R_OCTAVES,
                           CORE_LUT_PIECES - 4,
                           CORE_LUT_PIECES,
                           CORE_LUT_PIECES + 4,
                           none - 4,
                           none,
                           none + 1,
                           none + 5,
                           none + 6,
                           none + 7,
                           CORE_LUT_WORDS_MAX + 1,
                           CORE_LUT_WORDS_MAX + 4};
  for (size_t i = 0; i < sizeof counts / sizeof counts[0]; i++) {
    assert_count_refused(counts[i]);
  }
  unit_assert_fault(core_lut_check(NULL, SIZE_MAX), "table", 0);
  unit_assert_fault(core_lut_check(NULL, SIZE_MAX - 3), "table", 0);
}

UNIT_TEST(whole_tables_are_not_refused) {
  for (size_t i = 0; i < SUBJECTS; i++) {
    core_profile profile = prepared(&subjects[i], 1e-3);
    unit_accept(core_lut_check(profile.lut, profile.lut_count));
    core_profile_free(&profile);
  }
}

/* Each entry in turn gets every shift that points outside. */
UNIT_TEST(entries_that_point_outside_are_refused) {
  core_profile profile = prepared(&subjects[0], 1e-3);
  const size_t count = profile.lut_count;
  const uint32_t pieces =
      (uint32_t)((count - CORE_LUT_PIECES - CORE_LUT_SAMPLE_WORDS) / CORE_LUT_TERMS);
  float *words = copy_of(profile.lut, count);
  for (size_t at = CORE_LUT_R_OCTAVES; at < CORE_LUT_PIECES; at++) {
    for (uint32_t shift = 0; shift < 32; shift++) {
      const bool possible = shift <= 23 && shift >= 23 - CORE_LUT_CUTS_MAX;
      const uint32_t cuts = possible ? UINT32_C(1) << (23 - shift) : 1;
      const uint32_t last = pieces >= cuts ? pieces - cuts : 0;
      put_entry(words, at, CORE_LUT_ENTRY(last, shift));
      unit_assert_fault(core_lut_check(words, count), possible && pieces >= cuts ? NULL : "table",
                        0);
      put_entry(words, at, CORE_LUT_ENTRY(last + 1, shift));
      unit_assert_fault(core_lut_check(words, count), "table", 0);
      put_entry(words, at, CORE_LUT_ENTRY(UINT32_MAX / 32, shift));
      unit_assert_fault(core_lut_check(words, count), "table", 0);
    }
    memcpy(&words[at], &profile.lut[at], sizeof words[at]);
  }
  unit_accept(core_lut_check(words, count));
  free(words);
  core_profile_free(&profile);
}
