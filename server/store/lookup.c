#include "server/store/lookup.h"

#include <assert.h>

void lookup_count(const struct lookups *lookups, bool hit) {
  stats_add(&lookups->server->stats, hit ? STATS_CACHE_HITS : STATS_CACHE_MISSES, 1);
}

/* Takes an entry that is prepared or has a fault, and the caller's reference to it. */
static enum lookup_answer take_entry(struct lookup *lookup, struct cache_entry *entry) {
  lookup->fault = cache_fault(entry);
  if (lookup->fault.field != NULL) {
    cache_release(entry);
    return LOOKUP_FAULT;
  }
  lookup->entry = entry;
  return LOOKUP_READY;
}

static enum lookup_answer look_up(struct lookups *lookups, struct lookup *lookup,
                                  const struct cache_key *key, bool slow, bool counted) {
  static const core_fault unknown = {LOOKUP_FIELD_UNKNOWN,
                                     "sets of points that were sent to this daemon and are kept",
                                     0},
                          busy = {LOOKUP_FIELD_BUSY, "fewer profiles that wait at a time", 0},
                          no_memory = {CORE_FIELD_MEMORY,
                                       "less than the memory that is free: try again", 0};
  struct cache *cache = lookups->server->cache;
  struct cache_entry *entry;
  const enum cache_answer answer =
      cache_look(cache, key, slow, lookup->owner, &lookups->queue, &lookup->waiter, &entry);
  if (counted) {
    lookup_count(lookups, answer == CACHE_KEPT);
  }
  switch (answer) {
  case CACHE_NEW:
    cache_prepare(entry);
    return take_entry(lookup, entry);
  case CACHE_KEPT:
    return take_entry(lookup, entry);
  case CACHE_AWAITED:
    cache_prepare_in_pool(cache, lookups->loop);
    return LOOKUP_WAIT;
  case CACHE_UNKNOWN:
  case CACHE_BUSY:
  case CACHE_NO_MEMORY:
    break;
  }
  lookup->fault = answer == CACHE_UNKNOWN ? unknown : answer == CACHE_BUSY ? busy : no_memory;
  return LOOKUP_FAULT;
}

/* Takes the entry for which the job waited. It is valid even if it has been evicted since. */
static enum lookup_answer take_awaited(struct lookup *lookup) {
  assert(lookup->woken);
  struct cache_entry *entry = lookup->waiter.entry;
  cache_hold(entry);
  cache_leave(&lookup->waiter);
  lookup->woken = false;
  return take_entry(lookup, entry);
}

enum lookup_answer lookup_get(struct lookups *lookups, struct lookup *lookup,
                              const struct cache_key *key, bool slow, bool counted) {
  assert(lookup->entry == NULL);
  const enum lookup_answer answer = lookup->waiter.entry != NULL
                                        ? take_awaited(lookup)
                                        : look_up(lookups, lookup, key, slow, counted);
  lookup->waiter.admitted |= answer != LOOKUP_FAULT;
  return answer;
}

bool lookup_is_busy(core_fault fault) {
  return strcmp(fault.field, CORE_FIELD_MEMORY) == 0 || strcmp(fault.field, LOOKUP_FIELD_BUSY) == 0;
}

bool lookup_is_unknown(core_fault fault) {
  return strcmp(fault.field, LOOKUP_FIELD_UNKNOWN) == 0;
}

void lookups_wake(struct lookups *lookups) {
  struct cache_waiter *waiter;
  while ((waiter = cache_next_woken(lookups->server->cache, &lookups->queue)) != NULL) {
    struct lookup *lookup = (void *)((char *)waiter - offsetof(struct lookup, waiter));
    lookup->woken = true;
    lookup->on_ready(lookup->context);
  }
}
