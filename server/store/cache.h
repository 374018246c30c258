/* cache: prepared profiles by content, shared by all workers, bounded in bytes.
 *
 * An entry is a profile that is being prepared or has been; once prepared nothing of it changes.
 * It is freed when nobody refers to it any more: the cache's own table, the threads that keep it at
 * hand, the jobs that evaluate it or wait for it. So what is evicted may still be in use, and is
 * then not counted any more.
 *
 * Whoever asks first for a profile has it prepared; all who ask meanwhile wait for the same entry
 * and are woken. A fault goes to all of them and is not kept.
 *
 * Threading: one mutex guards the table, the order of eviction and the waiting; nothing is prepared
 * or freed under it. Profiles are evaluated without it, and entries that a thread keeps at hand
 * (server/store/profiles.h) are found without it.
 *
 * Eviction: least recently used first, in two lists. Profiles that are fast to prepare may hold a
 * quarter of all bytes and no more, so that a stream of them leaves three quarters to those that
 * took long. A use that the cache does not see, of an entry kept at hand, is a mark in the entry
 * that moves it to the head of its list when it comes to be evicted.
 */
#ifndef DIPOLED_CACHE_H
#define DIPOLED_CACHE_H

#include "server/store/cache_key.h"
#include "server/observe/stats.h"

struct cache;
struct cache_entry;
struct cache_waiter;

/* Of a thread that waits for entries. `wake` is called on any thread whenever cache_next_woken()
 * has something new; it may not call the cache. */
struct cache_queue {
  void (*wake)(void *context);
  void *context;
  struct cache_waiter *woken;
};

/* Somebody on that thread who waits for one entry; all 0 while nothing is waited for. */
struct cache_waiter {
  struct cache_entry *entry;
  struct cache_queue *queue;
  struct cache_waiter *next;
  struct cache_waiter **link; /* what points here; NULL: it is in no list */
};

/* NULL: out of memory. At most limit_bytes of prepared profiles are kept. */
struct cache *cache_new(const core_isa *isa, uint64_t limit_bytes, struct stats *stats);

/* Nothing is under way and all references have been released (asserted). */
void cache_free(struct cache *cache);

enum cache_answer {
  CACHE_KEPT,    /* *entry is prepared */
  CACHE_NEW,     /* *entry is to be prepared by the caller, now if it is fast; if it is slow on some
                    other thread, and the waiter waits for it */
  CACHE_AWAITED, /* another prepares it, and the waiter waits for it */
  CACHE_NO_MEMORY,
};

/* Looks for a profile. KEPT, NEW: *entry is a reference, to be released. NEW, AWAITED: `waiter` was
 * all 0, and belongs to `queue` from now on, unless it is NEW and fast. */
enum cache_answer cache_look(struct cache *cache, const struct cache_key *key, bool slow,
                             struct cache_queue *queue, struct cache_waiter *waiter,
                             struct cache_entry **entry);

/* Prepares a NEW entry, on any thread, and wakes all who wait for it. A slow one for which nobody
 * waits any more is not prepared: it is a fault that nobody sees. */
void cache_prepare(struct cache_entry *entry);

/* A waiter of this queue whose entry has been prepared, or has a fault; NULL: there is none. */
struct cache_waiter *cache_next_woken(struct cache *cache, struct cache_queue *queue);

/* It waits no more, whether it has been woken or not, and is all 0 again. */
void cache_leave(struct cache_waiter *waiter);

/* Of an entry that is KEPT, has been prepared by the caller, or that a waiter was woken for. The
 * profile is there when the fault's field is NULL, and lives as long as the reference. */
const core_profile *cache_profile(const struct cache_entry *entry);
core_fault cache_fault(const struct cache_entry *entry);

/* False: it is not in the cache, or not any more. Nobody should keep it at hand then. */
bool cache_keeps(const struct cache_entry *entry);
bool cache_is(const struct cache_entry *entry, const struct cache_key *key);

/* One more reference; one less. */
void cache_hold(struct cache_entry *entry);
void cache_release(struct cache_entry *entry);

/* It has been found without the cache's help: may be called by all who hold it, at any time. */
void cache_used(struct cache_entry *entry);

#endif
