/* histogram: how often durations were how long, in the form of an HdrHistogram (G. Tene): buckets as
 * wide as a 32nd of the octave that they lie in, so that every duration from 1 us to 100 s is known
 * to within 1.6 %, in memory that does not grow.
 *
 * One thread adds, without locks or locked instructions; any other may merge meanwhile.
 */
#ifndef DIPOLED_HISTOGRAM_H
#define DIPOLED_HISTOGRAM_H

#include <stdatomic.h>
#include <stdint.h>

enum {
  HISTOGRAM_SPLIT = 32,        /* buckets of an octave */
  HISTOGRAM_LEAST_OCTAVE = 10, /* 2^10 ns: below, buckets are as wide as in this one */
  HISTOGRAM_MOST_OCTAVE = 36,  /* to 2^37 ns, 137 s; what takes longer is in the last bucket */
  HISTOGRAM_BUCKETS = (HISTOGRAM_MOST_OCTAVE - HISTOGRAM_LEAST_OCTAVE + 2) * HISTOGRAM_SPLIT,
};

/* Starts all 0. */
struct histogram {
  _Atomic uint64_t counts[HISTOGRAM_BUCKETS];
  _Atomic uint64_t sum_ns;
  _Atomic uint64_t most_ns;
};

/* What several histograms hold together; starts all 0. */
struct histogram_sum {
  uint64_t counts[HISTOGRAM_BUCKETS];
  uint64_t count;
  uint64_t sum_ns;
  uint64_t most_ns; /* exact */
};

/* So many durations of ns each; always on the same thread. */
void histogram_add(struct histogram *histogram, uint64_t ns, uint64_t count);

void histogram_merge(struct histogram_sum *sum, const struct histogram *histogram);

/* The duration that a share (above 0, to 1) of all do not exceed: the middle of its bucket, or the
 * longest of all if that is less. 0 when there are none. Does not fall as the share rises. */
uint64_t histogram_quantile_ns(const struct histogram_sum *sum, double share);

#endif
