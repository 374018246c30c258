/* server: what all threads of the daemon share. Set up by main before the threads start; after that
 * only the statistics change. */
#ifndef DIPOLED_SERVER_H
#define DIPOLED_SERVER_H

#include <uv.h>

#include "core/core.h"
#include "server/options.h"
#include "server/observe/stats.h"

struct cache;
struct latency;
struct mc_pool;
struct modbus_service;
struct worker;

struct server {
  struct options options;
  const core_isa *isa;
  struct stats stats;
  _Atomic uint64_t buffer_bytes; /* of all connections */
  uint64_t started_ns;
  struct worker *workers;        /* [options.workers] */
  struct latency *latencies;     /* [options.workers], each counted by its worker */
  struct cache *cache;           /* prepared profiles */
  struct mc_pool *mc;            /* Monte Carlo jobs */
  struct modbus_service *modbus; /* NULL: not asked for */
  uv_async_t inherited_closed;   /* on main's loop: the connection of --fd is gone */
};

/* Takes bytes from the budget of all buffers (--max-total-bytes); false, and nothing is taken, when
 * they are not there. */
static inline bool server_take_bytes(struct server *server, uint64_t bytes) {
  if (atomic_fetch_add(&server->buffer_bytes, bytes) + bytes <= server->options.max_total_bytes) {
    return true;
  }
  atomic_fetch_sub(&server->buffer_bytes, bytes);
  return false;
}

/* The same without asking, for the first buffers of a connection: their number is bounded already,
 * and with them small requests and errors are answered whatever large ones hold. */
static inline void server_take_base_bytes(struct server *server, uint64_t bytes) {
  atomic_fetch_add(&server->buffer_bytes, bytes);
}

static inline void server_return_bytes(struct server *server, uint64_t bytes) {
  atomic_fetch_sub(&server->buffer_bytes, bytes);
}

#endif
