/* server: the state that all threads of the daemon share. main() sets it up before the threads
 * start. After that, only the atomic members and the objects behind the pointers change. */
#ifndef DIPOLED_SERVER_H
#define DIPOLED_SERVER_H

#include <stdlib.h>
#include <uv.h>

#include "core/core.h"
#include "server/net/access.h"
#include "server/observe/stats.h"
#include "server/options.h"

struct cache;
struct handshakes;
struct latency;
struct mc_pool;
struct modbus_service;
struct tls;
struct worker;

/* Memory for buffers: of all connections, or a share of it for some of them. */
struct budget {
  _Atomic uint64_t bytes; /* in use */
  uint64_t most;
  struct budget *whole; /* the budget that this one is a share of; NULL: none */
};

struct server {
  struct options options;
  struct access allow;      /* addresses that may use the binary protocol over TCP */
  struct access scpi_allow; /* likewise for SCPI */
  const core_isa *isa;
  struct stats stats;
  struct budget buffers;              /* budget of all connections (--max-total-bytes) */
  _Atomic uint64_t points_sent_bytes; /* bytes of sets of points that are not complete yet */
  uint64_t started_ns;
  _Atomic bool draining;         /* whether the daemon stops and accepts no clients */
  _Atomic uint64_t refused_ms;   /* when capacity was last lacking, by uv_hrtime(); 0: never */
  struct worker *workers;        /* [server_worker_count()] */
  struct latency *latencies;     /* [server_worker_count()]; each worker writes its own element */
  struct cache *cache;           /* prepared profiles */
  struct mc_pool *mc;            /* pool of threads for Monte Carlo jobs */
  struct modbus_service *modbus; /* NULL without --modbus */
  struct tls *tls;               /* NULL without --listen tls: */
  struct handshakes *handshakes; /* NULL without --listen tls: */
  uv_async_t inherited_closed;   /* of main's loop: sent when the connection of --fd has ended */
};

/* Returns the number of workers. Behind those that evaluate there is one that serves HTTP alone, if
 * that is requested, and then one for the handshakes of TLS alone. */
static inline uint64_t server_worker_count(const struct server *server) {
  return server->options.workers + (server->options.http != NULL) + (server->tls != NULL);
}

/* Takes bytes. If too few are left, takes none and returns false. */
static inline bool budget_take(struct budget *budget, uint64_t bytes) {
  if (atomic_fetch_add(&budget->bytes, bytes) + bytes <= budget->most &&
      (budget->whole == NULL || budget_take(budget->whole, bytes))) {
    return true;
  }
  atomic_fetch_sub(&budget->bytes, bytes);
  return false;
}

/* Counts the first buffers of a connection, even beyond the budget, so that small requests and
 * errors are reported however much memory large requests hold. The limits of connections bound
 * these buffers. */
static inline void budget_take_base(struct budget *budget, uint64_t bytes) {
  for (; budget != NULL; budget = budget->whole) {
    atomic_fetch_add(&budget->bytes, bytes);
  }
}

static inline void budget_return(struct budget *budget, uint64_t bytes) {
  for (; budget != NULL; budget = budget->whole) {
    atomic_fetch_sub(&budget->bytes, bytes);
  }
}

/* Resizes memory that counts, as realloc(): from `before` bytes to `bytes`, of which up to `base` are
 * had even beyond the budget. Returns NULL, and changes nothing, if there is no memory. */
static inline void *budget_resize(struct budget *budget, void *memory, size_t before, size_t bytes,
                                  size_t base) {
  const size_t more = bytes > before ? bytes - before : 0;
  if (bytes <= base) {
    budget_take_base(budget, more);
  } else if (more > 0 && !budget_take(budget, more)) {
    return NULL;
  }
  void *resized = realloc(memory, bytes);
  budget_return(budget, resized == NULL ? more : before + more - bytes);
  return resized;
}

#endif
