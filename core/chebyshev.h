/* chebyshev: series of Chebyshev polynomials, and how tables of series pack their integers. */
#ifndef DIPOLED_CORE_CHEBYSHEV_H
#define DIPOLED_CORE_CHEBYSHEV_H

#include <stddef.h>
#include <stdint.h>

/* Sets values[count] to T_0(s), T_1(s), ...; count: at least 2. */
static inline void core_chebyshev_polynomials(size_t count, double s, double *values) {
  values[0] = 1;
  values[1] = s;
  for (size_t k = 2; k < count; k++) {
    values[k] = 2 * s * values[k - 1] - values[k - 2];
  }
}

/* Returns the sum of terms[k] T_k(s), by Clenshaw's recurrence (1955). */
static inline double core_chebyshev_sum(size_t count, const double *terms, double s) {
  double next = 0, after = 0;
  for (size_t k = count - 1; k >= 1; k--) {
    const double sum = terms[k] + 2 * s * next - after;
    after = next;
    next = sum;
  }
  return terms[0] + s * next - after;
}

/* Returns the integer at *at, and moves *at behind it: in zigzag order (0, -1, 1, -2, ... are 0, 1, 2, 3,
 * ...), seven bits to a byte, the lowest first; the eighth bit of a byte is set if another byte follows. */
static inline int64_t core_packed_integer(const uint8_t **at) {
  uint64_t zigzag = 0;
  for (int shift = 0;; shift += 7) {
    const uint8_t byte = *(*at)++;
    zigzag |= (uint64_t)(byte & 0x7f) << shift;
    if (byte < 0x80) {
      return (int64_t)(zigzag >> 1) ^ -(int64_t)(zigzag & 1);
    }
  }
}

#endif
