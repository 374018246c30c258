/* Checks a table that a peer or a file has given: every entry must point to pieces inside of it. */
#include <math.h>

#include "core/lut/piece.h"

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
