/* stats: the counters of the daemon's threads. Counting takes a worker neither a lock nor a locked
 * instruction. server/observe/report.h gives the counters their names. */
#ifndef DIPOLED_STATS_H
#define DIPOLED_STATS_H

#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>

#include "core/models.def"

enum stats_index {
#define SERVER_STATISTIC(IDENT, name, type, help) STATS_##IDENT,
#include "server/observe/stats.def"
#define WIRE_MESSAGE(type, IDENT, name, ...) STATS_REQUESTS_##IDENT,
#include "proto/messages.def"
#define WIRE_STATUS(code, IDENT, modbus_exception, http, scpi, name, text) STATS_REPLIES_##IDENT,
#include "proto/statuses.def"
#undef WIRE_STATUS
  STATS_RADII, /* first counter of the radii by model */
  STATS_RADII_BEFORE = STATS_RADII - 1,
#define STATS_RADII_OF(id, IDENT, ...) STATS_RADII_##IDENT,
  CORE_EACH_MODEL(STATS_RADII_OF, STATS_RADII_OF) STATS_COUNT
};

/* Each worker has its own shard, which no other thread writes. All other threads share the
 * first shard. A counter's value is its sum over all shards. */
enum { STATS_SHARDS = 67 };

struct stats_shard {
  _Alignas(64) _Atomic uint64_t values[STATS_COUNT];
};

struct stats {
  struct stats_shard shards[STATS_SHARDS];
};

/* The number of this thread's shard. It is 0 until the thread calls stats_claim(). */
extern _Thread_local unsigned stats_shard;

/* Gives this thread a shard, from 1 to STATS_SHARDS - 1, that no other thread has. */
static inline void stats_claim(unsigned number) {
  stats_shard = number;
}

static inline void stats_add(struct stats *stats, enum stats_index index, uint64_t amount) {
  _Atomic uint64_t *value = &stats->shards[stats_shard].values[index];
  if (stats_shard == 0) {
    atomic_fetch_add_explicit(value, amount, memory_order_relaxed);
  } else {
    atomic_store_explicit(value, atomic_load_explicit(value, memory_order_relaxed) + amount,
                          memory_order_relaxed);
  }
}

static inline void stats_subtract(struct stats *stats, enum stats_index index, uint64_t amount) {
  stats_add(stats, index, UINT64_C(0) - amount);
}

/* Sets this worker's share of a gauge, whose value is the sum over all workers. */
static inline void stats_set(struct stats *stats, enum stats_index index, uint64_t value) {
  atomic_store_explicit(&stats->shards[stats_shard].values[index], value, memory_order_relaxed);
}

static inline uint64_t stats_get(const struct stats *stats, enum stats_index index) {
  uint64_t sum = 0;
  for (size_t i = 0; i < STATS_SHARDS; i++) {
    sum += atomic_load_explicit(&stats->shards[i].values[index], memory_order_relaxed);
  }
  return sum;
}

void stats_count_reply(struct stats *stats, unsigned status); /* of proto/statuses.def */
void stats_count_radii(struct stats *stats, unsigned model,
                       uint64_t radii); /* of core/models.def */

#endif
