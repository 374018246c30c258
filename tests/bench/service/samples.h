/* samples: keeps the time of every request, so that percentiles are exact. */
#ifndef DIPOLED_BENCH_SERVICE_SAMPLES_H
#define DIPOLED_BENCH_SERVICE_SAMPLES_H

#include <stddef.h>
#include <stdint.h>

struct samples {
  uint64_t *ns;
  size_t count;
  size_t capacity;
};

/* Before the first call, set all fields of a struct samples to 0. samples_clear() keeps the memory
 * for the next samples; samples_free() frees it. */
void samples_clear(struct samples *samples);
void samples_free(struct samples *samples);

void samples_add(struct samples *samples, uint64_t ns);

void samples_sort(struct samples *samples);

/* Returns a percentile in us, for example the median for share 0.5: the smallest time that this
 * share of the samples does not exceed. share is in (0, 1]; there is at least one sample, and they
 * are sorted. */
double samples_us(const struct samples *samples, double share);

#endif
