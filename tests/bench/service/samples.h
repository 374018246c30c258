/* samples: times of requests, all kept, so that percentiles are exact. */
#ifndef DIPOLED_BENCH_SERVICE_SAMPLES_H
#define DIPOLED_BENCH_SERVICE_SAMPLES_H

#include <stddef.h>
#include <stdint.h>

struct samples {
  uint64_t *ns;
  size_t count;
  size_t capacity;
};

/* All 0 is none. */
void samples_clear(struct samples *samples); /* keeps the memory */
void samples_free(struct samples *samples);

void samples_add(struct samples *samples, uint64_t ns);

void samples_sort(struct samples *samples);

/* The smallest time that a share of the samples (above 0, up to 1) does not exceed, in us, of
 * sorted samples, of which there is at least one. */
double samples_us(const struct samples *samples, double share);

#endif
