/* Checks tables that were built elsewhere, and makes profiles from them. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/kernels.h"
#include "core/lut/piece.h"

core_radii_range core_table_pieces(const core_profile *profile) {
  return (core_radii_range){(double)profile->lut[CORE_LUT_FIRST_MM],
                            (double)profile->lut[CORE_LUT_LAST_MM]};
}

bool core_table_has(enum core_quantity quantity) {
  const bool one = (quantity & (quantity - 1)) == 0;
  return one && (quantity & (CORE_QUANTITY_R | CORE_QUANTITY_CDF | CORE_MULTIPLES)) != 0;
}

/* Returns the exponent of the least radius of the samples. A peer may have sent any bits: the
 * result is within the exponents of a double. */
static int samples_exponent(const core_profile *profile) {
  return profile->evaluator != CORE_EVALUATOR_LUT
             ? ilogb(profile->scale_mm) - CORE_LUT_SCALE_OCTAVE
             : (int)(core_cells_bits(profile->lut[CORE_LUT_SAMPLES_MM]) >> 23 & 0xff) - 127;
}

void core_lut_samples(const core_profile *profile, double *r, double *R) {
  for (size_t i = 0; i < CORE_LUT_SAMPLES; i++) {
    const size_t n = (size_t)1 << CORE_LUT_OCTAVE_SAMPLES_LOG2;
    r[i] = ldexp(1 + (double)(i % n) / (double)n, samples_exponent(profile) + (int)(i / n));
  }
  r[CORE_LUT_SAMPLES - 1] = 0;
  if (profile->evaluator == CORE_EVALUATOR_LUT) {
    memcpy(R, profile->lut + profile->lut_count - CORE_LUT_SAMPLE_WORDS,
           CORE_LUT_SAMPLES * sizeof *R);
  } else {
    core_eval_any(profile, CORE_QUANTITY_R, CORE_LUT_SAMPLES, r, R);
  }
}

core_fault core_lut_check(const float *words, size_t count) {
  const core_fault fault = {"table", "an intact table", 0};
  const size_t others = CORE_LUT_PIECES + CORE_LUT_SAMPLE_WORDS;
  if (count < others + CORE_LUT_TERMS || count % CORE_LUT_TERMS != 0 ||
      count > CORE_LUT_WORDS_MAX) {
    return fault;
  }
  const size_t pieces = (count - others) / CORE_LUT_TERMS;
  for (size_t i = CORE_LUT_R_OCTAVES; i < CORE_LUT_PIECES; i++) {
    const uint32_t entry = core_cells_bits(words[i]);
    if (!core_cells_hold(CORE_LUT_ENTRY_PIECE(entry),
                         CORE_LUT_MANTISSA_BITS - CORE_LUT_ENTRY_SHIFT(entry), CORE_LUT_CUTS_MAX,
                         pieces)) {
      return fault;
    }
  }
  return (core_fault){0};
}

core_fault core_profile_from_table(core_profile *profile, const core_isa *isa, const float *words,
                                   size_t count) {
  const core_fault fault = core_lut_check(words, count);
  if (fault.field != NULL) {
    return fault;
  }
  float *copy = malloc(count * sizeof *copy);
  if (copy == NULL) {
    return CORE_OUT_OF_MEMORY;
  }
  memcpy(copy, words, count * sizeof *copy);
  profile->evaluator = CORE_EVALUATOR_LUT;
  profile->cost = 1;
  profile->kernels = core_isa_lut_kernels(isa);
  profile->lut = copy;
  profile->lut_count = count;
  profile->cos_in = profile->cos_out = 1;
  profile->scale_mm = ldexp(1, samples_exponent(profile) + CORE_LUT_SCALE_OCTAVE);
  return (core_fault){0};
}
