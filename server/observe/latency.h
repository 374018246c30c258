/* latency: measures how long requests take. A latency begins when the worker has read the request's
 * last byte from the socket. It ends when all parts of the reply have been written to the socket
 * or, for a slow reader, are ready to be written.
 *
 * The worker reads the clock once when a round of its loop first reads, and once at the end of the
 * round, or for every 64 requests.
 *
 * Histograms like HdrHistogram (G. Tene) hold the latencies: each octave of durations has 32
 * buckets of equal width. So every duration from 1 us to 100 s is known to within 1.6 %, in
 * constant memory.
 */
#ifndef DIPOLED_LATENCY_H
#define DIPOLED_LATENCY_H

#include <stdatomic.h>
#include <stdint.h>

/* ---- histograms ------------------------------------------------------------------------------ */

enum {
  HISTOGRAM_SPLIT = 32,        /* number of buckets in an octave */
  HISTOGRAM_LEAST_OCTAVE = 10, /* from 2^10 ns; buckets below are as wide as in this octave */
  HISTOGRAM_MOST_OCTAVE = 36,  /* to 2^37 ns, 137 s; the last bucket has all longer durations */
  HISTOGRAM_BUCKETS = (HISTOGRAM_MOST_OCTAVE - HISTOGRAM_LEAST_OCTAVE + 2) * HISTOGRAM_SPLIT,
};

/* A histogram of durations. All members start as 0. One thread adds to it, without locks or locked
 * instructions. Any other thread may merge it meanwhile. */
struct histogram {
  _Atomic uint64_t counts[HISTOGRAM_BUCKETS];
  _Atomic uint64_t sum_ns;
  _Atomic uint64_t most_ns;
};

/* The sum of several histograms. All members start as 0. */
struct histogram_sum {
  uint64_t counts[HISTOGRAM_BUCKETS];
  uint64_t count;
  uint64_t sum_ns;
  uint64_t most_ns; /* the longest duration, exact */
};

/* Adds `count` durations of `ns` each. */
void histogram_add(struct histogram *histogram, uint64_t ns, uint64_t count);

void histogram_merge(struct histogram_sum *sum, const struct histogram *histogram);

/* Returns a quantile: the duration that this share of all durations (above 0, up to 1) does not
 * exceed. The result is the middle of a bucket, or the longest duration if that is less; 0 if there
 * are no durations. It does not fall as the share rises. */
uint64_t histogram_quantile_ns(const struct histogram_sum *sum, double share);

/* Returns how many durations were less than 2^octave ns, from HISTOGRAM_LEAST_OCTAVE to
 * HISTOGRAM_MOST_OCTAVE: an exact number, because octaves begin with a bucket. */
uint64_t histogram_below(const struct histogram_sum *sum, unsigned octave);

/* ---- latencies of one worker ----------------------------------------------------------------- */

enum latency_class {
#define LATENCY_CLASS(IDENT, name, about) LATENCY_##IDENT,
#include "server/observe/stats.def"
  LATENCY_CLASSES,
  LATENCY_NONE = LATENCY_CLASSES
};

enum { LATENCY_REPLIES = 64 };

/* A request that is served in the current round. */
struct latency_reply {
  enum latency_class kind;
  uint64_t arrived_ns;
};

/* The latencies of one worker. All members start as 0. Other threads may read the histograms. */
struct latency {
  unsigned count;
  struct latency_reply replies[LATENCY_REPLIES];
  struct histogram histograms[LATENCY_CLASSES];
};

/* Notes that a request that arrived at arrived_ns is served in the current round, unless its class
 * is NONE. */
void latency_note(struct latency *latency, enum latency_class kind, uint64_t arrived_ns);

/* Adds the latencies of the current round, whose replies have been written, to the histograms. */
void latency_finish(struct latency *latency);

#endif
