#include "server/observe/latency.h"

#include <math.h>
#include <stddef.h>
#include <uv.h>

/* ---- histograms ------------------------------------------------------------------------------ */

enum { LEAST_SHIFT = HISTOGRAM_LEAST_OCTAVE - 5 }; /* 2^5 buckets in each octave */
_Static_assert(HISTOGRAM_SPLIT == 1 << 5, "LEAST_SHIFT");

/* Returns the bucket of a duration. The octave 2^k to 2^(k+1) ns has 32 buckets of 2^(k-5) ns.
 * Below the least octave, buckets are as wide as in the least octave. */
static size_t bucket_of(uint64_t ns) {
  const uint64_t least = ns | (UINT64_C(1) << HISTOGRAM_LEAST_OCTAVE);
  const unsigned octave = 63 - (unsigned)__builtin_clzll(least);
  if (octave > HISTOGRAM_MOST_OCTAVE) {
    return HISTOGRAM_BUCKETS - 1;
  }
  const unsigned shift = octave - 5;
  return (size_t)(shift - LEAST_SHIFT) * HISTOGRAM_SPLIT + (size_t)(ns >> shift);
}

static uint64_t middle_ns(size_t bucket) {
  const size_t octave = bucket < HISTOGRAM_SPLIT ? 0 : bucket / HISTOGRAM_SPLIT - 1;
  const unsigned shift = LEAST_SHIFT + (unsigned)octave;
  const uint64_t piece = bucket - octave * HISTOGRAM_SPLIT;
  return (piece << shift) + (UINT64_C(1) << (shift - 1));
}

/* Adds to a value that only this thread writes. */
static void add_to(_Atomic uint64_t *value, uint64_t amount) {
  atomic_store_explicit(value, atomic_load_explicit(value, memory_order_relaxed) + amount,
                        memory_order_relaxed);
}

void histogram_add(struct histogram *histogram, uint64_t ns, uint64_t count) {
  add_to(&histogram->counts[bucket_of(ns)], count);
  add_to(&histogram->sum_ns, ns * count);
  if (ns > atomic_load_explicit(&histogram->most_ns, memory_order_relaxed)) {
    atomic_store_explicit(&histogram->most_ns, ns, memory_order_relaxed);
  }
}

void histogram_merge(struct histogram_sum *sum, const struct histogram *histogram) {
  for (size_t i = 0; i < HISTOGRAM_BUCKETS; i++) {
    const uint64_t count = atomic_load_explicit(&histogram->counts[i], memory_order_relaxed);
    sum->counts[i] += count;
    sum->count += count;
  }
  sum->sum_ns += atomic_load_explicit(&histogram->sum_ns, memory_order_relaxed);
  const uint64_t most_ns = atomic_load_explicit(&histogram->most_ns, memory_order_relaxed);
  sum->most_ns = most_ns > sum->most_ns ? most_ns : sum->most_ns;
}

uint64_t histogram_quantile_ns(const struct histogram_sum *sum, double share) {
  if (sum->count == 0) {
    return 0;
  }
  /* rank among the sorted durations, from 1 */
  const double rank = ceil(share * (double)sum->count);
  uint64_t below = 0;
  size_t bucket = 0;
  for (; bucket + 1 < HISTOGRAM_BUCKETS; bucket++) {
    below += sum->counts[bucket];
    if (below > 0 && (double)below >= rank) {
      break;
    }
  }
  const uint64_t ns = middle_ns(bucket);
  return bucket + 1 < HISTOGRAM_BUCKETS && ns < sum->most_ns ? ns : sum->most_ns;
}

uint64_t histogram_below(const struct histogram_sum *sum, unsigned octave) {
  uint64_t below = 0;
  const size_t end = bucket_of(UINT64_C(1) << octave);
  for (size_t bucket = 0; bucket < end; bucket++) {
    below += sum->counts[bucket];
  }
  return below;
}

/* ---- latencies ------------------------------------------------------------------------------- */

void latency_finish(struct latency *latency) {
  const uint64_t now_ns = latency->count > 0 ? uv_hrtime() : 0;
  for (unsigned i = 0; i < latency->count; i++) {
    const struct latency_reply *reply = &latency->replies[i];
    histogram_add(&latency->histograms[reply->kind], now_ns - reply->arrived_ns, 1);
  }
  latency->count = 0;
}

void latency_note(struct latency *latency, enum latency_class kind, uint64_t arrived_ns) {
  if (latency->count == LATENCY_REPLIES) {
    latency_finish(latency);
  }
  latency->replies[latency->count] = (struct latency_reply){kind, arrived_ns};
  latency->count += kind != LATENCY_NONE;
}
