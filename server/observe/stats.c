#include "server/observe/stats.h"

_Thread_local unsigned stats_shard;

#define WIRE_STATUS(code, IDENT, modbus_exception, http, scpi, name, text)                         \
  _Static_assert(STATS_REPLIES_##IDENT == STATS_REPLIES_OK + (code), "in the order of their "      \
                                                                     "codes");
#include "proto/statuses.def"
#undef WIRE_STATUS

void stats_count_reply(struct stats *stats, unsigned status) {
  stats_add(stats, (enum stats_index)(STATS_REPLIES_OK + status), 1);
}

void stats_count_radii(struct stats *stats, unsigned model, uint64_t radii) {
  static const uint16_t index_of[] = {
#define CORE_MODEL(id, IDENT, name, formula, kernels, variant, parameters, source)                 \
  [id] = STATS_RADII_##IDENT,
#define CORE_SUM(id, IDENT, name, FIRST, SECOND, source) [id] = STATS_RADII_##IDENT,
#include "core/models.def"
  };
  stats_add(stats, (enum stats_index)index_of[model], radii);
}
