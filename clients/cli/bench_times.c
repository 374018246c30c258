#include <math.h>

#include "clients/cli/bench.h"

/* Up to an octave of whole ns each has a bucket; from there on a 64th of an octave. */
static size_t bucket_of(uint64_t ns) {
  if (ns < BENCH_OCTAVE) {
    return (size_t)ns;
  }
  const unsigned octave = 63U - (unsigned)__builtin_clzll(ns) - 6; /* 2^6 = BENCH_OCTAVE */
  const size_t bucket = (size_t)octave * BENCH_OCTAVE + (size_t)(ns >> octave);
  return bucket < BENCH_BUCKETS ? bucket : BENCH_BUCKETS - 1;
}

/* In the middle of it. */
static double ns_of(size_t bucket) {
  if (bucket < BENCH_OCTAVE) {
    return (double)bucket;
  }
  const int octave = (int)(bucket / BENCH_OCTAVE) - 1;
  return ldexp((double)(bucket - (size_t)octave * BENCH_OCTAVE) + 0.5, octave);
}

void bench_times_add(bench_times *times, uint64_t ns) {
  times->buckets[bucket_of(ns)]++;
  times->count++;
  times->most_ns = ns > times->most_ns ? ns : times->most_ns;
}

void bench_times_join(bench_times *times, const bench_times *more) {
  for (size_t i = 0; i < BENCH_BUCKETS; i++) {
    times->buckets[i] += more->buckets[i];
  }
  times->count += more->count;
  times->most_ns = more->most_ns > times->most_ns ? more->most_ns : times->most_ns;
}

double bench_times_quantile_us(const bench_times *times, double share) {
  const double wanted = ceil(share * (double)times->count);
  double before = 0;
  for (size_t i = 0; i < BENCH_BUCKETS; i++) {
    before += times->buckets[i];
    if (times->buckets[i] > 0 && before >= wanted) {
      return fmin(ns_of(i), (double)times->most_ns) / 1000;
    }
  }
  return 0;
}
