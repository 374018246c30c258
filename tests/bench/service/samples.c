#include "tests/bench/service/samples.h"

#include <math.h>
#include <stdlib.h>

#include "tests/bench/bench.h"

enum { FIRST_CAPACITY = 1 << 20 };

void samples_clear(struct samples *samples) {
  samples->count = 0;
}

void samples_free(struct samples *samples) {
  free(samples->ns);
  *samples = (struct samples){0};
}

void samples_add(struct samples *samples, uint64_t ns) {
  if (samples->count == samples->capacity) {
    const size_t capacity = samples->capacity > 0 ? 2 * samples->capacity : FIRST_CAPACITY;
    uint64_t *larger = realloc(samples->ns, capacity * sizeof *larger);
    if (larger == NULL) {
      bench_fail("out of memory");
    }
    samples->ns = larger;
    samples->capacity = capacity;
  }
  samples->ns[samples->count++] = ns;
}

static int compare(const void *a, const void *b) {
  const uint64_t x = *(const uint64_t *)a;
  const uint64_t y = *(const uint64_t *)b;
  return (x > y) - (x < y);
}

void samples_sort(struct samples *samples) {
  qsort(samples->ns, samples->count, sizeof *samples->ns, compare);
}

double samples_us(const struct samples *samples, double share) {
  if (samples->count == 0) {
    bench_fail("nothing was answered");
  }
  const size_t rank = (size_t)ceil(share * (double)samples->count);
  return (double)samples->ns[rank > 0 ? rank - 1 : 0] * 1e-3;
}
