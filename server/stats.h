/* stats: the daemon's counters and gauges, shared by all threads. */
#ifndef DIPOLED_STATS_H
#define DIPOLED_STATS_H

#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>

#include "proto/wire.h"

enum stats_index {
#define SERVER_STATISTIC(IDENT, name) STATS_##IDENT,
#include "server/stats.def"
#undef SERVER_STATISTIC
#define WIRE_MESSAGE(type, IDENT, name) STATS_REQUESTS_##IDENT,
#include "proto/messages.def"
#define WIRE_STATUS(code, IDENT, modbus_exception, name, text) STATS_ANSWERS_##IDENT,
#include "proto/statuses.def"
#undef WIRE_STATUS
  STATS_COUNT
};

struct stats {
  _Atomic uint64_t values[STATS_COUNT];
};

static inline void stats_add(struct stats *stats, enum stats_index index, uint64_t amount) {
  atomic_fetch_add_explicit(&stats->values[index], amount, memory_order_relaxed);
}

static inline void stats_subtract(struct stats *stats, enum stats_index index, uint64_t amount) {
  atomic_fetch_sub_explicit(&stats->values[index], amount, memory_order_relaxed);
}

static inline uint64_t stats_get(const struct stats *stats, enum stats_index index) {
  return atomic_load_explicit(&stats->values[index], memory_order_relaxed);
}

void stats_count_request(struct stats *stats, unsigned type);  /* a type of the list */
void stats_count_answer(struct stats *stats, unsigned status); /* a status of the list */

/* index < STATS_COUNT: the name on the wire, and the value now. */
wire_value stats_value(const struct stats *stats, size_t index);

#endif
