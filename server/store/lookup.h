/* lookup: a worker's end of the cache, by which its jobs look things of any kind up, wait for them
 * and are woken.
 */
#ifndef DIPOLED_LOOKUP_H
#define DIPOLED_LOOKUP_H

#include "server/server.h"
#include "server/store/cache.h"

/* What all lookups of one worker share; only its thread uses it. */
struct lookups {
  struct server *server;
  uv_loop_t *loop;
  struct cache_queue queue;
};

/* A job's lookup of one thing after the other. Before the first, set on_ready, context and owner, and
 * all other members to 0. */
struct lookup {
  void (*on_ready)(void *context); /* called after LOOKUP_WAIT: look the same thing up again */
  void *context;
  struct cache_owner *owner; /* the owner whose turns are used to prepare slow things */
  struct cache_entry *entry; /* after LOOKUP_READY: a reference, until lookup_return() */
  core_fault fault;          /* after LOOKUP_FAULT: the fault */
  struct cache_waiter waiter;
  bool woken;
};

enum lookup_answer { LOOKUP_READY, LOOKUP_FAULT, LOOKUP_WAIT };

/* Looks a thing up, which is prepared if it has to be: here, unless it is slow. counted: whether the
 * statistics of the cache count that. */
enum lookup_answer lookup_get(struct lookups *lookups, struct lookup *lookup,
                              const struct cache_key *key, bool slow, bool counted);

/* Returns what LOOKUP_READY has found; NULL if there is nothing. */
static inline const void *lookup_thing(const struct lookup *lookup) {
  return lookup->entry != NULL ? cache_thing(lookup->entry) : NULL;
}

/* Releases the thing, or gives up waiting for it. Does nothing if there is neither. */
static inline void lookup_return(struct lookup *lookup) {
  if (lookup->entry != NULL) {
    cache_release(lookup->entry);
    lookup->entry = NULL;
  }
  if (lookup->waiter.entry != NULL) {
    cache_leave(&lookup->waiter);
  }
  lookup->woken = false;
}

/* Counts in the statistics of the cache. */
void lookup_count(const struct lookups *lookups, bool hit);

/* The fields of faults: the owner has max_waiting_profiles waiters already; the thing is not there
 * and cannot be prepared here. */
#define LOOKUP_FIELD_BUSY "max_waiting_profiles"
#define LOOKUP_FIELD_UNKNOWN "set"

/* Returns whether a fault is temporary: memory is lacking, or too much waits. */
bool lookup_is_busy(core_fault fault);

/* Returns whether a fault is LOOKUP_FIELD_UNKNOWN. */
bool lookup_is_unknown(core_fault fault);

/* Calls on_ready() for the jobs whose things have been prepared. */
void lookups_wake(struct lookups *lookups);

#endif
