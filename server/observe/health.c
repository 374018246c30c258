#include "server/observe/health.h"

#include <string.h>

#include "server/net/worker.h"
#include "server/store/cache.h"

static uint64_t now_ms(void) {
  return uv_hrtime() / 1000000;
}

enum health health_of(const struct server *server) {
  if (atomic_load(&server->draining)) {
    return HEALTH_DRAINING;
  }
  return worker_silence_ms(server->workers, server->options.workers) >= HEALTH_STALLED_MS
             ? HEALTH_STALLED
             : HEALTH_OK;
}

enum health health_readiness(const struct server *server) {
  const enum health health = health_of(server);
  const uint64_t refused_ms = atomic_load_explicit(&server->refused_ms, memory_order_relaxed);
  const bool overloaded = refused_ms != 0 && now_ms() < refused_ms + HEALTH_OVERLOAD_MS;
  return health == HEALTH_OK && overloaded ? HEALTH_OVERLOADED : health;
}

const struct health_text health_texts[] = {
    [HEALTH_OK] = {"ok", ""},
    [HEALTH_DRAINING] = {"draining", ""},
    [HEALTH_STALLED] = {"stalled", "no worker has finished a turn for 3 s"},
    [HEALTH_OVERLOADED] = {"overloaded", "a request was refused with BUSY within the last second"},
};

void health_note_refusal(struct server *server, const wire_error *error) {
  if (error->status == WIRE_STATUS_BUSY && strcmp(error->field, LOOKUP_FIELD_BUSY) != 0) {
    atomic_store_explicit(&server->refused_ms, now_ms(), memory_order_relaxed);
  }
}
