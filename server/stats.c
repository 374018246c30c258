#include "server/stats.h"

_Thread_local unsigned stats_shard;

static const char *const names[STATS_COUNT] = {
#define SERVER_STATISTIC(IDENT, name) name,
#include "server/stats.def"
#undef SERVER_STATISTIC
#define WIRE_MESSAGE(type, IDENT, name) "requests_" name,
#include "proto/messages.def"
#define WIRE_STATUS(code, IDENT, modbus_exception, name, text) "answers_" name,
#include "proto/statuses.def"
#undef WIRE_STATUS
};

void stats_count_request(struct stats *stats, unsigned type) {
  switch (type) {
#define WIRE_MESSAGE(type, IDENT, name)                                                            \
  case type:                                                                                       \
    stats_add(stats, STATS_REQUESTS_##IDENT, 1);                                                   \
    break;
#include "proto/messages.def"
  }
}

void stats_count_answer(struct stats *stats, unsigned status) {
  switch (status) {
#define WIRE_STATUS(code, IDENT, modbus_exception, name, text)                                     \
  case code:                                                                                       \
    stats_add(stats, STATS_ANSWERS_##IDENT, 1);                                                    \
    break;
#include "proto/statuses.def"
#undef WIRE_STATUS
  }
}

wire_value stats_value(const struct stats *stats, size_t index) {
  wire_value value = {.value = stats_get(stats, (enum stats_index)index)};
  WIRE_SET_TEXT(value.name, names[index]);
  return value;
}
