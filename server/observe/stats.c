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
#define INDEX_OF(id, IDENT, ...) [id] = STATS_RADII_##IDENT,
  static const uint16_t index_of[] = {CORE_EACH_MODEL(INDEX_OF, INDEX_OF)};
  stats_add(stats, (enum stats_index)index_of[model], radii);
}
